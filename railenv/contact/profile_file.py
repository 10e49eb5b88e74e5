"""Files of measured or drawn wheel and rail profiles.

Text, UTF-8, two numbers per line: y and z with the axes of `railenv.contact.profiles`, separated by
comma, semicolon or space; millimetres unless the unit "m" is asked for. What follows ``#`` is a
comment. A row that repeats the one before is skipped.

Rows follow the outline, from either end. A profile has one z for each y, so a smoothed outline that
folds back is taken up to the fold: a wheel's beyond the flange's tip (back of the flange), a rail's
on its sides, 10 mm or more below the crown (lower edge of the head). A fold elsewhere is an error.
Heights are counted anew, from the tape circle of a wheel and the crown of a rail; where y is zero
is up to the file.

Points of a measurement are noisy, and contact depends on curvature. Both coordinates are therefore
smoothed over the length along the outline, each by the natural cubic spline that minimises the sum
of squared distances plus a multiple of the integrated squared second derivative; the multiple is
the one at which the points' root mean square distance from the spline is `tolerance`. The largest
distance is kept in the profile.

Outlines are refused, with the cause named, that are too short or long, do not look like the kind
they are said to be (unit, flipped axes), have gaps, single points or steps off the outline, or
noise beyond the tolerance.
"""

import math
import os
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_smoothing_spline

from railenv.contact.profile_checks import check_kind, check_points
from railenv.contact.profiles import Profile
from railenv.errors import (
    ArgumentError,
    InputFileError,
    check_not_negative,
    unknown_name,
)
from railenv.units import FloatArray

TOLERANCE = 3e-6
"""Root mean square distance between points and profile unless another is asked for [m]."""

_LARGEST_TOLERANCE = 1e-4
_LARGEST_FILE = 4_000_000
_FEWEST_ROWS = 40
_MOST_ROWS = 50_000
_UNITS = {"mm": 1.0, "m": 1e3}
_SPACING_MM = 0.05
_LEAST_FOLD_DEPTH_MM = 10.0
_BISECTIONS = 24


class _Outline(NamedTuple):
    """Points of a file, from left to right, and the lines they stand in; [mm], shape (n,)."""

    y: FloatArray
    z: FloatArray
    lines: NDArray[np.int64]


def read_profile(
    path: str | os.PathLike[str], kind: str, *, unit: str = "mm", tolerance: float = TOLERANCE
) -> Profile:
    """Read a profile from a file; see the module for the format.

    Args:
        path: The file.
        kind: "wheel" or "rail".
        unit: Unit of the file's numbers, "mm" or "m".
        tolerance: Root mean square distance of the points from the smoothed profile [m]; zero
            keeps every point.

    Returns:
        The profile, its points 0.05 mm apart along the outline.

    Raises:
        ArgumentError: An argument is not usable.
        InputFileError: The file cannot be read or is no plausible profile of this kind; the message
            names the file, the line where there is one, and the way out.
    """
    if kind not in ("wheel", "rail"):
        raise unknown_name("kind of profile", kind, ("wheel", "rail"))
    if unit not in _UNITS:
        raise unknown_name("unit of a profile", unit, _UNITS)
    check_not_negative("tolerance", tolerance, "metres")
    if tolerance > _LARGEST_TOLERANCE:
        raise ArgumentError(
            f"tolerance = {tolerance:g} m would smooth the profile away; "
            f"give {_LARGEST_TOLERANCE:g} m or less"
        )
    name = os.fspath(path)
    outline = _read(path, _UNITS[unit])
    check_kind(name, kind, unit, outline.y, outline.z)
    check_points(name, outline.y, outline.z, outline.lines, 1e3 * tolerance)
    y, z, largest = _smoothed(outline, 1e3 * tolerance)
    y, z = _one_valued(name, kind, y, z)
    z = z - (float(np.interp(0.0, y, z)) if kind == "wheel" else float(z.min()))
    return Profile(Path(name).name, kind, 1e-3 * y, 1e-3 * z, 1e-3 * largest)


def _read(path: str | os.PathLike[str], millimetres: float) -> _Outline:
    """Return the rows of a file [mm]."""
    points: list[tuple[float, float]] = []
    lines: list[int] = []
    for number, line in enumerate(_text(path).splitlines(), start=1):
        content = line.partition("#")[0].strip()
        if not content:
            continue
        row = _row(f"{os.fspath(path)}, line {number}", content)
        if points and row == points[-1]:
            continue
        points.append(row)
        lines.append(number)
    if not _FEWEST_ROWS <= len(points) <= _MOST_ROWS:
        raise InputFileError(
            f"{os.fspath(path)} holds {len(points)} different points; give {_FEWEST_ROWS} to "
            f"{_MOST_ROWS}"
        )
    table = millimetres * np.array(points, dtype=np.float64)
    numbers = np.array(lines, dtype=np.int64)
    if table[-1, 0] < table[0, 0]:
        table, numbers = table[::-1], numbers[::-1]
    return _Outline(table[:, 0].copy(), table[:, 1].copy(), numbers.copy())


