"""Cross sections of wheels and rails, by name from the catalogue.

Axes: y across, z down. A wheel's y counts from the tape circle (70 mm from the wheel's back) to the
field side, and z is zero at the tape circle and grows towards the flange's tip; the body is above
the line. A rail's y counts from the head's symmetry line to the field side, and z is zero at the
crown; the body is below the line, and it is not canted. So both stand for the right side of a
track, where y points outwards.

A profile has one z for each y. Between its points it is the cubic spline through them. Profiles of
files: `railenv.contact.profile_file`. Not known here: radius of the wheel, gauge, cant.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from railenv.contact import rails, wheels
from railenv.errors import ArgumentError, check_text, unknown_name
from railenv.units import FloatArray, Metre

_KINDS = ("wheel", "rail")
_FEWEST_POINTS = 10

_Points = Callable[[], tuple[FloatArray, FloatArray]]
_FIXED: dict[str, dict[str, _Points]] = {
    "wheel": {
        "s1002": wheels.s1002,
        "s1002cn": wheels.s1002cn,
        "lma": wheels.lma,
        "lmb10": wheels.lmb10,
    },
    "rail": {"60e1": rails.rail_60e1, "cn60": rails.rail_cn60},
}


@dataclass(frozen=True, eq=False)
class Profile:
    """Cross section of a wheel or of a rail.

    Attributes:
        name: Its name in the catalogue, or the file it comes from.
        kind: "wheel" or "rail".
        y: Lateral positions, rising, shape (n,) [m]; read-only.
        z: Heights, down, shape (n,) [m]; read-only.
        smoothing: Largest distance of the points it was made from to the profile [m]; zero for the
            catalogue, whose points lie on it.
    """

    name: str
    kind: str
    y: FloatArray
    z: FloatArray
    smoothing: Metre = 0.0

    def __post_init__(self) -> None:
        if self.kind not in _KINDS:
            raise unknown_name("kind of profile", self.kind, _KINDS)
        for axis in ("y", "z"):
            values = np.array(getattr(self, axis), dtype=np.float64)
            if values.ndim != 1 or len(values) < _FEWEST_POINTS:
                raise ArgumentError(
                    f"profile {self.name!r}: {axis} has shape {values.shape}; give one row of "
                    f"{_FEWEST_POINTS} numbers or more"
                )
            if not bool(np.isfinite(values).all()):
                raise ArgumentError(f"profile {self.name!r}: {axis} must be finite throughout")
            values.setflags(write=False)
            object.__setattr__(self, axis, values)
        if self.y.shape != self.z.shape:
            raise ArgumentError(
                f"profile {self.name!r}: {len(self.y)} values of y and {len(self.z)} of z; give "
                "one z for each y"
            )
        if bool(np.any(np.diff(self.y) <= 0.0)):
            raise ArgumentError(f"profile {self.name!r}: y must rise from point to point; sort it")

    def spline(self) -> CubicSpline:
        """Return z over y as a cubic spline through the points [m]."""
        return CubicSpline(self.y, self.z)


def profile_names(kind: str) -> tuple[str, ...]:
    """Return the catalogue's names of wheels or of rails, with the setting where one is needed.

    Args:
        kind: "wheel" or "rail".
    """
    if kind not in _KINDS:
        raise unknown_name("kind of profile", kind, _KINDS)
    family = "cone:angle=0.17" if kind == "wheel" else "arc:radius=0.3"
    return (*_FIXED[kind], family)


def get_profile(name: str) -> Profile:
    """Return a profile of the catalogue.

    Args:
        name: A wheel: "s1002", "s1002cn" (moved by 3 mm to the field side), "lma", "lmb10", or
            "cone:angle=0.17", a straight tread whose slope (tangent) is given, 0 to 0.2, with
            S1002's flange. A rail: "60e1", "cn60", or "arc:radius=0.3", a circular head of 0.005
            to 10 m.

    Raises:
        ArgumentError: The name or its setting is not known or out of range.
    """
    for kind, profiles in _FIXED.items():
        if name in profiles:
            y, z = profiles[name]()
            return Profile(name, kind, 1e-3 * y, 1e-3 * z)
    family, colon, setting = name.partition(":")
    if family == "cone":
        slope = _setting(name, colon, setting, "angle", 0.0, 0.2)
        y, z = wheels.cone(slope)
        return Profile(name, "wheel", 1e-3 * y, 1e-3 * z)
    if family == "arc":
        radius = _setting(name, colon, setting, "radius", 0.005, 10.0)
        y, z = rails.circular(1e3 * radius)
        return Profile(name, "rail", 1e-3 * y, 1e-3 * z)
    known = [each for kind in _KINDS for each in profile_names(kind)]
    raise unknown_name("profile", name[:60], known)


def _setting(
    name: str, colon: str, setting: str, key: str, smallest: float, largest: float
) -> float:
    """Return the one number of a family of profiles, or say how to write it."""
    shown = name[:60]
    given, equals, text = setting.partition("=")
    if not (colon and equals) or given != key:
        example = "cone:angle=0.17" if key == "angle" else "arc:radius=0.3"
        raise ArgumentError(f"profile {shown!r} must have the form {example}")
    value = check_text(f"profile {shown!r}: {key}", text)
    if not smallest <= value <= largest:
        raise ArgumentError(
            f"profile {shown!r}: {key} = {value:g} is out of range; "
            f"give {smallest:g} to {largest:g}"
        )
    return value
