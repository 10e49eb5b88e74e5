"""Gated policies: gains that a recurrent unit mixes as the motion tells it.

    h' = GRU(x, h),    g = softmax(R h' + b),    a = sum_k hat_k(told) W_k x + sum_j g_j V_j x

A policy whose delay is hidden has to find it out, and what it needs then are other gains, not
another command on top: the unit (Cho et al., arXiv:1406.1078, in the form of `torch.nn.GRUCell`)
chooses between sets of gains V_j, a mixture of experts (Jacobs et al., Neural Computation 3, 1991).
Whatever the gates are, the action at rest is zero, and as long as they stand still the policy is
linear: the linearisation at rest is exact with the gates that belong to the unit's state at rest.
In motion the gates are others: `law_with(gates)` is the law of the gates that a drive settles in.
"""

import dataclasses

import numpy as np
from numba import njit

from baselines.controller import Controller
from baselines.linear_dynamic import LinearDynamic
from baselines.policies.elementwise import sigmoid, softmax, tanh
from baselines.policies.history import History
from baselines.policies.linear import LinearPolicy, linear_path
from baselines.policies.network import layer_of_lanes, with_told
from baselines.policies.policy import HistoryPolicy, checked_array
from baselines.policies.realisation import Realisation
from railenv.errors import ArgumentError
from railenv.units import FloatArray

_MOST_STEPS = 100_000
_SETTLED = 1e-13


