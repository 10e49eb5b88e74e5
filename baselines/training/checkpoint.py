"""One checkpoint of a training run: a folder that is there as a whole or not at all.

    000001000000/            lane-steps taken
        arrays.npz           what the method needs to go on: weights, moments, buffers
        checkpoint.json      the rest, and the checksum of every file, its own content included
        policy/              the policy as it stood, where it was judged

It is written under a temporary name, forced to the disk, and renamed. A file that was cut short
later, by a power failure for instance, does not fit its checksum and is refused. Nothing is ever
unpickled.
"""

import hashlib
import io
import json
import os
import shutil
import tempfile
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from railenv.errors import ArgumentError, InputFileError, OutputError

WRITING = ".writing-"
"""Beginning of the name of a folder that is no checkpoint yet."""

_FORMAT, _VERSION = "railenv-training-checkpoint", 1
_ARRAYS, _PLAIN = "arrays.npz", "checkpoint.json"
_PREFIX = "array."
_OWN_SUM = "sha256_of_this"


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """What a checkpoint holds.

    Attributes:
        steps: Lane-steps taken.
        arrays: Arrays of the method.
        plain: Everything else, as JSON has it.
    """

    steps: int
    arrays: dict[str, NDArray[Any]]
    plain: dict[str, Any]


def checkpoint_name(steps: int) -> str:
    """Return the folder's name; names sort as steps do."""
    return f"{steps:012d}"


def write_checkpoint(
    folder: Path,
    steps: int,
    arrays: dict[str, NDArray[Any]],
    plain: dict[str, Any],
    write_policy: Callable[[Path], None] | None = None,
) -> Path:
    """Write a checkpoint as a whole.

    Args:
        folder: The run's folder of checkpoints, which exists.
        steps: Lane-steps taken.
        arrays: Arrays of the method; none of Python objects.
        plain: Everything else, for JSON, finite.
        write_policy: Called with the path of the policy's folder to write it; None for no policy.

    Returns:
        The checkpoint's folder.

    Raises:
        ArgumentError: An array holds objects.
        OutputError: It cannot be written; nothing is left behind then.
    """
    for name, array in arrays.items():
        if np.asarray(array).dtype.hasobject:
            raise ArgumentError(f"array {name!r} holds Python objects; give numbers")
    final = folder / checkpoint_name(steps)
    try:
        temporary = Path(tempfile.mkdtemp(prefix=WRITING, dir=folder))
        try:
            with (temporary / _ARRAYS).open("wb") as stream:
                # A prefix: any name may be given, also one that savez has for itself.
                named: Any = {f"{_PREFIX}{name}": array for name, array in arrays.items()}
                np.savez(stream, allow_pickle=False, **named)
            if write_policy is not None:
                write_policy(temporary / "policy")
            files = sorted(path for path in temporary.rglob("*") if path.is_file())
            body = {
                "format": _FORMAT,
                "version": _VERSION,
                "steps": steps,
                "sha256": {path.relative_to(temporary).as_posix(): _sum(path) for path in files},
                "plain": plain,
            }
            text = json.dumps({**body, _OWN_SUM: _sum_of(body)}, allow_nan=False)
            (temporary / _PLAIN).write_text(text, encoding="ascii")
            temporary.chmod(0o755)
            for path in (*files, temporary / _PLAIN, temporary):
                _to_disk(path)
            if final.exists():
                shutil.rmtree(final)
            temporary.rename(final)
            _to_disk(folder)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
    except OSError as error:
        raise OutputError(f"cannot write {final}: {error.strerror or error}") from None
    return final


def read_checkpoint(folder: Path) -> Checkpoint:
    """Read a checkpoint and check that every file of it is whole.

    Raises:
        InputFileError: A file is missing, cut short or altered, or it is no checkpoint.
    """
    try:
        body: Any = json.loads((folder / _PLAIN).read_text(encoding="ascii"))
        if body["format"] != _FORMAT or body["version"] != _VERSION:
            raise InputFileError(
                f"{folder} is a checkpoint of another version; go on with the program that wrote it"
            )
        # Older checkpoints have none.
        if _OWN_SUM in body and body.pop(_OWN_SUM) != _sum_of(body):
            raise InputFileError(f"{folder / _PLAIN} is not as it was written: damaged")
        sums = cast("dict[str, str]", body["sha256"])
        contents = {name: (folder / name).read_bytes() for name in sums}
        for name, content in contents.items():
            if hashlib.sha256(content).hexdigest() != sums[name]:
                raise InputFileError(f"{folder / name} is not as it was written: damaged")
        # What was checked is what is read, and never pickled objects.
        with np.load(io.BytesIO(contents[_ARRAYS]), allow_pickle=False) as stored:
            arrays = {name.removeprefix(_PREFIX): np.array(stored[name]) for name in stored.files}
        return Checkpoint(int(body["steps"]), arrays, dict(body["plain"]))
    except InputFileError:
        raise
    except OSError as error:
        raise InputFileError(f"cannot read {folder}: {error.strerror or error}") from None
    except (KeyError, TypeError, ValueError, EOFError, RecursionError, zipfile.BadZipFile) as error:
        raise InputFileError(
            f"{folder} is no whole checkpoint ({type(error).__name__}: {error})"
        ) from None


def _sum_of(body: dict[str, Any]) -> str:
    """Return the checksum of the content of checkpoint.json, whatever the order of its keys."""
    as_read = json.loads(json.dumps(body, allow_nan=False))
    return hashlib.sha256(json.dumps(as_read, sort_keys=True).encode("ascii")).hexdigest()


def _sum(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _to_disk(path: Path) -> None:
    """Force a file, or the entries of a folder, to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
