"""Training of gated policies: the loss of the gates, rates of learning, and what is refused."""

from typing import Any

import numpy as np
import pytest

from railenv.errors import ArgumentError

torch = pytest.importorskip("torch")

from baselines.policies.torch_modules import policy_of  # noqa: E402
from baselines.training.apg import AnalyticPolicyGradient  # noqa: E402
from baselines.training.new_module import module_arrays  # noqa: E402
from baselines.training.settings import TrainingSettings, settings_from  # noqa: E402

SMALL = {"lanes": 4, "window": 12, "windows_per_episode": 2}
GATED = {"class": "gated", "hidden": [3], "told_knots": [], "experts": [0.0, 0.1, 0.3]}
LINEAR = {"class": "linear", "told_knots": [0.0, 0.3]}


def settings(
    method: dict[str, Any] | None = None,
    policy: dict[str, Any] = GATED,
    delay: Any = (0.0, 0.3),
    name: str = "apg",
) -> TrainingSettings:
    """Return settings of a small run."""
    environment = {"track": "german_low", "track_pool": 2, "sensor_noise": 0.1}
    small = SMALL if name == "apg" else {}
    return settings_from(
        {
            "description": "test",
            "seed": 1,
            "steps": 1000,
            "environment": {**environment, "start": "controlled", "delay": delay},
            "policy": {"sensor_lags": [0, 2], "action_lags": [1, 4], **policy},
            "method": {"name": name, **small, **(method or {})},
        },
        "test",
    )


def same(one: AnalyticPolicyGradient, other: AnalyticPolicyGradient) -> bool:
    first, second = one.state(), other.state()
    return first[1] == second[1] and all(
        np.array_equal(first[0][name], second[0][name]) for name in first[0]
    )


@pytest.mark.slow
def test_restored_gated_method_goes_on_bit_for_bit() -> None:
    hyper = {"averaging": 0.5, "gate_weight": 2.0, "unit_rate": 0.5}
    undisturbed, resumed = (AnalyticPolicyGradient(settings(hyper), 1) for _ in range(2))
    undisturbed.update()
    arrays, plain = undisturbed.state()
    undisturbed.update()
    resumed.restore(arrays, plain)
    resumed.update()
    assert same(resumed, undisturbed)


@pytest.mark.slow
def test_cross_entropy_moves_the_gates_towards_the_gains_of_the_true_delay() -> None:
    # Delay and sets of gains are such that the third one alone is right in every lane.
    hyper = {"gate_weight": 1e4, "learning_rate": 1e-2, "windows_per_episode": 1}
    method = AnalyticPolicyGradient(settings(hyper, delay=0.3), 1)
    before = method.update()
    numbers = [method.update() for _ in range(5)]
    assert numbers[-1]["gate_entropy"] < before["gate_entropy"]
    assert numbers[-1]["delay_error"] < before["delay_error"]
    assert float(method._module.log_gates.argmax(dim=1).float().min()) == 2.0


def test_cross_entropy_is_least_at_the_gates_of_the_true_delay() -> None:
    method = AnalyticPolicyGradient(settings({"gate_weight": 1.0}), 1, torch.float64)
    loss = method._gates
    loss.begin(np.array([0.0, 0.025, 0.2]), np.ones(3))
    loss._age = 99
    wanted = torch.tensor([[1.0, 0.0, 0.0], [0.75, 0.25, 0.0], [0.0, 0.5, 0.5]])
    share = wanted.double().clamp(min=1e-300).requires_grad_()
    method._module.log_gates = share.log()
    value = loss.of_period()
    entropy = -(0.75 * np.log(0.75) + 0.25 * np.log(0.25) + np.log(0.5)) / 3.0
    assert float(value.detach()) == pytest.approx(entropy, rel=1e-12)
    assert loss.delay_error() == pytest.approx(0.0, abs=1e-12)
    # On the simplex a minimum: the slope is the same for all gates that are not zero.
    (slope,) = torch.autograd.grad(value, share)
    assert float(slope[1, 0]) == pytest.approx(float(slope[1, 1]), rel=1e-12)
    assert float(slope[2, 1]) == pytest.approx(float(slope[2, 2]), rel=1e-12)


