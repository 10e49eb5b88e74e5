"""Arrays and texts in a `.safetensors` file, read from whatever hand; nothing in it is executed.

The format (github.com/huggingface/safetensors, README "Format"): eight bytes, the length N of the
header as a little-endian number; N bytes of JSON, name -> {"dtype", "shape", "data_offsets"}, and
texts under "__metadata__"; then the arrays, row by row, without gap. Only double precision is
written and read, so that what is read back acts bit for bit like what was saved. The same content
gives the same bytes.
"""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from railenv.errors import InputFileError
from railenv.units import FloatArray

LARGEST_HEADER = 1_000_000
"""Most bytes of a header that is read."""

LARGEST_FILE = 64_000_000
"""Most bytes of a file that is read."""

_MOST_ARRAYS = 100
_MOST_DIMENSIONS = 4
_ENTRY = {"dtype", "shape", "data_offsets"}
_METADATA = "__metadata__"


def tensor_bytes(arrays: Mapping[str, FloatArray], texts: Mapping[str, str]) -> bytes:
    """Return the content of a file.

    Args:
        arrays: Arrays by name, stored by rising name in double precision.
        texts: What stands under `__metadata__`.
    """
    header: dict[str, Any] = {_METADATA: dict(sorted(texts.items()))}
    data = b""
    for name in sorted(arrays):
        values = np.ascontiguousarray(arrays[name], dtype="<f8")
        header[name] = {
            "dtype": "F64",
            "shape": list(values.shape),
            "data_offsets": [len(data), len(data) + values.nbytes],
        }
        data += values.tobytes()
    text = json.dumps(header, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text + data


def read_bytes(path: Path, largest: int) -> bytes:
    """Return the content of a file that is not larger than it may be.

    Raises:
        InputFileError: The file cannot be read or is too large.
    """
    try:
        if not path.is_file():
            word = "is no file" if path.exists() else "does not exist"
            raise InputFileError(f"{path} {word}; give a policy that save_trained wrote")
        with path.open("rb") as stream:
            content = stream.read(largest + 1)
    except (OSError, ValueError) as error:
        if isinstance(error, InputFileError):
            raise
        reason = getattr(error, "strerror", None) or error
        raise InputFileError(f"cannot read {path}: {reason}") from None
    if len(content) > largest:
        raise InputFileError(f"{path} has more than {largest:,} bytes; a policy has less")
    return content


def parse_tensors(path: Path, content: bytes) -> tuple[dict[str, FloatArray], dict[str, str]]:
    """Return the arrays and texts of a file's content.

    Args:
        path: Names the file in messages.
        content: Its bytes.

    Returns:
        Arrays of double precision by name, and the texts under `__metadata__`.

    Raises:
        InputFileError: It is no `.safetensors` file, is damaged, or holds anything but arrays of
            double precision and text.
    """
    length = int.from_bytes(content[:8], "little")
    if len(content) < 10 or not 2 <= length <= min(LARGEST_HEADER, len(content) - 8):
        raise InputFileError(
            f"{path} is no .safetensors file, or a damaged one: its header would have {length} "
            f"bytes, it has {len(content)} in all and a header at most {LARGEST_HEADER}; "
            "write it with save_trained"
        )
    header = parse_json(path, "header", content[8 : 8 + length])
    data = content[8 + length :]
    texts = header.pop(_METADATA, {})
    if not isinstance(texts, dict) or not all(isinstance(text, str) for text in texts.values()):
        raise InputFileError(f"{path}: {_METADATA} must hold texts alone")
    if len(header) > _MOST_ARRAYS:
        raise InputFileError(f"{path} holds {len(header)} arrays; a policy has a few")
    places = [(*_place(path, name, entry), name) for name, entry in header.items()]
    arrays: dict[str, FloatArray] = {}
    end = 0
    for begin, after, shape, name in sorted(places, key=lambda place: place[:2]):
        if begin != end or after > len(data):
            raise InputFileError(
                f"{path}: {name!r:.60} lies at bytes {begin} to {after}, where {end} and "
                f"{len(data)} bound it; the file is damaged"
            )
        values = np.frombuffer(data[begin:after], dtype="<f8").reshape(shape)
        arrays[name] = values.astype(np.float64)
        end = after
    if end != len(data):
        raise InputFileError(f"{path} has {len(data) - end} bytes that belong to no array")
    return arrays, texts


def _place(path: Path, name: str, entry: Any) -> tuple[int, int, tuple[int, ...]]:
    """Return where an array begins and ends and its shape."""
    if not isinstance(entry, dict) or set(entry) != _ENTRY:
        raise InputFileError(
            f"{path}: {name!r:.60} must have {', '.join(sorted(_ENTRY))} and nothing else"
        )
    if entry["dtype"] != "F64":
        raise InputFileError(
            f"{path}: {name!r:.60} has dtype {entry['dtype']!r:.20}; save it as F64, which holds "
            "every policy exactly"
        )
    shape, offsets = entry["shape"], entry["data_offsets"]
    for what, numbers in (("shape", shape), ("data_offsets", offsets)):
        if not isinstance(numbers, list) or not all(type(n) is int and n >= 0 for n in numbers):
            raise InputFileError(
                f"{path}: {what} of {name!r:.60} = {numbers!r:.60} must be whole numbers from zero"
            )
    if len(offsets) != 2 or len(shape) > _MOST_DIMENSIONS:
        raise InputFileError(
            f"{path}: {name!r:.60} has {len(shape)} dimensions and {len(offsets)} offsets; a "
            f"policy has at most {_MOST_DIMENSIONS} and two"
        )
    # Numbers of Python: their product does not wrap around.
    if max(shape, default=0) > LARGEST_FILE or math.prod(shape) * 8 != offsets[1] - offsets[0]:
        raise InputFileError(
            f"{path}: {name!r:.60} declares shape {shape!s:.60} over {offsets[1] - offsets[0]} "
            "bytes, which is not its size; the file is damaged"
        )
    return offsets[0], offsets[1], tuple(shape)


def parse_json(path: Path, what: str, text: bytes) -> dict[str, Any]:
    """Return the object of a JSON text: every key once, every number finite.

    Args:
        path: Names the file in messages.
        what: What of the file it is.
        text: The JSON.

    Raises:
        InputFileError: It is no such text.
    """

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) != len(pairs):
            raise ValueError("a key stands twice")
        return found

    def refused(constant: str) -> Any:
        raise ValueError(f"{constant} is no finite number")

    def finite(digits: str) -> float:
        number = float(digits)
        if not math.isfinite(number):
            raise ValueError(f"{digits:.20} is no finite number")
        return number

    try:
        found = json.loads(
            text.decode("utf-8"),
            object_pairs_hook=once,
            parse_constant=refused,
            parse_float=finite,
        )
    except (ValueError, RecursionError) as error:
        raise InputFileError(f"{path}: {what} is no usable JSON: {error!s:.120}") from None
    if not isinstance(found, dict):
        raise InputFileError(f"{path}: {what} is no JSON object")
    return found
