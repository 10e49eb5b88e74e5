"""A sampled law of finite history around a continuous plant, with hold and computational delay.

Plant: x' = A x + B f(t), y = C x + D f. Law, with t_k = k T and few command signals v:

    y_k = y(t_k),    v_k = -sum_(h >= 0) G_h y_(k-h) - sum_(h >= 1) F_h v_(k-h),    f = S v held

Hold, delay and feedthrough are those of `SampledLoop`; all forces share one delay. The law may be
scheduled on the delay it is told: G and F then have a leading axis, one entry per knot `told`, are
interpolated linearly between knots and constant beyond them.

Against `SampledLoop.from_feedback` this keeps apart that few signals drive many forces and that the
law has no state of its own: what the proof over a whole range of delays rests on.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from railenv.errors import ArgumentError, check_not_negative, check_positive
from railenv.stability.sampled_loop import SampledLoop
from railenv.units import FloatArray, Second

_DIMENSIONS = {"A": 2, "B": 2, "C": 2, "D": 2, "measured": 4, "commanded": 4, "spread": 2}


@dataclass(frozen=True, eq=False)
class FiniteHistoryLoop:
    """A plant, a law of finite history and its period.

    Attributes:
        A: Plant, shape (n, n).
        B: Force inputs, shape (n, m).
        C: Readings, shape (p, n).
        D: Feedthrough from forces to readings, shape (p, m).
        period: Control period T [s].
        measured: Gains G_0, G_1, ..., shape (q, ages, r, p), one entry per knot.
        commanded: Gains F_1, F_2, ..., shape (q, past, r, r).
        spread: S, forces of a signal of one, shape (m, r).
        told: Knots of the schedule, shape (q,), rising from zero or more [s]; a single one (what it
            is does not matter) for a law that is not scheduled.

    Raises:
        ArgumentError: An array has the wrong shape or is not finite, the period is not above zero,
            or the knots are negative or do not rise.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    period: Second
    measured: FloatArray
    commanded: FloatArray
    spread: FloatArray
    told: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "period", check_positive("period", self.period, "seconds"))
        for name in (*_DIMENSIONS, "told"):
            object.__setattr__(self, name, _finite(name, getattr(self, name)))
        told = self.told
        if told.ndim != 1 or len(told) == 0 or np.any(np.diff(told) <= 0.0) or told[0] < 0.0:
            raise ArgumentError(
                "told is not a list of rising delays; give knots from zero up in seconds"
            )
        for name, dimensions in _DIMENSIONS.items():
            if getattr(self, name).ndim != dimensions:
                raise ArgumentError(
                    f"{name} has {getattr(self, name).ndim} dimensions; give {dimensions}"
                )
        n, m, p, q = self.A.shape[0], self.B.shape[1], self.C.shape[0], len(told)
        r = self.spread.shape[1]
        wanted = {
            "A": (n, n),
            "B": (n, m),
            "C": (p, n),
            "D": (p, m),
            "measured": (q, max(self.measured.shape[1], 1), r, p),
            "commanded": (q, self.commanded.shape[1], r, r),
            "spread": (m, r),
        }
        for name, shape in wanted.items():
            if getattr(self, name).shape != shape or 0 in (n, m, p, r):
                raise ArgumentError(
                    f"{name} has shape {getattr(self, name).shape}; it must be {shape}, and there "
                    "must be a state, a force, a reading and a signal"
                )

    @property
    def num_signals(self) -> int:
        """Number of command signals r."""
        return self.spread.shape[1]

    @property
    def scheduled(self) -> bool:
        """Whether the law depends on what delay it is told."""
        return len(self.told) > 1

    def gains(self, told: float | None = None) -> tuple[FloatArray, FloatArray]:
        """Return G (ages, r, p) and F (past, r, r) when the law is told a delay [s].

        Raises:
            ArgumentError: The law is scheduled and nothing is told.
        """
        if not self.scheduled:
            return self.measured[0], self.commanded[0]
        if told is None:
            raise ArgumentError("told is missing; a scheduled law is told one delay")
        knots = self.told
        place = min(max(check_not_negative("told", told, "seconds"), knots[0]), knots[-1])
        upper = min(max(int(np.searchsorted(knots, place)), 1), len(knots) - 1)
        share = (place - knots[upper - 1]) / (knots[upper] - knots[upper - 1])
        both = (self.measured, self.commanded)
        G, F = ((1.0 - share) * X[upper - 1] + share * X[upper] for X in both)
        return G, F

    def to_sampled_loop(self, told: float | None = None) -> SampledLoop:
        """Return the loop as it is when the law is told a delay, with a law of few states.

        The transposed (observer) form: r states for each period of the history.

            s_j,k+1 = s_j+1,k - G_j y_k - F_j v_k,   v_k = s_1,k - G_0 y_k

        Args:
            told: What a scheduled law is told [s].
        """
        G, F = self.gains(told)
        r, p = G.shape[1:]
        ages = max(len(G) - 1, len(F))
        late = np.zeros((ages, r, p))
        late[: len(G) - 1] = -G[1:]
        back = np.zeros((ages, r, r))
        back[: len(F)] = -F
        Ac, Bc = np.zeros((ages * r, ages * r)), np.zeros((ages * r, p))
        for j in range(ages):
            row = slice(j * r, (j + 1) * r)
            if j < ages - 1:
                Ac[row, (j + 1) * r : (j + 2) * r] = np.eye(r)
            Ac[row, :r] += back[j]
            Bc[row] = late[j] - back[j] @ G[0]
        Cc = self.spread @ np.eye(r, ages * r)
        Dc = -self.spread @ G[0]
        return SampledLoop(self.A, self.B, self.C, self.D, self.period, Ac, Bc, Cc, Dc)

    def growth_rate(self, delay: float, told: float | None = None) -> float:
        """Return the largest growth rate ln|z| / T of the loop [1/s]; not proved.

        Args:
            delay: The delay of all forces [s].
            told: The delay that a scheduled law is told [s]; by default the true one.
        """
        return self.to_sampled_loop(delay if told is None else told).growth_rate(delay)

    def to_plain(self) -> dict[str, Any]:
        """Return the loop as plain numbers, exactly; survives JSON without loss."""
        names = (*_DIMENSIONS, "told")
        return {name: getattr(self, name).tolist() for name in names} | {"period": self.period}


def _finite(name: str, values: Any) -> FloatArray:
    try:
        if np.iscomplexobj(values):
            raise TypeError
        matrix = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise ArgumentError(
            f"{name} is not an array of real numbers; give numbers in rows of equal length"
        ) from None
    if not np.all(np.isfinite(matrix)):
        raise ArgumentError(
            f"{name} holds a value that is not finite; every entry must be a number"
        )
    return matrix
