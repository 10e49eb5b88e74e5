"""The vectorised nonlinear environment: lane by lane the single one, copies, autoreset."""

import pickle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import railenv  # noqa: F401  (registers the ids)
from railenv.envs.full_env import Full50Env, Full50VectorEnv
from railenv.errors import ArgumentError

# Everything that can vary does, and episodes end by time and, in a curve that the faster vehicles
# of the pool cannot take, by derailment.
RICH: dict[str, Any] = {
    "vehicle_ranges": "wide",
    "vehicle_pool": 3,
    "track": ("tb3352", "german_high"),
    "track_pool": 2,
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
    "rate_limit": 1e5,
    "actuator_lag": 0.01,
    "episode_seconds": 0.6,
    "curve": (400.0, 0.1),
    "curve_start": 0.0,
    "curve_transition": 30.0,
    "acceleration_limit": 80.0,
    "gauge_limit": 0.3,
}
PLAIN: dict[str, Any] = {"track_pool": 1, "episode_seconds": 0.3, "delay": (0.0, 0.1)}


def actions_of(lane: int, steps: int) -> np.ndarray:
    """Actions of one lane, the same in any batch; some leave the box."""
    rng = np.random.default_rng([99, lane])
    return rng.uniform(-1.2, 1.2, (steps, 4)).astype(np.float32)


def lane_of_single(settings: dict[str, Any], seed: int, lane: int, steps: int) -> list[Any]:
    """What a lane has to return with autoreset in the same step, from the single environment."""
    env = Full50Env(**settings)
    out: list[Any] = [env.reset(seed=seed + lane)]
    for action in actions_of(lane, steps):
        observation, reward, terminated, truncated, info = env.step(action)
        if terminated or truncated:
            out.append((observation, info))  # the final ones
            observation, info = env.reset()
        out.append((observation, reward, terminated, truncated, info))
    return out


def lanes_of_vector(
    settings: dict[str, Any], seed: int, number: int, steps: int, threads: int = 1
) -> list[list[Any]]:
    """The same of every lane of the vectorised environment."""
    env = Full50VectorEnv(number, autoreset_mode="same_step", threads=threads, **settings)
    actions = np.stack([actions_of(k, steps) for k in range(number)], axis=1)
    observation, info = env.reset(seed=seed)
    out: list[list[Any]] = [[(observation[k], of_lane(info, k))] for k in range(number)]
    for given in actions:
        observation, reward, terminated, truncated, info = env.step(given)
        for k in range(number):
            if terminated[k] or truncated[k]:
                out[k].append((info["final_obs"][k], of_lane(info["final_info"], k)))
            ends = (reward[k], terminated[k], truncated[k])
            out[k].append((observation[k], *ends, of_lane(info, k)))
    env.close()
    return out


def of_lane(info: dict[str, Any], lane: int) -> dict[str, Any]:
    """One lane's entries of an info, without those of other lanes."""
    plain = [name for name in info if not name.startswith(("_", "final"))]
    return {name: info[name][lane] for name in plain if info[f"_{name}"][lane]}


