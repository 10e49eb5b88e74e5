"""The reward: its terms, what divergence costs, and what good and bad control earn."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest

from railenv.envs.rail_env import Lateral17Env
from railenv.envs.rail_vector_env import Lateral17VectorEnv
from railenv.envs.reward import RECORDED, rewards_of_record
from railenv.envs.settings import EnvSettings
from railenv.errors import ArgumentError
from railenv.metrics.ride_index import sperling, sperling_filter
from railenv.simulation import LateralSimulation, required_length, wheelset_inputs
from railenv.track import make_track
from railenv.vehicle import lateral17

SETTINGS = EnvSettings()
WORST_STEP = SETTINGS.comfort_cap + SETTINGS.effort_weight + SETTINGS.stroke_weight
GAIN, TRACKS, PERIODS = 35e3, 8, 2000


class Rides(NamedTuple):
    """Returns and ride indices over the same tracks of 20 s."""

    returns: np.ndarray
    index: np.ndarray
    ended: int


def ride_index(recorded: np.ndarray) -> np.ndarray:
    """Mean over the tracks of the ride index at front and rear floor."""
    return np.array([np.mean(sperling(recorded[:, :, end], 200.0)) for end in (0, 1)])


def sky_hook(track: str, delay: float) -> Rides:
    env = Lateral17VectorEnv(TRACKS, track=track, track_pool=1, delay=delay)
    observations, _ = env.reset(seed=0, options={"track_seed": list(range(TRACKS))})
    scales = env._lanes.scales[:4]
    returns, alive, record = np.zeros(TRACKS), np.ones(TRACKS, dtype=bool), []
    for _ in range(PERIODS):
        actions = np.clip(-GAIN * observations[:, :4] * scales / 3000.0, -1.0, 1.0)
        observations, rewards, ended, late, _ = env.step(actions)
        returns += np.where(alive, rewards, 0.0)
        record.append(env._lanes.last_period()[0].copy())
        alive &= ~(ended | late)
    recorded = np.concatenate(record, axis=1)
    diverged = int(TRACKS - (returns > -WORST_STEP * PERIODS).sum())
    return Rides(returns, ride_index(recorded) if not diverged else np.full(2, np.nan), diverged)


def passive(track: str) -> Rides:
    vehicle = lateral17("paper_fit", "passive", 300.0)
    length = required_length(vehicle, 20.0)
    inputs = np.array(
        [
            wheelset_inputs(vehicle, make_track(track, length, seed), 0.005, 2 * PERIODS)
            for seed in range(TRACKS)
        ]
    )
    simulation = LateralSimulation(vehicle, RECORDED)
    simulation.reset(np.zeros((TRACKS, 0)), inputs, np.arange(TRACKS))
    no_force = np.zeros((TRACKS, 0))
    recorded = np.concatenate([simulation.advance(no_force) for _ in range(PERIODS)], axis=1)
    rewards = rewards_of_record(EnvSettings(track=track), recorded)
    return Rides(rewards.sum(axis=1), ride_index(recorded), 0)


def test_on_smooth_track_a_sky_hook_without_delay_earns_more_than_the_passive_vehicle(
    record_property: Callable[[str, object], None],
) -> None:
    hook, none = sky_hook("tb3352", 0.0), passive("tb3352")
    record_property(
        "printed",
        f"TB/T 3352, {TRACKS} tracks x 20 s: return of sky-hook {hook.returns.mean():.0f} "
        f"({hook.index[0]:.2f} front, {hook.index[1]:.2f} rear), of the passive vehicle "
        f"{none.returns.mean():.0f} ({none.index[0]:.2f} front, {none.index[1]:.2f} rear)",
    )
    assert hook.ended == 0
    assert np.all(hook.returns > none.returns)


def test_past_the_critical_delay_a_sky_hook_earns_far_less_than_the_passive_vehicle(
    record_property: Callable[[str, object], None],
) -> None:
    late, none = sky_hook("tb3352", 0.25), passive("tb3352")
    record_property(
        "printed",
        f"TB/T 3352, delay 0.25 s: return of sky-hook {late.returns.mean():.0f} with "
        f"{late.ended} of {TRACKS} ended, of the passive vehicle {none.returns.mean():.0f}",
    )
    # what is lost to the passive vehicle is more than all that the passive vehicle is charged
    assert np.all(late.returns < 2.0 * none.returns)


def test_on_rough_track_a_sky_hook_trades_the_rear_floor_for_the_front(
    record_property: Callable[[str, object], None],
) -> None:
    hook, none = sky_hook("german_low", 0.0), passive("german_low")
    record_property(
        "printed",
        f"German low, {TRACKS} tracks x 20 s: sky-hook {hook.index[0]:.2f} front, "
        f"{hook.index[1]:.2f} rear, return {hook.returns.mean():.0f}; passive vehicle "
        f"{none.index[0]:.2f} front, {none.index[1]:.2f} rear, return {none.returns.mean():.0f}",
    )
    assert hook.ended == 0
    assert hook.index[0] < none.index[0]
    assert hook.index[1] > none.index[1]


def test_rewards_of_a_record_are_those_of_the_environment() -> None:
    settings: dict[str, Any] = {"track": "german_low", "episode_seconds": 2.0, "track_pool": 1}
    env = Lateral17Env(**settings, comfort_reference=0.3)
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    record, rewards, actions = [], [], []
    for _ in range(200):
        actions.append(rng.uniform(-1, 1, 4))
        rewards.append(env.step(actions[-1])[1])
        record.append(env._lanes.last_period()[0][0].copy())
    recorded, applied = np.concatenate(record)[None], np.array(actions)[None]
    again = rewards_of_record(env.settings, recorded, applied)[0]
    # the same compiled arithmetic; the mean square of the action is summed in another order
    np.testing.assert_allclose(again, rewards, rtol=1e-14)


def judged(steps: int = 20, **columns: Any) -> np.ndarray:
    """Rewards of a record whose columns are zero but for those that are given."""
    recorded = np.zeros((1, steps, 8))
    for name, values in columns.items():
        where = {"accelerations": slice(0, 2), "displacements": slice(2, 4), "strokes": slice(4, 8)}
        recorded[0, :, where[name]] = np.reshape(values, (-1, 1))
    return rewards_of_record(SETTINGS, recorded)[0]


def test_a_vehicle_that_does_not_move_costs_nothing() -> None:
    assert not np.any(judged())


@pytest.mark.parametrize(("share", "cost"), [(0.5, 0.25), (1.0, 1.0), (2.0, 1.0), (1e6, 1.0)])
def test_a_stroke_costs_its_square_over_the_reference_up_to_its_weight(
    share: float, cost: float
) -> None:
    rewards = judged(strokes=share * SETTINGS.stroke_reference)
    # one square and one quotient
    np.testing.assert_allclose(rewards, -SETTINGS.stroke_weight * cost, rtol=1e-14)


@pytest.mark.parametrize("frequency", [1.0, 5.0, 12.5])
def test_a_sine_costs_its_weighted_root_mean_square(frequency: float) -> None:
    amplitude, period = 0.05, 0.2
    settings = EnvSettings(control_period=period, episode_seconds=20.0)
    time = 0.005 * np.arange(1, 4001)
    recorded = np.zeros((1, 4000, 8))
    recorded[0, :, :2] = amplitude * np.sin(2 * np.pi * frequency * time)[:, None]
    rewards = rewards_of_record(settings, recorded)[0]
    gain = np.abs(sperling_filter(np.array([frequency])))[0]
    expected = -(amplitude / np.sqrt(2) * gain / settings.comfort_reference)
    # The last second, five control periods; the filter starts at rest and forgets in a second.
    # Its digital form is 0.005 % off up to 20 Hz.
    assert np.sqrt(np.mean(rewards[-5:] ** 2)) == pytest.approx(-expected, rel=1e-3)


@pytest.mark.parametrize("acceleration", [1.0, 15.0, 19.9])
def test_comfort_costs_no_more_than_its_cap(acceleration: float) -> None:
    shaken = acceleration * (-1.0) ** np.arange(20)
    rewards = judged(accelerations=shaken)
    assert np.all(rewards >= -SETTINGS.comfort_cap)
    if acceleration > 10.0:
        np.testing.assert_array_equal(rewards, -SETTINGS.comfort_cap)


@pytest.mark.parametrize("value", [20.1, np.inf, -np.inf, np.nan])
def test_an_acceleration_that_is_none_ends_with_the_penalty_and_the_worst_of_all_terms(
    value: float,
) -> None:
    accelerations = np.zeros(20)
    accelerations[7] = value
    rewards = judged(accelerations=accelerations)
    worst = SETTINGS.comfort_cap + SETTINGS.stroke_weight
    # the fourth period ends it, and nothing is earned or charged after
    np.testing.assert_allclose(rewards[:4], [0, 0, 0, -worst - SETTINGS.penalty()], rtol=1e-14)
    assert not np.any(rewards[4:])


def test_leaving_the_gauge_for_one_physics_step_ends_with_the_penalty() -> None:
    displacements = np.full(20, 0.0999)
    displacements[4] = -0.1001
    rewards = judged(displacements=displacements)
    assert rewards[:3].tolist() == [0.0, 0.0, -SETTINGS.penalty()]


def test_ending_costs_more_than_the_worst_way_to_go_on_from_any_step_at_any_discount() -> None:
    left = PERIODS - np.arange(PERIODS)
    for discount in (1.0, 0.999, 0.99, 0.9):
        # the discounted sum of as many worst steps as are left, this one included
        worst = np.array([WORST_STEP * (discount ** np.arange(n)).sum() for n in left])
        assert np.all(SETTINGS.penalty() >= worst * (1 - 1e-12))


def test_an_episode_that_ends_at_once_is_worth_less_than_the_worst_one_that_does_not() -> None:
    rough = Lateral17Env(track="german_high:level=400", gauge_limit=1e3, acceleration_limit=1e3)
    rough.reset(seed=0)
    worst = sum(rough.step(np.ones(4) * (-1) ** k)[1] for k in range(PERIODS))
    # as bad as can be, nearly: at the caps almost everywhere
    assert worst < -0.9 * PERIODS * WORST_STEP
    best = Lateral17Env(track="flat", acceleration_limit=1e-3)
    best.reset(seed=0)
    reward, ended = best.step(np.full(4, 0.1))[1:3]
    assert ended
    assert reward < worst


def test_the_penalty_follows_the_length_of_the_episode_and_the_weights() -> None:
    settings = EnvSettings(
        episode_seconds=5.0, comfort_cap=3.0, effort_weight=0.5, stroke_weight=0.25
    )
    assert settings.penalty() == 500 * 3.75
    assert EnvSettings(divergence_penalty=7).penalty() == 7.0


def test_a_record_of_the_wrong_shape_is_refused() -> None:
    for shape in ((1, 20, 7), (20, 8), (1, 21, 8)):
        with pytest.raises(ArgumentError, match="recorded"):
            rewards_of_record(SETTINGS, np.zeros(shape))
