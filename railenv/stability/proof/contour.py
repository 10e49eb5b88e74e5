"""A quasi-polynomial along straight lines: proofs that it has no zero there, for delays in a box.

The function is h(s; tau) = sum_k p_k(s) exp(-s sum_g k_g tau_g). On a piece s = c + d t, t in
[-1, 1], of a straight line, with tau_g = middle + u_g, |u_g| <= width_g, it is expanded about the
centre: a constant, linear terms in t and every u_g, and a bound on everything else from the sizes
of the higher coefficients. If some direction w of the complex plane has

    Re(conj(w) a_0) > sum_i |Re(conj(w) a_i)| + |w| rest

then h stays in an open half-plane for the whole piece and the whole box: no zero, and the argument
changes by less than pi, so that its change is the principal value at the ends. Everything is a
ball; floating point only proposes w and the sizes of pieces.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from flint import acb, acb_poly, arb, fmpq

from railenv.stability.proof.characteristic import Characteristic
from railenv.stability.proof.polynomials import UndecidedError

Ball = Any
ComplexBall = Any

_ORDER = 10
"""Order of the expansion in t; what is beyond goes into the bound."""

_FACTORIAL = math.factorial(_ORDER + 1)


@dataclass(frozen=True, eq=False)
class Quasipolynomial:
    """h(s; tau) as balls at the working precision.

    Attributes:
        polynomials: p_k.
        exponents: k_g for each polynomial, one entry per group of channels.
    """

    polynomials: tuple[Any, ...]
    exponents: tuple[tuple[int, ...], ...]

    @classmethod
    def of(cls, h: Characteristic) -> "Quasipolynomial":
        """Take exact polynomials at the working precision."""
        return cls(tuple(acb_poly(p) for p in h.terms.values()), tuple(h.terms))

    def at(self, s: ComplexBall, delays: Sequence[Ball]) -> ComplexBall:
        """Return the value at one point for one delay per group."""
        value = acb(0)
        for p, exponents in zip(self.polynomials, self.exponents, strict=True):
            total = _total(exponents, delays)
            value += p(s) * (-s * total).exp()
        return value

    def slope(self, s: ComplexBall, delays: Sequence[Ball]) -> ComplexBall:
        """Return dh/ds at one point for one delay per group."""
        value = acb(0)
        for p, q, exponents in zip(self.polynomials, self._slopes, self.exponents, strict=True):
            total = _total(exponents, delays)
            value += (q(s) - total * p(s)) * (-s * total).exp()
        return value

    @cached_property
    def _slopes(self) -> tuple[Any, ...]:
        return tuple(p.derivative() for p in self.polynomials)


def _total(exponents: tuple[int, ...], delays: Sequence[Ball]) -> Ball:
    total = arb(0)
    for k, tau in zip(exponents, delays, strict=True):
        if k:
            total += k * tau
    return total


@dataclass(frozen=True, eq=False)
class Box:
    """One interval of delays per group, ends as doubles [s]."""

    low: tuple[float, ...]
    high: tuple[float, ...]

    @property
    def centre(self) -> tuple[float, ...]:
        """The middle, rounded to doubles."""
        return tuple((a + b) / 2 for a, b in zip(self.low, self.high, strict=True))

    @property
    def is_point(self) -> bool:
        """Whether every delay is a single number."""
        return self.low == self.high

    def halves(self, group: int) -> tuple["Box", "Box"]:
        """Cut the box in the middle of one group's interval."""
        middle = (self.low[group] + self.high[group]) / 2
        below = (*self.high[:group], middle, *self.high[group + 1 :])
        above = (*self.low[:group], middle, *self.low[group + 1 :])
        return Box(self.low, below), Box(above, self.high)


@dataclass(frozen=True, eq=False)
class Line:
    """A straight line s = start + direction x, x >= 0, in the unit of time of the polynomials."""

    start: ComplexBall
    direction: ComplexBall

    def at(self, x: float) -> ComplexBall:
        """Return the point at a double x."""
        return self.start + self.direction * arb(x)


