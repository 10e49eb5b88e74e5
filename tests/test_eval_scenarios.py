"""Scenarios: their names for good, and what they vary of channel and vehicle."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eval.scenarios import (
    CHANNELS,
    MODELS,
    VEHICLES,
    Channel,
    Scenario,
    vehicle_parameters,
)
from eval.scenarios.scenario import full_parameters, lateral_of
from railenv.errors import ArgumentError
from railenv.vehicle.nonlinear import FullParameters, FullVehicle

KEY = "v0/lateral17/nominal/4/300/german_low/constant:100/3"
SALT = "a salt of 16 characters"

delays = st.one_of(
    st.sampled_from([0.0, 50.0, 300.0]),
    st.floats(0.0, 1e6, allow_nan=False, allow_subnormal=False),
)
scenarios = st.builds(
    Scenario,
    st.sampled_from(["v0", "v1", "mine"]),
    st.just("lateral17"),
    st.sampled_from(VEHICLES),
    st.sampled_from(["2", "4"]),
    st.floats(1.0, 1000.0),
    st.sampled_from(["german_low", "tb3352", "fra6:level=0.5"]),
    st.builds(Channel, st.sampled_from(CHANNELS), delays),
    st.integers(0, 10**9 - 1),
)


# Names for good.


@given(scenarios)
def test_a_key_read_back_is_the_scenario(scenario: Scenario) -> None:
    assert Scenario.of(scenario.key) == scenario


@given(scenarios, scenarios)
def test_two_scenarios_have_one_key_only_if_they_are_equal(a: Scenario, b: Scenario) -> None:
    assert (a.key == b.key) == (a == b)


@given(delays, delays)
def test_delays_that_differ_by_less_than_six_digits_have_keys_of_their_own(
    a: float, b: float
) -> None:
    assert (Channel("constant", a).key == Channel("constant", b).key) == (a == b)


def test_the_parts_of_a_key_are_what_records_of_v0_call_them() -> None:
    # Typed as they are: a name changed by accident would part old records from new ones.
    scenario = Scenario(
        "v0", "lateral17", "nominal", "4", 300.0, "german_low", Channel("constant", 100.0), 3
    )
    assert scenario.key == KEY
    assert scenario.family == "v0/lateral17/nominal/4/300/german_low/constant:100"
    assert scenario.place == ("lateral17", "nominal", "4", 300.0)
    assert MODELS == ("lateral17", "full50")
    assert VEHICLES == ("nominal", "laden", "worn", "soft", "stiff")
    assert CHANNELS == ("constant", "spread", "jitter", "dropout")
    assert Scenario.of("v0/full50/laden/2/212.5/fra6/spread:0.25/0").speed_kmh == 212.5


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("", "eight parts"),
        (KEY + "/0", "eight parts"),
        (KEY.replace("300", "fast"), "speed = 'fast' is not a finite number"),
        (KEY.replace("300", "nan"), "speed"),
        (KEY.replace("300", "-300"), "speed_kmh = -300"),
        (KEY.replace("300", "300.0"), "written 'v0/lateral17/nominal/4/300/"),
        (KEY[:-1] + "03", "written"),
        (KEY[:-1] + "-1", "number '-1'"),
        (KEY[:-1] + "1e2", "number '1e2'"),
        (KEY[:-1] + "9" * 5000, "number"),
        (KEY.replace("lateral17", "lateral18"), "did you mean 'lateral17'"),
        (KEY.replace("nominal", "worm"), "did you mean 'worn'"),
        (KEY.replace("/4/", "/passive/"), "no actuators"),
        (KEY.replace("/4/", "/3/"), "layout = '3'"),
        (KEY.replace("german_low", "german_lo"), "did you mean 'german_low'"),
        (KEY.replace("german_low", "flat"), "unknown spectrum 'flat'"),
        (KEY.replace("german_low", "mine.csv"), "unknown spectrum 'mine.csv'"),
        (KEY.replace("constant", "constnat"), "did you mean 'constant'"),
        (KEY.replace(":100", ":-1"), "delay_ms = -1"),
        (KEY.replace(":100", ""), "write kind:delay"),
        (KEY.replace(":100", ":slow"), "delay = 'slow' is not a finite number"),
        (KEY.replace("v0", ""), "version = ''"),
        (KEY.replace("lateral17/nominal", "full50/worn"), "takes from profiles"),
    ],
)
def test_a_key_that_is_none_is_refused_by_name(key: str, words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        Scenario.of(key)


def test_minus_zero_is_the_delay_zero() -> None:
    assert Channel("constant", -0.0).key == "constant:0"


# Channels.


def test_a_constant_channel_delays_every_actuator_alike() -> None:
    np.testing.assert_array_equal(Channel("constant", 100.0).delays(4), [0.1] * 4)


def test_a_spread_channel_goes_from_half_the_delay_to_all_of_it() -> None:
    # d/2 + (k/3) d/2 for k = 0 .. 3; equal to a rounding of the products.
    np.testing.assert_allclose(
        Channel("spread", 120.0).delays(4), [0.06, 0.08, 0.1, 0.12], rtol=1e-15
    )
    np.testing.assert_array_equal(Channel("spread", 120.0).delays(2), [0.06, 0.12])
    np.testing.assert_array_equal(Channel("spread", 120.0).delays(1), [0.12])


@pytest.mark.parametrize("kind", CHANNELS)
@pytest.mark.parametrize("channels", [0, 1, 2, 4])
def test_every_kind_of_channel_has_the_delay_in_its_last_actuator(kind: str, channels: int) -> None:
    found = Channel(kind, 150.0).delays(channels)
    assert found.shape == (channels,)
    assert np.all(found <= 0.15)
    assert channels == 0 or found[-1] == 0.15


def test_jitter_and_losses_are_of_their_kinds_alone() -> None:
    # As the channels of v0 are: 20 ms, a tenth.
    assert [Channel(kind, 50.0).jitter for kind in CHANNELS] == [0.0, 0.0, 0.02, 0.0]
    assert [Channel(kind, 50.0).dropout for kind in CHANNELS] == [0.0, 0.0, 0.0, 0.1]


# Vehicles.


def changed(name: str) -> dict[str, float]:
    """Ratio to the nominal vehicle of every parameter that differs from it."""
    own, nominal = vehicle_parameters(name), vehicle_parameters("nominal")
    return {
        field.name: getattr(own, field.name) / getattr(nominal, field.name)
        for field in dataclasses.fields(own)
        if getattr(own, field.name) != getattr(nominal, field.name)
    }


# Lateral damping of the air springs themselves is scaled too, but paper_fit has none.
SECONDARY = {
    "secondary_longitudinal_stiffness",
    "secondary_lateral_stiffness",
    "secondary_vertical_stiffness",
    "secondary_vertical_damping",
}


@pytest.mark.parametrize(
    ("name", "fields", "factor"),
    [
        ("nominal", set(), 1.0),
        ("laden", {"carbody_mass", "carbody_yaw_inertia", "carbody_roll_inertia"}, 1.25),
        ("soft", SECONDARY, 0.8),
        ("stiff", SECONDARY, 1.25),
    ],
)
def test_a_variant_changes_its_own_parameters_and_no_other(
    name: str, fields: set[str], factor: float
) -> None:
    assert set(changed(name)) == fields
    assert all(ratio == pytest.approx(factor, rel=1e-15) for ratio in changed(name).values())


def test_worn_wheels_have_a_conicity_of_three_tenths_and_nothing_else() -> None:
    assert set(changed("worn")) == {"conicity"}
    assert vehicle_parameters("worn").conicity == 0.3


def test_soft_and_stiff_are_as_far_from_nominal_in_the_logarithm() -> None:
    assert changed("soft").keys() == changed("stiff").keys()
    for name, ratio in changed("soft").items():
        assert ratio * changed("stiff")[name] == pytest.approx(1.0, rel=1e-15)


def test_a_load_leaves_the_radii_of_gyration_as_they_are_on_both_models() -> None:
    own, nominal = full_parameters("laden"), full_parameters("nominal")
    for found, empty in (
        (own.lateral.carbody_yaw_inertia, nominal.lateral.carbody_yaw_inertia),
        (own.lateral.carbody_roll_inertia, nominal.lateral.carbody_roll_inertia),
        (own.carbody_pitch_inertia, nominal.carbody_pitch_inertia),
    ):
        radius = math.sqrt(found / own.lateral.carbody_mass)
        assert radius == pytest.approx(math.sqrt(empty / nominal.lateral.carbody_mass), rel=1e-15)


@pytest.mark.parametrize("name", ["nominal", "laden", "soft", "stiff"])
def test_the_nonlinear_vehicle_has_the_lateral_numbers_of_the_linear_one(name: str) -> None:
    assert full_parameters(name).lateral == vehicle_parameters(name)
    made = Scenario.of(KEY.replace("lateral17/nominal", f"full50/{name}")).made()
    assert isinstance(made, FullVehicle)
    assert made.parameters == full_parameters(name)
    default = dataclasses.replace(full_parameters("nominal"), lateral=vehicle_parameters(name))
    assert isinstance(default, FullParameters)


def test_a_scenario_makes_its_vehicle_at_its_speed_and_layout() -> None:
    scenario = Scenario.of("v0/lateral17/soft/2/250/tb3352/jitter:50/0")
    vehicle = scenario.made()
    assert vehicle.speed == pytest.approx(250.0 / 3.6, rel=1e-15)
    assert vehicle.layout == "2"
    assert vehicle.num_actuators == 2
    assert scenario.made("passive").num_actuators == 0
    assert lateral_of(scenario.place).parameters == vehicle_parameters("soft")
