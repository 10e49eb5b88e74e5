"""Vehicles that ship with railenv, one function each, every number with its source.

Sources, cited by the words in brackets:

[chen] Chen, Shi, Yu, J. Vib. Control, doi 10.1177/10775463261463161, Appendix 2.
[typical] Inside the range of published sets of similar vehicles: Math. Probl. Eng. 2019, 7163732,
    Table 2; Shock Vib. 2020, 6878252, Table 2; CRH380A sets of public multibody models; Velaro E
    (Goicolea, UPM). The paper does not print the value.
[hertz-kalker] Hertz ellipse of a cone on a R300 rail, Kalker coefficients, G = 81 GPa,
    Poisson's ratio 0.27, 60 kN wheel load; rounded, and scaled towards 64 kN.
[crh380a] Public CRH380A parameter set.
[calibrated] Fitted with `python -m eval.calibrate` so that the four-actuator vehicle at 300 km/h
    with a sky-hook gain of 35 kN s/m crosses at 202 ms and 1.323 Hz, as [chen] reports. An
    effective value that the paper does not state; the anti-roll stiffness is about twice the
    largest published one.
[assumed] Chosen by this project; said so wherever a result depends on it.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, field

from railenv.errors import unknown_name
from railenv.vehicle.parameters import VehicleParameters


@dataclass(frozen=True)
class Vehicle:
    """A named vehicle: parameters and, for each of them, where the number comes from."""

    name: str
    description: str
    parameters: VehicleParameters
    sources: dict[str, str] = field(repr=False)


_PUBLISHED = {
    "carbody_mass": 40390.0,
    "carbody_yaw_inertia": 1912600.0,
    "carbody_roll_inertia": 127681.0,
    "bogie_mass": 2200.0,
    "bogie_yaw_inertia": 2336.0,
    "bogie_roll_inertia": 1236.0,
    "primary_longitudinal_stiffness": 120e6,
    "primary_lateral_stiffness": 13.4e6,
    "secondary_longitudinal_stiffness": 0.133e6,
    "secondary_lateral_stiffness": 0.133e6,
    "secondary_vertical_stiffness": 0.203e6,
    "yaw_damper_stiffness": 8.8e6,
    "yaw_damper_damping": 330e3,
    "lateral_damper_stiffness": 4.5e6,
    "lateral_damper_damping": 15e3,
    "half_bogie_spacing": 8.69,
    "half_wheelbase": 1.25,
    "damper_offset": 0.27,
    "wheel_radius": 0.46,
    "half_contact_spacing": 0.7465,
    "half_primary_spacing": 1.0,
    "half_secondary_spacing": 0.95,
    "half_yaw_damper_spacing": 1.32,
    "carbody_to_damper_height": 0.922,
    "bogie_to_damper_height": -0.147,
    "conicity": 0.17,
}
_TYPICAL = {
    "wheelset_mass": 1900.0,
    "wheelset_yaw_inertia": 900.0,
    "primary_vertical_stiffness": 1.2e6,
    "primary_vertical_damping": 10e3,
    "primary_lateral_damping": 0.0,
    "secondary_lateral_damping": 0.0,
    "carbody_to_secondary_height": 0.65,
    "bogie_to_secondary_height": -0.35,
    "bogie_to_primary_height": 0.10,
}
_CREEP = {
    "creep_longitudinal": 1.05e7,
    "creep_lateral": 1.0e7,
    "creep_lateral_spin": 2.3e4,
    "creep_spin": 60.0,
}
# Carbody's centre of gravity 1.629 m above rail (axle 0.46 + h_3 0.10 - h_6 0.147 + h_5 0.922),
# floor 1.25 m above rail.
_ASSUMED = {"carbody_to_floor_height": 0.379}

_SHARED_SOURCES = {
    **dict.fromkeys(_PUBLISHED, "chen"),
    **dict.fromkeys(_TYPICAL, "typical"),
    **dict.fromkeys(_CREEP, "hertz-kalker"),
    **dict.fromkeys(_ASSUMED, "assumed"),
}


def paper_fit() -> Vehicle:
    """Return the paper's vehicle with roll stiffness and damping fitted to its critical delay."""
    # Frozen result of `python -m eval.calibrate`, rounded to three digits.
    fitted = {"antiroll_stiffness": 4.91e6, "secondary_vertical_damping": 71.8e3}
    return _vehicle(
        "paper_fit",
        "the source paper's vehicle; blanks typical, roll support fitted to 202 ms and 1.323 Hz",
        fitted,
        "calibrated",
    )


def published_typical() -> Vehicle:
    """Return the paper's vehicle with every blank from published sets, nothing fitted."""
    published = {"antiroll_stiffness": 1.0e6, "secondary_vertical_damping": 40e3}
    return _vehicle(
        "published_typical",
        "the source paper's vehicle; every blank from published sets, nothing fitted",
        published,
        "crh380a",
    )


def _vehicle(name: str, description: str, roll: dict[str, float], source: str) -> Vehicle:
    values = {**_PUBLISHED, **_TYPICAL, **_CREEP, **_ASSUMED, **roll}
    sources = {**_SHARED_SOURCES, **dict.fromkeys(roll, source)}
    parameters = VehicleParameters(**values)
    ordered = {f.name: sources[f.name] for f in dataclasses.fields(parameters)}
    return Vehicle(name, description, parameters, ordered)


_CATALOGUE: dict[str, Callable[[], Vehicle]] = {
    "paper_fit": paper_fit,
    "published_typical": published_typical,
}


def vehicle_names() -> list[str]:
    """List the names that `get_vehicle` knows."""
    return list(_CATALOGUE)


def get_vehicle(name: str) -> Vehicle:
    """Return a vehicle by name.

    Raises:
        ArgumentError: No vehicle has that name.
    """
    if name not in _CATALOGUE:
        raise unknown_name("vehicle", name, _CATALOGUE)
    return _CATALOGUE[name]()