class Piece:
    """The quasi-polynomial on one piece of a line, expanded once for all delays.

    Args:
        h: The function.
        line: The line.
        low, high: Ends of the piece on the line.
    """

    def __init__(self, h: Quasipolynomial, line: Line, low: float, high: float) -> None:
        self.h = h
        self.centre = line.start + line.direction * ((arb(low) + arb(high)) / 2)
        self.step = line.direction * ((arb(high) - arb(low)) / 2)
        inner = acb_poly([self.centre, self.step])
        self._head: list[Any] = []
        self._beyond: list[Ball] = []
        self._size: list[Ball] = []
        for p in h.polynomials:
            moved = p(inner)
            sizes = [abs(c) for c in moved.coeffs()]
            self._head.append(acb_poly(moved.coeffs()[: _ORDER + 1]))
            self._beyond.append(_upper(sum(sizes[_ORDER + 1 :], arb(0))))
            self._size.append(_upper(sum(sizes, arb(0))))
        self.reach = _upper(abs(self.centre) + abs(self.step))
        # Rightmost and leftmost real part on the piece decide how large exponentials can be.
        self._left = _upper(-self.centre.real + abs(self.step.real))
        self._real = _upper(abs(self.centre.real) + abs(self.step.real))

    def dominated_at_centre(self, longest: Sequence[Ball], shortest: Sequence[Ball]) -> bool:
        """Whether p_0 alone outweighs all others at the centre: then shorter pieces will do."""
        own, others = arb(0), arb(0)
        for index, exponents in enumerate(self.h.exponents):
            head = self._head[index].coeffs()
            if head and not any(exponents):
                own = abs(head[0])
            elif head:
                others += abs(head[0]) * self._largest(exponents, longest, shortest)
        return bool(own > others)

    def dominated(self, longest: Sequence[Ball], shortest: Sequence[Ball]) -> bool:
        """Whether p_0 alone outweighs all other terms, for every delay up to the longest."""
        own, others = arb(0), arb(0)
        for index, exponents in enumerate(self.h.exponents):
            if not any(exponents):
                head = self._head[index].coeffs()
                if not head:
                    return False
                own = 2 * abs(head[0]) - self._size[index]
            else:
                others += self._size[index] * self._largest(exponents, longest, shortest)
        return bool(own > others)

    def _largest(
        self, exponents: tuple[int, ...], longest: Sequence[Ball], shortest: Sequence[Ball]
    ) -> Ball:
        """Bound |exp(-s T)| over the piece for all T between two totals."""
        ends = longest if self._left > 0 else shortest
        return _upper((self._left * _total(exponents, ends)).exp())

    def excludes(self, middle: Sequence[Ball], width: Sequence[Ball]) -> tuple[bool, list[float]]:
        """Test for zeros on the piece with delays in a box.

        Args:
            middle: Middle of each group's delay, unit of the polynomials.
            width: Half-width of each group's delay.

        Returns:
            Whether there is provably none, and the share of the sum that each direction (t, then
            every group) takes, for the choice where to cut.
        """
        groups = len(middle)
        value = acb_poly()
        slopes = [acb_poly() for _ in range(groups)]
        rest, cross = arb(0), [arb(0)] * groups
        curved = [arb(0)] * groups
        for index, exponents in enumerate(self.h.exponents):
            total = _total(exponents, middle)
            head = self._head[index]
            x = -self.step * total
            size_x = _upper(abs(x))
            series, term = [acb(1)], acb(1)
            for k in range(1, _ORDER + 1):
                term = term * x / k
                series.append(term)
            ahead = (-self.centre * total).exp()
            ahead_size = _upper(abs(ahead))
            largest = _upper(size_x.exp())
            product = head * acb_poly(series) * ahead
            value += product
            # Truncated exponential, and polynomial coefficients left out.
            beyond = size_x ** (_ORDER + 1) / arb(_FACTORIAL) * largest
            rest += ahead_size * (self._size[index] * beyond + self._beyond[index] * largest)
            spread = arb(0)
            for g, k in enumerate(exponents):
                if k and not width[g].is_zero():
                    slopes[g] += k * product
                    cross[g] += (
                        ahead_size
                        * largest
                        * k
                        * (self._size[index] * beyond + self._beyond[index])
                    )
                    spread += k * width[g]
            if not spread.is_zero():
                y = self.reach * spread
                growth = (self._real * spread).exp()
                second = ahead_size * largest * self._size[index] * y * y / 2 * growth
                rest += second
                for g, k in enumerate(exponents):
                    if k:
                        curved[g] += second * k * width[g] / spread
        inside, shares = self._half_plane(value, slopes, rest, cross, width)
        if value.coeffs() and not value[0].contains(0):
            scale = abs(value[0])
            shares = [
                shares[0],
                *(s + float(_upper(c / scale)) for s, c in zip(shares[1:], curved, strict=True)),
            ]
        return inside, shares

    def _half_plane(
        self, value: Any, slopes: list[Any], rest: Ball, cross: list[Ball], width: Sequence[Ball]
    ) -> tuple[bool, list[float]]:
        coefficients = value.coeffs()
        groups = len(width)
        if not coefficients or coefficients[0].contains(0):
            return False, [1.0] * (groups + 1)
        a0 = coefficients[0]
        linear = [(coefficients[1] if len(coefficients) > 1 else acb(0)) / a0]
        scale = abs(a0)
        shares = [sum((abs(c) for c in coefficients[2:]), arb(0)) / scale]
        remaining = rest / scale
        inner = acb_poly([self.centre, self.step])
        for g in range(groups):
            if width[g].is_zero():
                linear.append(acb(0))
                shares.append(arb(0))
                continue
            # -s u_g G_g(t): constant part linear in u_g, the rest bilinear in (t, u_g).
            slope = (slopes[g] * inner).coeffs()
            linear.append((slope[0] if slope else acb(0)) * width[g] / a0)
            mixed = sum((abs(c) for c in slope[1:]), arb(0)) + self.reach * cross[g]
            shares.append(mixed * width[g] / scale)
        bound = remaining + sum(shares, arb(0))
        w = _direction([complex(z) for z in linear])
        re, im = arb(w.real), arb(w.imag)
        projected = [abs(re * z.real + im * z.imag) for z in linear]
        inside = re - sum(projected, arb(0)) > (re * re + im * im).sqrt() * bound
        return bool(inside), [float(_upper(p + s)) for p, s in zip(projected, shares, strict=True)]


def _upper(value: Ball) -> Ball:
    return value.abs_upper() if value > 0 or value.contains(0) else value.upper()


def _direction(linear: list[complex]) -> complex:
    """Propose the direction in which 1 stays farthest ahead of the linear terms."""
    candidates = [1.0 + 0.0j]
    for z in linear:
        if abs(z) > 0.0:
            normal = 1j * z / abs(z)
            candidates.append(normal if normal.real > 0 else -normal)

    def ahead(w: complex) -> float:
        return w.real - sum(abs((w.conjugate() * z).real) for z in linear)

    return max(candidates, key=ahead)


def delay_ball(delay: float, unit: Any) -> Ball:
    """Return a delay [s] in the polynomials' unit of time: exact, the unit is a power of two."""
    return arb(fmpq(*float(delay).as_integer_ratio()) / unit)


def midway(low: float, high: float) -> float:
    """Return the double between two doubles where a piece is cut.

    Raises:
        UndecidedError: There is none.
    """
    middle = (low + high) / 2
    if not low < middle < high:
        raise UndecidedError("pieces of a line have become as short as doubles can say")
    return middle
