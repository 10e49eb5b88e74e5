"""The environment against a simulation driven by hand: one seeded episode, step by step."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from scipy.signal import sosfilt

from railenv.actuation import ActuatorSpec
from railenv.envs.observation import sensor_names
from railenv.envs.rail_env import Lateral17Env
from railenv.metrics.ride_filter import ride_filter, ride_index_from_mean_square
from railenv.simulation import LateralSimulation, required_length, wheelset_inputs
from railenv.track import make_track
from railenv.vehicle import lateral17

# None of these is a default, so that a setting that is not handed on shows.
SPEED, PERIOD, STEP, DELAY, SECONDS, SEED = 200.0, 0.02, 0.004, 0.013, 4.0, 11
# The force limit lies above the scale: below it, a box that is not kept would not show.
SCALE, FORCE_LIMIT, RATE_LIMIT, LAG = 2500.0, 4000.0, 1.5e5, 0.004
REFERENCE, CAP, EFFORT_WEIGHT = 0.2, 0.75, 0.3
STROKE_WEIGHT, STROKE_REFERENCE = 0.4, 0.003
PERIODS, SUBSTEPS = round(SECONDS / PERIOD), round(PERIOD / STEP)
SENSORS = sensor_names("4")
FLOORS = ("floor_front_lateral_acceleration", "floor_rear_lateral_acceleration")
FORCES = tuple(f"actuator_force_{k}" for k in (1, 2, 3, 4))
STROKES = tuple(f"suspension_stroke_{k}" for k in (1, 2, 3, 4))

# The same compiled arithmetic on the same numbers: only sums of another order may differ.
ROUNDING = 1e-12
# Observations are float32, which has a relative spacing of 1.2e-7.
SINGLE = 2e-7


@dataclass(frozen=True)
class Episode:
    """What the environment returned, and what the simulation driven by hand recorded."""

    wanted: np.ndarray
    applied: np.ndarray
    observation_names: tuple[str, ...]
    observation_scales: np.ndarray
    observations: np.ndarray
    rewards: np.ndarray
    ends: list[tuple[bool, bool]]
    infos: list[dict[str, Any]]
    recorded: dict[str, np.ndarray]

    def info(self, name: str) -> np.ndarray:
        return np.array([info[name] for info in self.infos])


@pytest.fixture(scope="module")
def episode() -> Episode:
    """A whole episode: every other action stays in the box, the rest mostly leave it."""
    rng = np.random.default_rng(1)
    wanted = rng.uniform(-1.0, 1.0, (PERIODS, 4))
    wanted[1::2] *= 2.5
    applied = np.clip(wanted, -1.0, 1.0)

    env = Lateral17Env(
        layout=4,
        speed_kmh=SPEED,
        track="german_low",
        delay=DELAY,
        control_period=PERIOD,
        time_step=STEP,
        episode_seconds=SECONDS,
        action_scale=SCALE,
        force_limit=FORCE_LIMIT,
        rate_limit=RATE_LIMIT,
        actuator_lag=LAG,
        comfort_reference=REFERENCE,
        comfort_cap=CAP,
        effort_weight=EFFORT_WEIGHT,
        stroke_weight=STROKE_WEIGHT,
        stroke_reference=STROKE_REFERENCE,
    )
    env.reset(seed=0, options={"track_seed": SEED})
    steps = [env.step(action) for action in wanted]

    vehicle = lateral17("paper_fit", 4, SPEED)
    simulation = LateralSimulation(
        vehicle,
        (*SENSORS, *FLOORS, *FORCES),  # the strokes are sensors
        actuator=ActuatorSpec(FORCE_LIMIT, RATE_LIMIT, LAG),
        control_period=PERIOD,
        time_step=STEP,
    )
    track = make_track("german_low", required_length(vehicle, SECONDS), SEED)
    inputs = wheelset_inputs(vehicle, track, STEP, PERIODS * SUBSTEPS)
    simulation.reset(np.full((1, 4), DELAY), inputs[None])
    values = np.array([simulation.advance(SCALE * action[None])[0] for action in applied])
    recorded = {name: values[:, :, k] for k, name in enumerate(simulation.outputs)}
    return Episode(
        wanted,
        applied,
        env.observation_names,
        env.observation_scales,
        np.array([step[0] for step in steps]),
        np.array([step[1] for step in steps]),
        [step[2:4] for step in steps],
        [step[4] for step in steps],
        recorded,
    )


def filtered_squares(episode: Episode) -> np.ndarray:
    """Squares behind the ride filter at both floor ends, shape (2, periods, substeps)."""
    floors = np.array([episode.recorded[name].reshape(-1) for name in FLOORS])
    filtered = sosfilt(ride_filter(1.0 / STEP), floors, axis=-1)
    return np.square(filtered).reshape(2, PERIODS, SUBSTEPS)


def weighted(episode: Episode) -> np.ndarray:
    """Root mean square of the ride-filtered floor accelerations, per control period [m/s^2]."""
    return np.sqrt(filtered_squares(episode).mean(axis=(0, 2)))


def stroke_cost(episode: Episode) -> np.ndarray:
    """What the strokes of the secondary suspension cost, per control period."""
    squares = np.array([episode.recorded[name] ** 2 for name in STROKES]).mean(axis=(0, 2))
    return -STROKE_WEIGHT * np.minimum(squares / STROKE_REFERENCE**2, 1.0)


def test_the_command_is_the_clipped_action_in_newtons(episode: Episode) -> None:
    np.testing.assert_array_equal(episode.info("command"), SCALE * episode.applied)


def test_the_force_is_that_of_the_simulation_driven_by_hand(episode: Episode) -> None:
    expected = np.stack([episode.recorded[name][:, -1] for name in FORCES], axis=1)
    np.testing.assert_allclose(
        episode.info("force"), expected, rtol=ROUNDING, atol=ROUNDING * FORCE_LIMIT
    )


@pytest.mark.parametrize("sensor", SENSORS)
def test_a_sensor_column_is_its_output_at_the_end_of_the_period(
    episode: Episode, sensor: str
) -> None:
    expected = episode.recorded[sensor][:, -1]
    column = episode.observation_names.index(sensor)
    np.testing.assert_allclose(
        episode.observations[:, column] * episode.observation_scales[column],
        expected,
        rtol=SINGLE,
        atol=ROUNDING * np.abs(expected).max(),
    )


@pytest.mark.parametrize("age", range(1, 16))
def test_a_pipe_column_is_the_clipped_action_of_its_age(episode: Episode, age: int) -> None:
    columns = [episode.observation_names.index(f"action_{age}_ago_{c}") for c in (1, 2, 3, 4)]
    # the observation after step k shows action k as the one of one period ago; before them zeros
    expected = np.vstack([np.zeros((age - 1, 4)), episode.applied])[:PERIODS]
    np.testing.assert_array_equal(episode.observations[:, columns], expected.astype(np.float32))


def test_the_observation_has_no_other_columns(episode: Episode) -> None:
    # 0.3 s of 20 ms are 15 actions
    assert episode.observations.shape == (PERIODS, len(SENSORS) + 15 * 4)


def test_time_advances_by_the_control_period(episode: Episode) -> None:
    # a product of a count and the step: one rounding
    np.testing.assert_allclose(
        episode.info("time"), PERIOD * np.arange(1, PERIODS + 1), rtol=ROUNDING
    )


def test_the_weighted_acceleration_is_that_of_scipys_run_of_the_ride_filter(
    episode: Episode,
) -> None:
    # the filter's memory is carried from call to call in one and not in the other: rounding only
    np.testing.assert_allclose(episode.info("weighted_acceleration"), weighted(episode), rtol=1e-9)


def test_comfort_costs_the_weighted_acceleration_over_its_reference_up_to_the_cap(
    episode: Episode,
) -> None:
    expected = -np.minimum(weighted(episode) / REFERENCE, CAP)
    # as for the weighted acceleration
    np.testing.assert_allclose(episode.info("reward_comfort"), expected, rtol=1e-9)


def test_this_episodes_comfort_lies_on_both_sides_of_the_cap(episode: Episode) -> None:
    at_cap = episode.info("reward_comfort") == -CAP
    assert 0.05 < at_cap.mean() < 0.95


def test_effort_costs_the_mean_square_of_the_clipped_action(episode: Episode) -> None:
    expected = -EFFORT_WEIGHT * (episode.applied**2).mean(axis=1)
    # four squares and a mean
    np.testing.assert_allclose(episode.info("reward_effort"), expected, rtol=ROUNDING)


def test_the_stroke_costs_its_mean_square_over_the_reference_up_to_its_weight(
    episode: Episode,
) -> None:
    # four squares per step and a mean
    np.testing.assert_allclose(episode.info("reward_stroke"), stroke_cost(episode), rtol=1e-11)


def test_this_episodes_strokes_lie_on_both_sides_of_their_limit(episode: Episode) -> None:
    at_limit = stroke_cost(episode) == -STROKE_WEIGHT
    assert 0.05 < at_limit.mean() < 0.95


def test_the_reward_is_comfort_effort_and_stroke_while_nothing_goes_wrong(
    episode: Episode,
) -> None:
    comfort = -np.minimum(weighted(episode) / REFERENCE, CAP)
    effort = -EFFORT_WEIGHT * (episode.applied**2).mean(axis=1)
    # as for the weighted acceleration
    np.testing.assert_allclose(episode.rewards, comfort + effort + stroke_cost(episode), rtol=1e-9)


def test_the_running_ride_index_is_that_of_the_mean_square_since_the_start(
    episode: Episode,
) -> None:
    sums = np.cumsum(filtered_squares(episode).sum(axis=2), axis=1)
    means = sums / (SUBSTEPS * np.arange(1, PERIODS + 1))
    # as for the weighted acceleration
    np.testing.assert_allclose(
        episode.info("ride_index"), np.array(ride_index_from_mean_square(means)).T, rtol=1e-9
    )


def test_an_action_is_flagged_as_clipped_exactly_when_it_leaves_the_box(episode: Episode) -> None:
    outside = np.any(np.abs(episode.wanted) > 1.0, axis=1)
    assert episode.info("action_clipped").tolist() == outside.tolist()


def test_no_normal_reading_is_flagged_as_clipped(episode: Episode) -> None:
    assert not np.any(episode.info("observation_clipped"))


def test_an_episode_without_trouble_runs_to_its_time(episode: Episode) -> None:
    assert episode.ends == [(False, False)] * (PERIODS - 1) + [(False, True)]


def test_a_force_limit_below_the_scale_bounds_the_force() -> None:
    env = Lateral17Env(track="flat", action_scale=2500.0, force_limit=1750.0)
    env.reset(seed=0)
    assert env.step(np.ones(4))[4]["force"].tolist() == [1750.0] * 4


@pytest.fixture(scope="module", params=["front", "rear"])
def swing(request: pytest.FixtureRequest) -> tuple[np.ndarray, float]:
    """A push at one end for one long period, and how far that floor end swings meanwhile [m]."""
    end = request.param
    action = np.array([1.0, 1.0, 0.0, 0.0] if end == "front" else [0.0, 0.0, 1.0, 1.0])
    vehicle = lateral17("paper_fit", 4, 300.0)
    ends = ("front", "rear")
    names = tuple(f"floor_{e}_lateral_displacement" for e in ends)
    simulation = LateralSimulation(vehicle, names, control_period=1.0)
    simulation.reset(np.zeros((1, 4)))
    moved = np.abs(simulation.advance(3000.0 * action[None])[0])
    chosen = moved[:, ends.index(end)]
    peak = float(chosen.max())
    # what the two tests below rest on: this end goes farthest, and in the middle of the period
    assert moved.max() == peak
    assert max(chosen[0], chosen[-1]) < 0.9 * peak
    return action, peak


def played_once(action: np.ndarray, **settings: Any) -> dict[str, Any]:
    """Info after one long period on flat track."""
    env = Lateral17Env(track="flat", control_period=1.0, **settings)
    env.reset(seed=0)
    return env.step(action)[4]


def test_leaving_the_gauge_between_two_decisions_ends_the_episode(
    swing: tuple[np.ndarray, float],
) -> None:
    action, peak = swing
    # a thousandth is far above rounding and leaves only the samples around the peak outside
    assert played_once(action, gauge_limit=0.999 * peak)["ended_by"] == "gauge"


def test_staying_just_inside_the_gauge_does_not_end_the_episode(
    swing: tuple[np.ndarray, float],
) -> None:
    action, peak = swing
    # as above
    assert played_once(action, gauge_limit=1.001 * peak)["ended_by"] == ""
