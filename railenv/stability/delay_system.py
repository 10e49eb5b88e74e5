"""Linear systems under delayed feedback: x' = A x - sum_i b_i K_i x(t - tau_i).

b_i is column i of B, K_i row i of K: one channel per actuator, each with its own delay, and the
feedback law u = -K x(t - tau). Delay means the time between measurement and force; a sampled
controller's hold comes on top of it (see `railenv.stability.sampled`).

This module knows nothing of vehicles; anything linear can be asked.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy import linalg

from railenv.errors import ArgumentError, check_not_negative
from railenv.units import ComplexArray, FloatArray

# Singular values below this share of the largest count as zero when B K is factored: it only
# decides the size of the reduced problem, every root is corrected on the full matrices afterwards.
_RANK_TOLERANCE = 1e-12
# Delays beyond these under- or overflow in powers of the collocation.
_SHORTEST, _LONGEST = 1e-100, 1e100


@dataclass(frozen=True, eq=False)
class DelaySystem:
    """x' = A x - sum_i b_i K_i x(t - tau_i), retarded, with constant delays.

    Attributes:
        A: Plant, shape (n, n).
        B: Inputs, shape (n, m).
        K: Feedback gain, shape (m, n), with u = -K x(t - tau).

    Raises:
        ArgumentError: A matrix has the wrong shape or is not finite.
    """

    A: FloatArray
    B: FloatArray
    K: FloatArray

    def __post_init__(self) -> None:
        A = _matrix("A", self.A)
        B, K = _matrix("B", self.B), _matrix("K", self.K)
        n = A.shape[0]
        if A.shape != (n, n) or n == 0:
            raise ArgumentError(f"A has shape {A.shape}; it must be square and not empty")
        if B.shape[0] != n:
            raise ArgumentError(f"B has shape {B.shape}; it must have {n} rows as A has")
        if K.shape != (B.shape[1], n):
            raise ArgumentError(
                f"K has shape {K.shape}; it must be ({B.shape[1]}, {n}): one row per column of B"
            )
        for name, matrix in (("A", A), ("B", B), ("K", K)):
            matrix.setflags(write=False)
            object.__setattr__(self, name, matrix)

    @classmethod
    def from_statespace(cls, system: Any, K: Any) -> "DelaySystem":
        """Close the loop around a plant given as a state-space object.

        Args:
            system: Anything with matrices `A, B, C, D` (scipy.signal.StateSpace, python-control).
            K: Output gain, shape (inputs, outputs), with u = -K y(t - tau).

        Returns:
            The delay system with state gain K C.

        Raises:
            ArgumentError: The plant is in discrete time, or has direct feedthrough (then the loop
                is of neutral type, which this oracle does not answer).
        """
        period = getattr(system, "dt", None)
        if period not in (None, 0):
            raise ArgumentError(
                f"system has sampling period dt = {period}; give a continuous-time system"
            )
        gain = _matrix("K", K)
        C, D = _matrix("C", system.C), _matrix("D", system.D)
        if gain.shape != (D.shape[1], D.shape[0]):
            raise ArgumentError(
                f"K has shape {gain.shape}; it must be {(D.shape[1], D.shape[0])}: "
                "one row per input, one column per output"
            )
        if np.any(gain @ D @ gain):
            raise ArgumentError(
                "the loop is neutral: a fed-back output has direct feedthrough from the input; "
                "pass that output through a low-pass first"
            )
        return cls(np.asarray(system.A, float), np.asarray(system.B, float), gain @ C)

    @property
    def num_states(self) -> int:
        """Number of states n."""
        return self.A.shape[0]

    @property
    def num_channels(self) -> int:
        """Number of feedback channels m."""
        return self.B.shape[1]

    @property
    def undelayed(self) -> FloatArray:
        """Closed loop without delay, A - B K, shape (n, n)."""
        return self.A - self.B @ self.K

    def delays(self, delay: float | Sequence[float]) -> FloatArray:
        """Return one delay per channel.

        Args:
            delay: One delay for all channels or one per channel [s].

        Raises:
            ArgumentError: A delay is negative or not finite, or their number is wrong.
        """
        values = np.atleast_1d(np.asarray(delay, dtype=object))
        if values.ndim != 1 or len(values) not in (1, self.num_channels):
            raise ArgumentError(
                f"delay has {values.size} entries; give one or {self.num_channels}, one per channel"
            )
        checked = [check_not_negative("delay", value, "seconds") for value in values]
        for value in checked:
            if 0.0 < value < _SHORTEST or value > _LONGEST:
                raise ArgumentError(
                    f"delay = {value:g} s is out of reach; "
                    f"give 0, or {_SHORTEST:g} to {_LONGEST:g} s"
                )
        return np.broadcast_to(np.array(checked), (self.num_channels,)).copy()

    @cached_property
    def scaled(self) -> "DelaySystem":
        """The same system with states scaled by powers of two so that A and B K are balanced.

        Roots are unchanged. Newtons, metres and radians differ by many powers of ten, which costs
        digits in anything that is not scale-free.
        """
        d = self.state_scale
        return DelaySystem(self.A * d / d[:, None], self.B / d[:, None], self.K * d)

    @cached_property
    def state_scale(self) -> FloatArray:
        """Factors d with x = d * x_scaled, shape (n,)."""
        size = np.abs(self.A) + np.abs(self.B) @ np.abs(self.K)
        _, (scale, _) = linalg.matrix_balance(size, permute=False, separate=True)
        return np.asarray(scale, dtype=np.float64)

    def characteristic_matrix(self, s: complex, delays: FloatArray) -> ComplexArray:
        """Return M(s) = s I - A + sum_i b_i K_i exp(-s tau_i), shape (n, n)."""
        return (
            s * np.eye(self.num_states) - self.A + (self.B * np.exp(-s * delays)) @ self.K
        ).astype(np.complex128)

    def characteristic_derivative(self, s: complex, delays: FloatArray) -> ComplexArray:
        """Return dM/ds = I - sum_i tau_i b_i K_i exp(-s tau_i), shape (n, n)."""
        return (
            np.eye(self.num_states) - (self.B * (delays * np.exp(-s * delays))) @ self.K
        ).astype(np.complex128)

    def factor(self, channels: list[int]) -> tuple[FloatArray, FloatArray]:
        """Factor the part of B K that belongs to some channels by its rank.

        Args:
            channels: Channel numbers.

        Returns:
            L, shape (n, r), and R, shape (r, n), with B[:, channels] K[channels] = L R.
        """
        product = self.B[:, channels] @ self.K[channels]
        U, sizes, V = linalg.svd(product)
        rank = int(np.sum(sizes > _RANK_TOLERANCE * max(sizes[0], np.finfo(float).tiny)))
        root = np.sqrt(sizes[:rank])
        return U[:, :rank] * root, root[:, None] * V[:rank]


def _matrix(name: str, values: Any) -> FloatArray:
    try:
        if np.iscomplexobj(values):
            raise TypeError
        matrix = np.array(values, dtype=float)
    except (TypeError, ValueError):
        raise ArgumentError(
            f"{name} is not a matrix of real numbers; give a two-dimensional array"
        ) from None
    if matrix.ndim != 2:
        raise ArgumentError(f"{name} has {matrix.ndim} dimensions; give a two-dimensional array")
    if not np.all(np.isfinite(matrix)):
        raise ArgumentError(
            f"{name} holds a value that is not finite; every entry must be a number"
        )
    return matrix
