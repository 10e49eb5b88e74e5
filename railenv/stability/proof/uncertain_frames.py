"""A family of delay systems in a basis: M(s) over a part of all variables, to first order.

M = s I - A + sum_g z_g B_g K_g with z_g = exp(-s tau_g) for each group g of channels. A part is
a piece of the contour with intervals of delays and parameters. W M V is written as a centre, one
line per variable and a bound on the rest; the lines keep what is of first order with its direction.

The same formulas run in floats, which propose, and in balls, which prove.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from flint import acb, acb_mat, arb, arb_mat

from railenv.stability.proof.polynomials import UndecidedError
from railenv.stability.uncertain import NAMES, UncertainDelaySystem
from railenv.units import ComplexArray, FloatArray

Matrix = Any
"""An array in floats, an `arb_mat` or `acb_mat` in balls."""
Number = Any

BASIS_BITS = 24
"""Entries of V are whole multiples of 2^-BASIS_BITS: short to write down, good enough for any W."""


class Floats:
    """Arithmetic that proposes."""

    def real(self, value: float) -> Number:
        """Return a real number."""
        return value

    def complex(self, re: Number, im: Number) -> Number:
        """Return a complex number."""
        return complex(re, im)

    def exp(self, value: Number) -> Number:
        """Return the exponential."""
        with np.errstate(all="ignore"):
            return np.exp(value)

    def real_matrix(self, values: FloatArray) -> Matrix:
        """Return a real matrix."""
        return values

    def complex_matrix(self, values: ComplexArray) -> Matrix:
        """Return a complex matrix."""
        return values

    def product(self, left: Matrix, right: Matrix) -> Matrix:
        """Return a matrix product."""
        return left @ right

    def inverse(self, matrix: Matrix) -> Matrix:
        """Return the inverse."""
        return np.asarray(np.linalg.inv(matrix), dtype=np.complex128)

    def size(self, matrix: Matrix) -> Matrix:
        """Return the moduli of the entries."""
        return np.abs(matrix)


class Balls:
    """The same arithmetic in balls at the working precision: it proves."""

    def real(self, value: float) -> Number:
        """Return a real number."""
        return arb(value)

    def complex(self, re: Number, im: Number) -> Number:
        """Return a complex number."""
        return acb(re, im)

    def exp(self, value: Number) -> Number:
        """Return the exponential."""
        return value.exp()

    def real_matrix(self, values: FloatArray) -> Matrix:
        """Return a real matrix."""
        rows, columns = values.shape
        return arb_mat(rows, columns, [arb(v) for v in values.ravel().tolist()])

    def complex_matrix(self, values: ComplexArray) -> Matrix:
        """Return a complex matrix."""
        rows, columns = values.shape
        return acb_mat(rows, columns, [acb(v) for v in values.ravel().tolist()])

    def product(self, left: Matrix, right: Matrix) -> Matrix:
        """Return a matrix product."""
        return left * right

    def inverse(self, matrix: Matrix) -> Matrix:
        """Return the inverse; raises ZeroDivisionError if it cannot be enclosed."""
        return matrix.inv()

    def size(self, matrix: Matrix) -> Matrix:
        """Return the moduli of the entries."""
        return arb_mat(matrix.nrows(), matrix.ncols(), [abs(v) for v in matrix.entries()])


@dataclass(frozen=True)
class Part:
    """Intervals of all variables: frequency on the contour, one delay per group, parameters."""

    low: tuple[float, ...]
    high: tuple[float, ...]

    @property
    def centre(self) -> tuple[float, ...]:
        """The middle, rounded to doubles."""
        return tuple((a + b) / 2 for a, b in zip(self.low, self.high, strict=True))

    def halves(self, axis: int) -> tuple["Part", "Part"]:
        """Cut one interval in the middle."""
        middle = self.centre[axis]
        below = (*self.high[:axis], middle, *self.high[axis + 1 :])
        above = (*self.low[:axis], middle, *self.low[axis + 1 :])
        return Part(self.low, below), Part(above, self.high)

    def shrunk(self, axis: int) -> "Part":
        """Halve one interval about its middle."""
        a, b, c = self.low[axis], self.high[axis], self.centre[axis]
        low = (*self.low[:axis], (a + c) / 2, *self.low[axis + 1 :])
        return Part(low, (*self.high[:axis], (c + b) / 2, *self.high[axis + 1 :]))


@dataclass(frozen=True, eq=False)
class Blocks:
    """What belongs to A, and by group of channels to B and to K."""

    A: Matrix
    B: list[Matrix]
    K: list[Matrix]


class Scaled:
    """A family with states scaled by powers of two, in one arithmetic, channels in groups.

    Args:
        arithmetic: `Floats` or `Balls`.
        family: The family.
        groups: Channels that share a delay.
        decay_rate: The contour is Re s = -decay_rate.

    Raises:
        UndecidedError: The entries differ so much that scaling them is not exact.
    """

    def __init__(
        self,
        arithmetic: Floats | Balls,
        family: UncertainDelaySystem,
        groups: Sequence[Sequence[int]],
        decay_rate: float,
    ) -> None:
        self.arithmetic, self.decay_rate = arithmetic, decay_rate
        self.num_states, self.num_groups = family.nominal.num_states, len(groups)
        scale = family.nominal.state_scale
        factors = (scale / scale[:, None], 1.0 / scale[:, None], scale[None, :])

        def blocks(values: Sequence[FloatArray]) -> Blocks:
            A, B, K = (_scaled(v, f) for v, f in zip(values, factors, strict=True))
            return Blocks(
                arithmetic.real_matrix(A),
                [arithmetic.real_matrix(B[:, list(g)]) for g in groups],
                [arithmetic.real_matrix(K[list(g)]) for g in groups],
            )

        self.middle = blocks([getattr(family.nominal, name) for name in NAMES])
        self.radius = blocks([getattr(family, f"{name}_radius") for name in NAMES])
        self.directions = [blocks(direction) for direction in family.directions]
        self.eye = arithmetic.complex_matrix(np.eye(self.num_states, dtype=np.complex128))

    def largest_exponential(self, low: float, high: float) -> Number:
        """Return a bound on |exp(-s tau)| right of the contour, tau in an interval."""
        rate, tau = self.decay_rate, high if self.decay_rate > 0.0 else low
        return self.arithmetic.exp(self.arithmetic.real(rate) * self.arithmetic.real(tau))

    def sizes(self, low: Sequence[float], high: Sequence[float]) -> Matrix:
        """Return S >= |A - sum_g z_g B_g K_g| for all members, delays and s past the contour."""
        size, product = self.arithmetic.size, self.arithmetic.product
        total = size(self.middle.A) + self.radius.A
        for direction in self.directions:
            total = total + size(direction.A)
        for g in range(self.num_groups):
            left, right = size(self.middle.B[g]) + self.radius.B[g], self.radius.K[g]
            right = right + size(self.middle.K[g])
            for direction in self.directions:
                left, right = left + size(direction.B[g]), right + size(direction.K[g])
            total = total + product(left, right) * self.largest_exponential(low[g], high[g])
        return total


def _scaled(values: FloatArray, factor: FloatArray) -> FloatArray:
    with np.errstate(all="ignore"):
        moved = values * factor
        if not np.array_equal(moved / factor, values):
            raise UndecidedError("the entries of the matrices differ by too many powers of ten")
    return moved


class Frame:
    """A family seen in a basis: W (...) V with W the inverse of V.

    Args:
        family: The family in some arithmetic.
        basis: V as whole multiples of 2^-BASIS_BITS.
    """

    def __init__(self, family: Scaled, basis: ComplexArray) -> None:
        self.family, self.basis = family, basis
        arithmetic = family.arithmetic
        product, size = arithmetic.product, arithmetic.size
        V = arithmetic.complex_matrix(basis)
        W = arithmetic.inverse(V)

        def seen(blocks: Blocks, left: Matrix, right: Matrix) -> Blocks:
            return Blocks(
                product(product(left, blocks.A), right),
                [product(left, B) for B in blocks.B],
                [product(K, right) for K in blocks.K],
            )

        self.middle = seen(family.middle, W, V)
        self.directions = [seen(direction, W, V) for direction in family.directions]
        self.radius = seen(family.radius, size(W), size(V))

    def terms(self, part: Part, *, free: bool) -> tuple[Matrix, list[Matrix], Matrix]:
        """Return centre C, lines L_v and rest R with W M V in C + sum_v [-1, 1] L_v + [R].

        The brackets stand for: entries of modulus at most R's.

        Args:
            part: Intervals of frequency, delays, parameters.
            free: Take the exponentials as any numbers up to their largest modulus.
        """
        arithmetic = self.family.arithmetic
        real, product, size = arithmetic.real, arithmetic.product, arithmetic.size
        groups, rate = self.family.num_groups, real(self.family.decay_rate)
        ends = [(real(a), real(b)) for a, b in zip(part.low, part.high, strict=True)]
        middles = [(a + b) / 2 for a, b in ends]
        halves = [(b - a) / 2 for a, b in ends]
        omega, step = middles[0], halves[0]
        parameters, reach = middles[1 + groups :], halves[1 + groups :]
        s, j = arithmetic.complex(-rate, omega), arithmetic.complex(real(0.0), real(1.0))

        centre, rest = self.family.eye * s - self.middle.A, self.radius.A
        for p, direction in zip(parameters, self.directions, strict=True):
            centre = centre - direction.A * p
        along = self.family.eye * j
        lines: list[Matrix] = []
        turned = [direction.A * -1 for direction in self.directions]
        for g in range(groups):
            tau, half = middles[1 + g], halves[1 + g]
            left, right = self.middle.B[g], self.middle.K[g]
            left_more, right_more = size(left) * 0, size(right) * 0
            for p, r, direction in zip(parameters, reach, self.directions, strict=True):
                left, right = left + direction.B[g] * p, right + direction.K[g] * p
                left_more = left_more + size(direction.B[g]) * r
                right_more = right_more + size(direction.K[g]) * r
            loop = product(left, right)
            # What is of second order in parameters, or moves by itself.
            second = (
                product(left_more, right_more)
                + product(self.radius.B[g], size(right) + right_more + self.radius.K[g])
                + product(size(left) + left_more, self.radius.K[g])
            )
            largest = self.family.largest_exponential(part.low[1 + g], part.high[1 + g])
            if free:
                z, beyond, change = arithmetic.complex(real(0.0), real(0.0)), largest, largest
            else:
                # exp(y) = 1 + y + r, |r| <= |y|^2 / 2 max(1, exp(Re y)), y = s_c tau_c - s tau.
                z = arithmetic.exp(-s * tau)
                far = abs(s) * half + step * (tau + half)
                growth = arithmetic.exp(abs(rate) * half)
                beyond = abs(z) * (step * half + far * far * growth / 2)
                change = abs(z) * far * growth
                centre = centre + loop * z
                along = along - loop * (j * tau * z)
                lines.append(loop * (-s * z * half))
            rest = rest + size(loop) * beyond + second * largest
            for k, (r, direction) in enumerate(zip(reach, self.directions, strict=True)):
                tied = product(direction.B[g], right) + product(left, direction.K[g])
                rest = rest + size(tied) * (r * change)
                if not free:
                    turned[k] = turned[k] + tied * z
        lines.append(along * step)
        lines += [line * r for line, r in zip(turned, reach, strict=True)]
        return centre, lines, rest
