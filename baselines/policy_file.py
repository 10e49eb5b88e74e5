"""Linear controllers as files: arrays and one JSON text in an `.npz`, never anything to execute.

A file holds everything that turns an observation into an action: the matrices, the sensors' names,
the layout, the force of an action of one and, for a dynamic law, the control period. The same four
matrices mean one thing in continuous time and another from sample to sample: the kind says which.
What is read back acts bit for bit like what was saved.
"""

import json
import math
import warnings
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.controller import LinearFeedback
from baselines.linear_dynamic import LinearDynamic
from railenv.errors import ArgumentError, InputFileError
from railenv.files import replacing
from railenv.units import FloatArray

FORMAT = "railenv policy"
VERSION = 1

LARGEST_ARRAY = 64_000_000
"""Most bytes of one array in a file that is handed over."""

_MOST_ARRAYS = 32
_LARGEST_WHOLE = 2**53
_SAMPLED = "sampled_linear_dynamic"
_KEYS = {
    "linear_feedback": ("layout", "sensors", "action_scale"),
    "linear_dynamic": ("layout", "sensors", "action_scale", "control_period"),
    _SAMPLED: ("layout", "sensors", "action_scale", "control_period"),
}
_ARRAYS = {
    "linear_feedback": ("gain",),
    "linear_dynamic": ("A", "B", "C", "D"),
    _SAMPLED: ("A", "B", "C", "D"),
}


def save_policy(controller: LinearFeedback | LinearDynamic, path: str | Path) -> None:
    """Write a linear controller to an `.npz` file, as a whole or not at all.

    Args:
        controller: A `LinearFeedback` (sky-hook too) or `LinearDynamic`, continuous or sampled.
        path: The file; it must end in .npz.

    Raises:
        ArgumentError: The controller is no linear one, or acts by a method of its own.
        OutputError: The file cannot be written.
    """
    place = Path(path)
    if place.suffix != ".npz":
        raise ArgumentError(f"path = {str(place)!r} must end in .npz")
    metadata: dict[str, Any] = {"format": FORMAT, "version": VERSION}
    if isinstance(controller, LinearFeedback) and type(controller).act is LinearFeedback.act:
        kind, arrays = "linear_feedback", {"gain": controller.gain}
    elif isinstance(controller, LinearDynamic) and type(controller).act is LinearDynamic.act:
        law = controller.law
        kind = _SAMPLED if controller.sampled else "linear_dynamic"
        arrays = {"A": law.A, "B": law.B, "C": law.C, "D": law.D}
    else:
        raise ArgumentError(
            f"controller {type(controller).__name__} is no linear law that a file of matrices "
            "holds; give a LinearFeedback or a LinearDynamic"
        )
    metadata |= {"kind": kind, **{key: getattr(controller, key) for key in _KEYS[kind]}}
    with replacing(place) as stream:
        contents: dict[str, Any] = {"metadata": np.array(json.dumps(metadata)), **arrays}
        np.savez(stream, **contents)


