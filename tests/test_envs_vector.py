"""The vectorised environment against the single one, and Gymnasium's own semantics."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from railenv.envs.rail_env import Lateral17Env
from railenv.envs.rail_vector_env import Lateral17VectorEnv

# Everything that can vary does, and episodes end by time and by the gauge, at different steps.
RICH: dict[str, Any] = {
    "vehicle_ranges": "wide",
    "vehicle_pool": 5,
    "track": ("tb3352", "german_low"),
    "track_pool": 4,
    "track_level": (0.5, 2.0),
    "delay": (0.0, 0.2),
    "delay_per_channel": True,
    "sensor_delay": (0.0, 0.05),
    "jitter": 0.03,
    "dropout": 0.1,
    "sensor_dropout": 0.1,
    "sensor_noise": 0.2,
    "delay_observed": True,
    "told_error": 0.02,
    "observation_history": 2,
    "action_history": 3,
    "episode_seconds": 0.9,
    "gauge_limit": 0.004,
}
SMALL: dict[str, Any] = {"track_pool": 2, "delay": (0.0, 0.3), "episode_seconds": 0.05}
OTHERS: tuple[dict[str, Any], ...] = (
    {**SMALL, "start": "controlled", "vehicle_ranges": "narrow", "vehicle_pool": 3},
    {**SMALL, "start": "controlled", "actuator_lag": 0.02, "track": ("tb3352", "flat")},
    {**SMALL, "action": "bogies", "actuator_lag": 0.02, "jitter": 0.001, "max_delay": 0.31},
    {**SMALL, "layout": 2, "observation": "state", "rate_limit": 1e5, "dropout": 0.2},
    {**SMALL, "actuator_lag": 1e-5, "observation_scale": "si", "action_history": 0},
    {**SMALL, "jitter": 0.2, "common_jitter": True, "delay": 0.05, "sensor_dropout": 0.5},
)
MODES = ("next_step", "same_step", "disabled")


def bits(value: Any) -> Any:
    """What has to be equal: every bit of a number, the letters of a text."""
    array = np.asarray(value)
    return str(array) if array.dtype.kind == "U" else (array.shape, array.dtype, array.tobytes())


def actions_of(lane: int, steps: int, num: int) -> np.ndarray:
    """Actions of one lane, the same in any batch; some leave the box."""
    rng = np.random.default_rng([99, lane])
    return rng.uniform(-1.2, 1.2, (steps, num)).astype(np.float32)


def lane_of_single(settings: dict[str, Any], mode: str, seed: int, lane: int, steps: int) -> list:
    """What a lane has to return, from the single environment, reset as `mode` says."""
    env = Lateral17Env(**settings)
    actions = actions_of(lane, steps, *env.action_space.shape)
    out: list[tuple] = [env.reset(seed=seed + lane)]
    done = False
    for action in actions:
        if done and mode == "next_step":
            observation, info = env.reset()
            out.append((observation, 0.0, False, False, info))
            done = False
            continue
        if done and mode == "disabled":
            out.append(env.reset())
        observation, reward, terminated, truncated, info = env.step(action)
        done = terminated or truncated
        if done and mode == "same_step":
            out.append((observation, info))  # the final ones
            observation, info = env.reset()
            done = False
        out.append((observation, reward, terminated, truncated, info))
    return out


def lanes_of_vector(
    settings: dict[str, Any], mode: str, seed: int, num: int, steps: int, threads: int = 1
) -> list[list]:
    """The same of every lane of the vectorised environment."""
    env = Lateral17VectorEnv(num, autoreset_mode=mode, threads=threads, **settings)
    all_actions = np.stack(
        [actions_of(k, steps, *env.single_action_space.shape) for k in range(num)], axis=1
    )
    observations, info = env.reset(seed=seed)
    out: list[list] = [[(observations[k], of_lane(info, k))] for k in range(num)]
    done = np.zeros(num, dtype=bool)
    for actions in all_actions:
        if mode == "disabled" and done.any():
            observations, info = env.reset(options={"reset_mask": done})
            for k in np.nonzero(done)[0]:
                out[k].append((observations[k], of_lane(info, k)))
        observations, rewards, terminated, truncated, info = env.step(actions)
        done = terminated | truncated
        for k in range(num):
            if mode == "same_step" and done[k]:
                out[k].append((info["final_obs"][k], of_lane(info["final_info"], k)))
            out[k].append(
                (observations[k], rewards[k], terminated[k], truncated[k], of_lane(info, k))
            )
    env.close()
    return out


def of_lane(info: dict[str, Any], lane: int) -> dict[str, Any]:
    """One lane's entries of an info, without those of other lanes."""
    plain = [name for name in info if not name.startswith(("_", "final"))]
    return {name: info[name][lane] for name in plain if info[f"_{name}"][lane]}


