"""Rigid geometry of a wheelset on a track: where wheels touch rails, in three dimensions.

Axes: x forward, y to the right, z down; roll turns y towards z (right side down), yaw turns x
towards y. Everything is written for the right wheel on the right rail. The left one is its mirror
image: give it the shift, roll and yaw with changed signs.

The height of touch h(u, phi, psi) is how far down the wheelset's centre stands when the right wheel
just touches, relative to the centred wheelset; wheel and rail overlap where the centre is lower. A
wheel has two zones, tread and flange, each with its own height, so that contact at two points is
both zones touching. The rule: the centred wheelset is shifted from -10 to 20 mm; where its point of
touch jumps by the largest contact angle (S1002 on 60E1: from 28 to 70 degrees), the wheel's profile
is split at the middle angle; with no jump of 10 degrees, at 45 degrees. `zone_split` overrules it.
The zones reach over the split by `zone_overlap` to both sides. A contact in the overlap is found by
both zones; their weights run from 0 to 1 across the overlap and sum to 1, so that a contact which
travels through it is handed over and one patch never counts twice.

Deliberately not known here: elasticity (the point of rigid touch jumps where two places touch at
once), deformation of the track, and bending of the axle.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from railenv.contact.profiles import Profile
from railenv.contact.touch_curves import PlacedProfiles, place_profiles
from railenv.contact.touch_points import TouchPoints, WheelsetContact
from railenv.contact.touch_search import balance_many, touch_many
from railenv.errors import (
    ArgumentError,
    check_finite,
    check_not_negative,
    check_positive,
)
from railenv.units import Dimensionless, FloatArray, Metre

TREAD, FLANGE = 0, 1
"""The two zones of a wheel."""

_SWEEP = np.arange(-10e-3, 20e-3, 5e-5)  # [m] shifts at which the split is looked for
_SMALLEST_JUMP = np.radians(10.0)
_DEFAULT_SPLIT = np.radians(45.0)
_ROOM = (0.03, 0.15)  # [m] between gauge and backs: 75 in Europe, 82 in China

_LARGEST_ANGLE = 0.2  # [rad] of roll and yaw; the search's bracket, far beyond derailment


@dataclass(frozen=True, eq=False)
class WheelRail:
    """A wheel profile on a rail profile, and how both are placed.

    Attributes:
        wheel: Wheel profile.
        rail: Rail profile, uncanted.
        wheel_radius: Radius of the tape circle [m].
        back_to_back: Distance between the backs of the wheels [m]; China 1.353, Europe 1.360.
        tape_offset: Distance of the tape circle from the wheel's back [m].
        gauge: Distance between the rails' inner faces [m].
        gauge_depth: Depth below the crown at which the gauge is measured [m]; China 0.016,
            Europe 0.014.
        cant: Inward inclination of the rails, tangent [1].
        rail_lateral: Lateral position of the rail profile's origin from the track's centre [m];
            replaces the gauge when given.
        zone_split: Where tread and flange zone meet, y in the wheel profile [m]; found from the
            profile's slope when not given.
        zone_overlap: How far the zones reach over the split to both sides [m].
        curvature_width: Half width of the triangular weight by which curvatures are averaged [m];
            a loaded patch is 2 to 8 mm in half width.
    """

    wheel: Profile
    rail: Profile
    wheel_radius: Metre = 0.46
    back_to_back: Metre = 1.353
    tape_offset: Metre = 0.07
    gauge: Metre = 1.435
    gauge_depth: Metre = 0.016
    cant: Dimensionless = 1.0 / 40.0
    rail_lateral: Metre | None = None
    zone_split: Metre | None = None
    zone_overlap: Metre = 1e-3
    curvature_width: Metre = 2e-3

    def __post_init__(self) -> None:
        for name, kind in (("wheel", "wheel"), ("rail", "rail")):
            profile: Profile = getattr(self, name)
            if profile.kind != kind:
                raise ArgumentError(
                    f"{name} = {profile.name!r} is a {profile.kind} profile; give one of a {kind}"
                )
        for name in ("wheel_radius", "back_to_back", "gauge", "gauge_depth"):
            check_positive(name, getattr(self, name), "m")
        room = self.gauge - self.back_to_back
        if self.rail_lateral is None and not _ROOM[0] <= room <= _ROOM[1]:
            raise ArgumentError(
                f"gauge = {self.gauge:g} m and back_to_back = {self.back_to_back:g} m leave "
                f"{1e3 * room:.4g} mm for two flanges and their play; give a pair that leaves "
                f"{1e3 * _ROOM[0]:g} to {1e3 * _ROOM[1]:g} mm"
            )
        for name in ("zone_overlap", "curvature_width"):
            check_positive(name, getattr(self, name), "m")
        check_not_negative("tape_offset", self.tape_offset, "m")
        check_finite("cant", self.cant)
        for name in ("rail_lateral", "zone_split"):
            if getattr(self, name) is not None:
                check_finite(name, getattr(self, name), "m")
        _ = self.zones  # finds out now, not in the middle of a run, that the profiles do not fit

    @property
    def tape_circle(self) -> float:
        """Lateral position of the right wheel's tape circle from the wheelset's centre [m]."""
        return 0.5 * self.back_to_back + self.tape_offset

    @cached_property
    def placed(self) -> PlacedProfiles:
        """Both profiles in place, evenly sampled."""
        return place_profiles(
            self.wheel,
            self.rail,
            tape_circle=self.tape_circle,
            wheel_radius=self.wheel_radius,
            gauge=self.gauge,
            gauge_depth=self.gauge_depth,
            cant=self.cant,
            rail_lateral=self.rail_lateral,
            curvature_width=self.curvature_width,
        )

    @cached_property
    def zones(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """First and last profile point of the tread zone and of the flange zone."""
        y = self.placed.curves.wheel[:, 0] - self.tape_circle
        if self.zone_split is None:
            split = self._natural_split()
        else:
            split = int(np.searchsorted(y, self.zone_split))
        reach = round(self.zone_overlap / self.placed.curves.wheel_step)
        if not reach < split < len(y) - 1 - reach:
            raise ArgumentError(
                f"wheel {self.wheel.name!r} has no place to part tread and flange "
                f"(zone_split = {self.zone_split}); give zone_split on the profile, "
                f"{y[0]:g} to {y[-1]:g} m, farther than zone_overlap from its ends"
            )
        return (split - reach, len(y) - 1), (0, split + reach)

    @cached_property
    def axle_height(self) -> float:
        """Height of the axle over the rails' crown when the wheelset is centred [m]."""
        zero = np.zeros(1)
        curves = self.placed.curves
        return -float(touch_many(curves, 0, len(curves.wheel) - 1, zero, zero, zero)[0, 0])

    def touch(
        self, shift: ArrayLike, roll: ArrayLike = 0.0, yaw: ArrayLike = 0.0, zone: int | None = None
    ) -> TouchPoints:
        """Find where the right wheel touches, by search over its profile, to rounding.

        Args:
            shift: u, lateral displacement of the wheelset relative to the rail [m]; any shape.
            roll: phi [rad]; broadcast.
            yaw: psi [rad]; broadcast.
            zone: `TREAD`, `FLANGE`, or None for the whole wheel.

        Returns:
            The points. Where a zone's least gap is at its end in the overlap, the point is no
            touch: its weight is zero.

        Raises:
            ArgumentError: A pose is not finite or an angle is beyond 0.2 rad.
        """
        u, phi, psi = np.broadcast_arrays(
            _poses("shift", shift, np.inf, "m"),
            _poses("roll", roll, _LARGEST_ANGLE, "rad"),
            _poses("yaw", yaw, _LARGEST_ANGLE, "rad"),
        )
        first, last = self._range(zone)
        curves = self.placed.curves
        found = touch_many(curves, first, last, u.ravel(), phi.ravel(), psi.ravel())
        columns: list[FloatArray] = [column.reshape(u.shape) for column in found.T]
        height, by_shift, by_roll, by_yaw, forward, lateral, radius, across, place = columns
        points = curves.wheel
        places = curves.wheel_step * np.arange(len(points))
        sine = np.interp(place, places, points[:, 3] / np.hypot(points[:, 2], points[:, 3]))
        rail_y = curves.rail_start + curves.rail_step * np.arange(len(curves.rail))
        return TouchPoints(
            height=height + self.axle_height,
            shift_slope=by_shift,
            roll_slope=by_roll,
            yaw_slope=by_yaw,
            forward=forward,
            lateral=lateral,
            on_wheel=lateral - self.tape_circle,
            radius=radius,
            on_rail=across,
            angle=-np.arctan(by_shift),
            wheel_curvature=np.interp(place, places, self.placed.wheel_curvature),
            rail_curvature=np.interp(across, rail_y, self.placed.rail_curvature),
            # Meusnier: a surface of revolution curves by cos(slope)/radius along its circles.
            rolling_curvature=np.sqrt(1.0 - sine**2) / radius,
            weight=self._weight(place, zone),
        )

    def height(
        self, shift: ArrayLike, roll: ArrayLike = 0.0, yaw: ArrayLike = 0.0, zone: int | None = None
    ) -> FloatArray:
        """Return the height of touch of `touch` [m]."""
        return self.touch(shift, roll, yaw, zone).height

    def _natural_split(self) -> int:
        """Return the profile point in the middle of the largest jump of the contact angle."""
        curves = self.placed.curves
        points, zero = curves.wheel, np.zeros_like(_SWEEP)
        found = touch_many(curves, 0, len(points) - 1, _SWEEP, zero, zero)
        angles = -np.arctan(found[:, 1])
        jump = int(np.argmax(np.diff(angles)))
        high, low = (round(place / curves.wheel_step) for place in found[jump : jump + 2, 8])
        middle = 0.5 * (angles[jump] + angles[jump + 1])
        if angles[jump + 1] - angles[jump] < _SMALLEST_JUMP:
            low, high = 0, int(np.argmin(np.abs(points[:, 0] - self.tape_circle)))
            middle = _DEFAULT_SPLIT
        steep = np.flatnonzero(np.arctan2(-points[low:high, 3], points[low:high, 2]) > middle)
        return low + int(steep[-1]) if len(steep) else low

    def _range(self, zone: int | None) -> tuple[int, int]:
        if zone is None:
            return 0, len(self.placed.curves.wheel) - 1
        if zone not in (TREAD, FLANGE):
            raise ArgumentError(f"zone = {zone!r} does not exist; give TREAD (0) or FLANGE (1)")
        return self.zones[zone]

    def _weight(self, place: FloatArray, zone: int | None) -> FloatArray:
        if zone is None:
            return np.ones_like(place)
        (low, _), (_, high) = self.zones
        step = self.placed.curves.wheel_step
        t = np.clip((place - low * step) / ((high - low) * step), 0.0, 1.0)
        share = t * t * (3.0 - 2.0 * t)
        return share if zone == TREAD else 1.0 - share


