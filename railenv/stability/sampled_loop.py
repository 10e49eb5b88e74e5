"""A sampled linear controller around a continuous plant, with hold and computational delay.

Plant: x' = A x + B f(t), y = C x + D f. Controller, with t_k = k T:

    y_k = y(t_k),    u_k = Cc xc_k + Dc y_k,    xc_(k+1) = Ac xc_k + Bc y_k

Channel i holds f_i(t) = u_i,k on [t_k + tau_i, t_k + T + tau_i). With tau_i = d_i T + r_i, d_i
whole and r_i in [0, T), the force is u_i,k-d-1 on [t_k, t_k + r_i) and u_i,k-d from there on.

Feedthrough: a measurement is taken just before a force switches at the same instant. So y_k sees
the force that acted at the end of the period before, which is u_i,k-1-d for every r_i in [0, T);
without delay that is u_i,k-1, and there is no algebraic loop. With D not zero the loop therefore
depends on the delay continuously from the right only, at whole multiples of T.

A controller may be scheduled on the delay that it is told: its matrices then have a leading axis,
one entry per knot `told`, are interpolated linearly between knots and constant beyond them.

This module computes in floating point and proves nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy import linalg

from railenv.actuation.hold import held_input
from railenv.errors import ArgumentError, check_not_negative, check_positive
from railenv.stability.delay_system import DelaySystem
from railenv.units import FloatArray, Second

# Rows of the largest lifted map that is built: 6000 rows are 0.3 GB.
_REFUSED_MAP = 6000
# Singular values below this share count as zero when commands are replaced by fewer signals.
_RANK_TOLERANCE = 1e-12

_CONTROLLER = ("Ac", "Bc", "Cc", "Dc")


@dataclass(frozen=True, eq=False)
class SampledLoop:
    """A plant, a sampled controller and its period.

    Attributes:
        A: Plant, shape (n, n).
        B: Force inputs, shape (n, m).
        C: Measurements, shape (p, n).
        D: Feedthrough from forces to measurements, shape (p, m).
        period: Control period T [s].
        Ac: Controller state, shape (c, c), or (q, c, c) when scheduled; c may be 0.
        Bc: Shape (c, p), or (q, c, p).
        Cc: Shape (m, c), or (q, m, c).
        Dc: Shape (m, p), or (q, m, p).
        told: Knots of the schedule, shape (q,), rising [s]; None without a schedule.

    Raises:
        ArgumentError: A matrix has the wrong shape or is not finite, the period is not above zero,
            or the knots are negative or do not rise.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    period: Second
    Ac: FloatArray
    Bc: FloatArray
    Cc: FloatArray
    Dc: FloatArray
    told: FloatArray | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "period", check_positive("period", self.period, "seconds"))
        if self.told is not None:
            told = _finite("told", self.told)
            if told.ndim != 1 or len(told) == 0 or np.any(np.diff(told) <= 0.0) or told[0] < 0.0:
                raise ArgumentError(
                    "told is not a list of rising delays; give knots from zero up in seconds"
                )
            object.__setattr__(self, "told", told)
        lead = () if self.told is None else (len(self.told),)
        for name in ("A", "B", "C", "D", *_CONTROLLER):
            object.__setattr__(self, name, _finite(name, getattr(self, name)))
        for name, dimensions in (("A", 2), ("B", 2), ("C", 2), ("Ac", 2 + len(lead))):
            if getattr(self, name).ndim != dimensions:
                raise ArgumentError(
                    f"{name} has {getattr(self, name).ndim} dimensions; give {dimensions}"
                )
        n, m, p, c = self.A.shape[0], self.B.shape[1], self.C.shape[0], self.Ac.shape[-1]
        wanted = {
            "A": (n, n),
            "B": (n, m),
            "C": (p, n),
            "D": (p, m),
            "Ac": (*lead, c, c),
            "Bc": (*lead, c, p),
            "Cc": (*lead, m, c),
            "Dc": (*lead, m, p),
        }
        for name, shape in wanted.items():
            if getattr(self, name).shape != shape or n == 0:
                raise ArgumentError(
                    f"{name} has shape {getattr(self, name).shape}; it must be {shape}"
                    " and the plant must not be empty"
                )

    @classmethod
    def from_delay_system(cls, system: DelaySystem, period: float) -> "SampledLoop":
        """Sample the static feedback u = -K x.

        Args:
            system: The loop without sampling.
            period: Control period T [s].
        """
        m = system.num_channels
        return cls(
            A=system.A,
            B=system.B,
            C=system.K,
            D=np.zeros((m, m)),
            period=period,
            Ac=np.zeros((0, 0)),
            Bc=np.zeros((0, m)),
            Cc=np.zeros((m, 0)),
            Dc=-np.eye(m),
        )

    @classmethod
    def from_feedback(
        cls,
        A: Any,
        B: Any,
        C: Any,
        D: Any,
        period: float,
        measured: Any,
        commanded: Any | None = None,
        told: Any | None = None,
    ) -> "SampledLoop":
        """Close the loop with a finite history of measurements and commands.

        u_k = -sum_h G_h y_(k-h) - sum_h F_h u_(k-h).

        Args:
            A: Plant, shape (n, n).
            B: Force inputs, shape (n, m).
            C: Measurements, shape (p, n).
            D: Feedthrough, shape (p, m).
            period: Control period T [s].
            measured: Gains G_0, G_1, ..., shape (ages, m, p), or (q, ages, m, p) when scheduled.
            commanded: Gains F_1, F_2, ..., shape (ages, m, m) or (q, ages, m, m); None for none.
            told: Knots of the schedule, shape (q,) [s]; None without a schedule.
        """
        lead = () if told is None else (np.size(told),)
        G = _finite("measured", measured)
        m, p = _finite("B", B).shape[-1], _finite("C", C).shape[0]
        F = np.zeros((*lead, 0, m, m)) if commanded is None else _finite("commanded", commanded)
        for name, gain, columns in (("measured", G, p), ("commanded", F, m)):
            if gain.ndim != len(lead) + 3 or (*gain.shape[:-3], *gain.shape[-2:]) != (
                *lead,
                m,
                columns,
            ):
                raise ArgumentError(
                    f"{name} has shape {gain.shape}; it must be {(*lead, 'ages', m, columns)}"
                )
        ages_y, ages_u = G.shape[-3], F.shape[-3]
        if ages_y == 0:
            raise ArgumentError("measured has no gain; give at least that of the present sample")
        past_y, past_u = (ages_y - 1) * p, ages_u * m
        c = past_y + past_u

        def beside(gain: FloatArray, first: int) -> FloatArray:
            """Lay the gains of ages `first`, `first` + 1, ... side by side."""
            kept = np.moveaxis(gain[..., first:, :, :], -3, -2)
            return -kept.reshape(*lead, m, kept.shape[-2] * kept.shape[-1])

        Cc = np.concatenate([beside(G, 1), beside(F, 0)], axis=-1)
        Dc = -G[..., 0, :, :]
        Ac, Bc = np.zeros((*lead, c, c)), np.zeros((*lead, c, p))
        if past_y:
            Bc[..., :p, :] = np.eye(p)
            Ac[..., p:past_y, : past_y - p] = np.eye(past_y - p)
        if past_u:
            Bc[..., past_y : past_y + m, :] = Dc
            Ac[..., past_y : past_y + m, :] = Cc
            Ac[..., past_y + m :, past_y : c - m] = np.eye(past_u - m)
        return cls(A, B, C, D, period, Ac, Bc, Cc, Dc, told)

    @property
    def num_states(self) -> int:
        """Number of plant states n."""
        return self.A.shape[0]

    @property
    def num_channels(self) -> int:
        """Number of forces m."""
        return self.B.shape[1]

    def to_plain(self) -> dict[str, Any]:
        """Return the loop as plain numbers, exactly: what a re-checker reads.

        Keys `A B C D` (nested lists, row by row), `period` [s], `told` (list of knots [s], empty
        without a schedule) and `Ac Bc Cc Dc` (one matrix per knot; a list of one matrix without a
        schedule). Survives JSON without loss.
        """
        plain: dict[str, Any] = {name: getattr(self, name).tolist() for name in "ABCD"}
        plain["period"] = self.period
        plain["told"] = [] if self.told is None else self.told.tolist()
        for name in _CONTROLLER:
            matrix = getattr(self, name)
            plain[name] = (matrix[None] if self.told is None else matrix).tolist()
        return plain

    def controller(self, told: float | None) -> tuple[FloatArray, ...]:
        """Return Ac, Bc, Cc, Dc as they are when the controller is told a delay [s]."""
        if self.told is None:
            return tuple(getattr(self, name) for name in _CONTROLLER)
        if told is None:
            raise ArgumentError("told is missing; a scheduled controller is told one delay")
        knots = self.told
        place = min(max(check_not_negative("told", told, "seconds"), knots[0]), knots[-1])
        upper = min(max(int(np.searchsorted(knots, place)), 1), len(knots) - 1)
        lower = max(upper - 1, 0)
        span = knots[upper] - knots[lower]
        share = (place - knots[lower]) / span if span > 0.0 else 0.0
        both = [getattr(self, name) for name in _CONTROLLER]
        return tuple((1.0 - share) * M[lower] + share * M[upper] for M in both)

    @cached_property
    def state_scale(self) -> FloatArray:
        """Powers of two d with x = d * x_scaled that balance the plant with its feedback, (n,).

        Newtons, metres and radians differ by many powers of ten, which costs digits in anything
        that is not scale-free.
        """
        direct = np.abs(self.Dc) if self.told is None else np.abs(self.Dc).max(axis=0)
        size = np.abs(self.A) + np.abs(self.B) @ direct @ np.abs(self.C)
        _, (scale, _) = linalg.matrix_balance(size, permute=False, separate=True)
        return np.asarray(scale, dtype=np.float64)

    def delays(self, delay: float | Sequence[float]) -> FloatArray:
        """Return one delay per channel [s], shape (m,); see `DelaySystem.delays`."""
        m = self.num_channels
        return DelaySystem(np.zeros((1, 1)), np.zeros((1, m)), np.zeros((m, 1))).delays(delay)

    def lifted_matrix(
        self, delay: float | Sequence[float], told: float | None = None
    ) -> FloatArray:
        """Return the one-period map of [x, xc, past signals], exact up to rounding.

        The commands of the channels that share a delay are remembered as the fewest signals v with
        u = M v; plant states are divided by `state_scale`.

        Args:
            delay: One delay for all channels or one per channel [s].
            told: The delay that a scheduled controller is told [s]; by default the true one, if it
                is common to all channels.

        Raises:
            ArgumentError: A delay is not usable, or of so many periods that the map is too large.
        """
        T, n, m = self.period, self.num_states, self.num_channels
        delays = self.delays(delay)
        different = np.unique(delays)
        if self.told is not None and told is None and len(different) == 1:
            told = float(different[0])
        Ac, Bc, Cc, Dc = self.controller(told)
        c = Ac.shape[0]
        rows = n + c + m * (float(delays.max(initial=0.0)) / T + 2.0)
        if rows > _REFUSED_MAP:
            raise ArgumentError(
                f"period = {T:g} s cuts delay = {delays.max():g} s into too many parts "
                f"({rows:.3g} states); give a longer period"
            )
        scale = self.state_scale
        A, B, C = self.A * scale / scale[:, None], self.B / scale[:, None], self.C * scale
        commands = np.hstack([Dc @ C, Cc, Dc @ self.D])
        groups: list[tuple[list[int], FloatArray, FloatArray, int, int, float]] = []
        size = n + c
        for tau in different:
            channels = [k for k in range(m) if delays[k] == tau]
            few = _fewest(commands[channels])
            whole = int(np.floor(tau / T))
            rest = min(max(tau - whole * T, 0.0), T)
            groups.append((channels, *few, size, whole, rest))
            size += few[1].shape[0] * (whole + 1)
        # The forces at the end of the period before, from the oldest remembered signals.
        acting = np.zeros((m, size))
        for channels, spread, signals, start, whole, _ in groups:
            r = signals.shape[0]
            acting[channels, start + r * whole : start + r * (whole + 1)] = spread
        matrix = np.zeros((size, size))
        matrix[:n, :n] = linalg.expm(A * T)
        matrix[n : n + c, :n], matrix[n : n + c, n : n + c] = Bc @ C, Ac
        matrix[n : n + c] += Bc @ self.D @ acting
        for channels, spread, signals, start, whole, rest in groups:
            r = signals.shape[0]
            now = signals[:, n + c :] @ acting
            now[:, : n + c] += signals[:, : n + c]
            _, full = held_input(A, B[:, channels] @ spread, T)
            _, late = held_input(A, B[:, channels] @ spread, T - rest)
            end = start + r * (whole + 1)
            matrix[start : start + r] = now
            matrix[start + r : end, start : end - r] = np.eye(r * whole)
            matrix[:n, end - r : end] += full - late
            if whole == 0:
                matrix[:n] += late @ now
            else:
                matrix[:n, end - 2 * r : end - r] += late
        return matrix

    def growth_rate(self, delay: float | Sequence[float], told: float | None = None) -> float:
        """Return the largest growth rate ln|z| / T of the loop [1/s]; not proved.

        Args:
            delay: One delay for all channels or one per channel [s].
            told: The delay that a scheduled controller is told [s]; by default the true one.
        """
        largest = np.abs(linalg.eigvals(self.lifted_matrix(delay, told))).max()
        return float(np.log(max(largest, np.finfo(float).tiny)) / self.period)


def _fewest(commands: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return M and R with commands = M R up to rounding, as few rows in R as possible."""
    if commands.shape[0] == 0:
        return np.zeros((0, 0)), commands
    U, sizes, V = linalg.svd(commands, full_matrices=False)
    rank = int(np.sum(sizes > _RANK_TOLERANCE * max(float(sizes[0]), np.finfo(float).tiny)))
    root = np.sqrt(sizes[:rank])
    return U[:, :rank] * root, root[:, None] * V[:rank]


def _finite(name: str, values: Any) -> FloatArray:
    try:
        if np.iscomplexobj(values):
            raise TypeError
        matrix = np.array(values, dtype=float)
    except (TypeError, ValueError):
        raise ArgumentError(
            f"{name} is not an array of real numbers; give numbers in rows of equal length"
        ) from None
    if not np.all(np.isfinite(matrix)):
        raise ArgumentError(
            f"{name} holds a value that is not finite; every entry must be a number"
        )
    matrix.setflags(write=False)
    return matrix
