"""Files of measured track irregularity.

Comma separated text, UTF-8. Lines that start with ``#`` and blank lines are skipped. The first
other line names the columns: ``distance_m`` and at least one of ``alignment_mm``, ``vertical_mm``,
``cross_level_mm``, ``gauge_mm``, in any order, with the signs of `railenv.track.spectra`. Then
follow 8 rows or more of numbers, with the distance rising in equal steps from any start.

Equal means: every distance lies within 2 % of a step of the grid that runs evenly from the first
to the last row. That leaves room for distances printed with few digits (a step of 1/3 m printed to
the centimetre is 1 % off), and shifts no wave that the record can show by more than 0.063 rad.
Nothing is resampled: a gap is an error that says where.
"""

import math
import os
from pathlib import Path

import numpy as np

from railenv.errors import InputFileError, unknown_name
from railenv.track.spectra import CHANNELS
from railenv.units import FloatArray

_DISTANCE = "distance_m"
_COLUMNS = {f"{channel}_mm": channel for channel in CHANNELS}
_FEWEST_ROWS = 8
_STEP_TOLERANCE = 0.02
_LARGEST_IRREGULARITY_MM = 1000.0
"""Beyond a metre a value is not an irregularity: a wrong unit, or an absolute position."""
_LARGEST_DISTANCE = 1e9
"""Chainages stay far below; above it the grid would lose digits [m]."""


def read_columns(path: str | os.PathLike[str]) -> tuple[float, dict[str, FloatArray]]:
    """Read the grid step and the channels of a measured track.

    Args:
        path: The file.

    Returns:
        The grid step [m], and channel name to values [m].

    Raises:
        InputFileError: The file cannot be read or does not follow the format; the message names
            file, line and the way out.
    """
    lines = _lines(path)
    if not lines:
        raise InputFileError(
            f"{os.fspath(path)} holds no header line; begin it with {_DISTANCE},alignment_mm"
        )
    names = _header(path, *lines[0])
    if len(lines) - 1 < _FEWEST_ROWS:
        raise InputFileError(
            f"{os.fspath(path)}, line {lines[-1][0]}: the file ends after {len(lines) - 1} rows of "
            f"numbers; give {_FEWEST_ROWS} or more"
        )
    rows = [_row(path, number, text, names) for number, text in lines[1:]]
    table = np.array(rows, dtype=np.float64)
    numbers = [number for number, _ in lines[1:]]
    spacing = _uniform_step(path, table[:, names.index(_DISTANCE)], numbers)
    channels = {
        _COLUMNS[name]: 1e-3 * table[:, index]  # mm to m
        for index, name in enumerate(names)
        if name != _DISTANCE
    }
    return spacing, channels


def _lines(path: str | os.PathLike[str]) -> list[tuple[int, str]]:
    """Return line number and text of every line that says something."""
    try:
        if Path(path).exists() and not Path(path).is_file():
            raise InputFileError(f"{path} is no ordinary file; give the path of a CSV file")
        text = Path(path).read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputFileError(
            f"cannot read {os.fspath(path)}: {error.strerror}; give a readable text file"
        ) from None
    except UnicodeDecodeError as error:
        line = error.object.count(b"\n", 0, error.start) + 1
        raise InputFileError(
            f"{os.fspath(path)}, line {line}: not UTF-8 text; save the file as comma separated "
            "plain text"
        ) from None
    except ValueError as error:  # a file name with a null character
        raise InputFileError(
            f"cannot read {os.fspath(path)!r}: {error}; give another name"
        ) from None
    numbered = enumerate((line.strip() for line in text.split("\n")), start=1)
    return [(number, line) for number, line in numbered if line and not line.startswith("#")]


def _header(path: str | os.PathLike[str], number: int, text: str) -> list[str]:
    where = f"{os.fspath(path)}, line {number}"
    names = [name.strip() for name in text.split(",")]
    for name in names:
        if name != _DISTANCE and name not in _COLUMNS:
            known = [_DISTANCE, *_COLUMNS]
            raise InputFileError(
                f"{where}: the first line must be a header of column names, comma separated: "
                f"{unknown_name('column', _short(name), known)}"
            )
        if names.count(name) > 1:
            raise InputFileError(f"{where}: column {name} is named twice; keep one of them")
    if _DISTANCE not in names:
        raise InputFileError(f"{where}: no column {_DISTANCE}; add the distance along the track")
    if len(names) == 1:
        raise InputFileError(
            f"{where}: no column of irregularity; add one or more of {', '.join(_COLUMNS)}"
        )
    return names


def _row(path: str | os.PathLike[str], number: int, text: str, names: list[str]) -> list[float]:
    where = f"{os.fspath(path)}, line {number}"
    fields = text.split(",")
    if len(fields) != len(names):
        raise InputFileError(
            f"{where}: {len(fields)} values where the header names {len(names)} columns; give one "
            "value per column"
        )
    values: list[float] = []
    for name, entry in zip(names, fields, strict=True):
        try:
            value = float(entry)
        except ValueError:
            value = None
        if value is None or "_" in entry:  # Python reads 1_0 as ten
            raise InputFileError(
                f"{where}: {name} = {_short(entry.strip())!r} is not a number; give a decimal "
                "number with a point"
            )
        if not math.isfinite(value):
            raise InputFileError(
                f"{where}: {name} = {_short(entry.strip())} is not finite; repair or cut that part "
                "of the record"
            )
        limit = _LARGEST_DISTANCE if name == _DISTANCE else _LARGEST_IRREGULARITY_MM
        if abs(value) > limit:
            raise InputFileError(
                f"{where}: {name} = {value:g} is beyond {limit:g}; check the column's unit"
            )
        values.append(value)
    return values


def _uniform_step(path: str | os.PathLike[str], distance: FloatArray, numbers: list[int]) -> float:
    """Return the step of a uniform grid, or say at which line the distance leaves it."""
    steps = np.diff(distance)
    if bool(np.any(steps <= 0.0)):
        row = int(np.argmax(steps <= 0.0)) + 1
        raise InputFileError(
            f"{os.fspath(path)}, line {numbers[row]}: {_DISTANCE} = {distance[row]:g} does not "
            f"exceed {distance[row - 1]:g} in the row before; sort the rows by rising distance"
        )
    step = float(distance[-1] - distance[0]) / (len(distance) - 1)
    off_grid = np.abs(distance - distance[0] - step * np.arange(len(distance)))
    if float(np.max(off_grid)) <= _STEP_TOLERANCE * step:
        return step
    # One gap moves every row off the even grid, so look first for a step unlike the usual one (both
    # its ends may be off by the tolerance).
    usual = float(np.median(steps))
    uneven = np.abs(steps - usual) > 2.0 * _STEP_TOLERANCE * usual
    row = int(np.argmax(uneven)) + 1 if bool(np.any(uneven)) else int(np.argmax(off_grid))
    raise InputFileError(
        f"{os.fspath(path)}, line {numbers[row]}: {_DISTANCE} = {distance[row]:g} leaves the even "
        f"grid (it rises by {steps[row - 1]:g} here, usually by {usual:g}); resample the record to "
        "equal steps (2 % tolerance)"
    )


def _short(text: str) -> str:
    return text if len(text) <= 40 else text[:37] + "..."
