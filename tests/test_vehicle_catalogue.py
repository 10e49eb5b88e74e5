"""Catalogued vehicles: the printed numbers, and a source for every one of them."""

import dataclasses
import re

import pytest

from railenv.errors import ArgumentError
from railenv.vehicle import catalogue, get_vehicle, lateral17, vehicle_names

CITED = set(re.findall(r"^\[([a-z0-9-]+)\]", catalogue.__doc__ or "", flags=re.MULTILINE))

# Appendix 2 of the source paper (doi 10.1177/10775463261463161), in the units it prints.
APPENDIX = {
    "carbody_mass": (40390, "kg"),
    "carbody_yaw_inertia": (1912600, "kg m^2"),
    "carbody_roll_inertia": (127681, "kg m^2"),
    "bogie_mass": (2200, "kg"),
    "bogie_yaw_inertia": (2336, "kg m^2"),
    "bogie_roll_inertia": (1236, "kg m^2"),
    "primary_longitudinal_stiffness": (120, "MN/m"),
    "primary_lateral_stiffness": (13.4, "MN/m"),
    "secondary_longitudinal_stiffness": (0.133, "MN/m"),
    "secondary_lateral_stiffness": (0.133, "MN/m"),
    "secondary_vertical_stiffness": (0.203, "MN/m"),
    "yaw_damper_stiffness": (8.8, "MN/m"),
    "yaw_damper_damping": (330, "kN s/m"),
    "lateral_damper_stiffness": (4.5, "MN/m"),
    "lateral_damper_damping": (15, "kN s/m"),
    "half_bogie_spacing": (8.69, "m"),
    "half_wheelbase": (1.25, "m"),
    "damper_offset": (0.27, "m"),
    "wheel_radius": (0.46, "m"),
    "half_contact_spacing": (0.7465, "m"),
    "half_primary_spacing": (1.0, "m"),
    "half_secondary_spacing": (0.95, "m"),
    "half_yaw_damper_spacing": (1.32, "m"),
    "carbody_to_damper_height": (0.922, "m"),
    "bogie_to_damper_height": (-0.147, "m"),
    "conicity": (0.17, "1"),
}
PREFIX = {"MN/m": 1e6, "kN s/m": 1e3}
# What the paper does not print and both vehicles share, SI units.
FILLED_IN = {
    "wheelset_mass": 1900.0,
    "wheelset_yaw_inertia": 900.0,
    "primary_vertical_stiffness": 1.2e6,
    "primary_vertical_damping": 10e3,
    "primary_lateral_damping": 0.0,
    "secondary_lateral_damping": 0.0,
    "carbody_to_secondary_height": 0.65,
    "bogie_to_secondary_height": -0.35,
    "bogie_to_primary_height": 0.10,
    "carbody_to_floor_height": 1.629 - 1.25,
    "creep_longitudinal": 1.05e7,
    "creep_lateral": 1.0e7,
    "creep_lateral_spin": 2.3e4,
    "creep_spin": 60.0,
}
ROLL_SUPPORT = {
    "paper_fit": (4.91e6, 71.8e3, "calibrated"),
    "published_typical": (1.0e6, 40e3, "crh380a"),
}


def test_catalogue_knows_both_vehicles() -> None:
    assert vehicle_names() == ["paper_fit", "published_typical"]


@pytest.mark.parametrize("vehicle", vehicle_names())
@pytest.mark.parametrize("name", APPENDIX)
def test_number_is_the_one_the_paper_prints(vehicle: str, name: str) -> None:
    value, unit = APPENDIX[name]
    found = getattr(get_vehicle(vehicle).parameters, name)
    # rounding of the change of units
    assert found == pytest.approx(value * PREFIX.get(unit, 1.0), rel=1e-15)


@pytest.mark.parametrize("vehicle", vehicle_names())
@pytest.mark.parametrize("name", APPENDIX)
def test_printed_number_cites_the_paper(vehicle: str, name: str) -> None:
    assert get_vehicle(vehicle).sources[name] == "chen"


@pytest.mark.parametrize("vehicle", vehicle_names())
@pytest.mark.parametrize("name", FILLED_IN)
def test_blank_is_filled_with_the_chosen_value(vehicle: str, name: str) -> None:
    found = getattr(get_vehicle(vehicle).parameters, name)
    # rounding of one difference
    assert found == pytest.approx(FILLED_IN[name], rel=1e-14)


@pytest.mark.parametrize("vehicle", vehicle_names())
@pytest.mark.parametrize("name", FILLED_IN)
def test_filled_blank_does_not_cite_the_paper(vehicle: str, name: str) -> None:
    assert get_vehicle(vehicle).sources[name] != "chen"


@pytest.mark.parametrize("vehicle", ROLL_SUPPORT)
def test_vehicles_differ_in_roll_support_and_its_source(vehicle: str) -> None:
    found = get_vehicle(vehicle)
    p = found.parameters
    roll = p.antiroll_stiffness, p.secondary_vertical_damping
    sources = found.sources["antiroll_stiffness"], found.sources["secondary_vertical_damping"]
    *values, source = ROLL_SUPPORT[vehicle]
    assert (roll, sources) == (tuple(values), (source, source))


@pytest.mark.parametrize("vehicle", vehicle_names())
def test_every_parameter_has_a_source_that_the_module_cites(vehicle: str) -> None:
    found = get_vehicle(vehicle)
    names = [field.name for field in dataclasses.fields(found.parameters)]
    assert list(found.sources) == names
    assert set(found.sources.values()) <= CITED


@pytest.mark.parametrize("vehicle", vehicle_names())
def test_vehicle_carries_its_own_name(vehicle: str) -> None:
    assert get_vehicle(vehicle).name == vehicle


def test_unknown_vehicle_names_the_nearest_one() -> None:
    with pytest.raises(
        ArgumentError, match="unknown vehicle 'paper_fitted'; did you mean 'paper_fit'"
    ):
        lateral17("paper_fitted")


def test_vehicle_nowhere_near_lists_all_of_them() -> None:
    with pytest.raises(ArgumentError, match="known: paper_fit, published_typical"):
        get_vehicle("zzz")
