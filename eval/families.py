"""Families of loops for `railenv certify --vary`: parameters of vehicle and running in an interval.

What lies between the corners of a family is covered if each parameter enters through one monotone
function of itself: the speed as 1/v, conicity, creep, stiffness and damping as they are; one mass
or inertia may enter in a curved way. Lengths and the actuators' lag enter otherwise and are not
taken.
"""

import argparse

from eval.chart_axes import Axis, parse_axis, varied_loop
from railenv.errors import ArgumentError
from railenv.stability import UncertainDelaySystem

ROUNDING = 1e-12
"""Share of every entry that is added for the rounding of the vehicle's assembly."""

_AFFINE = ("stiffness", "damping", "creep", "conicity", "spin")
_CURVED = ("mass", "inertia")


def parse_family(options: argparse.Namespace) -> UncertainDelaySystem:
    """Return the family that --vary NAME=LOW:HIGH, repeated, means.

    Raises:
        ArgumentError: A name or interval is not usable, or it enters in a way that no corner shows.
    """
    axes = tuple(_interval(text, options) for text in options.vary)
    curved = [k for k, axis in enumerate(axes) if _is_curved(axis)]
    if len(curved) > 1:
        raise ArgumentError(
            f"{axes[curved[0]].name!r} and {axes[curved[1]].name!r} are both masses or inertias; "
            "vary one of them (several together as a+b*=LOW:HIGH)"
        )
    loop = varied_loop(options, axes)
    ranges = [(float(axis.values[0]), float(axis.values[-1])) for axis in axes]
    family = UncertainDelaySystem.between(loop, ranges, curved[0] if curved else None)
    return family.inflate(ROUNDING)


def _interval(text: str, options: argparse.Namespace) -> Axis:
    name, _, ends = text.partition("=")
    if ends.count(":") != 1:
        raise ArgumentError(f"vary = {text!r} must be NAME=LOW:HIGH or NAME*=LOW:HIGH")
    axis = parse_axis(f"{name}={ends}:2", options)
    if axis.kind == "actuator_lag":
        raise ArgumentError("actuator_lag enters neither affinely nor by its inverse; fix it")
    for target in axis.targets:
        known = target.endswith(_AFFINE + _CURVED) or target.startswith(_AFFINE)
        if axis.kind in ("parameter", "multiple") and not known:
            raise ArgumentError(
                f"{target} is a length: it enters in products with itself, so corners do not "
                "cover what lies between; vary stiffness, damping, creep, conicity, speed or a "
                "mass"
            )
    return axis


def _is_curved(axis: Axis) -> bool:
    return axis.kind in ("parameter", "multiple") and any(
        target.endswith(_CURVED) for target in axis.targets
    )
