"""Settings as TOML text, to be read again by `railenv.config.load_toml`."""

import json
import math
from collections.abc import Mapping
from typing import Any, cast

from railenv.errors import ArgumentError


def toml_text(values: Mapping[str, Any], comment: str = "") -> str:
    """Return nested mappings of texts, numbers, truth values and lists as TOML.

    Args:
        values: Plain entries, then tables; of tables within tables the name is written with dots.
        comment: Lines that stand above.

    Raises:
        ArgumentError: A value has no form in TOML.
    """
    lines = [f"# {line}".rstrip() for line in comment.splitlines()]
    return "\n".join([*lines, *_table(values, ())]).strip() + "\n"


def _table(values: Mapping[str, Any], path: tuple[str, ...]) -> list[str]:
    plain = {key: value for key, value in values.items() if not isinstance(value, Mapping)}
    lines = ["", f"[{'.'.join(map(_key, path))}]"] if path else []
    lines += [f"{_key(key)} = {_value(value, (*path, key))}" for key, value in plain.items()]
    for key, value in values.items():
        if isinstance(value, Mapping):
            lines += _table(cast("Mapping[str, Any]", value), (*path, key))
    return lines


def _key(key: str) -> str:
    bare = key.isascii() and key.replace("_", "").replace("-", "").isalnum()
    return key if bare else json.dumps(key)


def _value(value: Any, path: tuple[str, ...]) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        # A text of JSON is one of TOML, but for the delete character, which TOML wants escaped.
        return json.dumps(value).replace("\x7f", "\\u007f")
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float) and math.isfinite(value):
        # TOML wants a digit on both sides of the point: repr has one, or an exponent.
        return repr(value)
    if isinstance(value, list | tuple):
        entries = cast("list[Any]", value)
        return f"[{', '.join(_value(entry, path) for entry in entries)}]"
    raise ArgumentError(
        f"{'.'.join(path)} = {value!r} cannot be written as TOML; give texts, finite numbers, "
        "truth values or lists of them"
    )
