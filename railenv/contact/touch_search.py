"""Compiled search for the point at which a rigid wheel touches a rigid rail.

The right wheel is a surface of revolution about its axle, the rail a cylinder along the track.
Axes: x forward, y to the right, z down; the wheelset's centre lies on the axle midway between the
wheels. A point of the wheel at angle t about the axle (0 straight down, positive forward) is, in
wheelset axes, (r sin t, y, r cos t). The wheelset is yawed by psi (x towards y), then rolled about
its own x axis by phi (y towards z), and moved by the shift u. In track axes, before the shift,

    X1 = r sin t,  Y1 = y cos phi - r cos t sin phi,  Z1 = y sin phi + r cos t cos phi
    Y = u + X1 sin psi + Y1 cos psi

The height of touch is the least z_rail(Y) - Z1 over the wheel's surface. There the common normal
has no x component, which gives t for each point of the wheel's profile in closed form (its curve of
possible contact points, seen along the track the wheel's silhouette):

    sin t + tan psi (cos t sin phi + cos phi dr/dy) = 0

so that the search is over one variable, the place along the wheel's profile. It scans a zone in
steps of 0.4 mm and then solves for the stationary point between neighbours, to rounding.
Gradients follow from the envelope theorem: only the explicit dependence on u, phi, psi counts.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from railenv.units import FloatArray

Pose = tuple[float, float, float, float]  # cosine and sine of roll, then of yaw

COLUMNS = 9
"""Numbers for each touch: height, its derivatives by shift, roll and yaw, x and y of the point in
wheelset axes, rolling radius, lateral position in the track, place along the wheel's profile."""

_STRIDE = 8  # profile points per step of the first scan: 0.4 mm
# A minimum of the scan is looked at if it is no more than this above the best [m]: the gap curves
# by 160/m or less, so that half a step beside its least value it is up to 3.2e-6 m higher.
_NEAR = 4e-6
_ITERATIONS = 80


class TouchCurves(NamedTuple):
    """Wheel and rail as the search reads them.

    Attributes:
        wheel: Lateral position from the wheelset's centre, radius, and the derivatives of both by
            the place along the profile, at even steps of it, shape (n, 4) [m, m, 1, 1].
        wheel_step: Step of the place [m].
        rail: Height (down) and slope dz/dy at even lateral steps, shape (m, 2) [m, 1].
        rail_start: Lateral position of the rail's first point from the track's centre [m].
        rail_step: Lateral step [m].
    """

    wheel: FloatArray
    wheel_step: float
    rail: FloatArray
    rail_start: float
    rail_step: float


