"""The 50 coordinates of the nonlinear vehicle and the displacement rows of its points.

Axes of the track frame, which moves along the track at the running speed: x forward, y to the
right, z down. A positive roll turns y towards z, pitch z towards x, yaw x towards y. All
coordinates are zero in the design position: every body at its nominal place, the springs carrying
the weights above them, the wheels just touching the rails.

Six coordinates per body, then the pitch of the eight axle boxes: a box shares its journal's motion
otherwise. Rotations are small for bodies; the contact geometry takes the wheelset's roll and yaw
as they are. A wheelset's pitch is what its rotation differs from the nominal rolling -V t / r_0.
"""

import numpy as np

from railenv.units import FloatArray
from railenv.vehicle.coordinates import BOGIES, WHEELSETS

MOTIONS = ("longitudinal", "lateral", "vertical", "roll", "pitch", "yaw")
SIDES = ("left", "right")

BODIES: tuple[str, ...] = (
    "carbody",
    *(f"bogie{j}" for j in BOGIES),
    *(f"wheelset{i}" for i in WHEELSETS),
)
"""Bodies with six coordinates each, in the order of the coordinates."""

AXLE_BOXES: tuple[str, ...] = tuple(f"axle_box{i}_{side}" for i in WHEELSETS for side in SIDES)

COORDINATES: tuple[str, ...] = (
    *(f"{body}_{motion}" for body in BODIES for motion in MOTIONS),
    *(f"{box}_pitch" for box in AXLE_BOXES),
)
NUM_COORDINATES = len(COORDINATES)
_INDEX = {name: index for index, name in enumerate(COORDINATES)}

FIRST_WHEELSET = 6 * BODIES.index("wheelset1")
"""Index of `wheelset1_longitudinal`; wheelset i begins 6 (i - 1) later."""


def coordinate_index(name: str) -> int:
    """Return the position of a coordinate in the order of `COORDINATES`."""
    return _INDEX[name]


def unit_row(name: str) -> FloatArray:
    """Return the row that picks one coordinate, shape (50,)."""
    row = np.zeros(NUM_COORDINATES)
    row[_INDEX[name]] = 1.0
    return row


def side_sign(side: str) -> float:
    """Return +1 for the right side, -1 for the left one."""
    return 1.0 if side == "right" else -1.0


def point_row(body: str, direction: str, x: float, y: float, height: float) -> FloatArray:
    """Return the row of a point's small displacement in one direction.

    Args:
        body: One of `BODIES`.
        direction: "longitudinal", "lateral" or "vertical".
        x: Place ahead of the body's centre of gravity [m].
        y: Place to the right of it [m].
        height: Centre of gravity minus point, positive where the point is lower [m].

    Returns:
        Row r, shape (50,), so that the displacement is r @ q [m].
    """
    row = unit_row(f"{body}_{direction}")
    roll, pitch, yaw = (unit_row(f"{body}_{turn}") for turn in ("roll", "pitch", "yaw"))
    if direction == "longitudinal":
        return row + height * pitch - y * yaw
    if direction == "lateral":
        return row + x * yaw - height * roll
    return row + y * roll - x * pitch
