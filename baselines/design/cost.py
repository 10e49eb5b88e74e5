"""What a sampled linear law costs on random track, by the covariance of the loop.

Any law that offers its sampled form is closed around the design model; the covariance of all states
solves a Lyapunov equation. Independent of how the law was designed, and so the check of what a
design predicts.
"""

from dataclasses import dataclass

import numpy as np

from baselines.controller import LinearFeedback
from baselines.design.model import DesignModel, sensor_noise
from baselines.design.riccati import solve_lyapunov
from baselines.linear_dynamic import LinearDynamic
from railenv.units import MetrePerSecondSquared, Newton


@dataclass(frozen=True)
class LoopCost:
    """Mean squares of a loop on random track, as root mean squares.

    Attributes:
        weighted_acceleration: Ride-filtered acceleration over both floor ends [m/s^2].
        force_rms: Force over all channels [N].
    """

    weighted_acceleration: MetrePerSecondSquared
    force_rms: Newton


def loop_cost(
    model: DesignModel, law: LinearFeedback | LinearDynamic, noise: float = 0.0
) -> LoopCost:
    """Return the cost of a linear law in the design model's loop, with the model's delay.

    Args:
        model: Vehicle, track and delay.
        law: The law.
        noise: Standard deviation of its sensors' noise, in units of their controlled response [1].

    Raises:
        RailenvError: The loop is not stable.
        ArgumentError: The law does not fit the vehicle.
    """
    sampled = law.to_sampled_loop(model.vehicle, model.period)
    Ac, Bc, Cc, Dc = (np.asarray(part) for part in sampled.controller(None))
    M, R = model.measurement(law.sensors), sensor_noise(law.sensors, noise) ** 2
    n, c, m, d = len(model.A), len(Ac), model.num_channels, model.late
    # The loop's state: X, the law's own, and the commands u_(k-1) ... u_(k-d) on their way.
    size = n + c + d * m
    command, reading = np.zeros((m, size)), np.zeros((m, len(M)))
    command[:, :n], command[:, n : n + c], reading[:] = Dc @ M, Cc, Dc
    A, N = np.zeros((size, size)), np.zeros((size, len(M)))
    A[:n, :n] = model.A
    A[n : n + c, :n], A[n : n + c, n : n + c], N[n : n + c] = Bc @ M, Ac, Bc
    arriving, arriving_noise = command, reading
    if d > 0:
        arriving, arriving_noise = np.zeros((m, size)), np.zeros((m, len(M)))
        arriving[:, size - m :] = np.eye(m)
        A[n + c : n + c + m], N[n + c : n + c + m] = command, reading
        A[n + c + m :, n + c : size - m] = np.eye((d - 1) * m)
    A[:n] += model.B @ arriving
    N[:n] += model.B @ arriving_noise
    W = (N * R) @ N.T
    W[:n, :n] += model.G @ model.G.T
    X = solve_lyapunov(A, W)
    rows = model.D @ arriving
    rows[:, :n] += model.C
    through = model.D @ arriving_noise
    power = np.trace(rows @ X @ rows.T) + np.sum(through**2 * R) + np.trace(model.H @ model.H.T)
    force = np.trace(arriving @ X @ arriving.T) + np.sum(arriving_noise**2 * R)
    return LoopCost(float(np.sqrt(power)), float(np.sqrt(force / m)))
