"""Force elements of the nonlinear vehicle and their places.

Every element reads one relative displacement d = row @ q and resists it along the same row, so
forces on the two bodies are equal and opposite and do no work in between. Springs are bushings with
forces along the track's axes.

Where the preload acts: a spring that carries weight pushes along the z axis of the bogie frame, in
both stages. Its work to second order gives a geometric stiffness (the carbody's pendulum term and
its kin), kept apart as `geometric_stiffness` so that it can be left out, as the 17-coordinate model
leaves it out.

Left out on purpose: torsion of the springs, friction in them, and the change of an air
spring's load with height beyond its linear stiffness.
"""

from dataclasses import dataclass

import numpy as np

from railenv.units import FloatArray
from railenv.vehicle.coordinates import (
    BOGIES,
    WHEELSETS,
    Layout,
    actuator_positions,
    bogie_of_position,
    bogie_of_wheelset,
    bogie_sign,
    damper_positions,
    end_sign,
)
from railenv.vehicle.nonlinear.coordinates import (
    NUM_COORDINATES,
    SIDES,
    point_row,
    side_sign,
    unit_row,
)
from railenv.vehicle.nonlinear.parameters import FullParameters


@dataclass(frozen=True)
class LinearElement:
    """Spring and dashpot in parallel.

    Attributes:
        name: What it is.
        row: Relative displacement per coordinate, shape (50,).
        stiffness: In N/m or N m/rad.
        damping: In N s/m or N m s/rad.
    """

    name: str
    row: FloatArray
    stiffness: float
    damping: float = 0.0


@dataclass(frozen=True)
class Damper:
    """Piecewise linear dashpot, alone or in series with a spring.

    Attributes:
        name: What it is.
        row: Relative displacement per coordinate, shape (50,).
        damping: Up to the break [N s/m].
        break_force: Where the slope changes [N].
        beyond: Slope beyond it [N s/m].
        stiffness: Of the spring in series [N/m]; 0 for none. With one, the damper has a node.
    """

    name: str
    row: FloatArray
    damping: float
    break_force: float
    beyond: float
    stiffness: float = 0.0


@dataclass(frozen=True)
class Stop:
    """Bump stop in both directions, by table.

    Attributes:
        name: What it is.
        row: Relative displacement per coordinate, shape (50,).
    """

    name: str
    row: FloatArray