def load_policy(path: str | Path) -> LinearFeedback | LinearDynamic:
    """Read a controller that `save_policy` wrote.

    Raises:
        InputFileError: The file cannot be read, is of another kind, or its values do not fit.
    """
    place = Path(path)
    arrays = read_arrays(place)
    text = arrays.pop("metadata", None)
    if text is None or text.dtype.kind != "U" or text.shape != ():
        raise InputFileError(
            f"{place} is no saved policy: it has no text 'metadata'; write one with save_policy"
        )
    try:
        metadata = json.loads(str(text))
    except (ValueError, RecursionError) as error:
        raise InputFileError(f"{place}: metadata is no JSON: {error}") from None
    if not isinstance(metadata, dict) or metadata.pop("format", None) != FORMAT:
        raise InputFileError(f"{place} is no saved policy; write one with save_policy")
    version, kind = metadata.pop("version", None), metadata.pop("kind", None)
    if type(version) is not int or version != VERSION:
        raise InputFileError(
            f"{place} has version {version!r:.40}; this railenv reads version {VERSION}"
        )
    if not isinstance(kind, str) or kind not in _KEYS:
        raise InputFileError(f"{place} has kind {kind!r:.40}; known: {', '.join(_KEYS)}")
    for what, given, wanted in (
        ("metadata", metadata, _KEYS[kind]),
        ("arrays", arrays, _ARRAYS[kind]),
    ):
        if set(given) != set(wanted):
            raise InputFileError(
                f"{place}: {what} of a {kind} are {', '.join(wanted)}; the file has "
                f"{', '.join(given) or 'none'}"
            )
    sensors = metadata.pop("sensors")
    if not isinstance(sensors, list) or not all(isinstance(name, str) for name in sensors):
        raise InputFileError(f"{place}: sensors is no list of names")
    values = [exact_floats(place, name, arrays[name]) for name in _ARRAYS[kind]]
    layout = metadata.pop("layout")
    try:
        if kind == "linear_feedback":
            return LinearFeedback(values[0], tuple(sensors), layout, **metadata)
        sampled = kind == _SAMPLED
        return LinearDynamic(tuple(values), tuple(sensors), layout, sampled=sampled, **metadata)
    except ArgumentError as error:
        raise InputFileError(f"{place}: {error}") from None


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Read every array of an `.npz` file from whatever hand; nothing in it is executed.

    Args:
        path: The file.

    Returns:
        The arrays by name: real numbers or text.

    Raises:
        InputFileError: The file is missing, is no `.npz`, is damaged, or holds anything but numbers
            and text, or more than `LARGEST_ARRAY` bytes in an array.
    """
    try:
        if not path.is_file():
            word = "is no file" if path.exists() else "does not exist"
            raise InputFileError(f"{path} {word}; give an .npz file")
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            with zipfile.ZipFile(path) as archive:
                return _arrays(path, archive)
    except InputFileError:
        raise
    except zipfile.BadZipFile:
        raise InputFileError(
            f"{path} is no .npz file, or a damaged one; write it with numpy.savez"
        ) from None
    except Exception as error:
        # Whatever a parser makes of a hostile file, it is the file that is at fault.
        raise InputFileError(
            f"{path} cannot be read as an .npz file ({type(error).__name__}: {error}); "
            "write it with numpy.savez"
        ) from None


def _arrays(path: Path, archive: zipfile.ZipFile) -> dict[str, NDArray[Any]]:
    found: dict[str, NDArray[Any]] = {}
    members = archive.infolist()
    if len(members) > _MOST_ARRAYS:
        raise InputFileError(f"{path} holds {len(members)} arrays; a loop or policy has a few")
    for member in members:
        name = member.filename.removesuffix(".npy")
        if name in found:
            raise InputFileError(f"{path} holds {name!r:.60} twice; write each array once")
        with archive.open(member) as stream:
            version = np.lib.format.read_magic(stream)
            if version == (1, 0):
                shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
            else:
                shape, _, dtype = np.lib.format.read_array_header_2_0(stream)
        if dtype.kind not in "iufU":
            raise InputFileError(
                f"{path}: {name!r:.60} holds {dtype.name} values; give real numbers"
            )
        size = math.prod(shape) * dtype.itemsize
        if min(shape, default=0) < 0 or size > min(LARGEST_ARRAY, member.file_size):
            raise InputFileError(
                f"{path}: {name!r:.60} declares shape {shape!s:.60}, which is more than the "
                f"file or {LARGEST_ARRAY // 10**6} MB holds; the file is damaged or not a loop"
            )
        with archive.open(member) as stream:
            found[name] = np.lib.format.read_array(stream, allow_pickle=False)
    return found


def exact_floats(path: Path, name: str, array: NDArray[Any]) -> FloatArray:
    """Return an array's values in double precision, or refuse those that would be rounded.

    Raises:
        InputFileError: The array holds text, or a number that double precision does not hold.
    """
    if array.dtype.kind == "U":
        raise InputFileError(f"{path}: {name!r:.60} holds text; give real numbers")
    with np.errstate(over="ignore", invalid="ignore"):
        values = array.astype(np.float64)
        whole = array.dtype.kind in "iu"
        rounded = (
            np.abs(values) >= _LARGEST_WHOLE if whole else (values != array) & (array == array)
        )
    if np.any(rounded):
        raise InputFileError(
            f"{path}: {name!r:.60} holds numbers that double precision does not; save it as float64"
        )
    return values