def wheelset_contact(pair: WheelRail, shift: ArrayLike, yaw: ArrayLike = 0.0) -> WheelsetContact:
    """Place a rigid wheelset on rigid rails: roll and height from both wheels touching.

    Args:
        pair: Profiles and their placing, the same on both sides.
        shift: Lateral displacement of the wheelset's centre, to the right [m]; any shape.
        yaw: Yaw angle [rad]; broadcast.

    Returns:
        The pose and both contact points.

    Raises:
        ArgumentError: A shift or yaw angle is not finite, or the yaw is beyond 0.2 rad.
    """
    u, psi = np.broadcast_arrays(
        _poses("shift", shift, np.inf, "m"), _poses("yaw", yaw, _LARGEST_ANGLE, "rad")
    )
    u, psi = u.copy(), psi.copy()
    phi = balance_many(pair.placed.curves, u.ravel(), psi.ravel()).reshape(u.shape)
    right = pair.touch(u, phi, psi)
    return WheelsetContact(u, psi, phi, right.height, right, pair.touch(-u, -phi, -psi))


def rolling_radius_difference(
    pair: WheelRail, shift: ArrayLike, yaw: ArrayLike = 0.0
) -> FloatArray:
    """Return the right rolling radius minus the left one [m], on rigid rails.

    Args:
        pair: Profiles and their placing.
        shift: Lateral displacement of the wheelset's centre, to the right [m]; any shape.
        yaw: Yaw angle [rad]; broadcast.
    """
    contact = wheelset_contact(pair, shift, yaw)
    return contact.right.radius - contact.left.radius


def _poses(name: str, values: ArrayLike, largest: float, unit: str) -> FloatArray:
    array = np.asarray(values, dtype=np.float64)
    wrong = ~(np.abs(array) <= largest) | np.isinf(array)
    if bool(wrong.any()):
        rule = f"at most {largest:g} {unit} in size" if np.isfinite(largest) else "finite"
        raise ArgumentError(f"{name} = {array[wrong].flat[0]:g} {unit} must be {rule}")
    return array
