"""The characteristic function of a delay system as exact polynomials.

With f_i(t) = u_i(t - tau_i), u = -K x - F f and channels gathered in groups of one delay each,
z_g = exp(-s tau_g), the roots are the zeros of

    h(s, z) = det [ s I - A   -B      ]  =  sum_k p_k(s) prod_g z_g^(k_g)
                  [   Z K      I + Z F ]

The degree in z_g is at most the rank of that group's part of B K (of its channels where F is not
zero). The p_k are found exactly: characteristic polynomials of rational matrices on a grid of whole
numbers z, then interpolation. p_0 = det(s I - A) is monic; without F all others have lower degree.

Time is counted in a unit near the system's own (a power of two), which changes no root's place but
keeps the polynomials' coefficients near each other: s here is the true s times `unit`.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from flint import fmpq, fmpq_mat, fmpq_poly

from railenv.errors import ArgumentError
from railenv.stability.delay_system import DelaySystem

MOST_POLYNOMIALS = 1100
"""Largest number of characteristic polynomials: ten independent channels."""

LARGEST_WORK = 4e9
"""Largest number of polynomials times states^4; some minutes."""

_MOST_SCALES = 40

Rational = Any
Polynomial = Any


@dataclass(frozen=True, eq=False)
class Characteristic:
    """h(s, z) = sum_k p_k(s) prod_g z_g^(k_g), exactly.

    Attributes:
        terms: p_k by exponents k (one entry per group), zero polynomials left out.
        groups: Channels of each group.
        unit: Unit of time [s], a power of two; s here is the true s times this.
        degree: Number of states n, the degree of p_0.
    """

    terms: dict[tuple[int, ...], Polynomial]
    groups: tuple[tuple[int, ...], ...]
    unit: Rational
    degree: int

    @property
    def without_delay(self) -> Polynomial:
        """q(s) = h(s, 1), the characteristic polynomial without delay."""
        return sum(self.terms.values(), fmpq_poly([0]))


def characteristic(system: DelaySystem, groups: Sequence[Sequence[int]]) -> Characteristic:
    """Return the characteristic function of a system whose channels share delays in groups.

    Args:
        system: The loop, neutral ones included.
        groups: Channels of each group; channels left out are taken without delay.

    Raises:
        ArgumentError: So many groups that the polynomials cannot be computed in reasonable time.
    """
    unit = time_unit(system)
    n, m = system.num_states, system.num_channels
    # Powers of two: exact, and the rationals stay short.
    scale = [exact(d) for d in system.state_scale]
    A = fmpq_mat(
        [[exact(system.A[i, j]) * unit * scale[j] / scale[i] for j in range(n)] for i in range(n)]
    )
    if m == 0:
        return Characteristic(
            {(0,) * len(groups): A.charpoly()}, tuple(tuple(g) for g in groups), unit, n
        )
    B = fmpq_mat([[exact(system.B[i, k]) * unit / scale[i] for k in range(m)] for i in range(n)])
    K = fmpq_mat([[exact(system.K[k, j]) * scale[j] for j in range(n)] for k in range(m)])
    F = fmpq_mat([[exact(system.feedthrough[k, j]) for j in range(m)] for k in range(m)])
    ranks = [_rank(B, K, group) if not system.neutral else len(group) for group in groups]
    # A group without any effect stays out of sight: its exponent is always zero.
    count = math.prod(rank + 1 for rank in ranks)
    if count > MOST_POLYNOMIALS or count * n**4 > LARGEST_WORK:
        raise ArgumentError(
            f"{len(groups)} different delays on {n} states need {count} polynomials of that "
            "degree; give fewer different delays"
        )
    nodes = _nodes(F, groups, ranks, m)
    values: dict[tuple[int, ...], Polynomial] = {}
    for index in itertools.product(*(range(rank + 1) for rank in ranks)):
        z = [fmpq(1)] * m
        for group, points, position in zip(groups, nodes, index, strict=True):
            for channel in group:
                z[channel] = points[position]
        values[index] = _determinant(A, B, K, F, z)
    for axis, points in enumerate(nodes):
        values = _interpolate(values, axis, points)
    terms = {k: p for k, p in values.items() if not p.is_zero()}
    return Characteristic(terms, tuple(tuple(g) for g in groups), unit, n)


def time_unit(system: DelaySystem) -> Rational:
    """Return a power of two near the inverse of the loop's size [s]; 1 for a loop of zeros."""
    scaled = system.scaled
    size = float(np.abs(scaled.A).max(initial=0.0) + np.abs(scaled.B @ scaled.K).max(initial=0.0))
    if not (0.0 < size < math.inf):
        return fmpq(1)
    # Roots are smaller than the matrices' norm; its square root of a typical spread is not known,
    # and none is needed: the unit only keeps numbers short.
    exponent = -round(math.log2(size)) // 2
    return fmpq(2) ** exponent


