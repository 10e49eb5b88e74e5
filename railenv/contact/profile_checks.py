"""What makes a row of points a plausible profile of a wheel or a rail; all lengths [mm].

The limits are wide: every main-line wheel and rail of the catalogue and its worn states are well
inside. They are there to catch a wrong unit, flipped axes, another kind of part, and bad points.
"""

import numpy as np
from numpy.typing import NDArray

from railenv.errors import InputFileError
from railenv.units import FloatArray

_WHEEL_TREAD = (-30.0, 30.0)
_WHEEL_WIDTH = (85.0, 200.0)
_FLANGE_PLACE = (-70.0, -40.0)
_FLANGE_HEIGHT = (20.0, 42.0)
_RAIL_HALF_WIDTH = (22.0, 55.0)
_RAIL_DEPTH = (4.0, 200.0)
_LARGEST_OFFSET = 5.0
_WIDEST_GAP = 3.0
_LARGEST_STEP = 0.1
_NOISE_ALLOWED = 2.0
_RAREST_NOISE = 6.0
"""A point farther off than so many standard deviations is no noise."""


def check_kind(name: str, kind: str, unit: str, y: FloatArray, z: FloatArray) -> None:
    """Raise `InputFileError` if an outline does not look like the kind it is said to be.

    Args:
        name: The file.
        kind: "wheel" or "rail".
        unit: The unit that the file was read in.
        y: From left to right; ends may fold back, shape (n,) [mm].
        z: Heights, down, shape (n,) [mm].
    """
    width = float(np.ptp(y))
    if width < 1.0:
        raise InputFileError(
            f"{name}: the profile is {width:g} mm wide; the numbers look like metres: "
            "read it with unit m"
        )
    if width > 5000.0 and unit == "m":
        raise InputFileError(
            f"{name}: the profile is {1e-3 * width:g} m wide; the numbers look like millimetres: "
            "read it with unit mm"
        )
    if kind == "wheel":
        _check_wheel(name, y, z)
    else:
        _check_rail(name, y, z)


def _check_wheel(name: str, y: FloatArray, z: FloatArray) -> None:
    if not _WHEEL_WIDTH[0] <= float(np.ptp(y)) <= _WHEEL_WIDTH[1]:
        raise InputFileError(
            f"{name}: the outline is {np.ptp(y):.1f} mm wide, a wheel's is {_WHEEL_WIDTH[0]:g} "
            f"to {_WHEEL_WIDTH[1]:g} mm; give flange and tread, in the stated unit"
        )
    level = float(np.median(z))
    below, above = float(z.max()) - level, level - float(z.min())
    tip = int(np.argmax(z)) if below >= above else int(np.argmin(z))
    if above > below:
        raise InputFileError(
            f"{name}: the flange goes up to z = {z[tip]:.2f} mm; z looks flipped: it must grow "
            "downwards, towards the flange's tip"
        )
    if float(y[tip]) > -_FLANGE_PLACE[1]:
        raise InputFileError(
            f"{name}: the flange's tip is at y = {y[tip]:.2f} mm; y looks flipped: it must grow "
            "to the field side, away from the flange"
        )
    if not _FLANGE_PLACE[0] <= float(y[tip]) <= _FLANGE_PLACE[1]:
        raise InputFileError(
            f"{name}: the lowest point is at y = {y[tip]:.2f} mm, a flange's tip at "
            f"{_FLANGE_PLACE[0]:g} to {_FLANGE_PLACE[1]:g} mm; count y from the tape circle"
        )
    if y.min() > _WHEEL_TREAD[0] or y.max() < _WHEEL_TREAD[1]:
        raise InputFileError(
            f"{name}: the outline covers y = {y.min():.1f} to {y.max():.1f} mm; it must hold "
            f"{_WHEEL_TREAD[0]:g} to {_WHEEL_TREAD[1]:g} mm"
        )
    zero = float(z[int(np.argmin(np.abs(y)))])
    if abs(zero) > _LARGEST_OFFSET:
        raise InputFileError(
            f"{name}: z is {zero:.2f} mm at y = 0, the tape circle; count both from there"
        )
    height = float(z[tip]) - zero
    if not _FLANGE_HEIGHT[0] <= height <= _FLANGE_HEIGHT[1]:
        raise InputFileError(
            f"{name}: the flange is {height:.2f} mm high, a wheel's {_FLANGE_HEIGHT[0]:g} to "
            f"{_FLANGE_HEIGHT[1]:g} mm; check that the whole flange is there, and the unit"
        )


