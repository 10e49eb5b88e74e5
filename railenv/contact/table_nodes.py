"""What the nodes of the contact table hold: Hertz's solution, and heights made fit for a B-spline.

Arrays have the table's shape (nodes of v, nodes of roll); see `railenv.contact.table`.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from railenv.contact.geometry import FLANGE, TREAD, WheelRail
from railenv.contact.hertz import hertz_contact
from railenv.contact.kalker import KalkerCoefficients, kalker_coefficients
from railenv.contact.touch_points import TouchPoints
from railenv.errors import ArgumentError, check_positive
from railenv.units import FloatArray

IntArray = NDArray[np.int64]

LARGEST_RADIUS = 1.5
"""Largest combined radius of wheel and rail across [m]."""

LEAST_SHARE = 0.1
"""Least sum of curvatures across as a share of the rail's own [1]."""

QUANTITIES = 10
"""Numbers that `railenv.contact.table.patch` returns."""

_INTERPENETRATION = 0.55
"""Part of Hertz's approach by which rigid profiles overlap over the loaded patch [1]:
J. Piotrowski, W. Kik, Vehicle System Dynamics 46 (2008) 27."""

_STIFFNESS_SPREAD = 2e-3
"""Standard deviation of the Gaussian over v by which Hertz's constant is averaged [m].

Two patches that share are stiffer than either, not in between; the approach, 0.1 mm, hardly tells.
But k has a force of its own, -2/5 p^(5/2) dk/du, which would push the wheelset away from a jump and
which this keeps below a tenth of the force that draws it there."""

_REACH = 6e-3  # [m] of shift over which patches are asked to share

PAD = 3
"""Nodes added at each edge, on which a cubic B-spline is linear or constant."""


class HertzTable:
    """Hertz's solution over the ratio of curvatures: a table asks for it 60 000 times."""

    def __init__(self, shear_modulus: float, poisson_ratio: float) -> None:
        ratio = np.geomspace(1e-3, 1e4, 400)
        contact = hertz_contact(
            1.0, ratio, shear_modulus=shear_modulus, poisson_ratio=poisson_ratio
        )
        values = np.stack([contact.along, contact.across, contact.approach])
        self._poisson_ratio = poisson_ratio
        self._spline = CubicSpline(np.log(ratio), np.log(values), axis=1)

    def solve(self, points: TouchPoints) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return a and b per cube root of the force [m/N^(1/3)] and k_n [N/m^(3/2)].

        The sum of curvatures across is bounded from below by `LARGEST_RADIUS` and `LEAST_SHARE`.
        """
        least = np.maximum(1.0 / LARGEST_RADIUS, LEAST_SHARE * points.rail_curvature)
        across = np.maximum(points.wheel_curvature + points.rail_curvature, least)
        along = points.rolling_curvature
        a, b, approach = np.asarray(np.exp(self._spline(np.log(across / along))))
        # Lengths scale by the cube root of the radii, the approach by its inverse.
        scale = np.cbrt(along)
        return a / scale, b / scale, (approach * scale) ** -1.5

    def creep_coefficients(self, axis_ratio: FloatArray) -> KalkerCoefficients:
        """Return Kalker's coefficients for a/b."""
        return kalker_coefficients(axis_ratio, self._poisson_ratio)


def grid(name: str, step: float, extent: tuple[float, float], unit: str) -> FloatArray:
    """Return evenly spaced nodes over a range, one of them zero."""
    check_positive(name, step, unit)
    low, high = math.floor(extent[0] / step), math.ceil(extent[1] / step)
    if not 8 <= high - low <= 4000:
        raise ArgumentError(
            f"{name} = {step:g} {unit} makes {high - low} steps over {extent[0]:g} to "
            f"{extent[1]:g} {unit}; give a step for 8 to 4000"
        )
    return step * np.arange(low, high + 1, dtype=np.float64)


