"""Policies as torch modules and as ONNX models: the same numbers three times."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from policy_examples import MAKERS, VEHICLE, history, linear

from baselines import SkyHook, make_controller
from baselines.policies import HistoryPolicy, LinearPolicy
from baselines.policies.onnx_export import export_onnx, onnx_difference, onnx_model
from baselines.policies.torch_modules import (
    LinearModule,
    NetworkModule,
    RecurrentModule,
    module_of,
    policy_of,
)
from eval.rollout import ControlledBatch, Stepping
from railenv.envs.observation import sensor_names
from railenv.errors import ArgumentError, OutputError
from railenv.track import make_track


@pytest.mark.slow
@pytest.mark.parametrize("make", MAKERS)
@pytest.mark.parametrize("fields", [{}, {"told_knots": ()}])
def test_policy_and_module_are_one_over_a_closed_loop_with_tell_and_cut(
    make: Any, fields: dict[str, Any]
) -> None:
    policy: HistoryPolicy = make(1, base=SkyHook(10e3, 4), **fields)
    seen, lanes, steps = policy.history, 4, 300
    module = module_of(make(1, base=SkyHook(10e3, 4), **fields))
    delays = np.repeat(np.array([[0.0], [0.07], [0.2], [0.3]]), 4, axis=1)
    told = torch.tensor(delays[:, 0])
    track = make_track("tb3352", VEHICLE.speed * 3.0, 1)
    batch = ControlledBatch(policy, VEHICLE, sensor_names("4"), Stepping())
    # Thirty times the usual track, so that actions are cut.
    batch.reset(delays, [track], level=np.full(lanes, 30.0))
    depth, past = seen.sensor_lags[-1], seen.action_lags[-1]
    readings = [np.zeros((lanes, 16))] * depth
    actions = [np.zeros((lanes, 2))] * past
    hidden, cut = module.initial_hidden(lanes, told), False
    for _ in range(steps):
        readings.append(batch._now / np.array(seen.scales))
        parts = [readings[-1 - age] for age in seen.sensor_lags]
        parts += [actions[-age] for age in seen.action_lags]
        with torch.no_grad():
            wanted, hidden = module(torch.tensor(np.hstack(parts)), told, hidden)
        cut = cut or bool((wanted.abs() > 1.0).any())
        actions.append(wanted.clamp(-1.0, 1.0).numpy())
        batch.advance()
        np.testing.assert_allclose(batch.commands[:, ::2] / 3000.0, actions[-1], atol=1e-12)
    assert cut


@pytest.mark.parametrize("make", MAKERS)
def test_a_policy_through_a_module_and_back_is_bitwise_itself(make: Any) -> None:
    policy = make(2, base=SkyHook(10e3, 4))
    again = policy_of(module_of(policy))
    rng = np.random.default_rng(0)
    for each in (policy, again):
        each.reset(3, 0)
        each.tell(np.array([0.0, 0.1, 0.25]))
    for _ in range(10):
        readings = 0.01 * rng.normal(size=(3, 16))
        np.testing.assert_array_equal(policy.act(readings), again.act(readings))


@pytest.mark.slow
@pytest.mark.parametrize(
    "make", [LinearModule, NetworkModule, RecurrentModule], ids=lambda make: make.__name__
)
def test_a_new_module_begins_with_the_base_alone_and_learns_all_of_itself(make: Any) -> None:
    module = make(history(), base=SkyHook(10e3, 4), seed=3, dtype=torch.float64)
    features = torch.randn((5, module.history.num_features), dtype=torch.float64)
    told = torch.linspace(0.0, 0.4, 5, dtype=torch.float64)
    actions, hidden = module(features, told)
    base = torch.zeros_like(actions)
    for sensor in range(4):
        name = f"carbody_lateral_velocity_{sensor + 1}"
        column = module.history.feature_names.index(name)
        # Sky-hook 10 kN s/m, the mean of a bogie's two forces, in units of 3 kN.
        share = -10e3 * module.history.scales[column] / 3000.0 / 2.0
        base[:, sensor // 2] += share * features[:, column]
    torch.testing.assert_close(actions.detach(), base, atol=1e-14, rtol=0.0)
    same = make(history(), base=SkyHook(10e3, 4), seed=3, dtype=torch.float64)
    other = make(history(), base=SkyHook(10e3, 4), seed=4, dtype=torch.float64)
    pairs = zip(module.parameters(), same.parameters(), strict=True)
    assert all(torch.equal(a, b) for a, b in pairs)
    if make is not LinearModule:
        pairs = zip(module.parameters(), other.parameters(), strict=True)
        assert not all(torch.equal(a, b) for a, b in pairs)
    # After one step of the readout every weight has a gradient.
    for _ in range(2):
        actions, hidden = module(features, told, hidden.detach())
        module.zero_grad()
        (actions**2).sum().backward()
        with torch.no_grad():
            for parameter in module.parameters():
                parameter -= 0.01 * parameter.grad
    moved = [p.grad.abs().max() > 0.0 for n, p in module.named_parameters() if n != "layers.2.bias"]
    assert all(moved)  # the last bias of a network is taken off again


def test_a_module_of_single_precision_is_the_policys_to_its_rounding() -> None:
    policy = linear()
    module = module_of(policy, torch.float32)
    features = np.random.default_rng(0).normal(size=(6, policy.history.num_features))
    told = np.linspace(0.0, 0.35, 6)
    own = policy._decide(features, told)
    single, _ = module(torch.tensor(features, dtype=torch.float32), torch.tensor(told).float())
    np.testing.assert_allclose(single.detach().numpy(), own, atol=1e-5)


def test_a_base_that_cannot_be_trained_upon_is_refused() -> None:
    with pytest.raises(ArgumentError, match="has states"):
        LinearModule(history(), base=make_controller("lqg"))
    narrow = history(sensors=("carbody_roll_rate",))
    with pytest.raises(ArgumentError, match="no sensor of the history"):
        LinearModule(narrow, base=SkyHook(10e3, 4))
    with pytest.raises(ArgumentError, match="no linear law"):
        LinearPolicy(history(), linear().weights, make_controller("semiactive-skyhook"))


@pytest.mark.slow
@pytest.mark.parametrize("make", MAKERS)
@pytest.mark.parametrize("fields", [{}, {"told_knots": ()}])
def test_the_onnx_model_acts_as_the_policy(
    make: Any, fields: dict[str, Any], tmp_path: Path
) -> None:
    policy = make(4, base=SkyHook(10e3, 4), **fields)
    assert export_onnx(policy, tmp_path / "policy.onnx") < 1e-12
    import onnx

    model = onnx.load(tmp_path / "policy.onnx")
    (entry,) = [each for each in model.metadata_props if each.key == "railenv_history"]
    about = json.loads(entry.value)
    assert tuple(about["feature_names"]) == policy.history.feature_names


@pytest.mark.parametrize("make", MAKERS)
def test_an_onnx_model_with_one_wrong_weight_leaves_no_file(
    make: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import onnx
    from onnx import numpy_helper

    policy = make(4)
    model = onnx.load_from_string(onnx_model(policy))
    constants = model.graph.initializer
    place = next(k for k, each in enumerate(constants) if policy.weights.size == np.prod(each.dims))
    values = numpy_helper.to_array(constants[place]).copy()
    values.flat[7] += 1e-4
    constants[place].CopyFrom(numpy_helper.from_array(values, constants[place].name))
    wrong = model.SerializeToString()
    assert onnx_difference(policy, wrong) > 1e-6
    monkeypatch.setattr("baselines.policies.onnx_export.onnx_model", lambda _: wrong)
    with pytest.raises(OutputError, match="differ from the policy's"):
        export_onnx(policy, tmp_path / "policy.onnx")
    assert list(tmp_path.iterdir()) == []


def test_what_cannot_be_exported_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match=r"must end in \.onnx"):
        export_onnx(linear(), tmp_path / "policy.bin")
    dynamic = linear(base=make_controller("lqg"))
    with pytest.raises(ArgumentError, match="has states"):
        export_onnx(dynamic, tmp_path / "policy.onnx")
