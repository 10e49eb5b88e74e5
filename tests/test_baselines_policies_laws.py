"""Policies as laws: lanes, the law at rest, the loop that the oracle is given, the environment."""

import numpy as np
import pytest
import torch
from policy_examples import (
    MAKERS,
    PERIOD,
    TOLD,
    VEHICLE,
    linear,
    network,
    played,
    recurrent,
    small_readings,
)

from baselines import SkyHook
from baselines.linear_dynamic import LinearDynamic
from baselines.policies.realisation import gains_by_age
from baselines.policies.torch_modules import module_of
from eval.rollout import ControlledBatch, Stepping
from eval.stability_answers import is_sampled_only
from railenv.actuation import ActuatorSpec
from railenv.envs.observation import sensor_names
from railenv.envs.rail_vector_env import Lateral17VectorEnv
from railenv.errors import ArgumentError
from railenv.stability import SampledLoop
from railenv.stability.loops import LinearSystem
from railenv.track import make_track
from railenv.vehicle import lateral17, state_space


@pytest.mark.parametrize("make", MAKERS)
def test_a_lane_is_bitwise_the_same_in_any_batch(make: type) -> None:
    policy = make(base=SkyHook(10e3, 4))
    told = np.random.default_rng(1).uniform(0.0, 0.35, 37)
    readings = small_readings(policy, 25, 37, 3.0)
    together = played(policy, readings, told)
    for lane in (0, 5, 36):
        alone = played(policy, readings[:, [lane]], told[[lane]])
        np.testing.assert_array_equal(alone[:, 0], together[:, lane])
    few = played(policy, readings[:, 30:], told[30:])
    np.testing.assert_array_equal(few, together[:, 30:])


@pytest.mark.parametrize("make", MAKERS)
@pytest.mark.parametrize("told", [0.0, 0.13])
def test_rest_is_an_equilibrium_of_every_policy(make: type, told: float) -> None:
    policy = make()
    actions = played(policy, np.zeros((30, 1, len(policy.measures))), np.array([told]))
    np.testing.assert_array_equal(actions, 0.0)


@pytest.mark.parametrize(
    "fields", [{}, {"told_knots": ()}, {"action": "each"}, {"action_lags": ()}]
)
def test_the_law_at_rest_of_a_linear_policy_plays_the_same(fields: dict[str, object]) -> None:
    policy = linear(base=SkyHook(10e3, 4), **fields)
    readings = small_readings(policy, 40, 3, 0.1)
    actions = played(policy, readings, np.full(3, 0.06))
    law = policy.law_at(0.06)
    law.reset(3, 0)
    columns = [policy.measures.index(name) for name in law.measures]
    same = np.array([law.act(reading[:, columns]) for reading in readings])
    assert np.abs(actions).max() < 1.0  # the cut is outside the law
    # Partial sums in another order, over 40 steps of a law with actions of order 0.3.
    np.testing.assert_allclose(actions, same, atol=1e-13)


# A gated policy's unit starts beside its rest and takes a while to come there.
@pytest.mark.parametrize("make", [linear, network, recurrent])
def test_the_law_at_rest_is_the_derivative_of_what_is_played(make: type) -> None:
    policy = make(base=SkyHook(10e3, 4))
    readings = small_readings(policy, 12, 1, 1.0)
    law = policy.law_at(0.08)
    law.reset(1, 0)
    columns = [policy.measures.index(name) for name in law.measures]
    derivative = np.array([law.act(reading[:, columns]) for reading in readings])
    step, told = 1e-5, np.array([0.08])
    ahead, back = (played(policy, sign * step * readings, told) for sign in (1.0, -1.0))
    # Central difference: error of order step^2, rounding of order 1e-16 / step.
    np.testing.assert_allclose((ahead - back) / (2.0 * step), derivative, atol=1e-8)


