"""The differentiable twin: the environment's numbers, and gradients that are true."""

from typing import Any

import numpy as np
import pytest

from railenv.actuation import DelaySpec
from railenv.envs.observation import bound, sensor_names
from railenv.envs.rail_vector_env import Lateral17VectorEnv
from railenv.envs.reward import RECORDED
from railenv.errors import ArgumentError
from railenv.vehicle import lateral17, state_space

torch = pytest.importorskip("torch")

from baselines.twin import DifferentiableTwin  # noqa: E402 (torch may be missing)

LANES = 5
CASES: dict[str, dict[str, Any]] = {
    "a delay of its own for every channel": {
        "delay": (0.0, 0.25),
        "delay_per_channel": True,
        "sensor_delay": (0.0, 0.05),
    },
    "delays of whole steps": {"delay": DelaySpec((0.0, 0.005, 0.02, 0.0123), sensor_delay=0.05)},
    "three vehicles, histories, told delays": {
        "delay": (0.0, 0.2),
        "delay_per_channel": True,
        "delay_observed": True,
        "told_error": 0.02,
        "vehicle_ranges": "narrow",
        "vehicle_pool": 3,
        "observation_history": 2,
        "action_history": 5,
        "track_level": (0.5, 2.0),
    },
    "three vehicles, lag": {
        "delay": (0.0, 0.2),
        "actuator_lag": 0.015,
        "vehicle_ranges": "narrow",
        "vehicle_pool": 3,
        "action": "bogies",
        "action_scale": 1000.0,
    },
    "start under control": {
        "delay": (0.0, 0.1),
        "start": "controlled",
        "track": ("german_low", "tb3352"),
        "delay_observed": True,
    },
    "two actuators, states, rate limit": {
        "layout": 2,
        "delay": (0.0, 0.2),
        "observation": "state",
        "observation_scale": "si",
        "action_scale": 40e3,
        "rate_limit": 1e6,
        "gauge_limit": 1.0,
    },
    # Far beyond what a vehicle does, so that limit and caps are met and no lane ends.
    "force limit and caps, other steps": {
        "delay": (0.0, 0.1),
        "action_scale": 40e3,
        "gauge_limit": 100.0,
        "acceleration_limit": 1e4,
        "control_period": 0.02,
        "time_step": 0.004,
        "action": "bogies",
    },
}


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


def random_actions(periods: int, num_actions: int, seed: int = 1, lanes: int = LANES) -> np.ndarray:
    """Actions of which some lie outside the box."""
    size = (periods, lanes, num_actions)
    return np.random.default_rng(seed).uniform(-1.1, 1.1, size)


def exact_columns(env: Lateral17VectorEnv) -> np.ndarray:
    """The environment's newest measurement before it is rounded to float32."""
    batch, names = env._lanes._batch, env._lanes.episodes.measured
    scales = env._lanes.scales[: len(names)]
    limits = np.array([bound(name)[0] for name in names]) / scales
    return np.clip(batch.sampled[:, : len(names)] / scales, -limits, limits)


