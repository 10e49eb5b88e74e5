"""The one-period map of a sampled loop in balls, at one delay and over a range of delays.

State: plant states (scaled by powers of two), controller states, and for every group of channels
with one delay d T + r the signals v_(k-1), ..., v_(k-d-1) with u = M v exactly. Only the plant's
rows depend on r, through G(T - r) with G(s) the integral of exp(A q) B M over q in [0, s]:

    x_(k+1) = exp(A T) x_k + G(T - r) v_(k-d) + (G(T) - G(T - r)) v_(k-d-1)

so the map is affine in the matrix G(T - r) and, between two knots, in the delay told. If G(T - r)
lies in the hull of some control points, the map lies in the hull of the maps built from each
control point with each end of the told range and each knot inside it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from flint import arb, arb_mat, fmpq, fmpq_mat

from railenv.stability.proof.ball_matrices import (
    Matrix,
    add_block,
    beside,
    exact,
    in_balls,
    part,
    rational,
)
from railenv.stability.proof.precision import precision
from railenv.stability.proof.sampled_curve import control_points
from railenv.stability.sampled_loop import SampledLoop

# The period's exponential is wanted to this many bits; more precision is spent until it is there.
_ACCURACY, _BITS, _MOST_BITS = 110, 192, 6200


@dataclass(frozen=True)
class Group:
    """Channels that share a delay: u = M v with signals v = R (x, xc, f), one R per knot."""

    channels: tuple[int, ...]
    M: Matrix
    R: tuple[Matrix, ...]

    @property
    def rank(self) -> int:
        """Number of signals."""
        return int(self.M.ncols())


@dataclass(frozen=True)
class _Controller:
    """Blocks of the map that the controller contributes, as balls, for one told delay."""

    Ac: Matrix
    from_states: Matrix
    from_old: list[Matrix]
    signals: list[Matrix]
    signals_old: list[list[Matrix]]


class SampledMap:
    """Enclosures of the lifted map of one loop for one grouping of its channels.

    Args:
        loop: The loop.
        groups: Channels by common delay; every channel once.

    Attributes:
        bits: Working precision to use with every method.
        exponents: Plant states are x_i = 2^exponents_i times the scaled ones.
        groups: The groups with their signals.
    """

    def __init__(self, loop: SampledLoop, groups: Sequence[Sequence[int]]) -> None:
        self.loop = loop
        self.n, self.c = loop.num_states, loop.Ac.shape[-1]
        self.exponents = [int(e) for e in np.log2(loop.state_scale)]
        # In rational numbers, where scaling by powers of two cannot leave the range.
        units = [fmpq(2) ** e for e in self.exponents]
        scale = fmpq_mat(self.n, self.n)
        back = fmpq_mat(self.n, self.n)
        for i, unit in enumerate(units):
            scale[i, i], back[i, i] = unit, 1 / unit
        A, B, C, self._D = map(rational, (loop.A, loop.B, loop.C, loop.D))
        self._A, self._B, self._C = back * A * scale, back * B, C * scale
        self.groups = tuple(self._grouped(tuple(channels)) for channels in groups)
        self._inputs = beside(
            [part(self._B, range(self.n), g.channels) * g.M for g in self.groups]
            or [fmpq_mat(self.n, 0)]
        )
        self._told: dict[float, _Controller] = {}
        self.bits = _BITS
        while not self._accurate() and self.bits < _MOST_BITS:
            self.bits *= 2
            self.__dict__.pop("_period", None)

    def size(self, wholes: Sequence[int]) -> int:
        """Return the number of lifted states for some whole periods d per group."""
        signals = sum(g.rank * (d + 1) for g, d in zip(self.groups, wholes, strict=True))
        return self.n + self.c + signals

    def at(self, wholes: Sequence[int], rests: Sequence[Any], told: float) -> Matrix:
        """Return the map at one delay per group, d T + r, and one told delay.

        Args:
            wholes: Whole periods d per group.
            rests: Exact r per group [s], from 0 up to and including T.
            told: Delay that the controller is told [s].
        """
        T = exact(self.loop.period)
        late = [self._transition(T - r)[1][g] for g, r in enumerate(rests)]
        return self._assembled(wholes, late, self._controller(told))

    def hull(
        self, whole: int, low: float, high: float, told: tuple[float, float], degree: int
    ) -> list[list[Matrix]] | None:
        """Enclose the maps of all common delays d T + r, r in [low, high], and told delays.

        Args:
            whole: Whole periods d.
            low: Smallest r [s].
            high: Largest r [s], at most T.
            told: Smallest and largest told delay [s].
            degree: Degree of the curve's Bernstein form.

        Returns:
            For each told delay at the ends and at the knots between a list of maps; all the maps
            asked for lie in the convex hull of all of these together. None if the range of r is
            too long.
        """
        middle, half = (exact(low) + exact(high)) / 2, (exact(high) - exact(low)) / 2
        flow, effects = self._transition(exact(self.loop.period) - middle)
        points: list[Matrix] | None = effects
        if half > 0:
            points = control_points(
                in_balls(self._A), in_balls(self._inputs), flow, effects[0], half, degree
            )
        if points is None:
            return None
        return [
            [self._assembled([whole], [late], self._controller(place)) for late in points]
            for place in self.told_corners(*told)
        ]

    def told_corners(self, low: float, high: float) -> list[float]:
        """Return the ends of a told range and the knots between: their hull holds all."""
        knots: list[float] = [] if self.loop.told is None else self.loop.told.tolist()
        return sorted({low, high, *(k for k in knots if low < k < high)})

    def _grouped(self, channels: tuple[int, ...]) -> Group:
        """Factor commands exactly: R is their reduced echelon form, M their pivot columns."""
        commands = beside(
            [beside([Dc * self._C, Cc, Dc * self._D]) for _, _, Cc, Dc in self._knots]
        )
        own = part(commands, channels, range(commands.ncols()))
        width = self.n + self.c + self.loop.num_channels

        def group(spread: Matrix, rows: Matrix) -> Group:
            blocks = [range(j * width, (j + 1) * width) for j in range(len(self._knots))]
            kept = range(rows.nrows())
            return Group(channels, spread, tuple(part(rows, kept, block) for block in blocks))

        count = len(channels)
        if channels:
            echelon, rank = own.rref()
            if rank < count:
                echelon = part(echelon, range(rank), range(own.ncols()))
                pivots = [next(j for j, v in enumerate(row) if v != 0) for row in echelon.tolist()]
                return group(part(own, range(count), pivots), echelon)
        identity = [fmpq(int(i == j)) for i in range(count) for j in range(count)]
        return group(fmpq_mat(count, count, identity), own)

    @cached_property
    def _knots(self) -> list[tuple[Matrix, ...]]:
        """Exact Ac, Bc, Cc, Dc at each knot; one entry without a schedule."""
        loop = self.loop
        parts = (loop.Ac, loop.Bc, loop.Cc, loop.Dc)
        if loop.told is None:
            return [tuple(map(rational, parts))]
        return [tuple(rational(M[j]) for M in parts) for j in range(len(loop.told))]

    def _transition(self, duration: Any) -> tuple[Matrix, list[Matrix]]:
        """Return exp(A s) and G(s) per group, for an exact duration s [s]."""
        n, width = self.n, self._inputs.ncols()
        rows = [[arb(v) for v in row] for row in beside([self._A, self._inputs]).tolist()]
        rows += [[arb(0)] * (n + width) for _ in range(width)]
        result = (arb_mat(rows) * arb(duration)).exp()
        effects, start = list[Matrix](), n
        for group in self.groups:
            effects.append(part(result, range(n), range(start, start + group.rank)))
            start += group.rank
        return part(result, range(n), range(n)), effects

    @cached_property
    def _period(self) -> tuple[Matrix, list[Matrix]]:
        return self._transition(exact(self.loop.period))

    def _accurate(self) -> bool:
        with precision(self.bits):
            entries = self._period[0].entries()
            largest = max(float(abs(v).upper()) for v in entries)
            worst = max(float(v.rad()) for v in entries)
        return worst <= largest * 2.0**-_ACCURACY < np.inf

    def _assembled(
        self, wholes: Sequence[int], late: Sequence[Matrix], controller: _Controller
    ) -> Matrix:
        """Return the map from G(T - r) per group, d per group and the controller."""
        n, c, groups = self.n, self.c, self.groups
        starts, size = list[int](), n + c
        for group, whole in zip(groups, wholes, strict=True):
            starts.append(size)
            size += group.rank * (whole + 1)
        # Where the oldest signals are: they act at the end of the period before.
        oldest = [s + g.rank * d for s, g, d in zip(starts, groups, wholes, strict=True)]
        zero = arb(0)
        rows = [[zero] * size for _ in range(size)]
        flow, full = self._period
        add_block(rows, 0, 0, flow)
        add_block(rows, n, 0, controller.from_states)
        add_block(rows, n, n, controller.Ac)
        for old, block in zip(oldest, controller.from_old, strict=True):
            add_block(rows, n, old, block)
        for g, group in enumerate(groups):
            r, start, old = group.rank, starts[g], oldest[g]
            add_block(rows, start, 0, controller.signals[g])
            for other, block in zip(oldest, controller.signals_old[g], strict=True):
                add_block(rows, start, other, block)
            for i in range(start + r, old + r):
                rows[i][i - r] = arb(1)
        for g, group in enumerate(groups):
            r, start, old = group.rank, starts[g], oldest[g]
            add_block(rows, 0, old, full[g] - late[g])
            if wholes[g] > 0:
                add_block(rows, 0, old - r, late[g])
            elif r > 0:
                add_block(rows, 0, 0, late[g] * arb_mat(rows[start : start + r]))
        return arb_mat(rows)

    def _controller(self, told: float) -> _Controller:
        """Return the controller's blocks, interpolated exactly."""
        if told in self._told:
            return self._told[told]
        knots = [0.0] if self.loop.told is None else self.loop.told.tolist()
        last = len(knots) - 1
        j = max(sum(k <= told for k in knots) - 1, 0)
        share = fmpq(0)
        if j < last and told > knots[j]:
            share = (exact(told) - exact(knots[j])) / (exact(knots[j + 1]) - exact(knots[j]))

        def between(matrices: Sequence[Matrix]) -> Matrix:
            if share == 0:
                return matrices[j]
            return matrices[j] * (1 - share) + matrices[j + 1] * share

        Ac, Bc = (between([knot[k] for knot in self._knots]) for k in (0, 1))
        signals = [between(group.R) for group in self.groups]
        states = self.n + self.c

        def old(rows: Matrix, first: int) -> list[Matrix]:
            """Return the effect of each group's oldest signals through columns of forces."""
            kept = range(rows.nrows())
            return [
                in_balls(part(rows, kept, [first + k for k in g.channels]) * g.M)
                for g in self.groups
            ]

        blocks = _Controller(
            Ac=in_balls(Ac),
            from_states=in_balls(Bc * self._C),
            from_old=old(Bc * self._D, 0),
            signals=[in_balls(part(R, range(R.nrows()), range(states))) for R in signals],
            signals_old=[old(R, states) for R in signals],
        )
        self._told[told] = blocks
        return blocks
