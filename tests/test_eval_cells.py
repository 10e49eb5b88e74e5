"""The cells of a suite: each one is its own run, on its own track, at its own delay and settings.

The suite differs from every default, so that none of its entries can be ignored.
"""

import numpy as np
import pytest

from baselines import SkyHook, make_controller
from eval import benchmark
from eval.benchmark import MAX_DELAY, run_group
from eval.measures import measure
from eval.rollout import Stepping, rollout
from eval.scenarios import Suite, cell_key, load_suite
from railenv.actuation import ActuatorSpec
from railenv.config import from_mapping, to_dict
from railenv.errors import ControllerError
from railenv.simulation import required_length, wheelset_inputs
from railenv.stability import critical_delays, sampled_critical_delay
from railenv.track import make_track
from railenv.vehicle import lateral17

CONTROLLER, SPEED, VEHICLE = "skyhook:gain=60e3", 250.0, "published_typical"
PERIOD, STEP, LIMIT, DURATION, SKIP = 0.02, 0.004, 500.0, 8.0, 2.0
SUITE = Suite(
    version="test-v0",
    vehicle=VEHICLE,
    controllers=(CONTROLLER, "passive"),
    layouts=("2",),
    speeds_kmh=(SPEED,),
    tracks=("tb3352", "german_low"),
    seeds=(2, 5),
    delays_ms=(30.0, 130.0),
    duration=DURATION,
    skip=SKIP,
    control_period=PERIOD,
    time_step=STEP,
    force_limit=LIMIT,
)
PLACES = [(track, seed) for track in ("tb3352", "german_low") for seed in (2, 5)]


@pytest.fixture(scope="module")
def group() -> dict:
    with pytest.MonkeyPatch.context() as patch:
        # the locus has tests of its own, and takes longer than the rest
        patch.setattr(benchmark, "root_locus", lambda *_: {})
        return run_group(SUITE, (CONTROLLER, "2", SPEED))


@pytest.fixture(scope="module")
def passive() -> dict:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(benchmark, "root_locus", lambda *_: {})
        return run_group(SUITE, ("passive", "passive", SPEED))


def alone(controller: str, layout: str, track: str, seed: int, delay: float) -> dict:
    """The measures of one run by itself."""
    vehicle = lateral17(VEHICLE, layout, SPEED)
    line = make_track(track, required_length(vehicle, DURATION), seed)
    trajectory = rollout(
        make_controller(controller, layout),
        vehicle,
        np.full((1, vehicle.num_actuators), delay),
        DURATION,
        track_inputs=wheelset_inputs(vehicle, line, STEP, round(DURATION / STEP))[None],
        stepping=Stepping(PERIOD, STEP, ActuatorSpec(force_limit=LIMIT)),
    )
    return measure(trajectory, SKIP, LIMIT).lane(0)


def cell_at(group: dict, track: str, seed: int, delay: float) -> dict:
    wanted = (track, seed, delay)
    (cell,) = [c for c in group["cells"] if (c["track"], c["seed"], c["delay_s"]) == wanted]
    return cell


@pytest.mark.parametrize("delay", [0.03, 0.13])
@pytest.mark.parametrize(("track", "seed"), PLACES)
def test_a_cell_is_its_own_run(group: dict, track: str, seed: int, delay: float) -> None:
    expected = alone(CONTROLLER, "2", track, seed, delay)
    cell = cell_at(group, track, seed, delay)
    # the lanes are the same bit by bit; a Fourier transform of many rounds its last bit differently
    assert {name: cell[name] for name in expected} == pytest.approx(expected, rel=1e-12)


def test_a_suite_has_a_cell_for_every_track_seed_and_delay(group: dict) -> None:
    found = [(c["track"], c["seed"], c["delay_s"]) for c in group["cells"]]
    assert sorted(found) == sorted((*place, delay) for place in PLACES for delay in (0.03, 0.13))


def test_no_two_cells_have_the_same_numbers(group: dict) -> None:
    assert len({c["floor_rms_rear"] for c in group["cells"]}) == 8


def test_a_cell_says_where_it_was_run(group: dict) -> None:
    for cell in group["cells"]:
        key = cell_key(CONTROLLER, "2", SPEED, cell["track"], cell["seed"], cell["delay_s"])
        assert cell["key"] == key
        assert (cell["controller"], cell["layout"], cell["speed_kmh"]) == (CONTROLLER, "2", SPEED)


