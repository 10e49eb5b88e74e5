"""The verifier's own characteristic function, from the numbers of a certificate.

h(s) = det [s I - A, -B; Z K, I + Z F] with z = exp(-s tau) for each group of channels, as exact
polynomials p_k(s): interpolated in the z from exact characteristic polynomials. It is written apart
from the prover's and without its savings (no ranks, no common divisors, no scaling of states).
"""

import itertools
from typing import Any, cast

from flint import acb, acb_poly, arb, fmpq, fmpq_mat, fmpq_poly

MOST_TERMS = 5000


class RejectedError(Exception):
    """The evidence does not prove the claim; the text says why."""


def rational(value: Any) -> Any:
    """Return a JSON number as the rational that the double is."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise RejectedError(f"{value!r} is not a number")
    return fmpq(*float(value).as_integer_ratio())


def matrix(name: str, rows: Any, height: int | None = None, width: int | None = None) -> Any:
    """Return a list of rows as an exact matrix, with its size checked."""
    if not isinstance(rows, list):
        raise RejectedError(f"{name} is not a list of rows")
    table = cast(list[Any], rows)
    height = len(table) if height is None else height
    width = height if width is None else width
    if len(table) != height or not all(_is_row(row, width) for row in table):
        raise RejectedError(f"{name} must have {height} rows of {width} numbers")
    if height == 0 or width == 0:
        return fmpq_mat(height, width)
    return fmpq_mat([[rational(value) for value in row] for row in table])


def _is_row(row: Any, width: int) -> bool:
    return isinstance(row, list) and len(cast(list[Any], row)) == width


class CharacteristicFunction:
    """h(s) of a certificate's system for groups of channels that share a delay.

    Args:
        system: The system's numbers: `A`, `B`, `K`, `feedthrough` as lists of rows.
        groups: Channels of each group.
        unit: Unit of time, a power of two [s].
    """

    def __init__(self, system: dict[str, Any], groups: list[list[int]], unit: Any) -> None:
        A = matrix("A", system["A"])
        n = A.nrows()
        if n == 0:
            raise RejectedError("the system has no states")
        m = len(system["K"])
        B = matrix("B", system["B"], n, m)
        K = matrix("K", system["K"], m, n)
        F = matrix("feedthrough", system["feedthrough"], m, m)
        if sorted(k for group in groups for k in group) != list(range(m)):
            raise RejectedError("the groups do not hold every channel once")
        self.degree, self.unit = n, unit
        sizes = [len(group) for group in groups]
        total = 1
        for size in sizes:
            total *= size + 1
        if total > MOST_TERMS:
            raise RejectedError("the certificate has too many independent delays to be checked")
        nodes = [[fmpq(1, 3 + 2 * k) for k in range(size + 1)] for size in sizes]
        values: dict[tuple[int, ...], Any] = {}
        for index in itertools.product(*(range(size + 1) for size in sizes)):
            z = [fmpq(0)] * m
            for group, points, i in zip(groups, nodes, index, strict=True):
                for channel in group:
                    z[channel] = points[i]
            values[index] = _determinant(A, B, K, F, z)
        for axis, points in enumerate(nodes):
            inverse = fmpq_mat([[x**k for k in range(len(points))] for x in points]).inv()
            values = {
                index: sum(
                    (
                        inverse[index[axis], i] * values[(*index[:axis], i, *index[axis + 1 :])]
                        for i in range(len(points))
                    ),
                    fmpq_poly([0]),
                )
                for index in values
            }
        # s in the certificate is the true s times the unit: p(s / unit) unit^n stays monic.
        self.exact = {
            k: fmpq_poly([c * unit ** (n - i) for i, c in enumerate(p.coeffs())])
            for k, p in values.items()
            if not p.is_zero()
        }
        self.terms = [(k, acb_poly(p)) for k, p in self.exact.items()]

    def at(self, s: Any, delays: list[Any]) -> Any:
        """Return h(s) for one delay per group, in the unit of time."""
        value: Any = acb(0)
        for exponents, p in self.terms:
            value += cast(Any, p(s) * (-s * total(exponents, delays)).exp())
        return value


def total(exponents: tuple[int, ...], delays: list[Any]) -> Any:
    """Return sum_g k_g tau_g."""
    return sum((k * tau for k, tau in zip(exponents, delays, strict=True)), arb(0))


def _determinant(A: Any, B: Any, K: Any, F: Any, z: list[Any]) -> Any:
    m = len(z)
    if m == 0:
        return A.charpoly()
    ZK = fmpq_mat([[z[k] * K[k, j] for j in range(K.ncols())] for k in range(m)])
    own = fmpq_mat([[z[k] * F[k, j] + int(k == j) for j in range(m)] for k in range(m)])
    factor = own.det()
    if factor == 0:
        raise RejectedError("the loop is not well posed at a point of the interpolation")
    return factor * (A - B * own.solve(ZK)).charpoly()
