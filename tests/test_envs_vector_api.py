"""The vectorised environment as Gymnasium's registry, wrappers and conventions expect it."""

import json
import warnings
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.wrappers import vector as wrappers

import railenv  # noqa: F401  (registers the ids)
from railenv.envs.rail_env import Lateral17Env
from railenv.envs.rail_vector_env import Lateral17VectorEnv
from railenv.errors import ArgumentError

ID = "railenv/Lateral17-v0"
SMALL: dict[str, Any] = {"episode_seconds": 0.05, "track_pool": 2}
VARIANTS: tuple[dict[str, Any], ...] = (
    {},
    {"layout": 2, "delay": (0.0, 0.2), "delay_per_channel": True, "delay_observed": True},
    {"observation": "state", "observation_history": 2, "action": "bogies", "jitter": 0.1},
    {"vehicle_ranges": "narrow", "vehicle_pool": 2, "start": "controlled", "dropout": 0.5},
    {"action_history": 0, "sensor_dropout": 0.5, "actuator_lag": 0.01, "max_delay": 0.1},
    {"gauge_limit": 1e-4, "track": "german_high"},
)


def make(num: int = 3, **settings: Any) -> Lateral17VectorEnv:
    return Lateral17VectorEnv(num, **{**SMALL, **settings})


@pytest.mark.parametrize("mode", ["next_step", "same_step"])
@pytest.mark.parametrize("settings", VARIANTS)
def test_what_is_returned_is_what_the_spaces_promise(settings: dict, mode: str) -> None:
    env = make(autoreset_mode=mode, **settings)
    single = Lateral17Env(**{**SMALL, **settings})
    assert env.single_observation_space == single.observation_space
    assert env.single_action_space == single.action_space
    assert env.observation_space.shape == (3, *single.observation_space.shape)
    env.action_space.seed(0)
    observations, info = env.reset(seed=0)
    for _ in range(12):
        assert observations.dtype == np.float32
        assert env.observation_space.contains(observations)
        for name, values in info.items():
            if name.startswith("_"):
                assert values.dtype == np.bool_
                assert values.shape == (3,)
            elif not name.startswith("final"):
                assert len(values) == 3
                assert f"_{name}" in info
        observations, rewards, ended, late, info = env.step(env.action_space.sample())
        assert (rewards.dtype, rewards.shape) == (np.float64, (3,))
        assert (ended.dtype, late.dtype) == (np.bool_, np.bool_)
        assert np.isfinite(rewards).all()


@pytest.mark.parametrize("settings", VARIANTS)
def test_two_seeded_rollouts_are_bitwise_equal(settings: dict) -> None:
    def played(env: Lateral17VectorEnv) -> bytes:
        env.action_space.seed(1)
        out = [env.reset(seed=9)[0]]
        for _ in range(12):
            observations, rewards, *_ = env.step(env.action_space.sample())
            out += [observations, rewards]
        return b"".join(array.tobytes() for array in out)

    env = make(**settings)
    first = played(env)
    assert played(make(**settings)) == first
    assert played(env) == first


@pytest.mark.parametrize("arguments", [{"vectorization_mode": "vector_entry_point"}, {}])
def test_the_registry_makes_the_vectorised_environment_without_a_warning(arguments: dict) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        envs = gym.make_vec(ID, num_envs=4, delay=(0.0, 0.3), **SMALL, **arguments)
        assert isinstance(envs, Lateral17VectorEnv)
        assert envs.spec is not None
        assert envs.spec.id == ID
        assert envs.num_envs == 4
        assert envs.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
        delays = envs.reset(seed=0)[1]["delay"]
        envs.step(envs.action_space.sample())
        envs.close()
    assert len(np.unique(delays)) == 4
    assert np.all((delays >= 0.0) & (delays <= 0.3))


def test_the_registry_makes_the_synchronous_vector_too() -> None:
    envs = gym.make_vec(ID, num_envs=2, vectorization_mode="sync", **SMALL)
    assert envs.reset(seed=0)[0].shape == (2, 136)
    envs.close()