def bits(value: Any) -> Any:
    """What has to be equal: every bit of a number, the letters of a text."""
    if isinstance(value, dict):
        return {name: bits(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [bits(entry) for entry in value]
    array = np.asarray(value)
    if array.dtype == object:
        return "nothing" if value is None else [bits(entry) for entry in array]
    return str(array) if array.dtype.kind == "U" else (array.shape, array.tobytes())


def reasons(lane: list[Any]) -> set[str]:
    """By what the episodes of a lane have ended."""
    return {str(step[1]["ended_by"]) for step in lane[1:] if len(step) == 2}


def test_a_lane_is_the_single_environment_bit_for_bit() -> None:
    number, steps = 3, 130
    lanes = lanes_of_vector(RICH, 40, number, steps, threads=2)
    # the comparison is worth something only if episodes end in more ways than one
    assert set.union(*(reasons(lane) for lane in lanes)) >= {"derailment", ""}
    for k in (0, 2):
        assert bits(lanes[k]) == bits(lane_of_single(RICH, 40, k, steps))


@pytest.mark.slow
@pytest.mark.parametrize("settings", [RICH, {**PLAIN, "episode_seconds": 5.0}])
def test_a_lane_is_the_single_environment_bit_for_bit_over_2000_steps(settings: dict) -> None:
    lanes = lanes_of_vector(settings, 7, 4, 2000, threads=2)
    for k in range(4):
        assert bits(lanes[k]) == bits(lane_of_single(settings, 7, k, 2000))


def test_a_lane_depends_neither_on_the_lanes_beside_it_nor_on_threads() -> None:
    one, five = (lanes_of_vector(PLAIN, 11, n, 40, t) for n, t in ((1, 1), (5, 3)))
    assert bits(five[0]) == bits(one[0])
    assert bits(five[4]) != bits(five[0])


@pytest.mark.parametrize("mode", ["next_step", "same_step", "disabled"])
def test_a_derailed_lane_is_reset_as_the_mode_says(mode: str) -> None:
    settings = {
        "track": "flat",
        "curve": (300.0, 0.0),
        "curve_start": 0.0,
        "curve_transition": 20.0,
    }
    env = gym.make_vec(
        "railenv/Full50-v0",
        num_envs=2,
        vectorization_mode="vector_entry_point",
        autoreset_mode=mode,
        threads=2,
        **settings,
    )
    env.reset(seed=0)
    for _ in range(100):
        _, reward, terminated, _, info = env.step(np.zeros((2, 4)))
        if terminated.any():
            break
    final = info["final_info"] if mode == "same_step" else info
    assert final["ended_by"].tolist() == ["derailment"] * 2
    assert (reward < -10_000.0).all()
    if mode == "disabled":
        with pytest.raises(ArgumentError, match="lane 0 has ended"):
            env.step(np.zeros((2, 4)))
        env.reset(options={"reset_mask": np.ones(2, dtype=bool)})
    _, reward, terminated, _, info = env.step(np.zeros((2, 4)))
    assert not terminated.any()
    assert info["time"].tolist() == [0.0 if mode == "next_step" else 0.01] * 2
    env.close()


def test_a_checkpoint_goes_on_as_the_original_did() -> None:
    settings = {**RICH, "curve": None, "track": "tb3352", "vehicle_pool": 2}
    env = Full50VectorEnv(3, autoreset_mode="same_step", threads=2, **settings)
    env.reset(seed=1, options={"track_seed": [3, 4, 3]})
    actions = np.stack([actions_of(k, 150) for k in range(3)], axis=1)
    for given in actions[:20]:
        env.step(given)
    kept = pickle.loads(pickle.dumps(env.checkpoint()))
    expected = [env.step(given) for given in actions[20:100]]
    env.reset(seed=5)
    env.restore(kept)
    assert bits([env.step(given) for given in actions[20:100]]) == bits(expected)
    twin = Full50VectorEnv(3, autoreset_mode="same_step", **settings)
    twin.restore(kept)
    assert bits([twin.step(given) for given in actions[20:100]]) == bits(expected)


def test_a_checkpoint_of_other_settings_is_refused() -> None:
    env, other = Full50VectorEnv(1, **PLAIN), Full50VectorEnv(1, **PLAIN, friction=0.1)
    env.reset(seed=0)
    with pytest.raises(ArgumentError, match="other settings"):
        other.restore(env.checkpoint())


def test_a_pickled_batch_goes_on_as_the_original() -> None:
    env = Full50VectorEnv(2, threads=2, **PLAIN)
    env.reset(seed=1)
    env.step(np.ones((2, 4)))
    copy = pickle.loads(pickle.dumps(env))
    for _ in range(10):
        assert bits(copy.step(np.ones((2, 4)))) == bits(env.step(np.ones((2, 4))))
    env.close()
    copy.close()


def test_no_two_returned_arrays_share_memory() -> None:
    env = Full50VectorEnv(2, autoreset_mode="same_step", **{**PLAIN, "episode_seconds": 0.02})
    kept: list[np.ndarray] = []
    returned: Any = env.reset(seed=0)
    for _ in range(5):
        info = returned[-1]
        parts = [*returned[:-1], *info.values(), *info.get("final_info", {}).values()]
        arrays = [part for part in parts if isinstance(part, np.ndarray)]
        assert not any(np.shares_memory(a, b) for a in arrays for b in kept)
        kept += arrays
        returned = env.step(np.zeros((2, 4)))