def linear_elements(parameters: FullParameters) -> tuple[LinearElement, ...]:
    """Return springs, bushings, bars and rods.

    The lateral springs of an axle box act at the axle, as in the 17-coordinate model; its arm's
    bushing carries the pitch of the box.
    """
    p = parameters.lateral
    elements: list[LinearElement] = []
    for wheelset in WHEELSETS:
        bogie, axle = f"bogie{bogie_of_wheelset(wheelset)}", f"wheelset{wheelset}"
        place, height = end_sign(wheelset) * p.half_wheelbase, p.bogie_to_primary_height
        arm = end_sign(wheelset) * parameters.arm_length
        for side in SIDES:
            y = side_sign(side) * p.half_primary_spacing
            label = f"{wheelset}_{side}"

            def stretch(direction: str, y: float = y, bogie: str = bogie) -> FloatArray:
                frame = point_row(bogie, direction, place, y, height)  # noqa: B023
                return frame - point_row(axle, direction, 0.0, y, 0.0)  # noqa: B023

            # The box is ahead of its arm's bushing on a leading wheelset; it turns about the axle.
            bushing = (
                point_row(bogie, "vertical", place - arm, y, height)
                - point_row(axle, "vertical", 0.0, y, 0.0)
                - arm * unit_row(f"axle_box{label}_pitch")
            )
            elements += [
                LinearElement(
                    f"primary_longitudinal_{label}",
                    stretch("longitudinal"),
                    p.primary_longitudinal_stiffness,
                ),
                LinearElement(
                    f"primary_lateral_{label}",
                    stretch("lateral"),
                    p.primary_lateral_stiffness,
                    p.primary_lateral_damping,
                ),
                LinearElement(
                    f"primary_vertical_{label}", stretch("vertical"), p.primary_vertical_stiffness
                ),
                LinearElement(
                    f"arm_bushing_{label}",
                    bushing,
                    parameters.arm_stiffness,
                    parameters.arm_damping,
                ),
            ]
    for number in BOGIES:
        bogie, place = f"bogie{number}", bogie_sign(number) * p.half_bogie_spacing
        for side in SIDES:
            y, label = side_sign(side) * p.half_secondary_spacing, f"{number}_{side}"
            coefficients = {
                "longitudinal": (p.secondary_longitudinal_stiffness, 0.0),
                "lateral": (p.secondary_lateral_stiffness, p.secondary_lateral_damping),
                "vertical": (p.secondary_vertical_stiffness, p.secondary_vertical_damping),
            }
            for direction, (stiffness, damping) in coefficients.items():
                top = point_row("carbody", direction, place, y, p.carbody_to_secondary_height)
                bottom = point_row(bogie, direction, 0.0, y, p.bogie_to_secondary_height)
                name = f"secondary_{direction}_{label}"
                elements.append(LinearElement(name, top - bottom, stiffness, damping))
        roll = unit_row("carbody_roll") - unit_row(f"{bogie}_roll")
        rod = point_row(
            "carbody",
            "longitudinal",
            place,
            0.0,
            parameters.carbody_height - parameters.traction_rod_carbody,
        ) - point_row(
            bogie,
            "longitudinal",
            0.0,
            0.0,
            parameters.bogie_height - parameters.traction_rod_bogie,
        )
        elements += [
            LinearElement(f"antiroll_bar_{number}", roll, p.antiroll_stiffness),
            LinearElement(f"traction_rod_{number}", rod, parameters.traction_rod_stiffness),
        ]
    elements.append(
        LinearElement(
            "coupler",
            unit_row("carbody_longitudinal"),
            parameters.coupler_stiffness,
            parameters.coupler_damping,
        )
    )
    return tuple(elements)


def dampers(parameters: FullParameters, layout: Layout) -> tuple[Damper, ...]:
    """Return primary vertical dampers, yaw dampers and the lateral dampers the layout keeps.

    Those with a spring in series come last, in the order of the 17-coordinate model's nodes. A
    damper that transmits nothing is left out.
    """
    p = parameters.lateral
    found: list[Damper] = []
    for element in linear_elements(parameters):
        if element.name.startswith("primary_vertical_") and p.primary_vertical_damping > 0.0:
            damping = p.primary_vertical_damping
            found.append(
                Damper(
                    element.name.replace("vertical", "damper"),
                    element.row,
                    damping,
                    parameters.primary_damper_break,
                    damping * parameters.primary_damper_ratio,
                )
            )
    for number in BOGIES if p.yaw_damper_stiffness > 0.0 else ():
        for side in SIDES:
            y = side_sign(side) * p.half_yaw_damper_spacing
            height, place = parameters.yaw_damper_height, bogie_sign(number) * p.half_bogie_spacing
            top, bottom = parameters.carbody_height - height, parameters.bogie_height - height
            row = point_row("carbody", "longitudinal", place, y, top) - point_row(
                f"bogie{number}", "longitudinal", 0.0, y, bottom
            )
            found.append(
                Damper(
                    f"bogie{number}_yaw_damper_{side}",
                    row,
                    p.yaw_damper_damping,
                    parameters.yaw_damper_break,
                    min(parameters.yaw_damper_beyond, p.yaw_damper_damping),
                    p.yaw_damper_stiffness,
                )
            )
    if p.lateral_damper_stiffness > 0.0:
        found += [
            Damper(
                f"lateral_damper_{position}",
                damper_row(parameters, position),
                p.lateral_damper_damping,
                parameters.lateral_damper_break,
                min(parameters.lateral_damper_beyond, p.lateral_damper_damping),
                p.lateral_damper_stiffness,
            )
            for position in damper_positions(layout)
        ]
    return tuple(found)


