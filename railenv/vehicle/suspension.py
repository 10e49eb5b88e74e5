"""Linear force elements and their places in the lateral vehicle.

An element reads one relative displacement d = row @ q - track_row @ w and resists it. Spring and
dashpot in parallel give the force k d + c d'. A Maxwell element (spring k in series with dashpot
c) has a node between the two: force k (d - z), z' = (k / c) (d - z).

Numbering and sign conventions are those of `railenv.vehicle.coordinates`.
"""

from dataclasses import dataclass

import numpy as np

from railenv.units import FloatArray
from railenv.vehicle.coordinates import (
    BOGIES,
    NUM_COORDINATES,
    WHEELSETS,
    Layout,
    bogie_of_position,
    bogie_of_wheelset,
    bogie_sign,
    damper_positions,
    end_sign,
    lateral_of_point,
    unit_row,
)
from railenv.vehicle.parameters import VehicleParameters

NUM_TRACK = 2 * len(WHEELSETS)
"""Track inputs: alignment at wheelsets 1 to 4 [m], then track roll at wheelsets 1 to 4 [rad]."""


@dataclass(frozen=True)
class ParallelElement:
    """Spring and dashpot in parallel, on d = row @ q - track_row @ w.

    Attributes:
        name: What it is, for messages and tests.
        row: Relative displacement per coordinate, shape (17,).
        stiffness: k, in N/m or N m/rad.
        damping: c, in N s/m or N m s/rad.
        track_row: Share of the track's motion in the displacement, shape (8,).
    """

    name: str
    row: FloatArray
    stiffness: float
    damping: float
    track_row: FloatArray


@dataclass(frozen=True)
class MaxwellElement:
    """Spring in series with a dashpot, on d = row @ q; its node is one more state.

    Attributes:
        name: Name of the node's state.
        row: Relative displacement per coordinate, shape (17,).
        stiffness: Of the spring [N/m], above zero.
        damping: Of the dashpot [N s/m], above zero.
    """

    name: str
    row: FloatArray
    stiffness: float
    damping: float


def damper_row(parameters: VehicleParameters, position: int) -> FloatArray:
    """Return the stretch of a lateral damper or actuator, carbody minus bogie, shape (17,)."""
    p = parameters
    bogie = bogie_of_position(position)
    offset = end_sign(position) * p.damper_offset
    place = damper_place(parameters, position)
    on_carbody = lateral_of_point("carbody", place, p.carbody_to_damper_height)
    return on_carbody - lateral_of_point(f"bogie{bogie}", offset, p.bogie_to_damper_height)


def damper_place(parameters: VehicleParameters, position: int) -> float:
    """Return how far a damper place lies ahead of the carbody's centre [m]."""
    bogie = bogie_of_position(position)
    offset = end_sign(position) * parameters.damper_offset
    return bogie_sign(bogie) * parameters.half_bogie_spacing + offset


def parallel_elements(parameters: VehicleParameters) -> tuple[ParallelElement, ...]:
    """Return primary and secondary suspension, element by element.

    Args:
        parameters: The vehicle's numbers.

    Returns:
        Three elements per wheelset and four per bogie. Wheelset roll is neglected: the wheelset
        follows the track's roll, so the primary vertical element reads bogie roll minus track roll.
    """
    p = parameters
    elements: list[ParallelElement] = []
    for wheelset in WHEELSETS:
        bogie = bogie_of_wheelset(wheelset)
        place = end_sign(wheelset) * p.half_wheelbase
        frame = lateral_of_point(f"bogie{bogie}", place, p.bogie_to_primary_height)
        arm = p.half_primary_spacing**2
        elements += [
            _element(
                f"primary_lateral_{wheelset}",
                frame - unit_row(f"wheelset{wheelset}_lateral"),
                2 * p.primary_lateral_stiffness,
                2 * p.primary_lateral_damping,
            ),
            _element(
                f"primary_longitudinal_{wheelset}",
                unit_row(f"wheelset{wheelset}_yaw") - unit_row(f"bogie{bogie}_yaw"),
                2 * p.primary_longitudinal_stiffness * arm,
                0.0,
            ),
            _element(
                f"primary_vertical_{wheelset}",
                unit_row(f"bogie{bogie}_roll"),
                2 * p.primary_vertical_stiffness * arm,
                2 * p.primary_vertical_damping * arm,
                track_roll_of=wheelset,
            ),
        ]
    for bogie in BOGIES:
        place = bogie_sign(bogie) * p.half_bogie_spacing
        carbody = lateral_of_point("carbody", place, p.carbody_to_secondary_height)
        frame = lateral_of_point(f"bogie{bogie}", 0.0, p.bogie_to_secondary_height)
        yaw = unit_row("carbody_yaw") - unit_row(f"bogie{bogie}_yaw")
        roll = unit_row("carbody_roll") - unit_row(f"bogie{bogie}_roll")
        arm = p.half_secondary_spacing**2
        elements += [
            _element(
                f"secondary_lateral_{bogie}",
                carbody - frame,
                2 * p.secondary_lateral_stiffness,
                2 * p.secondary_lateral_damping,
            ),
            _element(
                f"secondary_longitudinal_{bogie}",
                yaw,
                2 * p.secondary_longitudinal_stiffness * arm,
                0.0,
            ),
            _element(
                f"secondary_vertical_{bogie}",
                roll,
                2 * p.secondary_vertical_stiffness * arm,
                2 * p.secondary_vertical_damping * arm,
            ),
            _element(f"antiroll_bar_{bogie}", roll, p.antiroll_stiffness, 0.0),
        ]
    return tuple(elements)


def maxwell_elements(parameters: VehicleParameters, layout: Layout) -> tuple[MaxwellElement, ...]:
    """Return the yaw dampers (two per bogie) and the lateral dampers that the layout keeps.

    A damper whose series stiffness is zero transmits nothing and is left out.
    """
    p = parameters
    elements: list[MaxwellElement] = []
    if p.yaw_damper_stiffness > 0.0:
        for bogie in BOGIES:
            yaw = unit_row("carbody_yaw") - unit_row(f"bogie{bogie}_yaw")
            for side, sign in (("left", -1.0), ("right", 1.0)):
                # A point at y = w moves along x by -w yaw; the sign of the stretch is free.
                elements.append(
                    MaxwellElement(
                        f"bogie{bogie}_yaw_damper_{side}_node",
                        -sign * p.half_yaw_damper_spacing * yaw,
                        p.yaw_damper_stiffness,
                        p.yaw_damper_damping,
                    )
                )
    if p.lateral_damper_stiffness > 0.0:
        elements += [
            MaxwellElement(
                f"lateral_damper_{position}_node",
                damper_row(p, position),
                p.lateral_damper_stiffness,
                p.lateral_damper_damping,
            )
            for position in damper_positions(layout)
        ]
    return tuple(elements)


def _element(
    name: str,
    row: FloatArray,
    stiffness: float,
    damping: float,
    track_roll_of: int | None = None,
) -> ParallelElement:
    track_row = np.zeros(NUM_TRACK)
    if track_roll_of is not None:
        track_row[len(WHEELSETS) + track_roll_of - 1] = 1.0
    assert row.shape == (NUM_COORDINATES,)
    return ParallelElement(name, row, stiffness, damping, track_row)
