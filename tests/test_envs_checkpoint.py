"""Copies of an environment in mid-episode go on as the original does."""

import copy
import json
import pickle
from collections.abc import Callable, Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from railenv.envs.rail_env import Lateral17Env
from railenv.envs.rail_vector_env import Lateral17VectorEnv
from railenv.errors import ArgumentError

RICH: dict[str, Any] = {
    "vehicle_ranges": "narrow",
    "vehicle_pool": 3,
    "track_pool": 2,
    "track_level": (0.5, 1.5),
    "delay": (0.0, 0.15),
    "sensor_delay": (0.0, 0.05),
    "jitter": 0.05,
    "dropout": 0.1,
    "sensor_dropout": 0.1,
    "sensor_noise": 0.2,
    "delay_observed": True,
    "told_error": 0.01,
    "observation_history": 1,
    "actuator_lag": 0.01,
    "episode_seconds": 0.8,
    "gauge_limit": 0.004,
}
Env = Lateral17Env | Lateral17VectorEnv


def single(**settings: Any) -> Lateral17Env:
    return Lateral17Env(**{**RICH, **settings})


def vector(threads: int = 1, **settings: Any) -> Lateral17VectorEnv:
    return Lateral17VectorEnv(3, threads=threads, **{**RICH, **settings})


def two_threads() -> Lateral17VectorEnv:
    return vector(threads=2)


def steps_of(env: Env, rng: np.random.Generator, number: int) -> list[Any]:
    """What some steps return; the single environment is reset by hand."""
    shape = env.action_space.shape
    assert shape is not None
    out: list[Any] = []
    for _ in range(number):
        returned = env.step(rng.uniform(-1, 1, shape).astype(np.float32))
        out.append(returned)
        if isinstance(env, Lateral17Env) and (returned[2] or returned[3]):
            out.append(env.reset())
    return out


def assert_same(found: Any, expected: Any) -> None:
    assert type(found) is type(expected)
    if isinstance(found, dict):
        assert list(found) == list(expected)
        for name in found:
            assert_same(found[name], expected[name])
    elif isinstance(found, tuple | list):
        assert len(found) == len(expected)
        for a, b in zip(found, expected, strict=True):
            assert_same(a, b)
    elif isinstance(found, np.ndarray):
        assert found.dtype == expected.dtype
        assert found.tobytes() == expected.tobytes()
    else:
        assert found == expected


# 70 periods lie past the first block of 64 in which jitter is drawn, and inside an episode of some
# lanes, after the first end of others; 100 more pass further ends and blocks.
BEFORE, AFTER = 70, 100


def in_mid_episode(make: Callable[[], Env]) -> Env:
    env = make()
    env.reset(seed=21)
    steps_of(env, np.random.default_rng(0), BEFORE)
    return env


@pytest.mark.parametrize(
    "make", [single, vector, pytest.param(two_threads, marks=pytest.mark.slow)]
)
@pytest.mark.parametrize(
    "copied", [lambda env: pickle.loads(pickle.dumps(env)), copy.deepcopy], ids=["pickle", "copy"]
)
def test_a_copy_goes_on_identically(make: Callable[[], Env], copied: Callable[[Env], Env]) -> None:
    env = in_mid_episode(make)
    twin = copied(env)
    ours = steps_of(env, np.random.default_rng(1), AFTER)
    assert_same(steps_of(twin, np.random.default_rng(1), AFTER), ours)


def test_a_wrapped_environment_can_be_copied_too() -> None:
    env = gym.make("railenv/Lateral17-v0", track_pool=1, episode_seconds=1.0)
    env.reset(seed=0)
    twin = pickle.loads(pickle.dumps(env))
    assert_same(twin.step(np.zeros(4)), env.step(np.zeros(4)))


@pytest.mark.parametrize(
    "make", [single, vector, pytest.param(two_threads, marks=pytest.mark.slow)]
)
def test_an_environment_goes_back_to_its_checkpoint(make: Callable[[], Env]) -> None:
    env = in_mid_episode(make)
    saved = env.checkpoint()
    first = steps_of(env, np.random.default_rng(1), AFTER)
    env.restore(saved)
    assert_same(steps_of(env, np.random.default_rng(1), AFTER), first)
    # and once more: going on has changed nothing in the checkpoint
    env.restore(saved)
    assert_same(steps_of(env, np.random.default_rng(1), AFTER), first)


@pytest.mark.parametrize("make", [single, vector, two_threads])
@pytest.mark.parametrize("played", [0, 40])
def test_a_fresh_environment_goes_on_from_a_checkpoint(
    make: Callable[[], Env], played: int
) -> None:
    env = in_mid_episode(make)
    saved = env.checkpoint()
    other = make()
    if played:
        other.reset(seed=77)
        steps_of(other, np.random.default_rng(2), played)
    other.restore(saved)
    ours = steps_of(env, np.random.default_rng(1), AFTER)
    assert_same(steps_of(other, np.random.default_rng(1), AFTER), ours)


def test_a_checkpoint_of_one_thread_serves_two() -> None:
    one, two = in_mid_episode(vector), two_threads()
    two.restore(one.checkpoint())
    ours = steps_of(one, np.random.default_rng(1), AFTER)
    assert_same(steps_of(two, np.random.default_rng(1), AFTER), ours)


