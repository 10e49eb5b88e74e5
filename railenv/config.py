"""Typed settings: TOML to frozen dataclass with strict keys, dataclass to plain dict for records.

Also finds the named configurations that ship with the package: in a checkout they are the
`configs` folder beside the package, in an installed wheel they are package data.
"""

import dataclasses
import tomllib
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from railenv.errors import ArgumentError, InputFileError, unknown_name

T = TypeVar("T")

_PACKAGE = Path(__file__).resolve().parent


def configs_root() -> Path:
    """Return the folder that holds the named configurations."""
    packaged = _PACKAGE / "_configs"
    return packaged if packaged.is_dir() else _PACKAGE.parent / "configs"


def config_names(kind: str) -> list[str]:
    """List the named configurations of one kind.

    Args:
        kind: Sub-folder of `configs`, e.g. "benchmark".

    Returns:
        Names without the ending, sorted.
    """
    return sorted(path.stem for path in (configs_root() / kind).glob("*.toml"))


def config_path(kind: str, name: str) -> Path:
    """Return the file of a named configuration.

    Args:
        kind: Sub-folder of `configs`.
        name: Name without the ending.

    Raises:
        ArgumentError: No configuration has that name.
    """
    names = config_names(kind)
    if name not in names:
        raise unknown_name(f"{kind} configuration", name, names)
    return configs_root() / kind / f"{name}.toml"


def load_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises:
        InputFileError: The file cannot be read or is not TOML.
    """
    try:
        with path.open("rb") as stream:
            return tomllib.load(stream)
    except OSError as error:
        raise InputFileError(f"cannot read {path}: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputFileError(f"{path} is not valid TOML: {error}") from None


def from_mapping(cls: type[T], values: Mapping[str, Any], where: str) -> T:
    """Build a dataclass from a mapping, refusing unknown, missing and wrongly typed entries.

    Args:
        cls: Dataclass to build; nested dataclasses are built from nested mappings, lists become
            tuples, and whole numbers are accepted for floats.
        values: The entries.
        where: Names the origin in messages, e.g. the file.

    Raises:
        ArgumentError: An entry is unknown, missing or of the wrong type.
    """
    hints = typing.get_type_hints(cls)
    fields = {field.name: field for field in _fields(cls)}
    for key in values:
        if key not in fields:
            raise ArgumentError(f"{where}: {unknown_name('key', key, fields)}")
    missing = [
        name
        for name, field in fields.items()
        if name not in values
        and field.default is dataclasses.MISSING
        and field.default_factory is dataclasses.MISSING
    ]
    if missing:
        raise ArgumentError(f"{where}: missing {', '.join(missing)}; every one must be given")
    return cls(
        **{key: _convert(hints[key], value, f"{where}: {key}") for key, value in values.items()}
    )


def to_dict(instance: object) -> dict[str, Any]:
    """Return a dataclass as plain dicts, lists and scalars, ready for JSON."""
    return {field.name: _plain(getattr(instance, field.name)) for field in _fields(type(instance))}


def _fields(cls: type) -> tuple["dataclasses.Field[Any]", ...]:
    if not dataclasses.is_dataclass(cls):
        raise TypeError(f"{cls} is not a dataclass")
    return dataclasses.fields(cls)


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return to_dict(value)
    if isinstance(value, tuple | list):
        return [_plain(item) for item in typing.cast("list[Any]", value)]
    return value


def _convert(hint: Any, value: Any, where: str) -> Any:
    origin = typing.get_origin(hint)
    if origin in (typing.Union, types.UnionType):
        for choice in typing.get_args(hint):
            try:
                return _convert(choice, value, where)
            except ArgumentError:
                continue
        raise ArgumentError(f"{where} = {value!r} fits none of {hint}")
    if origin is tuple:
        if not isinstance(value, list | tuple):
            raise ArgumentError(f"{where} = {value!r} must be a list")
        items = typing.cast("list[Any]", value)
        return tuple(
            _convert(typing.get_args(hint)[0], item, f"{where}[{i}]")
            for i, item in enumerate(items)
        )
    if dataclasses.is_dataclass(hint) and isinstance(value, Mapping):
        return from_mapping(typing.cast("type[Any]", hint), typing.cast("Any", value), where)
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if (
        isinstance(hint, type)
        and isinstance(value, hint)
        and not (hint is int and isinstance(value, bool))
    ):
        return value
    if hint is type(None) and value is None:
        return None
    wanted: Any = getattr(hint, "__name__", hint)
    raise ArgumentError(f"{where} = {value!r} must be of type {wanted}")