def exact(value: float) -> Rational:
    """Return a double as the rational number it is."""
    return fmpq(*float(value).as_integer_ratio())


def _rank(B: Any, K: Any, group: Sequence[int]) -> int:
    columns = fmpq_mat([[B[i, k] for k in group] for i in range(B.nrows())])
    rows = fmpq_mat([[K[k, j] for j in range(K.ncols())] for k in group])
    return int((columns * rows).rank())


def _determinant(A: Any, B: Any, K: Any, F: Any, z: list[Rational]) -> Polynomial:
    """Return h(., z) for numbers z: det(I + Z F) charpoly(A - B (I + Z F)^-1 Z K)."""
    m = len(z)
    ZK = fmpq_mat([[z[k] * K[k, j] for j in range(K.ncols())] for k in range(m)])
    I_ZF = fmpq_mat([[z[k] * F[k, j] + (1 if k == j else 0) for j in range(m)] for k in range(m)])
    through = I_ZF.det()
    return through * (A - B * I_ZF.solve(ZK)).charpoly()


def _nodes(
    F: Any, groups: Sequence[Sequence[int]], ranks: list[int], m: int
) -> list[list[Rational]]:
    """Return the points z of each group; none makes I + Z F singular."""
    scale = fmpq(1)
    for _ in range(_MOST_SCALES):
        nodes = [[scale * k for k in range(rank + 1)] for rank in ranks]
        # det(I + Z F) is a polynomial in the scale that is 1 at zero: small scales avoid its zeros.
        if all(F[i, j] == 0 for i in range(m) for j in range(m)) or _all_regular(
            F, groups, nodes, m
        ):
            return nodes
        scale = scale * fmpq(3, 7)
    raise ArgumentError("feedthrough makes I + F singular: the loop is not well posed")


def _all_regular(
    F: Any, groups: Sequence[Sequence[int]], nodes: list[list[Rational]], m: int
) -> bool:
    for combination in itertools.product(*nodes):
        z = [fmpq(1)] * m
        for group, value in zip(groups, combination, strict=True):
            for channel in group:
                z[channel] = value
        matrix = [[z[k] * F[k, j] + (1 if k == j else 0) for j in range(m)] for k in range(m)]
        if fmpq_mat(matrix).det() == 0:
            return False
    return True


def _interpolate(
    values: dict[tuple[int, ...], Polynomial], axis: int, points: list[Rational]
) -> dict[tuple[int, ...], Polynomial]:
    """Turn values at points along one axis into coefficients of powers along it."""
    size = len(points)
    powers = fmpq_mat([[x**k for k in range(size)] for x in points]).inv()
    found: dict[tuple[int, ...], Polynomial] = {}
    for index in values:
        k = index[axis]
        found[index] = sum(
            (
                powers[k, row] * values[(*index[:axis], row, *index[axis + 1 :])]
                for row in range(size)
            ),
            fmpq_poly([0]),
        )
    return found
