"""Gated policies: gates, laws of fixed gates, the module, and files."""

from pathlib import Path

import numpy as np
import pytest
import torch
from policy_examples import gated, played, small_readings

from baselines import SkyHook
from baselines.policies import GatedPolicy, LinearPolicy, load_trained, save_trained
from baselines.policies.torch_modules import module_of
from railenv.errors import ArgumentError


def settled(policy: GatedPolicy, told: float, periods: int = 400) -> None:
    """Leave a policy alone until its unit is at rest."""
    policy.reset(1, 0)
    policy.tell(np.array([told]))
    for _ in range(periods):
        policy.act(np.zeros((1, len(policy.measures))))


@pytest.mark.slow
def test_policy_and_module_say_the_same_for_two_hundred_steps() -> None:
    policy = gated(3)
    module = module_of(policy)
    told = torch.tensor([0.0, 0.1, 0.4], dtype=torch.float64)
    policy.reset(3, 0)
    hidden, rng = module.initial_hidden(3, told), np.random.default_rng(1)
    for _ in range(200):
        features = 3.0 * rng.normal(size=(3, policy.history.num_features))
        with torch.no_grad():
            wanted, hidden = module(torch.tensor(features), told, hidden)
        # Sums in another order, of a unit that forgets.
        np.testing.assert_allclose(
            policy._decide(features, told.numpy()), wanted.numpy(), atol=1e-12
        )
        np.testing.assert_allclose(policy.gates, module.log_gates.exp().numpy(), atol=1e-12)


def test_gates_are_shares_that_sum_to_one() -> None:
    policy = gated(2)
    played(policy, small_readings(policy, 20, 5, 1e3), np.linspace(0.0, 0.3, 5))
    assert policy.gates.shape == (5, 3)
    assert policy.gates.min() > 0.0
    # Three numbers, rounded.
    np.testing.assert_allclose(policy.gates.sum(axis=1), 1.0, atol=1e-15)
    assert np.ptp(policy.gates[:, 0]) > 1e-3


def test_gates_of_a_lane_do_not_depend_on_the_other_lanes() -> None:
    policy, told = gated(2), np.linspace(0.0, 0.3, 5)
    readings = small_readings(policy, 20, 5, 3.0)
    played(policy, readings, told)
    together = policy.gates.copy()
    for lane in range(5):
        played(policy, readings[:, [lane]], told[[lane]])
        np.testing.assert_array_equal(policy.gates[0], together[lane])


@pytest.mark.parametrize("told", [0.0, 0.13])
@pytest.mark.parametrize("expert", [0, 1, 2])
def test_law_of_one_gate_is_the_linear_policy_of_its_gains(expert: int, told: float) -> None:
    policy = gated(4, base=SkyHook(10e3, 4))
    gains = policy.weights + policy.experts[expert]
    plain = LinearPolicy(policy.history, gains, base=SkyHook(10e3, 4))
    readings = small_readings(policy, 40, 2, 0.1)
    laws = policy.law_with(np.eye(3)[expert], told), plain.law_at(told)
    for law in laws:
        law.reset(2, 0)
    for reading in readings:
        first, second = (
            law.act(reading[:, [policy.measures.index(name) for name in law.measures]])
            for law in laws
        )
        # Gains in units of the force: the same sums, rounded in another order.
        np.testing.assert_allclose(first, second, atol=1e-12)


@pytest.mark.slow
def test_law_at_rest_is_the_derivative_of_what_the_settled_policy_does() -> None:
    told, step = 0.08, 1e-5
    policy = gated(5, base=SkyHook(10e3, 4))
    law = policy.law_at(told)
    law.reset(1, 0)
    columns = [policy.measures.index(name) for name in law.measures]
    readings = small_readings(policy, 12, 1, 1.0)
    derivative = np.array([law.act(reading[:, columns]) for reading in readings])
    both = []
    for sign in (1.0, -1.0):
        settled(policy, told)
        both.append(np.array([policy.act(sign * step * reading) for reading in readings]))
    # Central difference: error of order step^2, rounding of order 1e-16 / step.
    np.testing.assert_allclose((both[0] - both[1]) / (2.0 * step), derivative, atol=1e-8)


def test_gates_at_rest_are_those_that_a_policy_left_alone_comes_to() -> None:
    policy = gated(6)
    settled(policy, 0.21)
    # What 400 periods of a unit that keeps about half of itself leave.
    np.testing.assert_allclose(policy.gates[0], policy.gates_at_rest(0.21), atol=1e-12)


def test_law_at_rest_is_the_law_with_the_gates_at_rest() -> None:
    policy = gated(6, told_knots=())
    laws = policy.law_at(), policy.law_with(policy.gates_at_rest())
    readings = small_readings(policy, 12, 1, 0.1)
    for law in laws:
        law.reset(1, 0)
    columns = [policy.measures.index(name) for name in laws[0].measures]
    for reading in readings:
        np.testing.assert_array_equal(*(law.act(reading[:, columns]) for law in laws))


@pytest.mark.parametrize(
    ("gates", "message"),
    [
        ([0.5, 0.5], r"gates has shape \(2,\)"),
        ([0.5, 0.6, -0.1], "zero or more"),
        ([0.5, 0.5, 0.5], "one in sum"),
        ([np.nan, 0.5, 0.5], "not finite"),
    ],
)
def test_gates_that_no_softmax_gives_are_refused(gates: list[float], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        gated().law_with(np.array(gates))


def test_gated_policy_comes_back_from_its_file_bit_for_bit(tmp_path: Path) -> None:
    policy = gated(7)
    save_trained(policy, tmp_path / "policy", {})
    again = load_trained(tmp_path / "policy")
    assert isinstance(again, GatedPolicy)
    readings, told = small_readings(policy, 20, 3, 1.0), np.array([0.0, 0.1, 0.3])
    np.testing.assert_array_equal(played(again, readings, told), played(policy, readings, told))
    np.testing.assert_array_equal(again.gates, policy.gates)