def zone_nodes(
    pair: WheelRail,
    zone: int,
    v: FloatArray,
    roll: FloatArray,
    yaw_lever: float,
    yaw_layer: float,
    hertz: HertzTable,
    load: float,
) -> tuple[FloatArray, FloatArray]:
    """Fill the nodes of one zone.

    Args:
        pair: Profiles and their placing.
        zone: `TREAD` or `FLANGE`.
        v: Shifts at the rail's level, shape (n,) [m].
        roll: Rolls, shape (m,) [rad].
        yaw_lever: c of the table's coordinates [m].
        yaw_layer: Yaw angle of the second layer [rad].
        hertz: Hertz's solution.
        load: Vertical load that neighbouring patches share [N].

    Returns:
        B-spline coefficients of the height, of its growth to the second layer, and of the
        stiffness, last axis 3, and the quantities of `patch`, last axis `QUANTITIES`; with `PAD`
        nodes more at each edge.
    """
    shift, roll = v[:, None] + pair.wheel_radius * roll, roll[None, :]
    points = pair.touch(shift, roll, 0.0, zone)
    yawed = pair.touch(shift - yaw_lever * yaw_layer**2, roll, yaw_layer, zone)
    own = _own_touch(points.weight, zone)
    height = _coefficients(_continued(points, v, own))
    growth = _coefficients(_continued(yawed, v, _own_touch(yawed.weight, zone))) - height
    along, across, stiffness = hertz.solve(points)
    cosine = np.cos(points.angle) ** 2.5
    shares = _Shares(points, v, own, (load / (stiffness * cosine)) ** (2.0 / 3.0))
    spread = _STIFFNESS_SPREAD / (v[1] - v[0])
    smooth = np.exp(gaussian_filter1d(np.log(stiffness), spread, axis=0, mode="nearest"))
    vertical = points.weight * smooth * cosine
    # dr/dy of the wheel where it touches, and by it the point's way forward per yaw angle.
    steep = np.tan(-points.angle - roll)
    forward = -points.radius * (np.cos(roll) * steep + np.sin(roll))
    kalker = hertz.creep_coefficients(along / across)
    columns = (points.radius, points.lateral, forward, points.angle, along, across, *kalker)
    quantities = [_averaged(_constant(shares.mean(each))) for each in columns]
    coefficients = (
        _linear(height),
        _linear(growth),
        _constant(np.take_along_axis(vertical, own, 0)),
    )
    return np.stack(coefficients, axis=-1), np.stack(quantities, axis=-1)


class _Shares:
    """How the patches that neighbouring shifts touch with share the load at each node.

    Where the rigid point of touch jumps, two places carry while their heights of touch differ by
    less than the approach. A neighbour's place, its height going on along the rail's curve to the
    node, is pressed in by p - gap and carries as (p - gap)^(3/2), with p 0.55 of Hertz's approach.
    So what is told of a patch changes over a distance that load and angle set, p over the
    difference of slopes, and not over one step of the table.

    Args:
        points: The touches of the nodes.
        v: Shifts of the nodes [m].
        own: The node whose touch each shows.
        approach: Hertz's at the shared load [m].
    """

    def __init__(self, points: TouchPoints, v: FloatArray, own: IntArray, approach: FloatArray):
        self._own = own
        reach = min(round(_REACH / (v[1] - v[0])), len(v) - 1)
        height, slope, bend = (
            np.take_along_axis(each, own, 0)
            for each in (points.height, points.shift_slope, points.rail_curvature)
        )
        p = _INTERPENETRATION * np.take_along_axis(approach, own, 0)
        nodes = np.arange(len(v))
        self._parts: list[tuple[IntArray, FloatArray]] = []
        total = np.zeros_like(height)
        for offset in range(-reach, reach + 1):
            other = np.clip(nodes + offset, 0, len(v) - 1)
            away = (v - v[other])[:, None]
            gap = height[other] + away * (slope[other] + 0.5 * bend[other] * away) - height
            weight = np.clip(1.0 - np.maximum(gap, 0.0) / p, 0.0, None) ** 1.5
            self._parts.append((other, weight))
            total += weight
        self._total = total

    def mean(self, values: FloatArray) -> FloatArray:
        """Return the mean over the patches that share, shape of the nodes."""
        here = np.take_along_axis(values, self._own, 0)
        found = np.zeros_like(here)
        for other, weight in self._parts:
            found += weight * here[other]
        return found / self._total


