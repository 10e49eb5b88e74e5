"""Linear least squares for gains that are scheduled on the told delay.

Gains that are linear between knots make the action linear in features times knot weights, so that
the best gains solve one linear equation whatever the data. A lane is told one delay for a whole
episode: it adds to two neighbouring knots only, and what it adds is its Gram matrix times a few
numbers. Sums are kept in double precision over all rounds.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from railenv.errors import ArgumentError, check_positive
from railenv.units import FloatArray

AnyFloats = NDArray[np.float32] | NDArray[np.float64]


class ScheduledLeastSquares:
    """Sums of the normal equations, and their solution.

    Args:
        knots: Number of knots K.
        actions: Number of actions A.
        features: Number of features F.

    Attributes:
        same: Sums of w_k^2 x x' for each knot, shape (K, F, F).
        across: Sums of w_k w_(k+1) x x' for neighbours, shape (K - 1, F, F).
        answers: Sums of w_k a x', shape (K, A, F).
        samples: Number of samples.
    """

    def __init__(self, knots: int, actions: int, features: int) -> None:
        self.same = np.zeros((knots, features, features))
        self.across = np.zeros((knots - 1, features, features))
        self.answers = np.zeros((knots, actions, features))
        self.samples = 0

    def add(self, features: AnyFloats, hat: FloatArray, wanted: FloatArray) -> None:
        """Add the samples of one lane.

        Args:
            features: Shape (samples, F).
            hat: Weights of the knots, not zero at two neighbours at most, shape (K,).
            wanted: Actions to be imitated, shape (samples, A).
        """
        x, a = np.asarray(features, dtype=np.float64), np.asarray(wanted, dtype=np.float64)
        gram, answer = x.T @ x, a.T @ x
        for k in np.flatnonzero(hat):
            self.same[k] += hat[k] ** 2 * gram
            self.answers[k] += hat[k] * answer
            if k + 1 < len(hat) and hat[k + 1] != 0.0:
                self.across[k] += hat[k] * hat[k + 1] * gram
        self.samples += len(x)

    def solve(self, ridge: float) -> FloatArray:
        """Return the gains of all knots, shape (K, A, F).

        Args:
            ridge: Cost of a squared gain, in units of the features' mean square [1].

        Raises:
            ArgumentError: There are no samples, or the ridge is not above zero.
        """
        check_positive("ridge", ridge)
        if self.samples == 0:
            raise ArgumentError("there are no samples to learn from; add some first")
        knots, actions, size = self.answers.shape
        whole = linalg.block_diag(*self.same)
        for k, block in enumerate(self.across):
            here, following = slice(k * size, (k + 1) * size), slice((k + 1) * size, (k + 2) * size)
            whole[here, following], whole[following, here] = block, block.T
        whole[np.diag_indices(len(whole))] += ridge * np.trace(whole) / len(whole)
        right = self.answers.transpose(0, 2, 1).reshape(knots * size, actions)
        found = linalg.solve(whole, right, assume_a="pos")
        return found.reshape(knots, size, actions).transpose(0, 2, 1).copy()
