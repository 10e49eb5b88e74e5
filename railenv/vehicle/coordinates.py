"""Axes, coordinate names and the displacement rows of points, for the 17-coordinate lateral model.

Axes: x forward, y to the right, z down. A positive roll turns y towards z (right side down), a
positive yaw turns x towards y. A height is "centre of gravity minus point": positive where the
point lies below the centre of gravity. A point at (x, height) of a body therefore moves laterally
by `lateral + x * yaw - height * roll`.

This module is the only place that knows index numbers; everything else asks by name.
"""

from typing import Literal

import numpy as np

from railenv.errors import ArgumentError
from railenv.units import FloatArray

WHEELSETS = (1, 2, 3, 4)
BOGIES = (1, 2)
DAMPER_POSITIONS = (1, 2, 3, 4)
"""Lateral damper or actuator places: 1, 2 front bogie (front, rear end), 3, 4 rear bogie."""

COORDINATES: tuple[str, ...] = (
    *(f"wheelset{i}_{motion}" for i in WHEELSETS for motion in ("lateral", "yaw")),
    *(f"bogie{j}_{motion}" for j in BOGIES for motion in ("lateral", "yaw", "roll")),
    *(f"carbody_{motion}" for motion in ("lateral", "yaw", "roll")),
)
NUM_COORDINATES = len(COORDINATES)
_INDEX = {name: index for index, name in enumerate(COORDINATES)}

Layout = Literal["passive", "2", "4"]
LAYOUTS: tuple[Layout, ...] = ("passive", "2", "4")
_ACTUATOR_POSITIONS: dict[Layout, tuple[int, ...]] = {
    "passive": (),
    "2": (1, 4),
    "4": DAMPER_POSITIONS,
}


def parse_layout(layout: object) -> Layout:
    """Return the layout's canonical name.

    Args:
        layout: "passive" (a lateral damper at all four places), 2 or "2" (actuators replace the
            dampers at places 1 and 4), 4 or "4" (actuators replace all four).

    Raises:
        ArgumentError: Anything else.
    """
    text = str(layout)
    for known in LAYOUTS:
        if text == known:
            return known
    raise ArgumentError(f"layout = {text!r} does not exist; choose passive, 2 or 4")


def actuator_positions(layout: Layout) -> tuple[int, ...]:
    """Return the damper places where the layout has an actuator, in channel order."""
    return _ACTUATOR_POSITIONS[layout]


def damper_positions(layout: Layout) -> tuple[int, ...]:
    """Return the damper places where the layout keeps a passive lateral damper."""
    return tuple(p for p in DAMPER_POSITIONS if p not in _ACTUATOR_POSITIONS[layout])


def coordinate_index(name: str) -> int:
    """Return the position of a coordinate in the order of `COORDINATES`."""
    return _INDEX[name]


def unit_row(name: str) -> FloatArray:
    """Return the row that picks one coordinate, shape (17,)."""
    row = np.zeros(NUM_COORDINATES)
    row[_INDEX[name]] = 1.0
    return row


def lateral_of_point(body: str, x: float, height: float) -> FloatArray:
    """Return the row of a point's lateral displacement.

    Args:
        body: "carbody", "bogie1" or "bogie2".
        x: Longitudinal place of the point ahead of the body's centre [m].
        height: Body's centre of gravity minus point, positive where the point is lower [m].

    Returns:
        Row r, shape (17,), so that the displacement is r @ q [m].
    """
    return (
        unit_row(f"{body}_lateral")
        + x * unit_row(f"{body}_yaw")
        - height * unit_row(f"{body}_roll")
    )


def bogie_of_wheelset(wheelset: int) -> int:
    """Return the bogie (1 leads) that carries a wheelset (1 leads)."""
    return 1 if wheelset <= 2 else 2


def bogie_of_position(position: int) -> int:
    """Return the bogie (1 leads) at which a damper place lies."""
    return 1 if position <= 2 else 2


def end_sign(number: int) -> int:
    """Return +1 for the leading wheelset or damper place of a bogie, -1 for the trailing one."""
    return 1 if number % 2 == 1 else -1


def bogie_sign(bogie: int) -> int:
    """Return +1 for the front bogie, -1 for the rear bogie."""
    return 1 if bogie == 1 else -1
