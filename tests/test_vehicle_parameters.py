"""Parameters: what is refused, and how it is said."""

import dataclasses
import math
import typing

import pytest

from railenv.errors import ArgumentError
from railenv.vehicle import VehicleParameters, get_vehicle

PAPER = get_vehicle("paper_fit").parameters
NAMES = [field.name for field in dataclasses.fields(VehicleParameters)]
HEIGHTS = [name for name in NAMES if name.endswith("_height")]
DIVISORS = [
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
]
MAY_BE_ZERO = [name for name in NAMES if name not in DIVISORS]
KNOWN_UNITS = {
    "1", "m", "kg", "kg m^2", "N", "N m", "N m^2", "N/m", "N s/m", "N m/rad",
}  # fmt: skip


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, "heavy", None])
@pytest.mark.parametrize("name", NAMES)
def test_value_that_is_no_finite_number_is_refused_by_name(name: str, bad: float) -> None:
    with pytest.raises(ArgumentError, match=f"^{name} = "):
        PAPER.replace(**{name: bad})


@pytest.mark.parametrize("name", [n for n in NAMES if n not in HEIGHTS])
def test_negative_value_is_refused_by_name(name: str) -> None:
    with pytest.raises(ArgumentError, match=f"^{name} = -1 must"):
        PAPER.replace(**{name: -1.0})


@pytest.mark.parametrize("name", DIVISORS)
def test_zero_where_the_model_divides_is_refused_by_name(name: str) -> None:
    with pytest.raises(ArgumentError, match=f"^{name} = 0 must be above zero"):
        PAPER.replace(**{name: 0.0})


@pytest.mark.parametrize("name", MAY_BE_ZERO)
def test_zero_elsewhere_is_accepted(name: str) -> None:
    assert getattr(PAPER.replace(**{name: 0.0}), name) == 0.0


@pytest.mark.parametrize("name", HEIGHTS)
def test_height_may_be_negative(name: str) -> None:
    assert getattr(PAPER.replace(**{name: -0.4}), name) == -0.4


def test_there_are_six_heights() -> None:
    assert len(HEIGHTS) == 6


def test_unknown_parameter_names_the_nearest_one() -> None:
    with pytest.raises(ArgumentError, match="did you mean 'conicity'"):
        PAPER.replace(conicty=0.2)


def test_replace_leaves_the_original_alone() -> None:
    PAPER.replace(conicity=0.4)
    assert PAPER.conicity == 0.17


def test_replace_changes_what_it_names_and_nothing_else() -> None:
    before, after = dataclasses.asdict(PAPER), dataclasses.asdict(PAPER.replace(conicity=0.4))
    assert {k for k in before if before[k] != after[k]} == {"conicity"}


def test_parameters_cannot_be_changed_in_place() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        PAPER.conicity = 0.4  # type: ignore[misc]


def test_axle_load_carries_a_quarter_carbody_half_a_bogie_and_the_wheelset() -> None:
    # 13097.5 kg times standard gravity; rounding
    assert PAPER.axle_load == pytest.approx(13097.5 * 9.80665, rel=1e-15)


@pytest.mark.parametrize("name", NAMES)
def test_every_field_has_a_unit(name: str) -> None:
    hint = typing.get_type_hints(VehicleParameters, include_extras=True)[name]
    assert hint.__metadata__[0] in KNOWN_UNITS


@pytest.mark.parametrize("value", ["40390", True, None])
def test_a_value_that_is_no_number_is_refused(value: object) -> None:
    with pytest.raises(ArgumentError, match="carbody_mass"):
        get_vehicle("paper_fit").parameters.replace(carbody_mass=value)
