"""Policies as ONNX models: one step, for a controller that has neither Python nor this package.

Inputs `features` (lanes, F), `told` (lanes,) [s] and `hidden` (lanes, units; the state at rest is
zero), outputs `action` (lanes, actions), cut to [-1, 1], and `next_hidden`; all in double
precision. The caller keeps readings and actions of the past: `railenv_history`, a JSON text in the
model's metadata, holds the fields of `baselines.policies.history.History` and the features' names.

A model is compared with the policy before it is written, step by step with onnxruntime.
"""

from pathlib import Path

import numpy as np

from baselines.policies.base_law import BaseLaw
from baselines.policies.gated import GatedPolicy
from baselines.policies.history import History
from baselines.policies.network import NetworkPolicy
from baselines.policies.onnx_graph import Graph, imported
from baselines.policies.policy import TOLD_UNIT, HistoryPolicy
from baselines.policies.recurrent import RecurrentPolicy
from railenv.config import to_dict
from railenv.errors import ArgumentError, OutputError
from railenv.files import replacing
from railenv.units import FloatArray

_CHECKED_STEPS = 100
_CHECKED_LANES = 4

LARGEST_DIFFERENCE = 1e-9
"""Largest difference of an action between the model and the policy."""


def export_onnx(policy: HistoryPolicy, path: str | Path) -> float:
    """Write a policy as an ONNX model, if it acts as the policy does.

    Args:
        policy: Any trained policy; a base must be static.
        path: The file; it must end in .onnx.

    Returns:
        Largest difference of an action over 100 random steps.

    Raises:
        ArgumentError: The policy cannot be exported, or onnx or onnxruntime is missing.
        OutputError: The model does not act as the policy, or the file cannot be written.
    """
    place = Path(path)
    if place.suffix != ".onnx":
        raise ArgumentError(f"path = {str(place)!r} must end in .onnx")
    content = onnx_model(policy)
    difference = onnx_difference(policy, content)
    # The opposite of <=, so that a number that is none is a difference.
    if not difference <= LARGEST_DIFFERENCE:
        raise OutputError(
            f"{place} is not written: the ONNX model's actions differ from the policy's by "
            f"{difference:.3g}, more than {LARGEST_DIFFERENCE:g}"
        )
    with replacing(place) as stream:
        stream.write(content)
    return difference


def onnx_difference(policy: HistoryPolicy, content: bytes, seed: int = 0) -> float:
    """Return how far a model's actions and states are from the policy's over 100 random steps.

    Args:
        policy: The policy.
        content: The model.
        seed: Seed of features and told delays.

    Raises:
        ArgumentError: onnxruntime is missing.
    """
    runtime = imported("onnxruntime")
    session = runtime.InferenceSession(content, providers=["CPUExecutionProvider"])
    history, rng = policy.history, np.random.default_rng(seed)
    told = rng.uniform(0.0, 1.2 * max(history.told_knots, default=0.3), _CHECKED_LANES)
    fixed = _fixed_weights(policy)
    policy.reset(_CHECKED_LANES, 0)
    hidden = np.zeros((_CHECKED_LANES, _num_hidden(policy)))
    largest = 0.0
    for _ in range(_CHECKED_STEPS):
        features = rng.normal(size=(_CHECKED_LANES, history.num_features))
        features *= 10.0 ** rng.uniform(-3.0, 1.0, (_CHECKED_LANES, 1))
        given = {"features": features, "told": told, "hidden": hidden}
        action, hidden = session.run(["action", "next_hidden"], given)
        own = policy._decide(features, told)
        if fixed is not None:
            own = own + features @ fixed.T
        own = np.clip(own, -1.0, 1.0)
        largest = max(largest, _difference(action, own))
        if isinstance(policy, RecurrentPolicy | GatedPolicy):
            largest = max(largest, _difference(hidden, policy._hidden))
    policy.reset(1, 0)
    return largest


def _difference(values: FloatArray, others: FloatArray) -> float:
    if values.shape != others.shape or not np.all(np.isfinite(values)):
        return float("inf")
    return float(np.abs(values - others).max(initial=0.0))


def onnx_model(policy: HistoryPolicy) -> bytes:
    """Return the content of a policy's ONNX model.

    Raises:
        ArgumentError: The policy has a base with states, or readings of a base that are no
            features, or onnx is missing.
    """
    graph = Graph(imported("onnx"))
    history = policy.history
    action = _linear_path(graph, history, policy.weights)
    fixed = _fixed_weights(policy)
    if fixed is not None:
        action = graph.add("Add", action, graph.times("features", fixed))
    after = graph.add("Identity", "hidden")
    if isinstance(policy, NetworkPolicy):
        beside = [_network(graph, policy, _inputs(graph, history, rest)) for rest in (False, True)]
        action = graph.add("Add", action, graph.add("Sub", *beside))
    elif isinstance(policy, RecurrentPolicy):
        rest = _inputs(graph, history, True)
        after = _unit(graph, policy, _inputs(graph, history, False), rest)
        action = graph.add("Add", action, graph.times(after, policy.readout))
    elif isinstance(policy, GatedPolicy):
        after = _unit(graph, policy, _inputs(graph, history, False), None)
        logits = graph.add(
            "Add", graph.times(after, policy.readout), graph.keep(policy.readout_bias)
        )
        gates = graph.add("Softmax", logits, axis=1)
        action = graph.add("Add", action, _mixed(graph, policy.experts, gates))
    ends = graph.keep(np.array(-1.0)), graph.keep(np.array(1.0))
    graph.add("Clip", action, *ends, output="action")
    graph.add("Identity", after, output="next_hidden")
    about = {**to_dict(history), "feature_names": list(history.feature_names)}
    return graph.model(history.num_features, history.num_actions, _num_hidden(policy), about)