@pytest.mark.parametrize("case", CASES)
def test_twin_and_environment_have_the_same_numbers(case: str) -> None:
    env = Lateral17VectorEnv(LANES, "disabled", **CASES[case])
    twin = DifferentiableTwin(LANES, **CASES[case])
    assert twin.observation_names == env.observation_names
    first, _ = env.reset(seed=11)
    # float32 against float64; beyond one the rounding grows with the number
    np.testing.assert_allclose(twin.reset(seed=11), first, rtol=1.2e-7, atol=1.2e-7)
    for actions in random_actions(320, twin.num_actions):
        rounded, reward, ended, _, there = env.step(actions)
        observation, value, info = twin.step(torch.from_numpy(actions))
        exact = exact_columns(env)
        columns = exact.shape[1]
        # 1e-9 is the promise; two ways of exact stepping differ by rounding, 1e-11 at most
        np.testing.assert_allclose(observation[:, :columns], exact, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(observation, rounded, rtol=1.2e-7, atol=1.2e-7)
        np.testing.assert_allclose(value, reward, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(info["force"], there["force"], rtol=1e-9, atol=1e-7)
        for name in ("comfort", "effort", "stroke", "divergence"):
            np.testing.assert_allclose(info[name], there[f"reward_{name}"], rtol=1e-9, atol=1e-9)
        assert not ended.any()


def test_the_case_of_limits_meets_force_limit_and_cap() -> None:
    twin = DifferentiableTwin(LANES, **CASES["force limit and caps, other steps"])
    twin.reset(seed=11)
    seen = [twin.step(torch.from_numpy(a))[2] for a in random_actions(320, 2)]
    assert any((info["force"].abs() == 30e3).any() for info in seen)
    assert any((info["comfort"] == -5.0).any() for info in seen)
    assert any((info["stroke"] == -0.05).any() for info in seen)


def test_readings_beyond_their_bounds_are_cut_as_in_the_environment() -> None:
    settings = {"action_scale": 30e3, "gauge_limit": 1e3, "acceleration_limit": 1e4, "layout": 2}
    env, twin = Lateral17VectorEnv(1, "disabled", **settings), DifferentiableTwin(1, **settings)
    seen, _ = env.reset(seed=0)
    twin.reset(seed=0)
    cut = 0
    for _ in range(600):
        # pushed the way it moves, the carbody swings up
        actions = np.sign(seen[:, :2]).astype(np.float64)
        seen, _, _, _, info = env.step(actions)
        observation, _, _ = twin.step(torch.from_numpy(actions))
        exact = exact_columns(env)
        np.testing.assert_allclose(observation[:, : exact.shape[1]], exact, rtol=1e-9, atol=1e-9)
        cut += int(info["observation_clipped"][0])
    assert cut > 10


def test_a_second_episode_goes_on_with_the_same_random_streams() -> None:
    settings = {"delay": (0.0, 0.3), "delay_observed": True}
    env, twin = Lateral17VectorEnv(3, **settings), DifferentiableTwin(3, **settings)
    env.reset(seed=4)
    first = twin.reset(seed=4)
    _, there = env.reset()
    second = twin.reset()
    assert np.array_equal(twin.delay, there["delay"])
    assert not torch.equal(first, second)


@pytest.mark.parametrize("limit", [{"gauge_limit": 0.02}, {"acceleration_limit": 0.5}])
def test_a_lane_that_ends_pays_once_and_is_frozen(limit: dict[str, float]) -> None:
    settings = {**limit, "delay": 0.03, "action_scale": 5e3, "action": "bogies"}
    env, twin = Lateral17VectorEnv(2, "disabled", **settings), DifferentiableTwin(2, **settings)
    env.reset(seed=0)
    twin.reset(seed=0)
    # The first lane is pushed aside, the second is left alone.
    push = torch.tensor([[1.0, 1.0], [0.0, 0.0]], dtype=torch.float64)
    for _ in range(200):
        _, reward, ended, _, _ = env.step(push.numpy())
        last, value, info = twin.step(push)
        # the penalty is 5060 with the default of 20 s: more than 1e-9 of it is no rounding
        np.testing.assert_allclose(value, reward, rtol=1e-9)
        assert np.array_equal(info["ended"], ended)
        if ended.any():
            break
    assert ended.tolist() == [True, False]
    assert info["divergence"].tolist() == [-twin.settings.penalty(), 0.0]
    state = twin._state[0].clone()
    more = torch.zeros(2, 2, dtype=torch.float64, requires_grad=True)
    total = torch.zeros((), dtype=torch.float64)
    for _ in range(20):
        after, value, info = twin.step(more)
        assert torch.equal(after[0], last[0])
        assert value[0] == 0.0
        assert info["force"][0].abs().max() == 0.0
        total = total + value.sum() + after.sum()
    # an unstable vehicle would go on growing without end
    assert torch.equal(twin._state[0], state)
    total.backward()
    assert torch.equal(more.grad[0], torch.zeros(2, dtype=torch.float64))
    assert more.grad[1].abs().min() > 0.0


def test_what_a_caller_writes_into_an_observation_changes_nothing() -> None:
    twin = DifferentiableTwin(1)
    twin.reset(seed=0).fill_(7.0)
    twin.detach().fill_(7.0)
    assert twin.detach().abs().max() < 1.0


def test_single_precision_stays_near() -> None:
    settings = {"delay": (0.0, 0.2), "layout": 2, "track": "german_low"}
    twin = DifferentiableTwin(4, **settings)
    single = DifferentiableTwin(4, dtype=torch.float32, **settings)
    twin.reset(seed=3)
    single.reset(seed=3)
    for actions in torch.from_numpy(random_actions(400, 2, lanes=4)):
        exact, reward, _ = twin.step(actions)
        near, value, _ = single.step(actions.float())
        # as measured over 20 s and said in the docstring
        assert (exact - near).abs().max() < 3e-4
        assert (reward - value).abs().max() < 1e-4
    assert near.dtype == value.dtype == torch.float32


def test_no_output_in_use_reads_the_rates_of_the_track() -> None:
    for layout in (2, 4):
        system = state_space(lateral17("paper_fit", layout, 300.0))
        _, D = system.output_rows((*RECORDED, *sensor_names(str(layout)), *system.states))
        assert not D[:, system.num_actuators + 8 :].any()


@pytest.mark.parametrize("name", ["jitter", "dropout", "sensor_dropout"])
def test_delays_that_vary_within_an_episode_are_refused(name: str) -> None:
    with pytest.raises(ArgumentError, match=rf"^{name} = 0\.01 is not supported by the twin"):
        DifferentiableTwin(1, **{name: 0.01})


def test_bad_actions_and_untimely_steps_are_refused() -> None:
    with pytest.raises(ArgumentError, match=r"dtype = torch\.float16 must be"):
        DifferentiableTwin(1, dtype=torch.float16)
    with pytest.raises(ArgumentError, match="unknown environment setting 'dealy'"):
        DifferentiableTwin(1, dealy=0.1)
    twin = DifferentiableTwin(2, episode_seconds=0.01)
    good = torch.zeros(2, 4, dtype=torch.float64)
    with pytest.raises(ArgumentError, match="call reset first"):
        twin.step(good)
    with pytest.raises(ArgumentError, match="call reset first"):
        twin.detach()
    twin.reset(seed=0)
    with pytest.raises(ArgumentError, match=r"actions of shape \(2, 3\)"):
        twin.step(good[:, :3])
    with pytest.raises(ArgumentError, match=r"type torch\.float32 must be"):
        twin.step(good.float())
    with pytest.raises(ArgumentError, match="not finite"):
        twin.step(good * torch.nan)
    twin.step(good)
    with pytest.raises(ArgumentError, match=r"the episodes of 0\.01 s are over"):
        twin.step(good)
