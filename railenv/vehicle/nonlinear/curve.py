"""Curves with cant and transitions, as every body of the vehicle meets them.

A line is given by its curvature and its cant angle over distance, both linear between points; a
transition is a ramp of both. Right-hand curves are positive, and so is a cant whose right rail is
the lower one.

Every body has a track frame of its own at its place on the line. Coordinates are relative to it,
and so is the contact. Against a common frame, that of the carbody's centre, a body's frame is
displaced sideways by the line's bend, turned by its change of direction, and rolled by the change
of cant; suspension forces are worked out in the common frame. Moving frames are accelerated:

    lateral:  V^2 kappa - g cant
    down:     g cant^2 / 2 - V^2 kappa cant     (what a body weighs more or less in the cant)
    yaw:      V^2 kappa'                        on transitions

The roll acceleration of a cant ramp, V^2 cant'', acts at its two ends only and is left out.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit

from railenv.errors import ArgumentError, check_finite, check_positive
from railenv.units import STANDARD_GRAVITY, FloatArray
from railenv.vehicle.nonlinear.coordinates import BODIES, NUM_COORDINATES
from railenv.vehicle.nonlinear.rates import FrameArrays

_BODIES = len(BODIES)
_LATERAL, _VERTICAL, _ROLL, _YAW = 1, 2, 3, 5
_LARGEST_CANT = 0.2  # [rad], 300 mm on standard gauge; small angles end there


class CurveArrays(NamedTuple):
    """Curvature and cant of a line, linear between points and constant beyond the ends.

    Attributes:
        place: Distances of the points along the line, rising, shape (points,) [m]; without points
            the line is straight.
        curvature: Shape (points,) [1/m].
        cant: Shape (points,) [rad].
        direction: Integral of the curvature up to each point, shape (points,) [rad].
        sideways: Integral of the direction up to each point, shape (points,) [m].
    """

    place: FloatArray
    curvature: FloatArray
    cant: FloatArray
    direction: FloatArray
    sideways: FloatArray


def straight_line() -> CurveArrays:
    """Return a line without curves."""
    none = np.zeros(0)
    return CurveArrays(none, none, none, none, none)


def curved_line(points: Sequence[tuple[float, float, float]]) -> CurveArrays:
    """Return a line with curves.

    Args:
        points: Distance [m], curvature [1/m] and cant angle [rad], two points or more.

    Raises:
        ArgumentError: A value is not finite, distances do not rise, a cant is beyond small angles,
            or there are too few points.
    """
    if len(points) < 2:
        raise ArgumentError(f"points has {len(points)} entries; give two or more")
    for k, (place, curvature, cant) in enumerate(points):
        check_finite(f"points[{k}] distance", place, "m")
        check_finite(f"points[{k}] curvature", curvature, "1/m")
        if not abs(check_finite(f"points[{k}] cant", cant, "rad")) <= _LARGEST_CANT:
            raise ArgumentError(
                f"points[{k}] cant = {cant:g} rad is beyond {_LARGEST_CANT:g}; give an angle, "
                "which is the cant in metres over the spacing of the rolling circles"
            )
    place, curvature, cant = np.array(points, dtype=np.float64).T.copy()
    step = np.diff(place)
    if not bool(np.all(step > 0.0)):
        raise ArgumentError("points must have rising distances")
    direction, sideways = np.zeros(len(place)), np.zeros(len(place))
    for k, length in enumerate(step):
        slope = (curvature[k + 1] - curvature[k]) / length
        direction[k + 1] = direction[k] + length * (curvature[k] + slope * length / 2.0)
        sideways[k + 1] = sideways[k] + length * (
            direction[k] + length * (curvature[k] / 2.0 + slope * length / 6.0)
        )
    return CurveArrays(place, curvature, cant, direction, sideways)


def circular_curve(
    radius: float, cant: float, *, start: float = 0.0, transition: float = 100.0
) -> CurveArrays:
    """Return a line that runs through a transition into a right-hand curve without end.

    Args:
        radius: Of the curve [m], above zero.
        cant: Cant angle in the curve [rad].
        start: Where the transition begins [m].
        transition: Its length [m].
    """
    check_positive("radius", radius, "m")
    check_positive("transition", transition, "m")
    return curved_line([(start, 0.0, 0.0), (start + transition, 1.0 / radius, cant)])


@njit(cache=True, nogil=True, error_model="numpy")
def _line(curves: CurveArrays, place: float) -> tuple[float, float, float, float, float, float]:
    """Return curvature, its slope, cant, its slope, direction and sideways place."""
    last = len(curves.place) - 1
    k = -1
    while k < last and curves.place[k + 1] <= place:
        k += 1
    at = max(k, 0)
    t = place - curves.place[at]
    slope, cant_slope = 0.0, 0.0
    if 0 <= k < last:
        length = curves.place[k + 1] - curves.place[k]
        slope = (curves.curvature[k + 1] - curves.curvature[k]) / length
        cant_slope = (curves.cant[k + 1] - curves.cant[k]) / length
    curvature = curves.curvature[at]
    direction = curves.direction[at]
    return (
        curvature + slope * t,
        slope,
        curves.cant[at] + cant_slope * t,
        cant_slope,
        direction + t * (curvature + slope * t / 2.0),
        curves.sideways[at] + t * (direction + t * (curvature / 2.0 + slope * t / 6.0)),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def curve_frame(
    curves: CurveArrays, lead: float, speed: float, setback: FloatArray, frame: FrameArrays
) -> None:
    """Write what the line does to the vehicle.

    Args:
        curves: The line, with points.
        lead: Where the leading wheelset is [m].
        speed: Running speed [m/s].
        setback: Distance of wheelsets 1 to 4 behind the first, shape (4,) [m].
        frame: Overwritten.
    """
    middle = lead - 0.5 * setback[3]
    kappa_0, _, cant_0, cant_slope_0, direction_0, sideways_0 = _line(curves, middle)
    for body in range(_BODIES):
        if body == 0:
            place = middle
        elif body == 1:
            place = lead - 0.5 * setback[1]
        elif body == 2:
            place = lead - 0.5 * (setback[2] + setback[3])
        else:
            place = lead - setback[body - 3]
        kappa, slope, cant, cant_slope, direction, sideways = _line(curves, place)
        ahead, b = place - middle, 6 * body
        frame.offset[b + _LATERAL] = sideways - sideways_0 - direction_0 * ahead
        frame.offset[b + _YAW] = direction - direction_0
        frame.offset[b + _ROLL] = cant - cant_0
        frame.rate[b + _LATERAL] = speed * (direction - direction_0 - kappa_0 * ahead)
        frame.rate[b + _YAW] = speed * (kappa - kappa_0)
        frame.rate[b + _ROLL] = speed * (cant_slope - cant_slope_0)
        centripetal = speed * speed * kappa
        frame.acceleration[b + _LATERAL] = centripetal - STANDARD_GRAVITY * cant
        frame.acceleration[b + _VERTICAL] = (
            0.5 * STANDARD_GRAVITY * cant * cant - centripetal * cant
        )
        frame.acceleration[b + _YAW] = speed * speed * slope
        if body > 2:
            frame.turning[body - 3] = speed * kappa


def frame_in(curves: CurveArrays, lead: float, speed: float, setback: FloatArray) -> FrameArrays:
    """Return what the line does to a vehicle whose leading wheelset is at `lead` [m]."""
    n = NUM_COORDINATES
    frame = FrameArrays(np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(_BODIES - 3))
    curve_frame(curves, lead, speed, setback, frame)
    return frame
