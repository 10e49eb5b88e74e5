"""The H2-optimal law for a known delay: regulator, estimator, and what they will cost.

Over the design model (`baselines.design.model`) the law minimises

    E z'z + effort * E |u|^2 / (m F0^2),   F0 = 3 kN

With a delay of d periods the optimal command acts on what the state will be when it arrives,
u_k = -K E[X_(k+d) | what is known at k], with the gain K of the loop without those periods: the
states of the pipe need no Riccati equation of their own. The estimate is Kalman's. Its error and
what is added on the way are white over the periods, so that the cost follows from covariances:

    E z'z = tr (C - D K) S (C - D K)' + tr C P_d C' + tr H H'

with S the covariance of the prediction and P_d that of its error.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg

from baselines.design.model import DesignModel, sensor_noise
from baselines.design.riccati import solve_lyapunov, solve_riccati, solve_stein
from railenv.envs.observation import DEFAULT_ACTION_SCALE
from railenv.errors import check_positive
from railenv.units import FloatArray, MetrePerSecondSquared, Newton


@dataclass(frozen=True, eq=False)
class Regulator:
    """The gain on the predicted state, and the equation it comes from.

    Attributes:
        gain: K, shape (m, n) [N per state's unit].
        value: X of the vehicle, filter and force states, shape (c, c).
        riccati: A, G and Q of its equation X = A' X (I + G X)^-1 A + Q.
    """

    gain: FloatArray
    value: FloatArray
    riccati: tuple[FloatArray, FloatArray, FloatArray]


def regulator(model: DesignModel, effort: float) -> Regulator:
    """Return the optimal gain of a design model.

    The track is out of the command's reach: the Riccati equation is that of the vehicle, and the
    gain on the track's states follows from a linear one.

    Args:
        model: The design model.
        effort: What E |u|^2 / (m F0^2) costs [(m/s^2)^2], above zero.
    """
    m, n = model.num_channels, len(model.A)
    track = np.arange(n - m - model.num_track, n - m)
    own = np.setdiff1d(np.arange(n), track)
    A, B = model.A[own][:, own], model.B[own]
    across, F = model.A[own][:, track], model.A[track][:, track]
    C, C_track, D = model.C[:, own], model.C[:, track], model.D
    weight = check_positive("effort", effort) / (m * DEFAULT_ACTION_SCALE**2)
    R = D.T @ D + weight * np.eye(m)
    cross = linalg.solve(R, D.T @ C, assume_a="pos")
    without = A - B @ cross
    Q = C.T @ C - C.T @ D @ cross
    G = B @ linalg.solve(R, B.T, assume_a="pos")
    X = solve_riccati(without, G, (Q + Q.T) / 2)
    inertia = R + B.T @ X @ B
    gain = linalg.solve(inertia, B.T @ X @ A + D.T @ C, assume_a="pos")
    closed = A - B @ gain
    constant = closed.T @ X @ across + C.T @ C_track - gain.T @ D.T @ C_track
    coupling = solve_stein(closed.T, F, constant)
    ahead = B.T @ (X @ across + coupling @ F) + D.T @ C_track
    whole = np.zeros((m, n))
    whole[:, own], whole[:, track] = gain, linalg.solve(inertia, ahead, assume_a="pos")
    return Regulator(whole, X, (without, G, (Q + Q.T) / 2))


@dataclass(frozen=True, eq=False)
class Estimator:
    """Kalman's filter over the design model.

    Attributes:
        sensors: What is measured.
        M: Rows of the measurement, shape (p, n).
        gain: L of X_(k|k) = X_(k|k-1) + L (y_k - M X_(k|k-1)), shape (n, p).
        error: Covariance of X_k - X_(k|k), shape (n, n).
        innovation: Covariance of L (y_k - M X_(k|k-1)), shape (n, n).
    """

    sensors: tuple[str, ...]
    M: FloatArray
    gain: FloatArray
    error: FloatArray
    innovation: FloatArray


def estimator(model: DesignModel, sensors: tuple[str, ...], noise: float) -> Estimator:
    """Return the optimal estimator for sensors with white noise.

    Args:
        model: The design model.
        sensors: Names of what is measured.
        noise: Standard deviation of the noise, in units of the columns' controlled response [1],
            above zero.
    """
    check_positive("noise", noise)
    M = model.measurement(sensors)
    deviation = sensor_noise(sensors, noise)
    whitened = M / deviation[:, None]
    W = model.G @ model.G.T
    before = solve_riccati(model.A.T, whitened.T @ whitened, W)
    S = whitened @ before @ whitened.T + np.eye(len(M))
    scaled = linalg.solve(S, whitened @ before, assume_a="pos").T
    innovation = scaled @ S @ scaled.T
    error = before - innovation
    return Estimator(sensors, M, scaled / deviation, (error + error.T) / 2, innovation)


def perfect_knowledge(model: DesignModel) -> Estimator:
    """Return what stands for full information: the state, the track met so far included."""
    n = len(model.A)
    return Estimator((), np.eye(n), np.eye(n), np.zeros((n, n)), model.G @ model.G.T)


@dataclass(frozen=True, eq=False)
class Optimum:
    """An H2-optimal law and its cost.

    Attributes:
        model: What it is designed for.
        regulator: Its gain.
        estimator: Its knowledge.
    """

    model: DesignModel
    regulator: Regulator
    estimator: Estimator

    @cached_property
    def _covariances(self) -> tuple[FloatArray, FloatArray]:
        """Of the predicted state and of its error."""
        A, B, K = self.model.A, self.model.B, self.regulator.gain
        added = self.model.G @ self.model.G.T
        error, arriving = self.estimator.error, self.estimator.innovation
        for _ in range(self.model.late):
            error, arriving = A @ error @ A.T + added, A @ arriving @ A.T
        return solve_lyapunov(A - B @ K, arriving), error

    @property
    def weighted_acceleration(self) -> MetrePerSecondSquared:
        """Root mean square of the ride-filtered acceleration over both floor ends [m/s^2]."""
        state, error = self._covariances
        C, D, K, H = self.model.C, self.model.D, self.regulator.gain, self.model.H
        rows = C - D @ K
        total = np.trace(rows @ state @ rows.T) + np.trace(C @ error @ C.T) + np.trace(H @ H.T)
        return float(np.sqrt(total))

    @property
    def force_rms(self) -> Newton:
        """Root mean square of the force, over all channels [N]."""
        K = self.regulator.gain
        return float(np.sqrt(np.trace(K @ self._covariances[0] @ K.T) / len(K)))