@pytest.mark.parametrize("start", ["rest", "controlled"])
def test_a_checkpoint_remembers_tracks_that_were_given_by_seed(start: str) -> None:
    settings = {"delay": 0.05, "track_pool": 2, "episode_seconds": 3.0, "start": start}
    env, other = (Lateral17VectorEnv(3, **settings) for _ in "ab")
    options = {"track_seed": [9, 4, 9]} if start == "rest" else None
    env.reset(seed=0, options=options)
    steps_of(env, np.random.default_rng(0), 20)
    other.restore(env.checkpoint())
    ours = steps_of(env, np.random.default_rng(1), 100)
    assert_same(steps_of(other, np.random.default_rng(1), 100), ours)


def test_a_checkpoint_before_the_first_reset_asks_for_one() -> None:
    saved = single().checkpoint()
    env = in_mid_episode(single)
    env.restore(saved)
    with pytest.raises(ArgumentError, match="reset"):
        env.step(np.zeros(4))


def test_the_random_stream_goes_on_from_a_checkpoint_in_the_next_episodes() -> None:
    env, other = in_mid_episode(single), single()
    other.restore(env.checkpoint())
    for _ in range(3):
        assert_same(other.reset(), env.reset())
    assert other.np_random.bit_generator.state == env.np_random.bit_generator.state


def leaves(value: Any) -> Iterator[Any]:
    if isinstance(value, dict):
        assert all(type(name) is str for name in value)
        for entry in value.values():
            yield from leaves(entry)
    elif isinstance(value, list | tuple):
        for entry in value:
            yield from leaves(entry)
    else:
        yield value


@pytest.mark.parametrize("make", [single, vector])
def test_a_checkpoint_is_plain_data(make: Callable[[], Env]) -> None:
    env = in_mid_episode(make)
    for leaf in leaves(env.checkpoint()):
        if isinstance(leaf, np.ndarray):
            assert leaf.dtype.kind in "fib"
        else:
            assert leaf is None or type(leaf) in (bool, int, float, str)


def through_a_file(value: Any) -> Any:
    """A checkpoint written as text and read again."""

    def plain(entry: Any) -> Any:
        if isinstance(entry, np.ndarray):
            return {"array": entry.tolist(), "type": str(entry.dtype), "shape": entry.shape}
        raise TypeError(entry)

    def back(entry: dict[str, Any]) -> Any:
        if set(entry) == {"array", "type", "shape"}:
            return np.array(entry["array"], dtype=entry["type"]).reshape(entry["shape"])
        return entry

    return json.loads(json.dumps(value, default=plain), object_hook=back)


@pytest.mark.parametrize("make", [single, vector])
def test_a_checkpoint_survives_being_written_as_text(make: Callable[[], Env]) -> None:
    env, other = in_mid_episode(make), make()
    other.restore(through_a_file(env.checkpoint()))
    ours = steps_of(env, np.random.default_rng(1), AFTER)
    assert_same(steps_of(other, np.random.default_rng(1), AFTER), ours)


def test_no_array_of_a_checkpoint_is_one_of_the_environment() -> None:
    env = in_mid_episode(vector)
    saved = env.checkpoint()
    kept = [leaf for leaf in leaves(saved) if isinstance(leaf, np.ndarray)]
    twin = copy.deepcopy(env)
    for array in kept:
        array[...] = 1
    ours = steps_of(twin, np.random.default_rng(1), 10)
    assert_same(steps_of(env, np.random.default_rng(1), 10), ours)


def without(saved: dict[str, Any], array: str) -> dict[str, Any]:
    left = {name: a for name, a in saved["arrays"].items() if name != array}
    return {**saved, "arrays": left}


def bent(saved: dict[str, Any], array: str) -> dict[str, Any]:
    return {**saved, "arrays": {**saved["arrays"], array: np.zeros((1, 2, 3))}}


FOREIGN: dict[str, Callable[[dict[str, Any]], Any]] = {
    "nothing": lambda saved: None,
    "a list": lambda saved: [saved],
    "empty": lambda saved: {},
    "a version only": lambda saved: {"version": saved["version"]},
    "another version": lambda saved: {**saved, "version": 99},
    "another delay": lambda saved: single(delay=0.1).checkpoint(),
    "another seed of the pools": lambda saved: single(pool_seed=1).checkpoint(),
    "of the vector": lambda saved: Lateral17VectorEnv(1, **RICH).checkpoint(),
    "of three lanes": lambda saved: vector().checkpoint(),
    "without an array": lambda saved: without(saved, "lanes.state"),
    "with a bent array": lambda saved: bent(saved, "delay"),
}


@pytest.mark.parametrize("kind", FOREIGN)
def test_a_foreign_checkpoint_is_refused_and_changes_nothing(kind: str) -> None:
    env = in_mid_episode(single)
    twin = copy.deepcopy(env)
    with pytest.raises(ArgumentError, match="checkpoint"):
        env.restore(FOREIGN[kind](env.checkpoint()))
    ours = steps_of(twin, np.random.default_rng(1), 20)
    assert_same(steps_of(env, np.random.default_rng(1), 20), ours)


def test_the_vector_refuses_a_checkpoint_of_the_single_environment() -> None:
    env = Lateral17VectorEnv(1, **RICH)
    env.reset(seed=0)
    with pytest.raises(ArgumentError, match="checkpoint"):
        env.restore(in_mid_episode(single).checkpoint())
