"""Noise of the sensors: its size, its whiteness, whose it is, and what it leaves alone."""

import pickle
from typing import Any

import numpy as np
import pytest
from scipy.stats import kstest

from railenv.envs.full_env import Full50Env, Full50VectorEnv
from railenv.envs.full_observation import bound_of
from railenv.envs.noise import AHEAD
from railenv.envs.observation import bound
from railenv.envs.rail_env import Lateral17Env
from railenv.envs.rail_vector_env import Lateral17VectorEnv

SHARE = 0.1
# A vehicle at rest on a flat track shows zero everywhere: what is read is the noise.
STILL: dict[str, Any] = {"track": "flat", "action_history": 0, "sensor_noise": SHARE}
SIGMAS = 5.0
"""Statistics may be off by so many of their own standard deviations; all seeds are fixed."""


def still(lanes: int, steps: int, seed: int = 0, **settings: Any) -> np.ndarray:
    """Readings of vehicles at rest, shape (steps + 1, lanes, columns)."""
    env = Lateral17VectorEnv(lanes, **{**STILL, **settings})
    seen = [env.reset(seed=seed)[0]]
    actions = np.zeros(env.action_space.shape)
    seen += [env.step(actions)[0] for _ in range(steps)]
    return np.array(seen, dtype=np.float64)


@pytest.fixture(scope="module")
def noise() -> np.ndarray:
    """Noise in units of its standard deviation, shape (measurements, lanes, columns)."""
    return still(16, 1000) / SHARE


@pytest.mark.parametrize("observation", ["sensors", "state"])
@pytest.mark.parametrize("scale", ["controlled", "si"])
def test_every_column_has_its_share_of_the_controlled_response(
    observation: str, scale: str
) -> None:
    settings = {"observation": observation, "observation_scale": scale}
    names = Lateral17Env(**STILL, **settings).observation_names
    usual = np.array([bound(name)[2] if scale == "si" else 1.0 for name in names])
    found = still(32, 300, **settings).reshape(-1, len(names))
    ratio = (found**2).mean(axis=0) / (SHARE * usual) ** 2
    # times n it is chi-square of n degrees of freedom: its standard deviation is sqrt(2 / n)
    assert np.abs(ratio - 1.0).max() < SIGMAS * np.sqrt(2.0 / len(found))


def test_the_noise_is_gaussian_with_mean_zero(noise: np.ndarray) -> None:
    assert kstest(noise.ravel(), "norm").pvalue > 1e-6
    means = noise.mean(axis=(0, 1))
    assert np.abs(means).max() < SIGMAS / np.sqrt(noise[..., 0].size)


# Around the length of a block, where a repeated one would show.
@pytest.mark.parametrize("lag", [1, 2, AHEAD - 1, AHEAD, AHEAD + 1, 2 * AHEAD])
def test_the_noise_is_white(noise: np.ndarray, lag: int) -> None:
    products = noise[lag:] * noise[:-lag]
    correlation = products.mean(axis=(0, 1))
    # a mean of independent products of variance one
    assert np.abs(correlation).max() < SIGMAS / np.sqrt(products[..., 0].size)


def test_columns_are_independent(noise: np.ndarray) -> None:
    samples = noise.reshape(-1, noise.shape[-1])
    apart = samples.T @ samples / len(samples) - np.diag((samples**2).mean(axis=0))
    assert np.abs(apart).max() < SIGMAS / np.sqrt(len(samples))


@pytest.mark.parametrize("lag", [0, 1])
def test_lanes_are_independent(noise: np.ndarray, lag: int) -> None:
    samples = noise.transpose(1, 0, 2)
    later, earlier = samples[:, lag:], samples[:, : samples.shape[1] - lag]
    count = later[0].size
    correlation = later.reshape(len(samples), -1) @ earlier.reshape(len(samples), -1).T / count
    apart = correlation - np.diag(np.diag(correlation))
    assert np.abs(apart).max() < SIGMAS / np.sqrt(count)