def _linear_path(graph: Graph, history: History, weights: FloatArray) -> str:
    """Return the name of the linear path's action: knots weighted by hats of the told delay."""
    if history.num_knots == 1:
        return graph.times("features", weights[0])
    knots = np.array(history.told_knots)
    # hat = min(rise, fall) between 0 and 1; the first has no rise and the last no fall.
    gaps = np.diff(knots)
    rise, fall = np.concatenate([[0.0], 1.0 / gaps]), np.concatenate([-1.0 / gaps, [0.0]])
    rise_from = np.concatenate([[1.0], -knots[:-1] / gaps])
    fall_from = np.concatenate([knots[1:] / gaps, [1.0]])
    told = graph.add("Unsqueeze", "told", graph.keep(np.array([1], dtype=np.int64)))
    lines = [
        graph.add("Add", graph.add("Mul", told, graph.keep(slope)), graph.keep(start))
        for slope, start in ((rise, rise_from), (fall, fall_from))
    ]
    ends = graph.keep(np.array(0.0)), graph.keep(np.array(1.0))
    return _mixed(graph, weights, graph.add("Clip", graph.add("Min", *lines), *ends))


def _mixed(graph: Graph, weights: FloatArray, shares: str) -> str:
    """Return the name of the sum over sets of gains, each with its share."""
    sets, actions, features = weights.shape
    each = graph.times("features", weights.reshape(sets * actions, features))
    shape = graph.keep(np.array([-1, sets, actions], dtype=np.int64))
    axis = graph.keep(np.array([2], dtype=np.int64))
    weighted = graph.add(
        "Mul", graph.add("Reshape", each, shape), graph.add("Unsqueeze", shares, axis)
    )
    sum_over = graph.keep(np.array([1], dtype=np.int64))
    return graph.add("ReduceSum", weighted, sum_over, keepdims=0)


def _inputs(graph: Graph, history: History, rest: bool) -> str:
    """Return the name of a network's inputs, with all features zero if at rest."""
    features = "features"
    if rest:
        features = graph.add("Mul", "features", graph.keep(np.array(0.0)))
    if not history.is_told:
        return features
    told = graph.add("Unsqueeze", "told", graph.keep(np.array([1], dtype=np.int64)))
    scaled = graph.add("Div", told, graph.keep(np.array(TOLD_UNIT)))
    return graph.add("Concat", features, scaled, axis=1)


def _network(graph: Graph, policy: NetworkPolicy, inputs: str) -> str:
    for k, (weight, bias) in enumerate(policy.layers):
        inputs = graph.add("Add", graph.times(inputs, weight), graph.keep(np.array(bias)))
        if k < len(policy.layers) - 1:
            inputs = graph.add("Tanh", inputs)
    return inputs


def _unit(
    graph: Graph, policy: RecurrentPolicy | GatedPolicy, inputs: str, rest: str | None
) -> str:
    """Return the name of a gated recurrent unit's next state; see `RecurrentPolicy`."""
    units = policy.weight_hh.shape[1]
    b, c = graph.keep(np.array(policy.bias_ih)), graph.keep(np.array(policy.bias_hh))
    given = graph.add("Add", graph.times(inputs, policy.weight_ih), b)
    kept = graph.add("Add", graph.times("hidden", policy.weight_hh), c)

    def part(value: str, k: int) -> str:
        return graph.columns(value, k * units, (k + 1) * units)

    def first_axis_part(k: int) -> str:
        return graph.keep(np.array(policy.bias_hh[k * units : (k + 1) * units]))

    def sigmoid(value: str) -> str:
        half = graph.keep(np.array(0.5))
        return graph.add(
            "Add", graph.add("Mul", graph.add("Tanh", graph.add("Mul", value, half)), half), half
        )

    def candidate(x: str, h_reset: str, h_new: str) -> str:
        reset = sigmoid(graph.add("Add", part(x, 0), h_reset))
        return graph.add("Tanh", graph.add("Add", part(x, 2), graph.add("Mul", reset, h_new)))

    update = sigmoid(graph.add("Add", part(given, 1), part(kept, 1)))
    new = candidate(given, part(kept, 0), part(kept, 2))
    if rest is not None:
        still = graph.add("Add", graph.times(rest, policy.weight_ih), b)
        new = graph.add("Sub", new, candidate(still, first_axis_part(0), first_axis_part(2)))
    one = graph.keep(np.array(1.0))
    fresh = graph.add("Mul", graph.add("Sub", one, update), new)
    return graph.add("Add", fresh, graph.add("Mul", update, "hidden"))


def _num_hidden(policy: HistoryPolicy) -> int:
    if isinstance(policy, RecurrentPolicy | GatedPolicy):
        return policy.readout.shape[1]
    return 0


def _fixed_weights(policy: HistoryPolicy) -> FloatArray | None:
    """Return the base as gains of the features; None without a base."""
    if policy.base is None:
        return None
    fixed = BaseLaw(policy.base, policy.history).static_weights()
    if fixed is None:
        raise ArgumentError(
            f"base {type(policy.base).__name__} has states or reads what is no feature, and one "
            "step does not hold it; export a policy with a static base or none"
        )
    return fixed
