"""Whether two runs have the same results, bit for bit."""

import hashlib
import json
import struct
from pathlib import Path

from eval.store.reader import Reader, Value
from eval.store.schema import COLUMNS

_LEFT_OUT = ("message",)
"""A message may say how long something took."""

_PLACE = ("controller", "layout", "vehicle", "speed_kmh")


def digest(folder: Path) -> str:
    """Return the SHA-256 over the columns of all cells, in the order of controller and key.

    Time histories and roots follow, where there are any. Times, sessions, messages and answers on
    stability are not in it.

    Args:
        folder: The run's folder.

    Returns:
        64 hexadecimal digits.

    Raises:
        InputFileError: There are no records, or they are damaged.
    """
    names = [name for name in COLUMNS if name not in _LEFT_OUT]
    state = hashlib.sha256(" ".join(names).encode())
    with Reader.open(folder) as records:
        for row in records.rows():
            for name in names:
                state.update(_spelt(row[name]))
        for row in records.motion():
            answer = row["answer"]
            # Why there is none is a message.
            text = "" if "error" in answer else json.dumps(answer, sort_keys=True)
            for value in (*(row[name] for name in _PLACE), text):
                state.update(_spelt(value))
    return state.hexdigest()


def _spelt(value: Value) -> bytes:
    """Return a value's type and bits; no two rows of values have the same bytes."""
    if value is None:
        return b"n"
    if isinstance(value, float):
        return b"f" + struct.pack(">d", value)
    if isinstance(value, int):
        return b"i" + struct.pack(">q", value)
    text = value.encode()
    return b"t" + struct.pack(">q", len(text)) + text