def test_the_spec_of_the_vectorised_environment_can_be_written_down() -> None:
    envs = gym.make_vec(ID, num_envs=2, delay=0.1, **SMALL)
    assert envs.spec is not None
    assert json.loads(envs.spec.to_json())["kwargs"]["delay"] == 0.1
    again = gym.make_vec(envs.spec)
    assert isinstance(again, Lateral17VectorEnv)
    assert again.settings == envs.unwrapped.settings


@pytest.mark.parametrize("given", [AutoresetMode.SAME_STEP, "same_step", "SameStep"])
def test_an_autoreset_mode_has_its_usual_spellings(given: Any) -> None:
    assert make(autoreset_mode=given).metadata["autoreset_mode"] is AutoresetMode.SAME_STEP


WRAPPERS: tuple[tuple[str, Callable[[VectorEnv], VectorEnv], str], ...] = (
    ("statistics", wrappers.RecordEpisodeStatistics, "next_step"),
    ("statistics", wrappers.RecordEpisodeStatistics, "same_step"),
    ("reward", wrappers.NormalizeReward, "next_step"),
    ("reward", wrappers.NormalizeReward, "same_step"),
    ("observation", wrappers.NormalizeObservation, "next_step"),
)


@pytest.mark.parametrize(("name", "wrap", "mode"), WRAPPERS)
def test_gymnasiums_vector_wrappers_run_over_it(name: str, wrap: Callable, mode: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = wrap(make(autoreset_mode=mode, delay=(0.0, 0.3)))
        env.reset(seed=0)
        episodes = []
        for _ in range(13):
            observations, rewards, _, _, info = env.step(np.zeros((3, 4), dtype=np.float32))
            assert np.isfinite(observations).all()
            assert np.isfinite(rewards).all()
            if "episode" in info:
                episodes += info["episode"]["l"][info["_episode"]].tolist()
        env.close()
    if name == "statistics":
        # five periods an episode, in each lane twice
        assert episodes == [5] * 6


def test_seeds_may_be_given_one_by_one_and_left_out() -> None:
    env = make()
    base = env.reset(seed=10)[0]
    assert env.np_random_seed == (10, 11, 12)
    np.testing.assert_array_equal(env.reset(seed=[10, 11, 12])[0], base)
    states = [generator.bit_generator.state for generator in env.np_random]
    env.reset(seed=[10, None, 12])
    assert env.np_random[0].bit_generator.state == states[0]
    assert env.np_random[1].bit_generator.state != states[1]
    assert env.np_random_seed == (10, 11, 12)


def test_a_reset_without_a_seed_goes_on_with_the_random_streams() -> None:
    settings = {"delay": (0.0, 0.3)}
    first, second = make(**settings), make(**settings)
    delays = []
    for env in (first, second):
        env.reset(seed=3)
        delays.append(env.reset()[1]["delay"])
    np.testing.assert_array_equal(delays[0], delays[1])
    assert not np.array_equal(delays[0], first.reset(seed=3)[1]["delay"])


def test_lanes_that_were_never_seeded_differ() -> None:
    delays = make(delay=(0.0, 0.3)).reset()[1]["delay"]
    assert len(np.unique(delays)) == 3


@pytest.mark.parametrize("seed", [-1, 1.5, "0", [1, 2], [1, 2, -3], [1, 2, 0.5], True])
def test_a_bad_seed_is_refused_and_changes_nothing(seed: Any) -> None:
    env = make()
    env.reset(seed=0)
    before = [generator.bit_generator.state for generator in env.np_random]
    with pytest.raises(ArgumentError, match="seed"):
        env.reset(seed=seed)
    assert [generator.bit_generator.state for generator in env.np_random] == before


@pytest.mark.parametrize(
    "mask",
    [
        np.zeros(3, dtype=bool),
        np.ones(2, dtype=bool),
        np.ones(3, dtype=int),
        np.ones((3, 1), dtype=bool),
        "all",
    ],
)
def test_a_bad_reset_mask_is_refused(mask: Any) -> None:
    env = make(autoreset_mode="disabled")
    env.reset(seed=0)
    with pytest.raises(ArgumentError, match="reset_mask"):
        env.reset(options={"reset_mask": mask})


def test_a_reset_mask_resets_its_lanes_only() -> None:
    env = make(autoreset_mode="disabled")
    env.reset(seed=0)
    before = env.step(np.full((3, 4), 0.5))[0]
    options = {"reset_mask": np.array([False, True, False])}
    after, info = env.reset(options=options)
    assert list(options) == ["reset_mask"]
    np.testing.assert_array_equal(after[[0, 2]], before[[0, 2]])
    assert not np.array_equal(after[1], before[1])
    assert info["_time"].tolist() == [False, True, False]
    assert env.step(np.zeros((3, 4)))[4]["time"].tolist() == pytest.approx([0.02, 0.01, 0.02])


def test_without_autoreset_a_step_after_the_end_is_refused_and_names_the_lane() -> None:
    env = make(autoreset_mode="disabled")
    env.reset(seed=0)
    env.step(np.zeros((3, 4)))
    env.reset(options={"reset_mask": np.array([True, False, True])})
    for _ in range(4):
        late = env.step(np.zeros((3, 4)))[3]
    assert late.tolist() == [False, True, False]
    with pytest.raises(ArgumentError, match="lane 1"):
        env.step(np.zeros((3, 4)))


def test_the_first_reset_must_be_of_all_lanes() -> None:
    env = make(autoreset_mode="disabled")
    with pytest.raises(ArgumentError, match="reset"):
        env.step(np.zeros((3, 4)))
    with pytest.raises(ArgumentError, match="first reset"):
        env.reset(options={"reset_mask": np.array([True, False, False])})
    env.reset(options={"reset_mask": np.ones(3, dtype=bool)})
    env.step(np.zeros((3, 4)))


@pytest.mark.parametrize(
    "actions",
    [np.zeros((2, 4)), np.zeros(4), np.full((3, 4), np.nan), np.zeros((3, 4), dtype=complex), "up"],
)
def test_bad_actions_are_refused(actions: Any) -> None:
    env = make()
    env.reset(seed=0)
    with pytest.raises(ArgumentError, match="actions"):
        env.step(actions)


@pytest.mark.parametrize(
    "arguments",
    [
        {"num_envs": 0},
        {"num_envs": 2.5},
        {"threads": 0},
        {"autoreset_mode": "never"},
        {"autoreset_mode": None},
        {"render_mode": "gif"},
    ],
)
def test_bad_arguments_are_refused_by_name(arguments: dict) -> None:
    with pytest.raises(ArgumentError, match=next(iter(arguments))):
        Lateral17VectorEnv(**{**SMALL, **arguments})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([1], "options"),
        ({"delay": [0.1, 0.2]}, "2 entries for 3 lanes"),
        ({"vehicle": [0, 0, 7]}, "vehicle"),
        ({"mask": 1}, "reset option"),
    ],
)
def test_bad_options_are_refused_and_change_nothing(options: Any, message: str) -> None:
    env, twin = make(), make()
    for each in (env, twin):
        each.reset(seed=0)
    with pytest.raises(ArgumentError, match=message):
        env.reset(seed=5, options=options)
    actions = np.full((3, 4), 0.3)
    np.testing.assert_array_equal(env.step(actions)[0], twin.step(actions)[0])


def test_options_may_be_given_lane_by_lane() -> None:
    info = make(max_delay=0.4).reset(seed=0, options={"delay": [0.0, 0.1, 0.35]})[1]
    assert info["delay"].tolist() == [[0.0] * 4, [0.1] * 4, [0.35] * 4]


@pytest.mark.parametrize("threads", [1, 2])
def test_closing_twice_does_no_harm(threads: int) -> None:
    env = make(threads=threads)
    env.reset(seed=0)
    env.step(np.zeros((3, 4)))
    env.close()
    env.close()


def test_a_picture_of_every_lane_is_rendered() -> None:
    env = make(2, render_mode="rgb_array")
    env.reset(seed=0)
    env.step(np.full((2, 4), 0.5))
    frames = env.render()
    assert frames is not None
    assert [frame.shape for frame in frames] == [(480, 640, 3)] * 2
    assert make(2).render() is None
