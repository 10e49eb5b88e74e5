"""A gain on the predicted state as a law that runs: estimator, pipe of commands, prediction.

    p_(k+1) = A (p_k + L (y_k - M p_k)) + B u_(k-d)
    u_k     = -K [A^d (p_k + L (y_k - M p_k)) + sum_{i=1..d} A^(i-1) B u_(k-i)]

p is the estimate of the design model's state before the measurement. The sum is the exact effect of
the commands on their way, so that in a loop whose delay is the design's the prediction is right and
the poles are those of A - B K and of the estimator, A - A L M, and zeros: a finite spectrum
(Manitius and Olbrot 1979, IEEE Trans. Automatic Control 24, 541).
"""

import numpy as np

from baselines.design.model import DesignModel
from baselines.design.optimum import Estimator
from baselines.linear_dynamic import LinearDynamic
from railenv.units import FloatArray

Matrices = tuple[FloatArray, FloatArray, FloatArray, FloatArray]


def predictor_matrices(model: DesignModel, gain: FloatArray, estimator: Estimator) -> Matrices:
    """Return the matrices of a sampled law, u_k = -gain @ (prediction of the state at its arrival).

    Args:
        model: What the prediction is made with.
        gain: K, shape (m, n) [N per state's unit].
        estimator: Where the present state comes from, and the sensors.

    Returns:
        Ac, Bc, Cc and Dc of xc_(k+1) = Ac xc_k + Bc y_k, u_k = -(Cc xc_k + Dc y_k).
    """
    A, B, d, m = model.A, model.B, model.late, model.num_channels
    n, L, M = len(A), estimator.gain, estimator.M
    ages = [B]
    for _ in range(d - 1):
        ages.append(A @ ages[-1])
    ahead = gain @ np.linalg.matrix_power(A, d)
    correction = np.eye(n) - L @ M
    states = n + d * m
    Cc, Dc = np.zeros((m, states)), ahead @ L
    Cc[:, :n] = ahead @ correction
    for age in range(d):
        Cc[:, n + age * m : n + (age + 1) * m] = gain @ ages[age]
    Ac, Bc = np.zeros((states, states)), np.zeros((states, L.shape[1]))
    Ac[:n, :n], Bc[:n] = A @ correction, A @ L
    if d == 0:
        Ac[:n] -= B @ Cc
        Bc[:n] -= B @ Dc
    else:
        Ac[:n, states - m :] = B
        Ac[n : n + m], Bc[n : n + m] = -Cc, -Dc
        Ac[n + m :, n : states - m] = np.eye((d - 1) * m)
    return Ac, Bc, Cc, Dc


class PredictorLaw(LinearDynamic):
    """A gain on the predicted state, as a sampled law; arguments are those of the matrices."""

    def __init__(self, model: DesignModel, gain: FloatArray, estimator: Estimator) -> None:
        super().__init__(
            predictor_matrices(model, gain, estimator),
            estimator.sensors,
            model.vehicle.layout,
            control_period=model.period,
            sampled=True,
        )
