"""Feed-forward policies: a linear path and a network of tanh layers beside it.

    a = sum_k hat_k(told) W_k x + n(x, told) - n(0, told)

The network sees the features and, if the policy is told the delay, the told delay in units of
0.3 s. What it says at rest is taken off, so that rest is an equilibrium whatever the biases.
"""

from collections.abc import Sequence

import numpy as np
from numba import njit

from baselines.controller import Controller
from baselines.policies.elementwise import tanh
from baselines.policies.history import History
from baselines.policies.linear import linear_path
from baselines.policies.policy import TOLD_UNIT, HistoryPolicy, checked_array
from baselines.policies.realisation import Realisation
from railenv.errors import ArgumentError, unknown_name
from railenv.units import FloatArray

ACTIVATIONS = ("tanh",)

_MOST_LAYERS = 16


class NetworkPolicy(HistoryPolicy):
    """A feed-forward network beside a linear path.

    Args:
        history: What it sees, and what its actions mean.
        weights: Gains of the linear path, shape (knots, actions, F) [1].
        layers: Weight, shape (rows, columns), and bias, shape (rows,), of each layer; the first
            takes the features and, if told, the told delay; the last gives the actions.
        activation: Between the layers; "tanh".
        base: Classical law whose action is added before the cut.

    Attributes:
        layers: As given, in double precision, read-only.
        activation: As given.

    Raises:
        ArgumentError: The layers do not fit together, or a number is not finite.
    """

    def __init__(
        self,
        history: History,
        weights: FloatArray,
        layers: Sequence[tuple[FloatArray, FloatArray]],
        activation: str = "tanh",
        base: Controller | None = None,
    ) -> None:
        super().__init__(history, weights, base)
        if activation not in ACTIVATIONS:
            raise unknown_name("activation", activation, ACTIVATIONS)
        self.activation = activation
        if not 1 <= len(layers) <= _MOST_LAYERS:
            raise ArgumentError(f"layers are {len(layers)}; give 1 to {_MOST_LAYERS}")
        columns = history.num_features + int(history.is_told)
        checked: list[tuple[FloatArray, FloatArray]] = []
        for k, (weight, bias) in enumerate(layers):
            rows = history.num_actions if k == len(layers) - 1 else len(bias)
            checked.append(
                (
                    checked_array(f"weight of layer {k}", weight, (rows, columns)),
                    checked_array(f"bias of layer {k}", bias, (rows,)),
                )
            )
            columns = rows
        self.layers = tuple(checked)

    def _decide(self, features: FloatArray, told: FloatArray) -> FloatArray:
        rest = self._network(np.zeros_like(features), told)
        return linear_path(self, features, told) + (self._network(features, told) - rest)

    def _network(self, features: FloatArray, told: FloatArray) -> FloatArray:
        values = with_told(self.history, features, told)
        for k, (weight, bias) in enumerate(self.layers):
            result = np.empty((len(values), len(bias)))
            layer_of_lanes(weight, bias, values, result)
            values = result if k == len(self.layers) - 1 else tanh(result)
        return values

    def _at_rest(self, told: float) -> Realisation:
        history = self.history
        values = with_told(history, np.zeros((1, history.num_features)), np.array([told]))[0]
        slope = np.eye(len(values))
        for k, (weight, bias) in enumerate(self.layers):
            values, slope = weight @ values + bias, weight @ slope
            if k < len(self.layers) - 1:
                values = tanh(values[None, :])[0]
                slope = (1.0 - values**2)[:, None] * slope
        return self._linear_at_rest(self.gains_at(told) + slope[:, : history.num_features])


def with_told(history: History, features: FloatArray, told: FloatArray) -> FloatArray:
    """Return what a network is given: the features and, if told, the delay in units of 0.3 s."""
    if not history.is_told:
        return np.ascontiguousarray(features)
    return np.concatenate([features, (told / TOLD_UNIT)[:, None]], axis=1)


@njit(cache=True, nogil=True, error_model="numpy")
def layer_of_lanes(
    weight: FloatArray,
    bias: FloatArray,
    values: FloatArray,
    result: FloatArray,
) -> None:
    """Compute weight @ values + bias for every lane, sums in a fixed order.

    Args:
        weight: Shape (rows, columns).
        bias: Shape (rows,).
        values: Shape (lanes, columns).
        result: Shape (lanes, rows); overwritten.
    """
    for lane in range(len(values)):
        for row in range(len(bias)):
            total = bias[row]
            for column in range(values.shape[1]):
                total += weight[row, column] * values[lane, column]
            result[lane, row] = total
