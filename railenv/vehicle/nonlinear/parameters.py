"""Parameters of the nonlinear vehicle: the lateral model's numbers and what that model lacks.

The lateral numbers are the small-motion limit of this vehicle, so they are held as they are, in one
`VehicleParameters`. Heights above rail follow from them (axle, bogie, dampers, carbody) or are
given here.

Sources, cited by the words in brackets:

[crh380a] Public CRH380A multibody parameter set (51 coordinates).
[velaro] Velaro E, Goicolea, UPM (oa.upm.es/43946).
[ratio] The paper's linear value, softened beyond the break by the ratio that [crh380a] has.
[assumed] Chosen by this project.
"""

import dataclasses
import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np

from railenv.errors import (
    ArgumentError,
    check_finite,
    check_not_negative,
    check_positive,
    unknown_name,
)
from railenv.units import (
    STANDARD_GRAVITY,
    FloatArray,
    KilogramSquareMetre,
    Metre,
    Newton,
    NewtonPerMetre,
    NewtonSecondPerMetre,
)
from railenv.vehicle.parameters import VehicleParameters

Table = tuple[tuple[float, float], ...]


@dataclass(frozen=True, kw_only=True)
class FullParameters:
    """All numbers of the 50-coordinate vehicle that stand apart from wheel and rail.

    A damper is piecewise linear in the velocity of its dashpot: the linear coefficient of
    `lateral` up to a break, a softer one beyond (blow-off).

    Attributes:
        lateral: Numbers shared with the 17-coordinate model; conicity and creep coefficients there
            are not used unless asked for.
        carbody_pitch_inertia: I_cy.
        bogie_pitch_inertia: I_fy.
        wheelset_roll_inertia: I_wx.
        wheelset_pitch_inertia: I_wy, about the axle.
        axle_box_pitch_inertia: Of one box with its arm, about the axle.
        arm_length: From the axle to the arm's bushing, towards the bogie's centre.
        arm_stiffness: Of the bushing in the vertical direction.
        arm_damping: Of the bushing in the vertical direction.
        primary_damper_break: Force at which a primary vertical damper softens.
        primary_damper_ratio: Share of its damping that remains beyond.
        yaw_damper_break: Blow-off force.
        yaw_damper_beyond: Damping beyond it.
        lateral_damper_break: Blow-off force.
        lateral_damper_beyond: Damping beyond it.
        actuator_residue: Damping that an actuator has beside its force, as of a failed one that is
            switched to passive; every actuator of the layout has it.
        bump_stop: Displacement [m] and force [N] of the lateral bump stop of one bogie, rising from
            the free gap with force zero; linear in between and beyond.
        traction_rod_stiffness: One rod per bogie, in the middle.
        coupler_stiffness: What holds the carbody at the running speed, as a train does.
        coupler_damping: Its damping.
        traction_rod_carbody: Height of the rod's end at the carbody above rail.
        traction_rod_bogie: Height of its end at the bogie frame above rail.
        yaw_damper_height: Above rail.
        bump_stop_height: Above rail.
    """

    lateral: VehicleParameters
    carbody_pitch_inertia: KilogramSquareMetre = 1957888.0  # [velaro]
    bogie_pitch_inertia: KilogramSquareMetre = 1249.0  # [crh380a]
    wheelset_roll_inertia: KilogramSquareMetre = 900.0  # as the yaw inertia: a body of revolution
    wheelset_pitch_inertia: KilogramSquareMetre = 76.0  # [crh380a]
    axle_box_pitch_inertia: KilogramSquareMetre = 8.0  # [assumed]
    arm_length: Metre = 0.5  # [assumed]
    arm_stiffness: NewtonPerMetre = 13.72e6  # [crh380a], the arm's longitudinal value
    arm_damping: NewtonSecondPerMetre = 4.0e3  # [assumed], about a tenth of critical
    primary_damper_break: Newton = 1.0e3  # [ratio], 0.1 m/s
    primary_damper_ratio: float = 0.75  # [ratio], 14.7 / 19.6
    yaw_damper_break: Newton = 9.81e3  # [crh380a]
    yaw_damper_beyond: NewtonSecondPerMetre = 49.95e3  # [crh380a]
    lateral_damper_break: Newton = 1.5e3  # [ratio], 0.1 m/s
    lateral_damper_beyond: NewtonSecondPerMetre = 6.28e3  # [ratio], 24.6 / 58.8
    actuator_residue: NewtonSecondPerMetre = 0.0  # as the 17-coordinate model has it
    bump_stop: Table = (  # [crh380a]
        (0.020, 0.0),
        (0.026, 2000.0),
        (0.032, 5000.0),
        (0.038, 11000.0),
        (0.044, 25500.0),
        (0.048, 49000.0),
    )
    traction_rod_stiffness: NewtonPerMetre = 7.882e6  # [crh380a]
    coupler_stiffness: NewtonPerMetre = 40.0e3  # [assumed], 0.15 Hz with the whole vehicle
    coupler_damping: NewtonSecondPerMetre = 50.0e3  # [assumed], about half of critical
    traction_rod_carbody: Metre = 0.38  # [crh380a]
    traction_rod_bogie: Metre = 0.3975  # [crh380a]
    yaw_damper_height: Metre = 0.415  # [crh380a]
    bump_stop_height: Metre = 0.68  # [crh380a]

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            name, value = field.name, getattr(self, field.name)
            if name == "lateral":
                if not isinstance(value, VehicleParameters):
                    raise ArgumentError(f"lateral = {value!r} must be VehicleParameters")
                continue
            if name == "bump_stop":
                object.__setattr__(self, name, _checked_table(name, value))
                continue
            positive = name in _POSITIVE or name.endswith("inertia")
            check = check_positive if positive else check_not_negative
            object.__setattr__(self, name, check(name, value))
        if self.primary_damper_ratio > 1.0:
            raise ArgumentError(
                f"primary_damper_ratio = {self.primary_damper_ratio:g} must not exceed 1: "
                "a damper softens beyond its break"
            )

    def replace(self, **changes: Any) -> "FullParameters":
        """Return a copy with some fields changed.

        Raises:
            ArgumentError: A field does not exist (the message names the nearest ones) or a value
                is not allowed.
        """
        names = {field.name for field in dataclasses.fields(self)}
        for name in changes:
            if name not in names:
                raise unknown_name("vehicle parameter", name, names)
        return dataclasses.replace(self, **changes)

    @property
    def bogie_height(self) -> float:
        """Centre of gravity of a bogie frame above rail [m]."""
        return self.lateral.wheel_radius + self.lateral.bogie_to_primary_height

    @property
    def carbody_height(self) -> float:
        """Centre of gravity of the carbody above rail [m]."""
        damper = self.bogie_height - self.lateral.bogie_to_damper_height
        return damper + self.lateral.carbody_to_damper_height

    @property
    def secondary_preload(self) -> float:
        """Static load of one air spring [N]."""
        return self.lateral.carbody_mass * STANDARD_GRAVITY / 4.0

    @property
    def primary_preload(self) -> float:
        """Static load of one axle box [N]."""
        p = self.lateral
        return (p.carbody_mass / 8.0 + p.bogie_mass / 4.0) * STANDARD_GRAVITY

    @property
    def masses(self) -> FloatArray:
        """Mass or inertia of every coordinate, shape (50,)."""
        p = self.lateral
        carbody = (p.carbody_roll_inertia, self.carbody_pitch_inertia, p.carbody_yaw_inertia)
        bogie = (p.bogie_roll_inertia, self.bogie_pitch_inertia, p.bogie_yaw_inertia)
        wheelset = (
            self.wheelset_roll_inertia,
            self.wheelset_pitch_inertia,
            p.wheelset_yaw_inertia,
        )
        return np.array(
            [
                *(p.carbody_mass,) * 3,
                *carbody,
                *((p.bogie_mass,) * 3 + bogie) * 2,
                *((p.wheelset_mass,) * 3 + wheelset) * 4,
                *(self.axle_box_pitch_inertia,) * 8,
            ]
        )


_POSITIVE = frozenset(
    {
        "arm_length",
        "yaw_damper_beyond",
        "lateral_damper_beyond",
        "coupler_stiffness",
        "primary_damper_break",
        "yaw_damper_break",
        "lateral_damper_break",
    }
)


def _checked_table(name: str, table: Any) -> Table:
    """Return a force table with rising displacements and forces that do not fall."""
    points = tuple(
        (check_positive(f"{name}[{k}] displacement", d, "m"), check_finite(name, f, "N"))
        for k, (d, f) in enumerate(table)
    )
    places, forces = [d for d, _ in points], [f for _, f in points]
    rising = all(a < b for a, b in itertools.pairwise(places))
    steady = all(a <= b for a, b in itertools.pairwise(forces))
    if len(points) < 2 or not rising or not steady or forces[0] != 0.0:
        raise ArgumentError(
            f"{name} must have two points or more, displacements that rise from the free gap and "
            "forces that start at 0 and do not fall"
        )
    return points
