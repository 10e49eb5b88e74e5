"""Wheel and rail profiles made ready for the contact search: placed, canted, evenly sampled.

A profile is taken as a parametric cubic spline over its chord length, so that steep faces are as
well resolved as flat ones. Curvatures are averaged along the profile with a triangular weight,
since a contact patch is some millimetres wide and the nominal curvature jumps where arcs meet:

    mean(s) = (A(s + w) - 2 A(s) + A(s - w)) / w^2,   dA/ds = angle of the tangent
"""

from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from railenv.contact.profiles import Profile
from railenv.contact.touch_search import TouchCurves
from railenv.errors import ArgumentError
from railenv.units import FloatArray

_WHEEL_STEP = 5e-5
_RAIL_STEP = 2e-5
_STEEPEST = 12.0  # [1] slope at which the rail's sides are cut; beyond, they go on straight


class PlacedProfiles(NamedTuple):
    """Wheel and rail in place.

    Attributes:
        curves: What the search reads.
        wheel_curvature: Mean curvature of the wheel's profile at its points, convex positive,
            shape (n,) [1/m].
        rail_curvature: Likewise of the rail at its points, shape (m,) [1/m].
    """

    curves: TouchCurves
    wheel_curvature: FloatArray
    rail_curvature: FloatArray


class _Path(NamedTuple):
    """A plane curve over its length."""

    length: float
    across: CubicSpline
    down: CubicSpline

    def mean_curvature(self, place: FloatArray, width: float) -> FloatArray:
        """Return the averaged dz/dy tangent angle's derivative, positive where z'' > 0 [1/m]."""
        # Beyond its ends the curve goes on straight, as the search takes it.
        count = int((self.length + 2.0 * width) / 1e-5)
        fine = np.linspace(-width, self.length + width, count)
        inside = np.clip(fine, 0.0, self.length)
        angle = np.arctan2(self.down(inside, 1), self.across(inside, 1))
        turned = CubicSpline(fine, angle).antiderivative()
        both = np.asarray(turned(place + width)) + np.asarray(turned(place - width))
        return (both - 2.0 * np.asarray(turned(place))) / width**2


def _path(y: FloatArray, z: FloatArray) -> _Path:
    chord = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(y), np.diff(z)))])
    return _Path(float(chord[-1]), CubicSpline(chord, y), CubicSpline(chord, z))


def place_profiles(
    wheel: Profile,
    rail: Profile,
    *,
    tape_circle: float,
    wheel_radius: float,
    gauge: float,
    gauge_depth: float,
    cant: float,
    rail_lateral: float | None,
    curvature_width: float,
) -> PlacedProfiles:
    """Sample the right wheel and the right rail in their nominal places.

    Args:
        wheel: Wheel profile.
        rail: Rail profile, uncanted.
        tape_circle: Lateral position of the tape circle from the wheelset's centre [m].
        wheel_radius: Radius of the tape circle [m].
        gauge: Distance of the rails' inner faces [m].
        gauge_depth: Depth below the crown at which the gauge is measured [m].
        cant: Inward inclination of the rail, tangent [1].
        rail_lateral: Lateral position of the rail profile's origin [m]; replaces the gauge.
        curvature_width: Half width of the triangular weight of curvatures [m].

    Returns:
        Both profiles in place.

    Raises:
        ArgumentError: The rail does not reach down to the gauge's depth.
    """
    tread = _path(wheel.y, wheel.z)
    places = _WHEEL_STEP * np.arange(int(tread.length / _WHEEL_STEP) + 1, dtype=np.float64)
    wheel_points = np.stack(
        [
            tape_circle + tread.across(places),
            wheel_radius + tread.down(places),
            tread.across(places, 1),
            tread.down(places, 1),
        ],
        axis=1,
    )
    head = _canted(rail, cant)
    fine = np.linspace(0.0, head.length, int(head.length / 1e-5))
    y, z = np.asarray(head.across(fine)), np.asarray(head.down(fine))
    crown = int(np.argmin(z))
    lowest = float(z[crown])
    if rail_lateral is None:
        reach = float(z[0]) - lowest
        if not reach > gauge_depth > 0.0:
            raise ArgumentError(
                f"gauge_depth = {gauge_depth:g} m is not on rail {rail.name!r}, which reaches "
                f"{reach:g} m below its crown; give a depth on its inner face"
            )

        def below(place: float) -> float:
            return float(head.down(place)) - lowest - gauge_depth

        face = float(head.across(brentq(below, 0.0, float(fine[crown]), xtol=1e-14)))
        # The gauge is the least distance of the inner faces down to that depth; a side of 1:20
        # canted by 1:20 is upright, and one that is measured may then lean back a little.
        inner = y[: crown + 1][z[: crown + 1] - lowest <= gauge_depth]
        rail_lateral = 0.5 * gauge - min(face, float(inner.min()))
    falling = np.flatnonzero(np.diff(y) <= 0.0)
    low = int(falling[falling < crown].max(initial=-1)) + 1
    high = int(falling[falling >= crown].min(initial=len(y) - 1)) + 1
    fine, y = fine[low:high], y[low:high]
    slope = np.asarray(head.down(fine, 1)) / np.asarray(head.across(fine, 1))
    usable = np.flatnonzero(np.abs(slope) <= _STEEPEST)
    start, end = y[usable[0]], y[usable[-1]]
    even = start + _RAIL_STEP * np.arange(int((end - start) / _RAIL_STEP) + 1)
    along: FloatArray = np.interp(even, y, fine)
    for _ in range(4):  # Newton from a linear interpolation 1e-5 m fine: two steps reach rounding
        along = along - np.asarray((head.across(along) - even) / head.across(along, 1))
    rail_points = np.stack(
        [head.down(along) - lowest, head.down(along, 1) / head.across(along, 1)], axis=1
    )
    return PlacedProfiles(
        TouchCurves(
            np.ascontiguousarray(wheel_points),
            _WHEEL_STEP,
            np.ascontiguousarray(rail_points),
            rail_lateral + float(start),
            _RAIL_STEP,
        ),
        -tread.mean_curvature(places, curvature_width),
        head.mean_curvature(along, curvature_width),
    )


def _canted(rail: Profile, cant: float) -> _Path:
    """Return the rail's profile inclined towards the track's centre, its inner side lowered."""
    length = np.hypot(1.0, cant)
    cosine, sine = 1.0 / length, cant / length
    return _path(rail.y * cosine + rail.z * sine, rail.z * cosine - rail.y * sine)