def assert_equal(found: list[tuple], expected: list[tuple]) -> None:
    assert len(found) == len(expected)
    for step, (mine, theirs) in enumerate(zip(found, expected, strict=True)):
        assert len(mine) == len(theirs), step
        for a, b in zip(mine[:-1], theirs[:-1], strict=True):
            assert bits(a) == bits(b), step
        assert list(mine[-1]) == list(theirs[-1])
        for name, value in mine[-1].items():
            assert bits(value) == bits(theirs[-1][name]), (step, name)


@pytest.mark.parametrize("mode", MODES)
def test_a_lane_is_the_single_environment_bit_for_bit(mode: str) -> None:
    lanes = lanes_of_vector(RICH, mode, 40, 3, 600)
    flags = {tuple(map(bool, step[2:4])) for lane in lanes for step in lane if len(step) == 5}
    # the comparison is worth something only if episodes end in both ways
    assert flags >= {(False, False), (True, False), (False, True)}
    for k in (0, 2):
        assert_equal(lanes[k], lane_of_single(RICH, mode, 40, k, 600))


@pytest.mark.slow
@pytest.mark.parametrize("mode", MODES)
def test_a_lane_is_the_single_environment_bit_for_bit_over_10000_steps(mode: str) -> None:
    lanes = lanes_of_vector(RICH, mode, 7, 4, 10_000, threads=2)
    for k in range(4):
        assert_equal(lanes[k], lane_of_single(RICH, mode, 7, k, 10_000))


@pytest.mark.parametrize("settings", OTHERS)
def test_a_lane_is_the_single_environment_whatever_the_settings(settings: dict) -> None:
    lanes = lanes_of_vector(settings, "same_step", 3, 2, 40)
    for k in range(2):
        assert_equal(lanes[k], lane_of_single(settings, "same_step", 3, k, 40))


def test_a_lane_does_not_depend_on_the_number_of_lanes() -> None:
    one, three, seven = (lanes_of_vector(RICH, "same_step", 11, n, 300) for n in (1, 3, 7))
    assert_equal(three[0], one[0])
    assert_equal(seven[0], one[0])
    assert_equal(seven[2], three[2])


@pytest.mark.parametrize("threads", [2, 3, 7])
def test_a_lane_does_not_depend_on_the_number_of_threads(threads: int) -> None:
    alone = lanes_of_vector(RICH, "next_step", 5, 5, 200)
    shared = lanes_of_vector(RICH, "next_step", 5, 5, 200, threads=threads)
    for k in range(5):
        assert_equal(shared[k], alone[k])


@pytest.mark.parametrize(
    "options",
    [
        {"vehicle": 1},
        {"delay": 0.07},
        pytest.param(
            {"track_seed": 3, "delay": (0.1, 0.2, 0.0, 0.05)},
            id="track_seed and one delay per channel",
        ),
    ],
)
def test_an_option_does_in_a_lane_what_it_does_in_the_single_environment(options: dict) -> None:
    settings = {**SMALL, "vehicle_ranges": "narrow", "vehicle_pool": 2, "delay_per_channel": True}
    single, vector = Lateral17Env(**settings), Lateral17VectorEnv(2, **settings)
    one = single.reset(seed=5, options=options)
    each = {k: [v, v] if isinstance(v, tuple) else v for k, v in options.items()}
    observations, info = vector.reset(seed=4, options=each)
    assert_equal([(observations[1], of_lane(info, 1))], [one])
    for action in actions_of(0, 4, 4):
        after = single.step(action)
        observations, rewards, ended, late, info = vector.step(np.stack([action, action]))
        found = (observations[1], rewards[1], ended[1], late[1], of_lane(info, 1))
        assert_equal([found], [after])