@pytest.mark.parametrize("make", MAKERS)
def test_a_residual_policy_is_the_sum_of_both_before_the_cut(make: type) -> None:
    base = SkyHook(500e3, 4)  # beyond the box now and then
    alone, both = make(action_lags=()), make(base=base, action_lags=())
    readings, told = small_readings(alone, 20, 4, 0.3), np.array([0.0, 0.1, 0.2, 0.4])
    own = played(alone, readings, told)
    assert np.abs(own).max() < 1.0
    base.reset(4, 0)
    force = np.array([base.act(reading) * base.action_scale for reading in readings]) / 3000.0
    mean = np.repeat((force[..., ::2] + force[..., 1::2]) / 2.0, 2, axis=2)
    assert np.abs(own + mean).max() > 1.0
    np.testing.assert_allclose(
        played(both, readings, told), np.clip(own + mean, -1.0, 1.0), atol=1e-14
    )


def test_a_dynamic_base_keeps_its_states_beside_the_policys() -> None:
    names = ("carbody_roll_rate", "suspension_stroke_1")
    rng = np.random.default_rng(4)
    matrices = (
        -np.diag([3.0, 20.0]),
        rng.normal(size=(2, 2)),
        1e4 * rng.normal(size=(4, 2)),
        1e3 * rng.normal(size=(4, 2)),
    )
    base = LinearDynamic(matrices, names, 4)
    policy = linear(base=base, told_knots=())
    readings = small_readings(policy, 60, 2, 0.1)
    readings[0] = 0.0  # a continuous law takes its first reading for one that has just changed
    actions = played(policy, readings, np.zeros(2))
    law = policy.law_at()
    law.reset(2, 0)
    columns = [policy.measures.index(name) for name in law.measures]
    same = np.array([law.act(reading[:, columns]) for reading in readings])
    assert 1e-3 < np.abs(actions).max() < 1.0
    np.testing.assert_allclose(actions, same, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("action", ["each", "bogies"])
def test_the_loop_of_the_oracle_is_that_of_the_readings_kept_as_they_are(action: str) -> None:
    policy = linear(action=action)
    seen = policy.history
    loop = policy.to_sampled_loop(VEHICLE, PERIOD)
    system = state_space(VEHICLE)
    C, D = system.output_rows(policy.sensors)
    spread = np.repeat(np.eye(seen.num_actions), seen.share, axis=0)
    scale = policy.action_scale
    by_age = [gains_by_age(seen, gains) for gains in policy.weights]
    measured = np.array([-scale * spread @ G for G, _ in by_age])
    # What is remembered of the commands is one actuator's of each action.
    first = spread.T / seen.share / scale
    commanded = np.array([-scale * spread @ F @ first for _, F in by_age])
    ring = SampledLoop.from_feedback(
        system.A, system.actuator_input, C, D[:, :4], PERIOD, measured, commanded, TOLD
    )
    for delay, told in ((0.0, 0.0), (0.034, 0.034), (0.12, 0.1), (0.25, 0.27)):
        small, large = loop.growth_rate(delay, told), ring.growth_rate(delay, told)
        # Eigenvalues of 150 and 260 states; growth rates are ln|z| / 0.01 s.
        assert small == pytest.approx(large, abs=1e-6)
        at = policy.law_at(told).to_sampled_loop(VEHICLE, PERIOD).growth_rate(delay)
        assert at == pytest.approx(large, abs=1e-6)
    assert loop.Ac.shape[-1] < ring.Ac.shape[-1] / 1.5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "fields"),
    [(linear, {}), (recurrent, {}), (network, {"told_knots": ()}), (linear, {"layout": 2})],
)
def test_the_growth_rate_of_the_oracle_is_that_of_a_long_simulation(
    make: type, fields: dict[str, object]
) -> None:
    policy = make(3, **fields)  # its modes are well apart
    vehicle = lateral17("paper_fit", policy.layout, 300.0)
    delay = 0.123
    rate = policy.law_at(delay).to_sampled_loop(vehicle, PERIOD).growth_rate(delay)
    stepping = Stepping(actuator=ActuatorSpec(force_limit=None))
    names = state_space(vehicle).states
    batch = ControlledBatch(policy, vehicle, names, stepping)
    # What is left of a network's action at rest is rounding, 1e-17: start and end far above it.
    start = 1e-12 * np.random.default_rng(2).normal(size=(1, len(names)))
    batch.reset(np.full((1, vehicle.num_actuators), delay), initial_state=start)
    steps = min(3000, int(16.0 / abs(rate) / PERIOD))
    sizes = np.array([np.linalg.norm(batch.advance()[0, -1]) for _ in range(steps)])
    half = steps // 2
    # The faster modes have died out by half time; the phase of the mode that is left moves the
    # norm within a period, which a fit over many of them averages out.
    slope = np.polyfit(PERIOD * np.arange(half, steps), np.log(sizes[half:]), 1)[0]
    assert slope == pytest.approx(rate, abs=0.02, rel=0.005)