@njit(cache=True, nogil=True, error_model="numpy")
def _cubic(low: float, high: float, start: float, end: float, t: float) -> tuple[float, float]:
    """Return the Hermite cubic of two values and two slopes (per step) and its slope at t."""
    rise = high - low
    cubic = start + end - 2.0 * rise
    square = 3.0 * rise - 2.0 * start - end
    return (
        low + t * (start + t * (square + t * cubic)),
        start + t * (2.0 * square + 3.0 * t * cubic),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _rail_at(curves: TouchCurves, y: float) -> tuple[float, float]:
    """Return the rail's height and slope; beyond its ends it goes on straight."""
    rail, step = curves.rail, curves.rail_step
    t = (y - curves.rail_start) / step
    last = rail.shape[0] - 1
    if t <= 0.0:
        return rail[0, 0] + t * step * rail[0, 1], rail[0, 1]
    if t >= last:
        return rail[last, 0] + (t - last) * step * rail[last, 1], rail[last, 1]
    i = int(t)
    z, slope = _cubic(rail[i, 0], rail[i + 1, 0], rail[i, 1] * step, rail[i + 1, 1] * step, t - i)
    return z, slope / step


@njit(cache=True, nogil=True, error_model="numpy")
def _wheel_at(curves: TouchCurves, place: float) -> tuple[float, float, float, float]:
    """Return lateral position, radius and their derivatives by the place."""
    wheel, step = curves.wheel, curves.wheel_step
    t = place / step
    i = min(max(int(t), 0), wheel.shape[0] - 2)
    n = i + 1
    y, dy = _cubic(wheel[i, 0], wheel[n, 0], wheel[i, 2] * step, wheel[n, 2] * step, t - i)
    r, dr = _cubic(wheel[i, 1], wheel[n, 1], wheel[i, 3] * step, wheel[n, 3] * step, t - i)
    return y, r, dy / step, dr / step


@njit(cache=True, nogil=True, error_model="numpy")
def _silhouette(
    dy: float, dr: float, cos_roll: float, sin_roll: float, tan_yaw: float
) -> tuple[float, float]:
    """Return sin t and cos t of the wheel's point whose normal has no component along the track."""
    if tan_yaw == 0.0:
        return 0.0, 1.0
    side = tan_yaw * sin_roll
    long = math.sqrt(1.0 + side * side)
    sine = -tan_yaw * cos_roll * dr / (max(dy, 1e-9) * long)
    # A flank as steep as that has no such point at this yaw; its rim is as near as it comes.
    sine = min(max(sine, -1.0), 1.0)
    cosine = math.sqrt(1.0 - sine * sine)
    return (sine - cosine * side) / long, (cosine + sine * side) / long


@njit(cache=True, nogil=True, error_model="numpy")
def _gap(curves: TouchCurves, place: float, shift: float, pose: Pose) -> tuple[float, float]:
    """Return the gap z_rail(Y) - Z1 at a place and its derivative by the place at constant t.

    The derivative vanishes where the gap along the silhouette is stationary.
    """
    cos_roll, sin_roll, cos_yaw, sin_yaw = pose
    y, r, dy, dr = _wheel_at(curves, place)
    sine, cosine = _silhouette(dy, dr, cos_roll, sin_roll, sin_yaw / cos_yaw)
    lateral = y * cos_roll - r * cosine * sin_roll
    rail, slope = _rail_at(curves, shift + r * sine * sin_yaw + lateral * cos_yaw)
    across = dr * sine * sin_yaw + (dy * cos_roll - dr * cosine * sin_roll) * cos_yaw
    return (
        rail - y * sin_roll - r * cosine * cos_roll,
        slope * across - dy * sin_roll - dr * cosine * cos_roll,
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _stationary(curves: TouchCurves, low: float, high: float, shift: float, pose: Pose) -> float:
    """Return the place of the gap's minimum between two places (its end where it has none)."""
    at_low, at_high = _gap(curves, low, shift, pose)[1], _gap(curves, high, shift, pose)[1]
    if at_low >= 0.0 or at_high <= 0.0:
        return low if at_low >= 0.0 else high
    # Regula falsi, Illinois variant: the end that stays is halved.
    side = 0
    for _ in range(_ITERATIONS):
        middle = (low * at_high - high * at_low) / (at_high - at_low)
        if not low < middle < high:
            break
        here = _gap(curves, middle, shift, pose)[1]
        if here > 0.0:
            high, at_high = middle, here
            if side == 1:
                at_low *= 0.5
            side = 1
        elif here < 0.0:
            low, at_low = middle, here
            if side == -1:
                at_high *= 0.5
            side = -1
        else:
            return middle
        if high - low < 1e-13 or abs(here) < 1e-14:
            return middle
    return 0.5 * (low + high)


@njit(cache=True, nogil=True, error_model="numpy")
def _find(
    curves: TouchCurves,
    first: int,
    last: int,
    shift: float,
    pose: Pose,
    scan: FloatArray,
) -> float:
    """Return the place of the least gap between two profile points."""
    cos_roll, sin_roll, cos_yaw, sin_yaw = pose
    tan_yaw = sin_yaw / cos_yaw
    wheel = curves.wheel
    count = (last - first) // _STRIDE + 1
    least = np.inf
    for k in range(count):
        i = first + k * _STRIDE
        y, r = wheel[i, 0], wheel[i, 1]
        sine, cosine = _silhouette(wheel[i, 2], wheel[i, 3], cos_roll, sin_roll, tan_yaw)
        lateral = y * cos_roll - r * cosine * sin_roll
        rail = _rail_at(curves, shift + r * sine * sin_yaw + lateral * cos_yaw)[0]
        gap = rail - y * sin_roll - r * cosine * cos_roll
        scan[k] = gap
        least = min(least, gap)
    step = curves.wheel_step
    best, place = np.inf, step * first
    for k in range(count):
        here = scan[k]
        beaten = (k > 0 and scan[k - 1] < here) or (k < count - 1 and scan[k + 1] < here)
        if beaten or here > least + _NEAR:
            continue
        low = first + max(k - 1, 0) * _STRIDE
        high = min(first + (k + 1) * _STRIDE, last)
        candidate = _stationary(curves, step * low, step * high, shift, pose)
        gap = _gap(curves, candidate, shift, pose)[0]
        if gap < best:
            best, place = gap, candidate
    return place


@njit(cache=True, nogil=True, error_model="numpy")
def _touch(
    curves: TouchCurves,
    first: int,
    last: int,
    shift: float,
    roll: float,
    yaw: float,
    scan: FloatArray,
    result: FloatArray,
) -> None:
    """Write the numbers of one touch (see `COLUMNS`) into `result`."""
    pose = (math.cos(roll), math.sin(roll), math.cos(yaw), math.sin(yaw))
    cos_roll, sin_roll, cos_yaw, sin_yaw = pose
    place = _find(curves, first, last, shift, pose, scan)
    y, r, dy, dr = _wheel_at(curves, place)
    sine, cosine = _silhouette(dy, dr, cos_roll, sin_roll, sin_yaw / cos_yaw)
    forward = r * sine
    lateral = y * cos_roll - r * cosine * sin_roll
    down = y * sin_roll + r * cosine * cos_roll
    across = shift + forward * sin_yaw + lateral * cos_yaw
    rail, slope = _rail_at(curves, across)
    result[0] = rail - down
    result[1] = slope
    result[2] = -slope * down * cos_yaw - lateral
    result[3] = slope * (forward * cos_yaw - lateral * sin_yaw)
    result[4] = forward
    result[5] = y
    result[6] = r
    result[7] = across
    result[8] = place


@njit(cache=True, nogil=True, error_model="numpy")
def touch_many(
    curves: TouchCurves,
    first: int,
    last: int,
    shift: FloatArray,
    roll: FloatArray,
    yaw: FloatArray,
) -> FloatArray:
    """Find the touch of the right wheel between two profile points, for many poses.

    Args:
        curves: Wheel and rail.
        first: Index of the first profile point of the zone.
        last: Index of the last one.
        shift: u, shape (n,) [m].
        roll: phi, shape (n,) [rad].
        yaw: psi, shape (n,) [rad].

    Returns:
        One row of `COLUMNS` for each pose; the height counts from the rail's crown to the axle.
    """
    result = np.empty((shift.shape[0], COLUMNS))
    scan = np.empty((last - first) // _STRIDE + 1)
    for n in range(shift.shape[0]):
        _touch(curves, first, last, shift[n], roll[n], yaw[n], scan, result[n])
    return result


@njit(cache=True, nogil=True, error_model="numpy")
def balance_many(curves: TouchCurves, shift: FloatArray, yaw: FloatArray) -> FloatArray:
    """Find the roll at which both wheels touch, shape (n,) [rad].

    The left wheel is the right one's mirror image, so the heights h(u, phi, psi) and
    h(-u, -phi, -psi) have to be equal. Their difference falls with phi by about the spacing of the
    contact points: Newton's method, kept inside a bracket.

    Args:
        curves: Wheel and rail.
        shift: u, shape (n,) [m].
        yaw: psi, shape (n,) [rad].
    """
    rolls = np.empty(shift.shape[0])
    last = curves.wheel.shape[0] - 1
    scan = np.empty(last // _STRIDE + 1)
    right, left = np.empty(COLUMNS), np.empty(COLUMNS)
    for n in range(shift.shape[0]):
        low, high, roll = -0.2, 0.2, 0.0
        for _ in range(_ITERATIONS):
            _touch(curves, 0, last, shift[n], roll, yaw[n], scan, right)
            _touch(curves, 0, last, -shift[n], -roll, -yaw[n], scan, left)
            difference = right[0] - left[0]
            low, high = (roll, high) if difference > 0.0 else (low, roll)
            step = -difference / (right[2] + left[2])
            if not low < roll + step < high:
                step = 0.5 * (low + high) - roll
            roll += step
            if abs(step) < 1e-15 or high - low < 1e-15:
                break
        rolls[n] = roll
    return rolls