def test_first_half_window_of_an_episode_says_nothing_of_the_gates() -> None:
    run = settings({"gate_weight": 1.0})
    loss = AnalyticPolicyGradient(run, 1)._gates
    loss.begin(np.full(4, 0.2), np.ones(4))
    loss._module.log_gates = torch.log(torch.full((4, 3), 1.0 / 3.0))
    seen = [float(loss.of_period()) for _ in range(2 * SMALL["window"])]
    assert seen[: SMALL["window"] // 2] == [0.0] * (SMALL["window"] // 2)
    # Single precision.
    assert seen[SMALL["window"] // 2 :] == pytest.approx([np.log(3.0)] * 18, rel=1e-6)


def test_quiet_lanes_are_taught_the_gains_for_rest() -> None:
    policy = {**GATED, "rest_expert": True}
    run = settings({"gate_weight": 1.0, "quietest": 0.01}, policy)
    method = AnalyticPolicyGradient(run, 1, torch.float64)
    loss = method._gates
    # Amplitudes of all, a tenth, a hundredth: nothing, half and all of the set for rest.
    loss.begin(np.full(3, 0.05), np.array([1.0, 0.1, 0.01]))
    loss._age = 99
    expected = [[0.5, 0.5, 0.0, 0.0], [0.25, 0.25, 0.0, 0.5], [0.0, 0.0, 0.0, 1.0]]
    share = torch.tensor(expected, dtype=torch.float64).clamp(min=1e-300).requires_grad_()
    method._module.log_gates = share.log()
    value = loss.of_period()
    assert float(value.detach()) == pytest.approx((3.0 * np.log(2.0) - 0.5 * np.log(2.0)) / 3.0)
    # What the loud lane's gates say of its delay, the set for rest left out.
    assert loss.delay_error() == pytest.approx(0.0, abs=1e-12)
    at_rest = policy_of(method._module).gates_at_rest()
    assert float(loss.at_rest().detach()) == pytest.approx(-np.log(at_rest[-1]), rel=1e-9)


def test_without_a_set_for_rest_nothing_is_said_of_rest() -> None:
    loss = AnalyticPolicyGradient(settings({"gate_weight": 1.0}), 1)._gates
    assert float(loss.at_rest()) == 0.0


@pytest.mark.slow
def test_unit_rate_slows_the_unit_and_not_the_gains() -> None:
    moved = {}
    for share in (1.0, 0.25):
        hyper = {"unit_rate": share, "windows_per_episode": 1, "gradient_norm": 1e9}
        method = AnalyticPolicyGradient(settings(hyper), 1)
        generator = torch.Generator().manual_seed(0)
        with torch.no_grad():
            method._module.experts.normal_(std=0.02, generator=generator)
        start = module_arrays(method._module)
        method.update()
        after = module_arrays(method._module)
        moved[share] = {name: after[name] - start[name] for name in start}
    np.testing.assert_array_equal(moved[0.25]["experts"], moved[1.0]["experts"])
    # The first step of Adam is its rate; single precision of weights of order one.
    np.testing.assert_allclose(
        moved[0.25]["readout"], 0.25 * moved[1.0]["readout"], rtol=1e-3, atol=2e-7
    )
    assert np.abs(moved[1.0]["readout"]).max() > 1e-3


@pytest.mark.parametrize(
    ("method", "policy", "message"),
    [
        ({"gate_weight": 1.0}, LINEAR, "gate_weight = 1 is for class = 'gated'"),
        ({"imitation_rounds": 1}, GATED, "imitation_rounds give a linear path"),
    ],
)
def test_what_does_not_go_with_the_class_is_refused(
    method: dict[str, Any], policy: dict[str, Any], message: str
) -> None:
    with pytest.raises(ArgumentError, match=message):
        AnalyticPolicyGradient(settings(method, policy), 1)


@pytest.mark.parametrize(
    ("policy", "message"),
    [
        ({**GATED, "experts": []}, "experts = .. does not fit class = 'gated'"),
        ({**LINEAR, "experts": [0.0]}, "experts = .0.0. does not fit class = 'linear'"),
        ({**LINEAR, "rest_expert": True}, "rest_expert = true does not fit class = 'linear'"),
        ({**GATED, "experts": [0.1, 0.2]}, "must rise from 0"),
        ({**GATED, "experts": [0.0, 0.2, 0.2]}, "must rise from 0"),
        ({**GATED, "hidden": [3, 3]}, "one recurrent unit"),
        ({**GATED, "hidden": []}, "does not fit class = 'gated'"),
    ],
)
def test_gated_policy_is_described_whole_or_refused(policy: dict[str, Any], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        settings(policy=policy)


def test_method_that_cannot_train_gates_is_refused() -> None:
    with pytest.raises(ArgumentError, match="'ppo' does not train class = 'gated'"):
        settings(name="ppo")
