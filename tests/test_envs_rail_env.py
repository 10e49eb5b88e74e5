"""The single environment: checkers, seeds, delays, bounds, reward and endings."""

import pickle
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import railenv  # noqa: F401  (registers the ids)
from railenv.actuation import DelaySpec
from railenv.envs.observation import sensor_names
from railenv.envs.rail_env import Lateral17Env
from railenv.errors import ArgumentError

ID = "railenv/Lateral17-v0"
VARIANTS = (
    {},
    {"layout": 2, "delay": 0.1},
    {"delay": (0.0, 0.3), "track": "german_low"},
    {"observation": "state", "actuator_lag": 0.02},
    {"delay": DelaySpec((0.0, 0.1, 0.05, 0.2)), "rate_limit": 1e5},
)


def make(**settings: object) -> Lateral17Env:
    env = gym.make(ID, **settings).unwrapped
    assert isinstance(env, Lateral17Env)
    return env


def played(env: gym.Env, steps: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Observations and rewards of a seeded rollout with seeded actions."""
    observations, rewards = [env.reset(seed=seed)[0]], []
    rng = np.random.default_rng(seed)
    for _ in range(steps):
        observation, reward, *_ = env.step(rng.uniform(-1, 1, env.action_space.shape))
        observations.append(observation)
        rewards.append(reward)
    return np.array(observations), np.array(rewards)


@pytest.mark.parametrize("settings", VARIANTS)
def test_gymnasiums_checker_passes_without_a_warning(settings: dict) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(make(**settings))


@pytest.mark.parametrize("settings", VARIANTS)
def test_stable_baselines_checker_passes_without_a_warning(settings: dict) -> None:
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        checker.check_env(make(**settings))


def test_the_module_prefix_makes_the_environment_too() -> None:
    env = gym.make("railenv:railenv/Lateral17-v0", episode_seconds=1.0)
    assert isinstance(env.unwrapped, Lateral17Env)


@pytest.mark.parametrize("settings", VARIANTS)
def test_two_seeded_rollouts_are_bitwise_equal(settings: dict) -> None:
    first, second = (played(make(**settings), 150, 7) for _ in range(2))
    np.testing.assert_array_equal(first[0], second[0])
    np.testing.assert_array_equal(first[1], second[1])


def test_another_seed_is_another_track() -> None:
    env = make()
    assert not np.array_equal(played(env, 150, 1)[0], played(env, 150, 2)[0])


def test_a_fixed_track_seed_repeats_the_track_under_any_seed() -> None:
    env = make()

    def last(seed: int) -> np.ndarray:
        env.reset(seed=seed, options={"track_seed": 5, "delay": 0.1})
        for _ in range(200):
            observation = env.step(np.zeros(4))[0]
        return observation

    np.testing.assert_array_equal(last(1), last(2))


def test_no_returned_array_shares_memory_with_the_next_one() -> None:
    env = make()
    observation, info = env.reset(seed=0)
    kept = [observation, *(v for v in info.values() if isinstance(v, np.ndarray))]
    for _ in range(3):
        observation, _, _, _, info = env.step(np.ones(4) * 0.1)
        now = [observation, *(v for v in info.values() if isinstance(v, np.ndarray))]
        assert not any(np.shares_memory(a, b) for a in kept for b in now)
        kept += now


@pytest.mark.parametrize("delay", [0.0, 0.013, 0.1, 0.2345])
def test_the_force_arrives_when_info_says(delay: float) -> None:
    env = make(delay=delay, track="flat", time_step=0.0005)
    _, info = env.reset(seed=0)
    assert info["delay"].tolist() == [delay] * 4
    arrival = None
    for k in range(40):
        before = info["time"]
        *_, info = env.step(np.ones(4) if k == 0 else np.zeros(4))
        if info["force"][0] != 0.0 and arrival is None:
            arrival = before
    # force is seen at the ends of control periods: the command arrives within the one before
    assert arrival is not None
    assert arrival - 1e-12 <= delay < arrival + 0.01


def test_the_pipe_shows_the_past_actions_newest_first() -> None:
    env = make(track="flat")
    env.reset(seed=0)
    for value in (0.1, 0.2, 0.3):
        observation = env.step(np.full(4, value))[0]
    columns = list(env.observation_names)
    for age, value in ((1, 0.3), (2, 0.2), (3, 0.1), (4, 0.0)):
        assert observation[columns.index(f"action_{age}_ago_2")] == np.float32(value)


def test_the_documented_columns_are_the_columns() -> None:
    env = make()
    assert env.observation_names[:16] == sensor_names("4")
    assert env.observation_space.shape == (136,)
    doc = Lateral17Env.__doc__ or ""
    for word in ("(0-3)", "(4-7)", "(8, 9)", "(10)", "(11)", "(12-15)", "(16-135)"):
        assert word in doc
    assert env.observation_names[10:12] == ("carbody_roll_rate", "carbody_yaw_rate")


def test_every_column_but_unused_actions_moves() -> None:
    env = make()
    observations, _ = played(env, 600, 3)
    assert np.all(observations.std(axis=0) > 0.0)


def test_the_reward_is_its_terms_and_within_its_bounds() -> None:
    env = make(track="german_high", delay=0.25)
    env.reset(seed=1)
    for _ in range(300):
        _, reward, terminated, _, info = env.step(env.action_space.sample())
        names = ("comfort", "effort", "stroke", "divergence")
        assert reward == sum(info[f"reward_{name}"] for name in names)
        assert -5.06 - 10120.0 <= reward <= 0.0
        if terminated:
            break


def test_comfort_costs_one_at_the_reference_acceleration() -> None:
    env = make()
    env.reset(seed=0)
    for _ in range(100):
        *_, info = env.step(np.zeros(4))
    expected = -info["weighted_acceleration"] / env.settings.comfort_reference
    assert info["reward_comfort"] == pytest.approx(max(expected, -5.0))


def test_effort_costs_its_weight_at_full_action() -> None:
    env = make(track="flat")
    env.reset(seed=0)
    assert env.step(np.ones(4))[4]["reward_effort"] == pytest.approx(-0.01)


def test_an_episode_is_truncated_on_time_and_not_terminated() -> None:
    env = make(episode_seconds=0.05)
    env.reset(seed=0)
    ends = [env.step(np.zeros(4))[2:4] for _ in range(5)]
    assert ends == [(False, False)] * 4 + [(False, True)]


def test_leaving_the_gauge_terminates_with_its_reason_and_penalty() -> None:
    env = make(track="flat", gauge_limit=1e-4)
    env.reset(seed=0)
    for _ in range(100):
        _, reward, terminated, truncated, info = env.step(np.ones(4))
        if terminated:
            break
    assert terminated
    assert not truncated
    assert info["ended_by"] == "gauge"
    assert reward <= -500.0


def test_divergence_terminates_with_its_reason_and_worst_comfort() -> None:
    env = make(track="flat", acceleration_limit=1e-3)
    env.reset(seed=0)
    _, _, terminated, _, info = env.step(np.ones(4))
    assert terminated
    assert info["ended_by"] == "divergence"
    assert info["reward_comfort"] == -5.0


def test_an_action_outside_the_box_is_clipped_and_flagged() -> None:
    env = make(track="flat")
    env.reset(seed=0)
    info = env.step(np.array([2.0, 0.0, 0.0, 0.0]))[4]
    assert info["action_clipped"]
    assert info["command"].tolist() == [3000.0, 0.0, 0.0, 0.0]


def test_a_reading_beyond_its_bound_is_clipped_and_flagged() -> None:
    env = make(track="german_high:level=1e6", acceleration_limit=1e9, gauge_limit=1e9)
    env.reset(seed=0)
    flags = []
    for _ in range(300):
        observation, *_, info = env.step(np.zeros(4))
        assert env.observation_space.contains(observation)
        flags.append(info["observation_clipped"])
    assert any(flags)


def test_an_environment_survives_pickling_in_mid_episode() -> None:
    env = make(delay=0.1)
    played(env, 50, 4)
    copy = pickle.loads(pickle.dumps(env))
    for _ in range(50):
        action = np.full(4, 0.1)
        np.testing.assert_array_equal(env.step(action)[0], copy.step(action)[0])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"delay": -0.1}, "delay"),
        ({"delay": 0.4}, "above max_delay"),
        ({"delay": (0.2, 0.1)}, "upside down"),
        ({"delay": (0.1, 0.1, 0.1)}, "DelaySpec"),
        ({"layout": 3}, "layout"),
        ({"layout": "passive"}, "no actuator"),
        ({"speed_kmh": 0}, "speed_kmh"),
        ({"vehicle": "paper-fit"}, "paper_fit"),
        ({"track": "tb3353"}, "tb3352"),
        ({"delayy": 0.1}, "did you mean 'delay'"),
        ({"observation": "all"}, "observation"),
        ({"episode_seconds": 0.015}, "whole multiple"),
        ({"comfort_cap": np.nan}, "comfort_cap"),
        ({"time_step": 0.003}, "whole multiple"),
        ({"render_mode": "humane"}, "human"),
    ],
)
def test_a_bad_setting_is_refused_by_name(settings: dict, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        Lateral17Env(**settings).reset(seed=0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"dela": 0.1}, "delay"),
        ({"delay": 0.5}, "max_delay"),
        ({"delay": [0.1, 0.2]}, "4 channels"),
    ],
)
def test_a_bad_reset_option_is_refused(options: dict, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        make().reset(seed=0, options=options)


@pytest.mark.parametrize("action", [np.zeros(3), np.full(4, np.nan)])
def test_a_bad_action_is_refused(action: np.ndarray) -> None:
    env = make()
    env.reset(seed=0)
    with pytest.raises(ArgumentError, match="action"):
        env.step(action)
