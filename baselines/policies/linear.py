"""Linear policies: gains of the features, interpolated in the told delay."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from baselines.policies.policy import HistoryPolicy
from baselines.policies.realisation import Realisation
from railenv.units import FloatArray


class LinearPolicy(HistoryPolicy):
    """The linear policy a = sum_k hat_k(told) W_k x.

    See `HistoryPolicy` for arguments and attributes.
    """

    is_linear = True

    def _decide(self, features: FloatArray, told: FloatArray) -> FloatArray:
        return linear_path(self, features, told)

    def _at_rest(self, told: float) -> Realisation:
        return self._linear_at_rest(self.gains_at(told))


def linear_path(policy: HistoryPolicy, features: FloatArray, told: FloatArray) -> FloatArray:
    """Return the action of the linear path, shape (lanes, actions), a new array.

    Args:
        policy: Gives gains and knots.
        features: Shape (lanes, F).
        told: Told delay, shape (lanes,) [s].
    """
    lower, share = policy.history.place(told)
    actions = np.empty((len(features), policy.history.num_actions))
    _apply(policy.weights, lower, share, features, actions)
    return actions


@njit(cache=True, nogil=True, error_model="numpy")
def _apply(
    weights: FloatArray,
    lower: NDArray[np.int64],
    share: FloatArray,
    features: FloatArray,
    actions: FloatArray,
) -> None:
    # Sums in a fixed order per lane: a lane does not depend on how many there are.
    for lane in range(len(features)):
        knot, part = lower[lane], share[lane]
        for a in range(actions.shape[1]):
            below = 0.0
            for f in range(features.shape[1]):
                below += weights[knot, a, f] * features[lane, f]
            if part == 0.0:
                actions[lane, a] = below
                continue
            above = 0.0
            for f in range(features.shape[1]):
                above += weights[knot + 1, a, f] * features[lane, f]
            actions[lane, a] = (1.0 - part) * below + part * above