def test_a_cells_key_names_everything_that_it_depends_on() -> None:
    key = cell_key("skyhook:gain=35e3", "4", 300.0, "tb3352", 7, 0.125)
    assert key == "skyhook:gain=35e3|layout=4|300km/h|tb3352|seed=7|125ms"


def test_forces_are_cut_at_the_suites_limit(group: dict) -> None:
    assert max(c["force_peak"] for c in group["cells"]) == LIMIT


@pytest.mark.parametrize("delay", [0.03, 0.13])
@pytest.mark.parametrize(("track", "seed"), PLACES)
def test_a_passive_cell_is_its_own_run_at_every_delay(
    passive: dict, track: str, seed: int, delay: float
) -> None:
    expected = alone("passive", "passive", track, seed, 0.0)
    cell = cell_at(passive, track, seed, delay)
    # the lanes are the same bit by bit; a Fourier transform of many rounds its last bit differently
    assert {name: cell[name] for name in expected} == pytest.approx(expected, rel=1e-12)


def test_the_oracle_is_asked_about_the_suites_vehicle_at_its_speed(group: dict) -> None:
    loop = SkyHook(60e3, 2).to_delay_system(lateral17(VEHICLE, 2, SPEED))
    expected = [c.delay for c in critical_delays(loop, MAX_DELAY).crossings]
    assert expected
    assert [c["delay_s"] for c in group["stability"]["crossings"]] == expected


def test_the_sampled_answer_is_that_of_the_suites_control_period(group: dict) -> None:
    loop = SkyHook(60e3, 2).to_delay_system(lateral17(VEHICLE, 2, SPEED))
    expected = sampled_critical_delay(loop, critical_delays(loop, MAX_DELAY), PERIOD)
    assert group["stability"]["critical_delay_sampled_s"] == expected


def test_a_stability_answer_says_which_loop_it_is_about(group: dict) -> None:
    answer = group["stability"]
    found = [answer[key] for key in ("controller", "layout", "speed_kmh", "vehicle")]
    assert found == [CONTROLLER, "2", SPEED, VEHICLE]


def test_the_search_by_simulation_is_given_the_suites_stepping_and_longest_delay(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Nonlinear:
        def reset(self, num_lanes: int, seed: int) -> None: ...

        def act(self, observations: np.ndarray) -> np.ndarray:
            return np.zeros((len(observations), 2))

    asked: dict = {}

    def search(controller: object, vehicle: object, **settings: object) -> dict:
        asked.update(settings, vehicle=vehicle)
        raise ControllerError("enough was seen")

    monkeypatch.setattr(benchmark, "make_controller", lambda *_: Nonlinear())
    monkeypatch.setattr(benchmark, "simulated_critical_delay", search)
    run_group(SUITE, ("py:some:law", "2", SPEED))
    assert asked["stepping"] == Stepping(PERIOD, STEP, ActuatorSpec(force_limit=LIMIT))
    assert asked["max_delay"] == 0.13
    assert asked["vehicle"].speed == pytest.approx(SPEED / 3.6, rel=1e-12)  # rounding


def test_a_suite_is_run_by_controller_then_layout_then_speed() -> None:
    suite = from_mapping(
        Suite,
        {
            **to_dict(SUITE),
            "controllers": ["zero", "passive", "skyhook"],
            "layouts": ["4", "2"],
            "speeds_kmh": [200.0, 100.0],
        },
        "test",
    )
    assert list(suite.groups()) == [
        ("zero", "4", 200.0),
        ("zero", "4", 100.0),
        ("zero", "2", 200.0),
        ("zero", "2", 100.0),
        ("passive", "passive", 200.0),
        ("passive", "passive", 100.0),
        ("skyhook", "4", 200.0),
        ("skyhook", "4", 100.0),
        ("skyhook", "2", 200.0),
        ("skyhook", "2", 100.0),
    ]


def test_delays_are_given_in_milliseconds_and_meant_in_seconds() -> None:
    assert SUITE.delays == (0.03, 0.13)


def test_a_suite_survives_being_written_down() -> None:
    suite = load_suite("smoke")
    assert from_mapping(Suite, to_dict(suite), "test") == suite
