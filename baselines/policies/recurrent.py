"""Recurrent policies: a linear path and a gated recurrent unit beside it.

The unit is that of Cho et al. (arXiv:1406.1078) in the form of `torch.nn.GRUCell`, with one change:
its candidate is counted from what it is at rest, so that rest is an equilibrium whatever biases
and told delay, and the state at rest is zero.

    r = sigmoid(W_r x + b_r + U_r h + c_r)
    z = sigmoid(W_z x + b_z + U_z h + c_z)
    n = tanh(W_n x + b_n + r (U_n h + c_n))
    h' = (1 - z) (n - n_rest) + z h,        n_rest = n at features and h zero
    a = sum_k hat_k(told) W_k x + R h'

The unit's x holds the features and, if the policy is told the delay, the told delay in units of
0.3 s. Its arrays are W = [W_r; W_z; W_n] (`weight_ih`), U (`weight_hh`), b (`bias_ih`) and
c (`bias_hh`).
"""

import math

import numpy as np
from numba import njit

from baselines.controller import Controller
from baselines.policies.elementwise import sigmoid, sigmoid_of, tanh
from baselines.policies.history import History
from baselines.policies.linear import linear_path
from baselines.policies.network import with_told
from baselines.policies.policy import HistoryPolicy, checked_array
from baselines.policies.realisation import Realisation, ring_form
from railenv.errors import ArgumentError
from railenv.units import FloatArray


class RecurrentPolicy(HistoryPolicy):
    """A gated recurrent unit beside a linear path.

    Args:
        history: What it sees, and what its actions mean.
        weights: Gains of the linear path, shape (knots, actions, F) [1].
        weight_ih: Shape (3 units, inputs), inputs the features and, if told, the told delay.
        weight_hh: Shape (3 units, units).
        bias_ih: Shape (3 units,).
        bias_hh: Shape (3 units,).
        readout: From units to actions, shape (actions, units).
        base: Classical law whose action is added before the cut.

    Attributes:
        arrays: Names of the unit's arrays.
        weight_ih, weight_hh, bias_ih, bias_hh, readout: As given, in double precision, read-only.

    Raises:
        ArgumentError: The arrays do not fit together, or a number is not finite.
    """

    arrays = ("weight_ih", "weight_hh", "bias_ih", "bias_hh", "readout")

    def __init__(
        self,
        history: History,
        weights: FloatArray,
        weight_ih: FloatArray,
        weight_hh: FloatArray,
        bias_ih: FloatArray,
        bias_hh: FloatArray,
        readout: FloatArray,
        base: Controller | None = None,
    ) -> None:
        super().__init__(history, weights, base)
        shape = np.shape(readout)
        if len(shape) != 2 or shape[1] == 0:
            raise ArgumentError(f"readout has shape {shape}; it must be (actions, units)")
        units, inputs = shape[1], history.num_features + int(history.is_told)
        self.readout = checked_array("readout", readout, (history.num_actions, units))
        self.weight_ih = checked_array("weight_ih", weight_ih, (3 * units, inputs))
        self.weight_hh = checked_array("weight_hh", weight_hh, (3 * units, units))
        self.bias_ih = checked_array("bias_ih", bias_ih, (3 * units,))
        self.bias_hh = checked_array("bias_hh", bias_hh, (3 * units,))
        self._hidden: FloatArray = np.zeros((0, units))

    def _begin(self, num_lanes: int) -> None:
        self._hidden = np.zeros((num_lanes, self.readout.shape[1]))

    def _decide(self, features: FloatArray, told: FloatArray) -> FloatArray:
        given = with_told(self.history, features, told)
        rest = with_told(self.history, np.zeros_like(features), told)
        actions = linear_path(self, features, told)
        _advance(
            self.weight_ih,
            self.weight_hh,
            self.bias_ih,
            self.bias_hh,
            self.readout,
            given,
            rest,
            self._hidden,
            actions,
        )
        return actions

    def _at_rest(self, told: float) -> Realisation:
        history, units = self.history, self.readout.shape[1]
        F = history.num_features
        x = with_told(history, np.zeros((1, F)), np.array([told]))[0]
        given, c = self.weight_ih @ x + self.bias_ih, self.bias_hh[2 * units :]
        both = sigmoid((given + self.bias_hh)[None, :])[0]
        reset, update = both[:units], both[units : 2 * units]
        new = tanh((given[2 * units :] + reset * c)[None, :])[0]
        # At rest n - n_rest and h vanish: what the update gate does is of second order.
        gain = ((1.0 - update) * (1.0 - new**2))[:, None]
        slope = (c * reset * (1.0 - reset))[:, None]
        W, U = self.weight_ih[:, :F], self.weight_hh
        entry = gain * (W[2 * units :] + slope * W[:units])
        transition = gain * (reset[:, None] * U[2 * units :] + slope * U[:units])
        return ring_form(
            history,
            self.gains_at(told),
            transition + np.diag(update),
            entry,
            np.array(self.readout),
        )


@njit(cache=True, nogil=True, error_model="numpy")
def _advance(
    weight_ih: FloatArray,
    weight_hh: FloatArray,
    bias_ih: FloatArray,
    bias_hh: FloatArray,
    readout: FloatArray,
    given: FloatArray,
    rest: FloatArray,
    hidden: FloatArray,
    actions: FloatArray,
) -> None:
    """Advance the unit of every lane and add what it says to the actions.

    Args:
        weight_ih: See `RecurrentPolicy`, as the next four.
        weight_hh: As above.
        bias_ih: As above.
        bias_hh: As above.
        readout: As above.
        given: The unit's inputs, shape (lanes, inputs).
        rest: Its inputs at rest, shape (lanes, inputs).
        hidden: Its state, shape (lanes, units); changed.
        actions: Shape (lanes, actions); changed.
    """
    units = hidden.shape[1]
    now, still, kept = np.empty(3 * units), np.empty(3 * units), np.empty(3 * units)
    for lane in range(len(given)):
        for row in range(3 * units):
            total, quiet, old = bias_ih[row], bias_ih[row], bias_hh[row]
            for column in range(given.shape[1]):
                total += weight_ih[row, column] * given[lane, column]
                quiet += weight_ih[row, column] * rest[lane, column]
            for column in range(units):
                old += weight_hh[row, column] * hidden[lane, column]
            now[row], still[row], kept[row] = total, quiet, old
        for u in range(units):
            reset = sigmoid_of(now[u] + kept[u])
            update = sigmoid_of(now[units + u] + kept[units + u])
            new = math.tanh(now[2 * units + u] + reset * kept[2 * units + u])
            reset = sigmoid_of(still[u] + bias_hh[u])
            at_rest = math.tanh(still[2 * units + u] + reset * bias_hh[2 * units + u])
            hidden[lane, u] = (1.0 - update) * (new - at_rest) + update * hidden[lane, u]
        for a in range(actions.shape[1]):
            total = 0.0
            for u in range(units):
                total += readout[a, u] * hidden[lane, u]
            actions[lane, a] += total
