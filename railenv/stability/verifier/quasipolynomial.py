"""The verifier's own characteristic function, from the numbers of a certificate.

h(s) = det [s I - A, -B; Z K, I + Z F] with z = exp(-s tau) for each group of channels, as exact
polynomials p_k(s): interpolated in the z from exact characteristic polynomials. It is written apart
from the prover's and without its savings (no ranks, no common divisors, no scaling of states).
"""

import itertools
import math
from dataclasses import dataclass
from typing import Any, cast

from flint import acb, acb_poly, arb, fmpq, fmpq_mat, fmpq_poly

MOST_TERMS = 5000
_LONGEST_WHOLE = 1024
_LARGEST_WORK = 4e10
"""Polynomials times operations for each; some minutes."""


class RejectedError(Exception):
    """The evidence does not prove the claim; the text says why."""


def rational(value: Any) -> Any:
    """Return a JSON number as the rational that it is; whole numbers are not rounded to doubles."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise RejectedError(f"{value!r:.40} is not a number")
    if isinstance(value, int):
        if value.bit_length() > _LONGEST_WHOLE:
            raise RejectedError("a whole number is larger than any double")
        return fmpq(value)
    if not math.isfinite(value):
        raise RejectedError(f"{value} is not finite")
    return fmpq(*value.as_integer_ratio())


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


@dataclass(frozen=True, eq=False)
class System:
    """x' = A x + B f, f_i(t) = u_i(t - tau_i), u = -K x - F f, in exact numbers."""

    A: Any
    B: Any
    K: Any
    F: Any

    @classmethod
    def read(cls, plain: Any) -> "System":
        """Read a system's `A`, `B`, `K`, `feedthrough`, lists of rows.

        Raises:
            RejectedError: One of them is no matrix of the right size.
        """
        A = matrix("A", plain["A"])
        n, m = A.nrows(), len(plain["K"])
        if n == 0:
            raise RejectedError("the system has no states")
        return cls(
            A,
            matrix("B", plain["B"], n, m),
            matrix("K", plain["K"], m, n),
            matrix("feedthrough", plain["feedthrough"], m, m),
        )


class CharacteristicFunction:
    """h(s) of a certificate's system for groups of channels that share a delay.

    Args:
        system: The system.
        groups: Channels of each group, every channel once.
        unit: Unit of time, above zero [s].

    Raises:
        RejectedError: There would be too many polynomials, or too large ones.
    """

    def __init__(self, system: System, groups: list[list[int]], unit: Any) -> None:
        A, B, K, F = system.A, system.B, system.K, system.F
        n, m = A.nrows(), K.nrows()
        self.degree, self.unit = n, unit
        sizes = [len(group) for group in groups]
        count = math.prod(size + 1 for size in sizes)
        work = n**4 + n * n * m + (0 if _is_zero(F) else m**4)
        if count > MOST_TERMS or count * work > _LARGEST_WORK:
            raise RejectedError("the certificate is too large to be checked")
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


def _is_zero(F: Any) -> bool:
    return all(value == 0 for value in F.entries())


def _determinant(A: Any, B: Any, K: Any, F: Any, z: list[Any]) -> Any:
    m = len(z)
    if m == 0:
        return A.charpoly()
    ZK = fmpq_mat([[z[k] * K[k, j] for j in range(K.ncols())] for k in range(m)])
    if _is_zero(F):
        return (A - B * ZK).charpoly()
    own = fmpq_mat([[z[k] * F[k, j] + int(k == j) for j in range(m)] for k in range(m)])
    factor = own.det()
    if factor == 0:
        raise RejectedError("the loop is not well posed at a point of the interpolation")
    return factor * (A - B * own.solve(ZK)).charpoly()