def _text(path: str | os.PathLike[str]) -> str:
    shown = os.fspath(path)
    try:
        ordinary = Path(path).is_file() or not Path(path).exists()
        content = b""
        if ordinary:
            with Path(path).open("rb") as stream:
                content = stream.read(_LARGEST_FILE + 1)
    except OSError as error:
        raise InputFileError(
            f"cannot read {shown}: {error.strerror}; give a readable text file of points"
        ) from None
    except ValueError as error:  # a file name with a null character
        raise InputFileError(f"cannot read {shown!r}: {error}; give another name") from None
    if not ordinary:
        raise InputFileError(f"{shown} is no ordinary file; give a text file of points")
    if len(content) > _LARGEST_FILE:
        raise InputFileError(
            f"{shown} is larger than {_LARGEST_FILE // 1_000_000} MB; a profile needs no more than "
            f"{_MOST_ROWS} points"
        )
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise InputFileError(
            f"{shown}, line {line}: not UTF-8 text; save the points as plain text"
        ) from None


def _row(where: str, content: str) -> tuple[float, float]:
    # Spaces may stand on both sides of a comma, but ",," is a missing number.
    fields = re.split(r"\s*[,;]\s*|\s+", content)
    if len(fields) != 2:
        raise InputFileError(
            f"{where}: {len(fields)} values; give two, y and z, with decimal points, and begin "
            "comments with #"
        )
    values: list[float] = []
    for axis, entry in zip("yz", fields, strict=True):
        try:
            value = float(entry) if entry.isascii() and "_" not in entry else math.nan
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            shown = entry if len(entry) <= 40 else entry[:37] + "..."
            raise InputFileError(
                f"{where}: {axis} = {shown!r} is not a finite number; give one, or begin the line "
                "with # if it is a comment"
            )
        values.append(value)
    return values[0], values[1]


def _one_valued(
    name: str, kind: str, y: FloatArray, z: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the part of an outline around its running surface that has one z for each y."""
    # Go outwards from a place that no fold reaches.
    middle = int(np.argmin(np.abs(y))) if kind == "wheel" else int(np.argmin(z))
    falling = np.flatnonzero(np.diff(y) <= 0.0)
    before, after = falling[falling < middle], falling[falling >= middle]
    low = int(before[-1]) + 1 if len(before) else 0
    high = int(after[0]) if len(after) else len(y) - 1
    for end, folded in ((low, len(before) > 0), (high, len(after) > 0)):
        if kind == "rail":
            allowed = float(z[end] - z[middle]) >= _LEAST_FOLD_DEPTH_MM
        else:
            allowed = end == low and low < int(np.argmax(z))
        if folded and not allowed:
            raise InputFileError(
                f"{name}: the outline folds back at y = {y[end]:.2f} mm, z = {z[end]:.2f} mm; give "
                "points in their order along the outline, with one z for each y"
            )
    return y[low : high + 1], z[low : high + 1]


def _smoothed(outline: _Outline, tolerance: float) -> tuple[FloatArray, FloatArray, float]:
    """Return points of the smoothed outline and the largest distance to the given ones [mm]."""
    y, z = outline.y, outline.z
    along = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(y), np.diff(z)))])

    def fit(weight: float) -> tuple[list[BSpline], FloatArray]:
        curves = [make_smoothing_spline(along, values, lam=weight) for values in (y, z)]
        distance = np.hypot(curves[0](along) - y, curves[1](along) - z)
        return curves, distance

    # The distance rises with the weight; the weight is a length cubed [mm^3].
    low, high = -14.0, 4.0
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        distance = fit(10.0**middle)[1]
        too_far = float(np.sqrt(np.mean(distance**2))) > tolerance
        low, high = (low, middle) if too_far else (middle, high)
    curves, distance = fit(10.0**low if tolerance > 0.0 else 0.0)
    steps = math.ceil(float(along[-1]) / _SPACING_MM)
    places = np.linspace(0.0, float(along[-1]), steps + 1)
    return curves[0](places), curves[1](places), float(distance.max())