def test_the_track_in_info_does_not_depend_on_other_lanes_seeds() -> None:
    single, vector = Lateral17Env(**SMALL), Lateral17VectorEnv(2, **SMALL)
    alone = [single.reset(options={"track_seed": seed})[1]["track"] for seed in (5, 3)]
    info = vector.reset(options={"track_seed": [5, 3]})[1]
    assert info["track"].tolist() == alone


def test_a_track_given_to_one_lane_leaves_the_others_on_theirs() -> None:
    settings = {**SMALL, "episode_seconds": 1.0, "autoreset_mode": "disabled"}
    env, twin = Lateral17VectorEnv(3, **settings), Lateral17VectorEnv(3, **settings)
    for each in (env, twin):
        each.reset(seed=0, options={"track_seed": [5, 3, 9]})
    # seeds before, between and behind those in use, and one that is in use already
    for seed in (4, 1, 12, 9, 5):
        env.reset(options={"reset_mask": np.array([False, True, False]), "track_seed": seed})
        for _ in range(8):
            actions = np.full((3, 4), 0.1)
            found, expected = env.step(actions)[0], twin.step(actions)[0]
            np.testing.assert_array_equal(found[[0, 2]], expected[[0, 2]])
        assert not np.array_equal(found[1], expected[1])


def equal_infos(found: dict[str, Any], expected: dict[str, Any]) -> None:
    """Same keys and masks, same numbers wherever a mask says that there are any."""
    assert set(found) == set(expected)
    for name, value in expected.items():
        if name.startswith("_"):
            np.testing.assert_array_equal(found[name], value)
            continue
        if isinstance(value, dict):
            equal_infos(found[name], value)
            continue
        mask = expected[f"_{name}"]
        for lane in range(len(mask)):
            if mask[lane]:
                np.testing.assert_array_equal(found[name][lane], value[lane])
            elif name == "final_obs":
                assert found[name][lane] is None


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_autoreset_is_that_of_gymnasiums_own_vector(mode: AutoresetMode) -> None:
    num = 3
    settings = {**RICH, "episode_seconds": 0.2}
    mine = Lateral17VectorEnv(num, autoreset_mode=mode, **settings)
    theirs = SyncVectorEnv(
        [lambda: Lateral17Env(**settings) for _ in range(num)], autoreset_mode=mode
    )
    assert mine.single_observation_space == theirs.single_observation_space
    assert mine.observation_space == theirs.observation_space
    assert mine.action_space == theirs.action_space
    assert mine.metadata["autoreset_mode"] is theirs.metadata["autoreset_mode"]
    first, second = mine.reset(seed=[5, 3, 8]), theirs.reset(seed=[5, 3, 8])
    np.testing.assert_array_equal(first[0], second[0])
    equal_infos(first[1], second[1])
    rng, ends = np.random.default_rng(0), 0
    for _ in range(120):
        actions = rng.uniform(-1, 1, (num, 4)).astype(np.float32)
        found, expected = mine.step(actions), theirs.step(actions)
        for a, b in zip(found[:4], expected[:4], strict=True):
            assert a.dtype == b.dtype
            np.testing.assert_array_equal(a, b)
        equal_infos(found[4], expected[4])
        done = found[2] | found[3]
        ends += done.sum()
        if mode is AutoresetMode.DISABLED and done.any():
            after, wanted = (
                env.reset(options={"reset_mask": done.copy()}) for env in (mine, theirs)
            )
            np.testing.assert_array_equal(after[0], wanted[0])
            equal_infos(after[1], wanted[1])
    assert ends > 10