@pytest.mark.slow
@pytest.mark.parametrize("make", [linear, network])
def test_a_policy_acts_in_a_rollout_as_through_the_environment(make: type) -> None:
    policy = make(sensor_lags=(0, 1, 4), action_lags=(1, 5))
    seen, lanes, steps = policy.history, 3, 300
    env = Lateral17VectorEnv(lanes, delay=(0.0, 0.3), **seen.environment())
    told = np.array([0.0, 0.123, 0.25])
    given = {"track_seed": np.array([3, 4, 5]), "delay": told}
    observation, _ = env.reset(seed=4, options=given)
    columns = seen.columns(env.observation_names)
    told_column = seen.told_columns(env.observation_names)
    np.testing.assert_allclose(observation[:, told_column[0]] * 0.3, told, rtol=1e-6)
    tracks = [make_track("tb3352", VEHICLE.speed * 20.0, seed) for seed in (3, 4, 5)]
    batch = ControlledBatch(policy, VEHICLE, sensor_names("4"), Stepping())
    batch.reset(np.repeat(told[:, None], 4, axis=1), tracks, np.arange(3))
    module = module_of(make(sensor_lags=(0, 1, 4), action_lags=(1, 5)))
    hidden, largest = None, 0.0
    for _ in range(steps):
        features = torch.tensor(observation[:, columns].astype(float))
        with torch.no_grad():
            wanted, hidden = module(features, torch.tensor(told), hidden)
        actions = wanted.clamp(-1.0, 1.0).numpy().astype(np.float32)
        observation, *_ = env.step(actions)
        shown = batch.advance()[:, -1] / np.array(seen.scales)
        largest = max(largest, float(np.abs(shown).max()))
        # The environment rounds what is seen and asked for to float32, 6e-8 of the reading; the
        # loop is stable or grows slowly.
        np.testing.assert_allclose(shown, observation[:, :16], atol=2e-5, rtol=2e-6)
        np.testing.assert_allclose(batch.commands[:, ::2] / 3000.0, actions, atol=2e-6)
    assert largest > 0.1


def test_the_oracle_takes_a_told_linear_policy_as_a_sampled_schedule() -> None:
    policy = linear()
    assert is_sampled_only(policy)
    loop = policy.to_sampled_loop(VEHICLE, PERIOD)
    assert loop.told is not None
    np.testing.assert_array_equal(loop.told, TOLD)
    law = policy.law_at(0.05)
    assert isinstance(law, LinearDynamic)
    assert isinstance(law.law, LinearSystem)
    assert len(law.law.A) == 2 * 4  # actions times the oldest age


def test_a_told_policy_that_is_not_linear_names_the_law_at_one_told_delay() -> None:
    with pytest.raises(ArgumentError, match=r"law_at\(told\)"):
        network().to_sampled_loop(VEHICLE, PERIOD)
    hidden = network(told_knots=())
    assert hidden.to_sampled_loop(VEHICLE, PERIOD).told is None
