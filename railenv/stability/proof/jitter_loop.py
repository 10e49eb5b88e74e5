"""A loop with jittering delays, reduced to the channels that matter, as exact polynomials.

Channels come in blocks: each channel alone, or, if all share one jitter, those of one nominal
delay. With K_b = P_b R_b of full rank and L_b = B_b P_b the loop is

    x' = A x - sum_b L_b R_b x(t - tau_b - delta_b(t)),

L and R hold all L_b and R_b beside each other, and R = P R', L = L' S are of full rank again. Then

    h = det M,   N = R' adj(M) L',   M(s) = s I - A + sum_b exp(-s tau_b) L_b R_b,

are sums of exact polynomials times exp(-s T): N_ij = det(M + l_j r_i) - det(M) by the matrix
determinant lemma, and each determinant is polynomial in the numbers z_b = exp(-s tau_b), so that
characteristic polynomials on a grid of whole numbers z give it.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from flint import fmpq, fmpq_mat, fmpq_poly

from railenv.errors import ArgumentError
from railenv.stability.delay_system import DelaySystem
from railenv.stability.proof.characteristic import (
    LARGEST_WORK,
    MOST_POLYNOMIALS,
    exact,
    time_unit,
)
from railenv.units import FloatArray

Matrix = Any
Polynomial = Any

Terms = list[tuple[Polynomial, int]]
"""Polynomials, each with the number of its total delay T."""


@dataclass(frozen=True, eq=False)
class JitterLoop:
    """A loop reduced to the channels that jitter, time in units of `unit`.

    Attributes:
        blocks: Channels of each block; blocks without effect are left out.
        delays: Nominal delay of each block [s].
        A, L, R: Exact matrices, L and R of all blocks beside each other.
        mixers: P_b of each block.
        unit: Unit of time [s], a power of two.
    """

    blocks: tuple[tuple[int, ...], ...]
    delays: tuple[float, ...]
    A: Matrix
    L: Matrix
    R: Matrix
    mixers: tuple[Matrix, ...]
    unit: Any

    @classmethod
    def of(cls, system: DelaySystem, delays: FloatArray, common: bool) -> "JitterLoop":
        """Reduce a retarded loop.

        Args:
            system: The loop.
            delays: Nominal delay of each channel [s].
            common: Whether all channels share one jitter.
        """
        n, m = system.num_states, system.num_channels
        unit = time_unit(system)
        scale = [exact(d) for d in system.state_scale]
        A = fmpq_mat(
            [
                [exact(system.A[i, j]) * unit * scale[j] / scale[i] for j in range(n)]
                for i in range(n)
            ]
        )
        blocks = [(k,) for k in range(m)]
        if common:
            equal = dict.fromkeys(delays.tolist())
            blocks = [tuple(k for k in range(m) if delays[k] == tau) for tau in equal]
        kept: list[tuple[int, ...]] = []
        mixers: list[Matrix] = []
        columns: list[list[Any]] = []
        rows: list[list[Any]] = []
        for block in blocks:
            B = fmpq_mat(
                [[exact(system.B[i, k]) * unit / scale[i] for k in block] for i in range(n)]
            )
            P, R = full_rank(fmpq_mat([[exact(v) for v in system.K[k]] for k in block]))
            if R.nrows() == 0 or B.rank() == 0:
                continue
            kept.append(block)
            mixers.append(P)
            columns += (B * P).transpose().tolist()
            rows += [[v * d for v, d in zip(row, scale, strict=True)] for row in R.tolist()]
        chosen = tuple(float(delays[block[0]]) for block in kept)
        across = fmpq_mat(columns).transpose() if columns else fmpq_mat(n, 0)
        along = fmpq_mat(rows) if rows else fmpq_mat(0, n)
        return cls(tuple(kept), chosen, A, across, along, tuple(mixers), unit)

    @property
    def sizes(self) -> list[int]:
        """Number of reduced channels in each block."""
        return [P.ncols() for P in self.mixers]

    @cached_property
    def factors(self) -> tuple[Matrix, Matrix, Matrix, Matrix]:
        """P, R', L', S with R = P R' and L = L' S, all of full rank."""
        P, R = full_rank(self.R)
        return P, R, *full_rank(self.L)

    @cached_property
    def totals(self) -> list[Any]:
        """Distinct total delays of the terms, exact, in the unit of time."""
        return self._terms[2]

    @property
    def h(self) -> Terms:
        """Terms of det M."""
        return self._terms[0]

    @property
    def response(self) -> list[list[Terms]]:
        """Terms of R' adj(M) L'."""
        return self._terms[1]

    @cached_property
    def _terms(self) -> tuple[Terms, list[list[Terms]], list[Any]]:
        _, R, L, _ = self.factors
        tau = list(dict.fromkeys(t for t in self.delays if t > 0.0))
        starts = [0, *itertools.accumulate(self.sizes)]
        parts: dict[float, Matrix] = {}
        for t, a, b in zip(self.delays, starts[:-1], starts[1:], strict=True):
            effect = _columns(self.L, range(a, b)) * fmpq_mat(self.R.tolist()[a:b])
            parts[t] = parts[t] + effect if t in parts else effect
        ranks = [int(parts[t].rank()) for t in tau]
        count = math.prod(rank + 1 for rank in ranks)
        work = count * (1 + R.nrows() * L.ncols())
        if count > MOST_POLYNOMIALS or work * self.A.nrows() ** 4 > LARGEST_WORK:
            raise ArgumentError(
                f"jitter on {len(tau)} different delays and {self.A.nrows()} states needs {work} "
                "polynomials of that degree; give fewer different delays"
            )
        values: dict[tuple[int, ...], list[Polynomial]] = {}
        updates = [
            _columns(L, [j]) * fmpq_mat([R.tolist()[i]])
            for i in range(R.nrows())
            for j in range(L.ncols())
        ]
        for z in itertools.product(*(range(rank + 1) for rank in ranks)):
            closed = self.A - parts[0.0] if 0.0 in parts else self.A
            for k, t in zip(z, tau, strict=True):
                closed = closed - k * parts[t]
            own = closed.charpoly()
            values[z] = [own, *((closed - update).charpoly() - own for update in updates)]
        for axis, rank in enumerate(ranks):
            values = _interpolated(values, axis, rank + 1)
        exponents = {
            z: sum((k * exact(t) / self.unit for k, t in zip(z, tau, strict=True)), fmpq(0))
            for z in values
        }
        totals = list(dict.fromkeys(exponents.values()))

        def terms(number: int) -> Terms:
            return [
                (ps[number], totals.index(exponents[z]))
                for z, ps in values.items()
                if not ps[number].is_zero()
            ]

        q = L.ncols()
        N = [[terms(1 + i * q + j) for j in range(q)] for i in range(R.nrows())]
        return terms(0), N, totals


def full_rank(matrix: Matrix) -> tuple[Matrix, Matrix]:
    """Factor a matrix exactly: its pivot columns times its reduced echelon form."""
    echelon, rank = matrix.rref()
    rows = echelon.tolist()[:rank]
    pivots = [next(j for j, v in enumerate(row) if v != 0) for row in rows]
    if not rows:
        return fmpq_mat(matrix.nrows(), 0), fmpq_mat(0, matrix.ncols())
    return _columns(matrix, pivots), fmpq_mat(rows)


def _columns(matrix: Matrix, chosen: Sequence[int]) -> Matrix:
    return fmpq_mat([[row[j] for j in chosen] for row in matrix.tolist()])


def _interpolated(
    values: dict[tuple[int, ...], list[Polynomial]], axis: int, size: int
) -> dict[tuple[int, ...], list[Polynomial]]:
    """Turn values at 0, 1, ... along one axis into coefficients of powers along it."""
    inverse = fmpq_mat([[fmpq(x) ** k for k in range(size)] for x in range(size)]).inv()
    found: dict[tuple[int, ...], list[Polynomial]] = {}
    for index in values:
        along = [values[(*index[:axis], x, *index[axis + 1 :])] for x in range(size)]
        found[index] = [
            sum((inverse[index[axis], x] * p for x, p in enumerate(ps)), fmpq_poly([0]))
            for ps in zip(*along, strict=True)
        ]
    return found