def arrays_in(value: Any) -> Iterator[np.ndarray]:
    """Every array that a call returned, those inside of info too."""
    if isinstance(value, np.ndarray):
        yield value
        if value.dtype == object:
            for entry in value:
                yield from arrays_in(entry)
    elif isinstance(value, dict):
        for entry in value.values():
            yield from arrays_in(entry)
    elif isinstance(value, tuple | list):
        for entry in value:
            yield from arrays_in(entry)


@pytest.mark.parametrize("mode", MODES)
def test_no_two_returned_arrays_share_memory(mode: str) -> None:
    env = Lateral17VectorEnv(2, autoreset_mode=mode, **{**RICH, "episode_seconds": 0.03})
    kept: list[np.ndarray] = []
    done = np.ones(2, dtype=bool)

    def note(returned: Any) -> None:
        for array in arrays_in(returned):
            assert not any(np.shares_memory(array, other) for other in kept)
            kept.append(array)

    note(env.reset(seed=0))
    for _ in range(7):
        returned = env.step(np.zeros((2, 4)))
        note(returned)
        done = returned[2] | returned[3]
        if mode == "disabled" and done.any():
            note(env.reset(options={"reset_mask": done.copy()}))


@pytest.mark.parametrize("mode", MODES)
def test_what_a_caller_does_to_returned_arrays_changes_nothing(mode: str) -> None:
    settings = {**RICH, "episode_seconds": 0.05}
    untouched, touched = (Lateral17VectorEnv(3, autoreset_mode=mode, **settings) for _ in "ab")

    def spoil(returned: Any) -> None:
        for array in arrays_in(returned):
            if array.dtype.kind in "fib":
                array[...] = 1

    first, second = untouched.reset(seed=1), touched.reset(seed=1)
    spoil(second)
    for _ in range(12):
        actions = np.full((3, 4), 0.5, dtype=np.float32)
        first, second = untouched.step(actions), touched.step(actions)
        for a, b in zip(first[:4], second[:4], strict=True):
            np.testing.assert_array_equal(a, b)
        equal_infos(second[4], first[4])
        done = first[2] | first[3]
        spoil(second)
        if mode == "disabled" and done.any():
            first, second = (
                env.reset(options={"reset_mask": done.copy()}) for env in (untouched, touched)
            )
            np.testing.assert_array_equal(first[0], second[0])
            spoil(second)
        np.testing.assert_array_equal(actions, np.float32(0.5))


def test_lanes_that_a_reset_leaves_out_return_what_they_last_returned() -> None:
    env = Lateral17VectorEnv(3, autoreset_mode="disabled", **RICH)
    env.reset(seed=1)
    only_the_middle = {"reset_mask": np.array([False, True, False])}
    returned = env.step(np.ones((3, 4)))
    for _ in range(2):
        kept = returned[0].copy()
        returned[0][...] = 1.0
        returned = env.reset(options=only_the_middle)
        np.testing.assert_array_equal(returned[0][[0, 2]], kept[[0, 2]])


def test_what_the_single_environments_caller_does_to_its_arrays_changes_nothing() -> None:
    untouched, touched = Lateral17Env(**RICH), Lateral17Env(**RICH)
    first, second = untouched.reset(seed=1), touched.reset(seed=1)
    for _ in range(100):
        for array in arrays_in(second):
            array[...] = 1
        action = np.full(4, 0.5)
        first, second = untouched.step(action), touched.step(action)
        assert_equal([second], [first])


def test_memory_grows_linearly_with_the_lanes() -> None:
    def size(lanes: int) -> int:
        env = Lateral17VectorEnv(lanes, **{**RICH, "track_pool": 2})
        env.reset(seed=0)
        return sum(array.nbytes for array in env._lanes.arrays().values())

    few, more, many = size(64), size(128), size(256)
    # What does not grow (filter, scales) cancels in the differences.
    assert many - more == 2 * (more - few)
    # doubled lanes, at most doubled memory: 1 % for what does not grow
    assert 1.99 * more < many <= 2 * more
