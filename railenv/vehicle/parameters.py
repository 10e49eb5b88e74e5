"""Parameters of a bogie vehicle's lateral model: frozen, validated, in SI base units.

Symbols in brackets are those of Chen, Shi and Yu, "Stability analysis of railway vehicles with
time-delayed active suspension control via Pade approximation", J. Vib. Control,
doi 10.1177/10775463261463161, Appendix 2. Heights are "centre of gravity minus element": positive
where the element lies below that body's centre of gravity.

Derived quantities are properties; nothing that follows from other fields is stored.
"""

import dataclasses
from dataclasses import dataclass
from typing import Any

from railenv.errors import check_finite, check_not_negative, check_positive, unknown_name
from railenv.units import (
    STANDARD_GRAVITY,
    Dimensionless,
    Kilogram,
    KilogramSquareMetre,
    Metre,
    Newton,
    NewtonMetre,
    NewtonMetrePerRadian,
    NewtonPerMetre,
    NewtonSecondPerMetre,
    NewtonSquareMetre,
)

_MAY_BE_NEGATIVE = frozenset(
    {
        "carbody_to_secondary_height",
        "bogie_to_secondary_height",
        "bogie_to_primary_height",
        "carbody_to_damper_height",
        "bogie_to_damper_height",
        "carbody_to_floor_height",
    }
)
_MUST_BE_POSITIVE = frozenset(
    {
        "carbody_mass",
        "carbody_yaw_inertia",
        "carbody_roll_inertia",
        "bogie_mass",
        "bogie_yaw_inertia",
        "bogie_roll_inertia",
        "wheelset_mass",
        "wheelset_yaw_inertia",
        "half_bogie_spacing",
        "half_wheelbase",
        "wheel_radius",
        "half_contact_spacing",
        "yaw_damper_damping",
        "lateral_damper_damping",
    }
)


@dataclass(frozen=True, kw_only=True)
class VehicleParameters:
    """All numbers of the 17-coordinate lateral model.

    "Per box" is per axle box (two per wheelset), "per side" is per bogie side (two per bogie).
    Creep coefficients are per wheel: `creep_longitudinal` multiplies longitudinal creepage,
    `creep_lateral` lateral creepage, `creep_lateral_spin` couples the two, `creep_spin` turns spin
    creepage into a spin moment.

    Raises:
        ArgumentError: A value is not finite, a mass, inertia or base length is not above zero, or
            a stiffness, damping or creep coefficient is negative.
    """

    carbody_mass: Kilogram  # m_c
    carbody_yaw_inertia: KilogramSquareMetre  # I_cz
    carbody_roll_inertia: KilogramSquareMetre  # I_cx
    bogie_mass: Kilogram  # m_f
    bogie_yaw_inertia: KilogramSquareMetre  # I_fz
    bogie_roll_inertia: KilogramSquareMetre  # I_fx
    wheelset_mass: Kilogram  # m_w
    wheelset_yaw_inertia: KilogramSquareMetre  # I_wz

    primary_longitudinal_stiffness: NewtonPerMetre  # K_px, per box
    primary_lateral_stiffness: NewtonPerMetre  # K_py, per box
    primary_vertical_stiffness: NewtonPerMetre  # K_pz, per box
    primary_lateral_damping: NewtonSecondPerMetre  # C_py, per box
    primary_vertical_damping: NewtonSecondPerMetre  # C_pz, per box
    secondary_longitudinal_stiffness: NewtonPerMetre  # K_sx, per side
    secondary_lateral_stiffness: NewtonPerMetre  # K_sy, per side
    secondary_vertical_stiffness: NewtonPerMetre  # K_sz, per side
    secondary_lateral_damping: NewtonSecondPerMetre  # C_sy, per side
    secondary_vertical_damping: NewtonSecondPerMetre  # C_sz, per side
    antiroll_stiffness: NewtonMetrePerRadian  # K_rx, per bogie
    yaw_damper_stiffness: NewtonPerMetre  # K_yaw, in series with C_yaw, each damper
    yaw_damper_damping: NewtonSecondPerMetre  # C_yaw
    lateral_damper_stiffness: NewtonPerMetre  # K_shd, in series with C_shd, each damper
    lateral_damper_damping: NewtonSecondPerMetre  # C_shd

    half_bogie_spacing: Metre  # L_c
    half_wheelbase: Metre  # L_b
    damper_offset: Metre  # L_d, lateral damper or actuator ahead of / behind the bogie's centre
    wheel_radius: Metre  # r_0
    half_contact_spacing: Metre  # b, half of the lateral spacing of the rolling circles
    half_primary_spacing: Metre  # w_p
    half_secondary_spacing: Metre  # w_s
    half_yaw_damper_spacing: Metre  # w_yaw
    carbody_to_secondary_height: Metre  # h_1
    bogie_to_secondary_height: Metre  # h_2
    bogie_to_primary_height: Metre  # h_3
    carbody_to_damper_height: Metre  # h_5
    bogie_to_damper_height: Metre  # h_6
    carbody_to_floor_height: Metre

    conicity: Dimensionless  # lambda, equivalent conicity
    creep_longitudinal: Newton  # f_11, per wheel
    creep_lateral: Newton  # f_22, per wheel
    creep_lateral_spin: NewtonMetre  # f_23, per wheel
    creep_spin: NewtonSquareMetre  # f_33, per wheel

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            name = field.name
            if name in _MUST_BE_POSITIVE:
                check = check_positive
            else:
                check = check_finite if name in _MAY_BE_NEGATIVE else check_not_negative
            object.__setattr__(self, name, check(name, getattr(self, name)))

    @property
    def axle_load(self) -> float:
        """Vertical load of one axle on the rails, W [N]."""
        mass = self.carbody_mass / 4 + self.bogie_mass / 2 + self.wheelset_mass
        return mass * STANDARD_GRAVITY

    def replace(self, **changes: Any) -> "VehicleParameters":
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