def _check_rail(name: str, y: FloatArray, z: FloatArray) -> None:
    crown = int(np.argmin(z))
    ends = 0.5 * float(z[0] + z[-1])
    if ends < float(np.median(z)):
        raise InputFileError(
            f"{name}: the middle of the head is {float(np.median(z)) - ends:.2f} mm below its "
            "edges; z looks flipped: it must grow downwards from the crown"
        )
    for side, reach in (("left", -float(y.min())), ("right", float(y.max()))):
        if not _RAIL_HALF_WIDTH[0] <= reach <= _RAIL_HALF_WIDTH[1]:
            raise InputFileError(
                f"{name}: the head reaches {reach:.1f} mm to the {side} of y = 0, a rail's "
                f"{_RAIL_HALF_WIDTH[0]:g} to {_RAIL_HALF_WIDTH[1]:g} mm; count y from the "
                "symmetry line, in the stated unit, and give a rail"
            )
    if not -_RAIL_HALF_WIDTH[0] <= float(y[crown]) <= _RAIL_HALF_WIDTH[0]:
        raise InputFileError(
            f"{name}: the highest point is at y = {y[crown]:.2f} mm; count y from the head's "
            "symmetry line and do not turn the profile by the rail's cant"
        )
    if abs(float(z[crown])) > _LARGEST_OFFSET:
        raise InputFileError(f"{name}: z is {z[crown]:.2f} mm at the crown; count it from there")
    depth = float(z.max() - z[crown])
    if not _RAIL_DEPTH[0] <= depth <= _RAIL_DEPTH[1]:
        raise InputFileError(
            f"{name}: the outline is {depth:.2f} mm high, a rail head's {_RAIL_DEPTH[0]:g} to "
            f"{_RAIL_DEPTH[1]:g} mm; check that the gauge side is there, and the unit"
        )


def check_points(
    name: str, y: FloatArray, z: FloatArray, lines: NDArray[np.int64], tolerance: float
) -> None:
    """Raise `InputFileError` on gaps, points or steps off the outline, and noise.

    A point is compared with the cubic curve through two neighbours on either side; on arcs of
    12 mm radius with points up to 3 mm apart that differs by less than `_LARGEST_STEP`.

    Args:
        name: The file.
        y: Shape (n,) [mm].
        z: Shape (n,) [mm].
        lines: Line of each point in the file, shape (n,).
        tolerance: Root mean square distance that smoothing will aim at; noise may be twice that
            [mm]. Zero allows any.
    """
    distance = np.hypot(np.diff(y), np.diff(z))
    widest = int(np.argmax(distance))
    if float(distance[widest]) > _WIDEST_GAP:
        raise InputFileError(
            f"{name}, line {lines[widest]}: the next point is {distance[widest]:.2f} mm away; give "
            f"points {_WIDEST_GAP:g} mm apart or closer"
        )
    along = np.concatenate([[0.0], np.cumsum(distance)])
    off, size = _off_neighbours(along, y, z)
    # The median is blind to the few places where the curvature itself jumps. Across the outline
    # only one coordinate counts, whose median deviation is 0.674 times its standard deviation.
    noise = float(np.median(off / size)) / 0.674
    if tolerance > 0.0 and noise > _NOISE_ALLOWED * tolerance:
        raise InputFileError(
            f"{name}: the points scatter by about {1e3 * noise:.1f} micrometres, the tolerance is "
            f"{1e3 * tolerance:g}; smooth them with a tolerance of {1e3 * noise:.0f} micrometres "
            "or more"
        )
    limit = np.maximum(_LARGEST_STEP, _RAREST_NOISE * noise * size)
    worst = int(np.argmax(off / limit))
    if float(off[worst]) > float(limit[worst]):
        raise InputFileError(
            f"{name}, line {lines[worst + 2]}: the point y = {y[worst + 2]:g} mm, "
            f"z = {z[worst + 2]:g} mm lies {off[worst]:.3f} mm off the curve through its "
            "neighbours; remove it or the step in the outline"
        )


def _off_neighbours(
    along: FloatArray, y: FloatArray, z: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return distances from the cubic through four neighbours, and their scatter per noise of 1."""
    index = np.arange(2, len(along) - 2)
    neighbours = np.array([index - 2, index - 1, index + 1, index + 2])
    weights = np.ones((4, len(index)))
    for j in range(4):
        for k in range(4):
            if k != j:
                weights[j] *= along[index] - along[neighbours[k]]
                weights[j] /= along[neighbours[j]] - along[neighbours[k]]
    parts = [values[index] - np.sum(weights * values[neighbours], axis=0) for values in (y, z)]
    return np.hypot(*parts), np.sqrt(1.0 + np.sum(weights**2, axis=0))