def test_episodes_and_seeds_have_noise_of_their_own() -> None:
    env = Lateral17Env(**STILL)
    first, second = env.reset(seed=0)[0], env.reset()[0]
    other, again = env.reset(seed=1)[0], env.reset(seed=0)[0]
    assert np.any(first)
    assert len({seen.tobytes() for seen in (first, second, other)}) == 3
    assert again.tobytes() == first.tobytes()


RICH: dict[str, Any] = {
    "delay": (0.0, 0.2),
    "jitter": 0.02,
    "sensor_dropout": 0.2,
    "sensor_noise": 0.3,
    "observation_history": 1,
    "track_pool": 2,
    "episode_seconds": 0.9,
}


def actions_of(lane: int, steps: int) -> np.ndarray:
    return np.random.default_rng([5, lane]).uniform(-1, 1, (steps, 4)).astype(np.float32)


def lanes_of(env: Any, steps: int, seed: int | None = 3) -> list[np.ndarray]:
    """Observations of some steps; with a seed, of a run from its reset on."""
    seen = [] if seed is None else [env.reset(seed=seed)[0]]
    actions = np.stack([actions_of(k, steps) for k in range(env.num_envs)], axis=1)
    return seen + [env.step(given)[0] for given in actions]


@pytest.mark.parametrize("nonlinear", [False, True])
def test_a_lane_with_noise_is_the_single_environment_bit_for_bit(nonlinear: bool) -> None:
    single, vector = (
        (Full50Env, Full50VectorEnv) if nonlinear else (Lateral17Env, Lateral17VectorEnv)
    )
    steps = AHEAD + 40  # past a block and past an end
    many = vector(3, autoreset_mode="same_step", threads=2, **RICH)
    batch = lanes_of(many, steps)
    many.close()
    for lane in (0, 2):
        env = single(**RICH)
        seen = [env.reset(seed=3 + lane)[0]]
        for action in actions_of(lane, steps):
            observation, _, terminated, truncated, _ = env.step(action)
            seen.append(env.reset()[0] if terminated or truncated else observation)
        for mine, theirs in zip(seen, batch, strict=True):
            assert mine.tobytes() == theirs[lane].tobytes()


def test_a_lane_does_not_depend_on_the_number_of_lanes() -> None:
    few, many = (lanes_of(Lateral17VectorEnv(n, **RICH), 120) for n in (2, 70))
    for mine, theirs in zip(few, many, strict=True):
        # compared in the lanes that got the same actions, which are all of the smaller batch
        assert mine.tobytes() == theirs[:2].tobytes()


@pytest.mark.parametrize("before", [AHEAD - 2, AHEAD - 1, AHEAD])
def test_copies_and_checkpoints_go_on_with_the_same_noise(before: int) -> None:
    env, fresh = (Lateral17VectorEnv(3, **RICH) for _ in "ab")
    lanes_of(env, before)
    copy = pickle.loads(pickle.dumps(env))
    fresh.restore(env.checkpoint())
    ours = lanes_of(env, 100, seed=None)
    for other in (copy, fresh):
        for mine, theirs in zip(ours, lanes_of(other, 100, seed=None), strict=True):
            assert mine.tobytes() == theirs.tobytes()


def both(**settings: Any) -> tuple[list[Any], list[Any]]:
    """Steps of the same run with noise and without; it draws after all that makes an episode."""
    runs: list[list[Any]] = []
    for share in (SHARE, 0.0):
        env = Lateral17Env(sensor_noise=share, delay=(0.0, 0.2), **settings)
        env.reset(seed=8)
        runs.append([env.step(action) for action in actions_of(0, 150)])
    return runs[0], runs[1]


def test_reward_and_info_are_those_of_the_true_motion() -> None:
    for noisy, true in zip(*both(), strict=True):
        assert noisy[1:4] == true[1:4]
        for name, value in true[4].items():
            assert np.array_equal(noisy[4][name], value), name


def test_past_actions_and_told_delays_have_no_noise() -> None:
    for noisy, true in zip(*both(delay_observed=True), strict=True):
        assert np.all(noisy[0][:16] != true[0][:16])
        np.testing.assert_array_equal(noisy[0][16:], true[0][16:])


