"""The actuator itself: force limit, rate limit and first-order lag.

Order in the channel: command, force limit, rate limit, hold, delay, lag, force. The two limits act
on the sampled command (with a constant delay it makes no difference on which side of the delay they
stand); the lag T F' = F_command - F is linear and becomes part of the plant.
"""

from dataclasses import dataclass

import numpy as np

from railenv.errors import ArgumentError, check_not_negative, check_positive
from railenv.units import FloatArray, Newton, NewtonPerSecond, Second

PAPER_FORCE_LIMIT: Newton = 30e3
"""Force limit of the source paper, section 3.2 [N]."""

SHORTEST_LAG: Second = 1e-6
"""Shortest lag [s]; anything faster than the vehicle by so much is no lag."""


@dataclass(frozen=True)
class ActuatorSpec:
    """What an actuator can do.

    Attributes:
        force_limit: Largest force in either direction [N]; None for no limit.
        rate_limit: Largest change of force per time [N/s]; None for no limit.
        lag: Time constant of the first-order lag [s]; 0 for none.

    Raises:
        ArgumentError: A limit is not above zero or the lag is negative.
    """

    force_limit: Newton | None = PAPER_FORCE_LIMIT
    rate_limit: NewtonPerSecond | None = None
    lag: Second = 0.0

    def __post_init__(self) -> None:
        if self.force_limit is not None:
            check_positive("force_limit", self.force_limit, "N")
        if self.rate_limit is not None:
            check_positive("rate_limit", self.rate_limit, "N/s")
        if 0.0 < check_not_negative("lag", self.lag, "seconds") < SHORTEST_LAG:
            raise ArgumentError(
                f"lag = {self.lag:g} s is too short; give 0 or {SHORTEST_LAG:g} s and more"
            )

    def limited(self, command: FloatArray, previous: FloatArray, period: float) -> FloatArray:
        """Return the command after both limits.

        Args:
            command: Wanted force, any shape [N].
            previous: Limited command of the period before, same shape [N].
            period: Control period [s].
        """
        force = command
        if self.force_limit is not None:
            force = np.clip(force, -self.force_limit, self.force_limit)
        if self.rate_limit is not None:
            step = self.rate_limit * period
            force = np.clip(force, previous - step, previous + step)
        return force

    def with_lag(self, A: FloatArray, B: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Append the lag of every channel to a plant x' = A x + B F.

        Args:
            A: Shape (n, n).
            B: Actuator columns, shape (n, m).

        Returns:
            The plant driven by commands: A and B unchanged without lag, else of size n + m with the
            forces as the last m states.
        """
        if self.lag == 0.0:
            return A, B
        n, m = B.shape
        decay = -np.eye(m) / self.lag
        return (
            np.block([[A, B], [np.zeros((m, n)), decay]]),
            np.vstack([np.zeros((n, m)), -decay]),
        )