class GatedPolicy(HistoryPolicy):
    """Sets of gains mixed by a gated recurrent unit, beside a linear path.

    Args:
        history: What it sees, and what its actions mean.
        weights: Gains of the linear path, shape (knots, actions, F) [1].
        experts: Gains that are mixed, shape (experts, actions, F) [1].
        weight_ih: Shape (3 units, inputs), inputs the features and, if told, the told delay.
        weight_hh: Shape (3 units, units).
        bias_ih: Shape (3 units,).
        bias_hh: Shape (3 units,).
        readout: From units to gates, shape (experts, units).
        readout_bias: Shape (experts,).
        base: Classical law whose action is added before the cut.

    Attributes:
        arrays: Names of the arrays beside `weights`.
        gates: The gates of the last step, shape (lanes, experts); each row sums to one.

    Raises:
        ArgumentError: The arrays do not fit together, or a number is not finite.
    """

    arrays = (
        "experts",
        "weight_ih",
        "weight_hh",
        "bias_ih",
        "bias_hh",
        "readout",
        "readout_bias",
    )

    def __init__(
        self,
        history: History,
        weights: FloatArray,
        experts: FloatArray,
        weight_ih: FloatArray,
        weight_hh: FloatArray,
        bias_ih: FloatArray,
        bias_hh: FloatArray,
        readout: FloatArray,
        readout_bias: FloatArray,
        base: Controller | None = None,
    ) -> None:
        super().__init__(history, weights, base)
        shape = np.shape(readout)
        if len(shape) != 2 or 0 in shape:
            raise ArgumentError(f"readout has shape {shape}; it must be (experts, units)")
        number, units = shape
        inputs = history.num_features + int(history.is_told)
        gains = (number, history.num_actions, history.num_features)
        self.experts = checked_array("experts", experts, gains)
        self.weight_ih = checked_array("weight_ih", weight_ih, (3 * units, inputs))
        self.weight_hh = checked_array("weight_hh", weight_hh, (3 * units, units))
        self.bias_ih = checked_array("bias_ih", bias_ih, (3 * units,))
        self.bias_hh = checked_array("bias_hh", bias_hh, (3 * units,))
        self.readout = checked_array("readout", readout, shape)
        self.readout_bias = checked_array("readout_bias", readout_bias, (number,))
        self._hidden: FloatArray = np.zeros((0, units))
        self.gates: FloatArray = np.zeros((0, number))

    def _begin(self, num_lanes: int) -> None:
        self._hidden = np.zeros((num_lanes, self.readout.shape[1]))
        self.gates = self._gates(self._hidden)

    def _decide(self, features: FloatArray, told: FloatArray) -> FloatArray:
        inputs = with_told(self.history, features, told)
        self._hidden = self._advanced(inputs, self._hidden)
        self.gates = self._gates(self._hidden)
        mixed = np.empty((len(features), self.history.num_actions))
        _mix(self.experts, self.gates, np.ascontiguousarray(features), mixed)
        return linear_path(self, features, told) + mixed

    def _advanced(self, inputs: FloatArray, hidden: FloatArray) -> FloatArray:
        """Return the unit's next state; see `torch.nn.GRUCell`."""
        units = hidden.shape[1]
        given, kept = (np.empty((len(inputs), 3 * units)) for _ in range(2))
        layer_of_lanes(self.weight_ih, self.bias_ih, inputs, given)
        layer_of_lanes(self.weight_hh, self.bias_hh, hidden, kept)
        reset = sigmoid(given[:, :units] + kept[:, :units])
        update = sigmoid(given[:, units : 2 * units] + kept[:, units : 2 * units])
        new = tanh(given[:, 2 * units :] + reset * kept[:, 2 * units :])
        return (1.0 - update) * new + update * hidden

    def _gates(self, hidden: FloatArray) -> FloatArray:
        logits = np.empty((len(hidden), len(self.readout)))
        layer_of_lanes(self.readout, self.readout_bias, hidden, logits)
        return softmax(logits)

    def gates_at_rest(self, told: float = 0.0) -> FloatArray:
        """Return the gates that belong to the unit's state at rest, shape (experts,).

        Args:
            told: Told delay [s].

        Raises:
            ArgumentError: The unit does not come to rest from zero while all features are zero.
        """
        features = np.zeros((1, self.history.num_features))
        inputs = with_told(self.history, features, np.array([told]))
        hidden = np.zeros((1, self.readout.shape[1]))
        for _ in range(_MOST_STEPS):
            after = self._advanced(inputs, hidden)
            if np.abs(after - hidden).max() <= _SETTLED:
                return self._gates(after)[0]
            hidden = after
        raise ArgumentError(
            f"the recurrent unit does not come to rest within {_MOST_STEPS} steps while all "
            "features are zero, so that there is no law at rest; judge it by simulation"
        )

    def law_with(self, gates: FloatArray, told: float = 0.0) -> LinearDynamic:
        """Return the linear law that the policy is as long as its gates stand still.

        Exact inside the box for those gates; the base is included. Nothing is said of gates that
        move: a loop may grow whose every law of fixed gates decays.

        Args:
            gates: Shape (experts,), zero or more each, one in sum [1].
            told: Told delay [s].

        Raises:
            ArgumentError: The gates have the wrong shape, or are none that a softmax gives.
        """
        shares = checked_array("gates", gates, (len(self.experts),))
        # Means over lanes and periods of what sums to one but for rounding.
        if shares.min() < 0.0 or abs(shares.sum() - 1.0) > 1e-9:
            raise ArgumentError(
                f"gates = {shares.tolist()} must be zero or more each and one in sum; "
                "give the attribute gates of a lane, or a mean of such"
            )
        seen = dataclasses.replace(self.history, told_knots=())
        return LinearPolicy(seen, self._mixed(shares, told)[None], self.base).law_at()

    def _mixed(self, gates: FloatArray, told: float) -> FloatArray:
        """Return the gains of fixed gates, the linear path's included, shape (actions, F) [1]."""
        return self.gains_at(told) + np.tensordot(gates, self.experts, axes=1)

    def _at_rest(self, told: float) -> Realisation:
        return self._linear_at_rest(self._mixed(self.gates_at_rest(told), told))


@njit(cache=True, nogil=True, error_model="numpy")
def _mix(experts: FloatArray, gates: FloatArray, features: FloatArray, actions: FloatArray) -> None:
    # Sums in a fixed order per lane: a lane does not depend on how many there are.
    for lane in range(len(features)):
        for a in range(actions.shape[1]):
            total = 0.0
            for j in range(len(experts)):
                own = 0.0
                for f in range(features.shape[1]):
                    own += experts[j, a, f] * features[lane, f]
                total += gates[lane, j] * own
            actions[lane, a] = total