def stops(parameters: FullParameters) -> tuple[Stop, ...]:
    """Return the lateral bump stops, one per bogie."""
    p = parameters.lateral
    found: list[Stop] = []
    for number in BOGIES:
        place = bogie_sign(number) * p.half_bogie_spacing
        top = parameters.carbody_height - parameters.bump_stop_height
        bottom = parameters.bogie_height - parameters.bump_stop_height
        row = point_row("carbody", "lateral", place, 0.0, top) - point_row(
            f"bogie{number}", "lateral", 0.0, 0.0, bottom
        )
        found.append(Stop(f"bump_stop_{number}", row))
    return tuple(found)


def damper_row(parameters: FullParameters, position: int) -> FloatArray:
    """Return the stretch of a lateral damper or actuator, carbody minus bogie, shape (50,)."""
    p = parameters.lateral
    number = bogie_of_position(position)
    offset = end_sign(position) * p.damper_offset
    place = bogie_sign(number) * p.half_bogie_spacing + offset
    return point_row("carbody", "lateral", place, 0.0, p.carbody_to_damper_height) - point_row(
        f"bogie{number}", "lateral", offset, 0.0, p.bogie_to_damper_height
    )


def actuator_rows(parameters: FullParameters, layout: Layout) -> FloatArray:
    """Return one row per actuator channel, shape (channels, 50)."""
    rows = [damper_row(parameters, position) for position in actuator_positions(layout)]
    return np.array(rows).reshape(len(rows), NUM_COORDINATES)


def geometric_stiffness(parameters: FullParameters) -> FloatArray:
    """Return what the springs' preloads add to the stiffness, shape (50, 50).

    A preload P between point A above and point B below stores P (r_A - r_B) . e_z with the bogie
    frame's axis e_z = (pitch, -roll, 1 - (roll^2 + pitch^2) / 2). With l the nominal height of A
    over B and heights h counted from each centre of gravity down, the product is, to second order,

        dz - l - roll_f dy + pitch_f dx + l (roll_f^2 + pitch_f^2) / 2
        - h_A (roll_A^2 + pitch_A^2) / 2 + h_B (roll_B^2 + pitch_B^2) / 2

    with dx, dy, dz the first-order displacements of A relative to B.
    """
    p = parameters.lateral
    total = np.zeros((NUM_COORDINATES, NUM_COORDINATES))

    def add(load: float, above: str, below: str, heights: tuple[float, float], row_of: str) -> None:
        """Add one spring, given the names of its linear elements."""
        frame = above if above.startswith("bogie") else below
        h_above, h_below = heights
        bottom = _height_of(parameters, below) - h_below
        length = _height_of(parameters, above) - h_above - bottom
        for body, weight in ((frame, length), (above, -h_above), (below, h_below)):
            for turn in ("roll", "pitch"):
                row = unit_row(f"{body}_{turn}")
                total[:] += load * weight * np.outer(row, row)
        lateral, longitudinal = rows[row_of.format("lateral")], rows[row_of.format("longitudinal")]
        # The rows are frame minus wheelset in the primary, carbody minus frame in the secondary.
        for turn, sign, row in (("roll", -1.0, lateral), ("pitch", 1.0, longitudinal)):
            angle = unit_row(f"{frame}_{turn}")
            total[:] += sign * load * (np.outer(angle, row) + np.outer(row, angle))

    rows = {element.name: element.row for element in linear_elements(parameters)}
    for wheelset in WHEELSETS:
        for side in SIDES:
            add(
                parameters.primary_preload,
                f"bogie{bogie_of_wheelset(wheelset)}",
                f"wheelset{wheelset}",
                (p.bogie_to_primary_height, 0.0),
                f"primary_{{}}_{wheelset}_{side}",
            )
    for number in BOGIES:
        for side in SIDES:
            add(
                parameters.secondary_preload,
                "carbody",
                f"bogie{number}",
                (p.carbody_to_secondary_height, p.bogie_to_secondary_height),
                f"secondary_{{}}_{number}_{side}",
            )
    return total


def _height_of(parameters: FullParameters, body: str) -> float:
    if body == "carbody":
        return parameters.carbody_height
    if body.startswith("bogie"):
        return parameters.bogie_height
    return parameters.lateral.wheel_radius