def test_the_noise_is_added_to_the_true_reading() -> None:
    noisy, true = both(track="german_low")
    added = np.array(
        [a[0][:16].astype(float) - b[0][:16] for a, b in zip(noisy, true, strict=True)]
    )
    # 150 measurements of 16 columns, whatever the vehicle does meanwhile
    assert abs((added**2).mean() / SHARE**2 - 1.0) < SIGMAS * np.sqrt(2.0 / added.size)


def test_the_history_holds_what_was_measured() -> None:
    seen = still(1, 80, observation_history=2)[:, 0]
    np.testing.assert_array_equal(seen[2:, 16:32], seen[1:-1, :16])
    np.testing.assert_array_equal(seen[2:, 32:], seen[:-2, :16])


def test_a_lost_measurement_leaves_the_last_one_with_its_noise() -> None:
    seen = still(1, 400, sensor_dropout=0.4)[:, 0]
    same = seen[1:] == seen[:-1]
    assert np.array_equal(same.all(axis=1), same.any(axis=1))
    # 400 draws of probability 0.4, five standard deviations of 9.8
    assert abs(same.all(axis=1).sum() - 160) < 49


def test_a_reading_that_noise_takes_beyond_its_bound_is_cut_and_flagged() -> None:
    env = Lateral17Env(**{**STILL, "sensor_noise": 200.0})
    env.reset(seed=0)
    flags = []
    for _ in range(50):
        observation, _, _, _, info = env.step(np.zeros(4))
        assert env.observation_space.contains(observation)
        assert info["observation_clipped"] == np.any(
            np.abs(observation) == env.observation_space.high
        )
        flags.append(info["observation_clipped"])
    assert any(flags)


def test_without_noise_no_number_is_drawn_for_it() -> None:
    env = Lateral17Env(sensor_noise=0.0)
    env.reset(seed=12)
    expected = np.random.default_rng(12)
    # what an episode takes: six numbers, a delay per channel, the sensors' delay
    expected.random(6 + 4 + 1)
    for _ in range(2 * AHEAD):
        env.step(np.zeros(4))
    assert env.np_random.bit_generator.state == expected.bit_generator.state


@pytest.mark.parametrize("observation", ["sensors", "state"])
def test_the_nonlinear_vehicle_has_its_own_columns_noise(observation: str) -> None:
    settings: dict[str, Any] = {"track_pool": 1, "observation": observation, "action_history": 0}
    readings = []
    for share in (SHARE, 0.0):
        env = Full50VectorEnv(4, sensor_noise=share, observation_scale="si", **settings)
        readings.append([env.reset(seed=1)[0]])
        readings[-1] += [env.step(np.zeros((4, 4)))[0] for _ in range(60)]
    usual = np.array([bound_of(name)[2] for name in env.observation_names])
    added = (np.array(readings[0], dtype=float) - np.array(readings[1])) / (SHARE * usual)
    # 61 measurements of 4 lanes; a vehicle's own height is known to float32 only, far below noise
    squares = (added**2).mean(axis=(0, 1))
    assert np.abs(squares - 1.0).max() < SIGMAS * np.sqrt(2.0 / (61 * 4))


def test_the_twin_has_the_environments_noise_number_by_number() -> None:
    torch = pytest.importorskip("torch")
    from baselines.twin import DifferentiableTwin

    settings = {**RICH, "jitter": 0.0, "sensor_dropout": 0.0, "episode_seconds": 2.0}
    env, twin = Lateral17VectorEnv(3, **settings), DifferentiableTwin(3, **settings)
    # float32 against float64; beyond one the rounding grows with the number
    near = {"rtol": 1.2e-7, "atol": 1.2e-7}
    np.testing.assert_allclose(twin.reset(seed=4), env.reset(seed=4)[0], **near)
    for k in range(2 * AHEAD + 10):
        actions = np.random.default_rng(k).uniform(-0.2, 0.2, (3, 4))
        observation, *_ = twin.step(torch.from_numpy(actions))
        np.testing.assert_allclose(observation, env.step(actions)[0], **near)
