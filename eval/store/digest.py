"""Whether two runs have the same results, bit for bit."""

import hashlib
import struct
from pathlib import Path

from eval.store.reader import Reader, Value
from eval.store.schema import COLUMNS

_LEFT_OUT = ("message",)
"""A message may say how long something took."""


def digest(folder: Path) -> str:
    """Return the SHA-256 over the columns of all cells, in the order of controller and key.

    Times, sessions, messages and answers on stability are not in it.

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