def yaw_levers(pair: WheelRail) -> tuple[float, float]:
    """Return half of r tan(angle) - b for the centred tread contact and for the flange's face."""
    centred = pair.touch(0.0, 0.0, 0.0, TREAD)
    points = pair.placed.curves.wheel[pair.zones[FLANGE][0] : pair.zones[FLANGE][1] + 1]
    steepest = float(np.max(-points[:, 3] / points[:, 2]))
    face = points[int(np.argmax(-points[:, 3] / points[:, 2]))]
    tread = float(centred.radius * np.tan(centred.angle) - centred.lateral)
    return 0.5 * tread, 0.5 * float(face[1] * steepest - face[0])


def _own_touch(weight: FloatArray, zone: int) -> IntArray:
    """Return for each node the node along v whose touch it shows, shape of `weight`.

    Its own one, or the nearest that is a touch of the zone, where only the zone's end in the
    overlap is next to the rail: below it in v for the tread zone, above it for the flange zone.
    """
    nodes = np.arange(len(weight))[:, None]
    touching = weight > 0.0
    if zone == TREAD:
        limit = len(weight) - 1 - np.argmax(touching[::-1], axis=0)
        own = np.minimum(nodes, limit)
    else:
        own = np.maximum(nodes, np.argmax(touching, axis=0))
    return np.where(touching.any(axis=0), own, nodes)


def _continued(points: TouchPoints, v: FloatArray, own: IntArray) -> FloatArray:
    """Return heights, the last touch of a zone going on along its tangent.

    So a flange that is about to touch starts with its own slope and not with that of the zone's
    end. Where the end is farther from the rail than the tangent, it counts.
    """
    tangent = np.take_along_axis(points.height, own, 0) + np.take_along_axis(
        points.shift_slope, own, 0
    ) * (v[:, None] - v[own])
    return np.maximum(points.height, tangent)


def _coefficients(values: FloatArray) -> FloatArray:
    """Return the B-spline coefficients of the module's docstring."""
    return values - (_least_bend(values) + _least_bend(values.T).T) / 6.0


def _least_bend(values: FloatArray) -> FloatArray:
    """Return along the first axis the smallest of three neighbouring second differences.

    It is zero where they differ in sign, and at the ends.
    """
    bend = np.zeros_like(values)
    second = values[2:] - 2.0 * values[1:-1] + values[:-2]
    three = np.stack([second[:-2], second[1:-1], second[2:]])
    size = np.min(np.abs(three), axis=0)
    signs = np.sum(np.sign(three), axis=0)
    bend[2:-2] = np.where(np.abs(signs) == 3.0, np.sign(signs) * size, 0.0)
    return bend


def _linear(values: FloatArray) -> FloatArray:
    """Add `PAD` nodes at each edge on which the values go on linearly."""
    steps = np.arange(1, PAD + 1)[:, None]
    for _ in range(2):
        before = values[0] - steps[::-1] * (values[1] - values[0])
        after = values[-1] + steps * (values[-1] - values[-2])
        values = np.concatenate([before, values, after]).T
    return values


def _constant(values: FloatArray) -> FloatArray:
    """Add `PAD` nodes at each edge that repeat the edge."""
    return np.pad(values, PAD, mode="edge")


def _averaged(values: FloatArray) -> FloatArray:
    """Average as a cubic B-spline does at its nodes, so that `patch` jumps as smoothly as h."""
    for _ in range(2):
        padded = np.pad(values, ((1, 1), (0, 0)), mode="edge")
        values = ((padded[:-2] + 4.0 * padded[1:-1] + padded[2:]) / 6.0).T
    return values
