"""How many roots lie to the right of a contour, proved, and that it is so for a box of delays.

The contour runs in the upper half-plane from a point of the real axis to a point s_e so far out
that h(s) = s^n (1 + eps), |eps| < 1, for all |s| >= |s_e| to the right of the contour; its mirror
image closes it. By the argument principle the number of roots to the right is

    N = ( n arg s_e + arg( h(s_e) / s_e^n ) - change of arg h along the contour ) / pi,

a ball that must hold exactly one whole number (for the imaginary axis this is Mikhailov's and
Stepan's criterion). h has no poles, so nothing needs to be known of the plant's own roots.

If moreover h has no zero on the contour for any delays of a box, no root ever passes it, and N is
the same for the whole box.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from flint import acb, arb

from railenv.stability.proof.contour import (
    Box,
    Line,
    Piece,
    Quasipolynomial,
    delay_ball,
    midway,
)
from railenv.stability.proof.polynomials import UndecidedError

_FIRST_PIECE = 0.01
_GROWTH = 1.7
_SHRINK = 0.5
_NARROWEST = 1e-12
# Lengths of contours are doubles.
_LARGEST_EXPONENT = 1000


@dataclass(frozen=True, eq=False)
class Contour:
    """Lines one after the other, each with its length.

    Attributes:
        lines: Straight lines; each starts where the one before ends.
        lengths: Their lengths, doubles.
        degree: n.
    """

    lines: tuple[Line, ...]
    lengths: tuple[float, ...]
    degree: int

    @property
    def end(self) -> Any:
        """s_e."""
        return self.lines[-1].at(self.lengths[-1])


@dataclass
class Effort:
    """What a proof may cost: counted in tests, so that a verdict does not depend on the machine."""

    allowed: int
    spent: int = 0
    progress: Callable[[float], None] | None = field(default=None, repr=False)

    def spend(self) -> None:
        """Count one test.

        Raises:
            UndecidedError: The allowance is used up.
        """
        self.spent += 1
        if self.spent > self.allowed:
            raise UndecidedError(f"the proof needs more than {self.allowed} tests")


def far_radius(h: Quasipolynomial, degree: int, largest: Sequence[Any]) -> float:
    """Return a power of two r such that |h(s) / s^n - 1| < 1 wherever |s| >= r.

    Args:
        h: The function.
        degree: n.
        largest: Bound on |exp(-s T)| for each term over the region in question.

    Raises:
        UndecidedError: There is none: the loop is neutral and its difference part too strong.
    """
    leading = arb(0)
    for p, exponents, size in zip(h.polynomials, h.exponents, largest, strict=True):
        if any(exponents) and p.degree() >= degree:
            leading += abs(p[degree]) * size
    if not leading < 1:
        raise UndecidedError(
            "the loop is neutral: roots come as near to the contour as the difference part says"
        )
    target = (1 + leading) / 2
    exponent = -40
    while exponent <= _LARGEST_EXPONENT:
        radius = arb(2) ** exponent
        total = arb(0)
        for p, exponents, size in zip(h.polynomials, h.exponents, largest, strict=True):
            coefficients = p.coeffs()
            for power, c in enumerate(coefficients):
                if power < degree or any(exponents):
                    total += abs(c) * radius ** (power - degree) * size
        if total < target:
            return float(2.0**exponent)
        exponent += 1
    raise UndecidedError("no bound on the size of unstable roots was found")


def cover(
    h: Quasipolynomial,
    contour: Contour,
    delays: Sequence[Any],
    effort: Effort,
    unit: Any,
    first: float = _FIRST_PIECE,
) -> list[list[float]]:
    """Cut the contour into pieces on each of which h stays in a half-plane, at fixed delays.

    Args:
        h: The function.
        contour: What is to be cut.
        delays: One delay per group, in the polynomials' unit of time.
        effort: What it may cost.
        unit: That unit [s], for messages.
        first: Length of the first piece that is tried.

    Returns:
        For each line the rising ends of its pieces, from 0 to its length.
    """
    zero = [arb(0)] * len(delays)
    found: list[list[float]] = []
    for line, length in zip(contour.lines, contour.lengths, strict=True):
        ends = [0.0]
        size = min(first, length)
        while ends[-1] < length:
            high = min(ends[-1] + size, length)
            effort.spend()
            if Piece(h, line, ends[-1], high).excludes(delays, zero)[0]:
                ends.append(high)
                size = (high - ends[-2]) * _GROWTH
            else:
                size = (high - ends[-1]) * _SHRINK
                if size < _NARROWEST * (min(1.0, length) + ends[-1]):
                    raise UndecidedError(_too_near(line.at(ends[-1]), unit))
        found.append(ends)
    return found


def _too_near(s: Any, unit: Any) -> str:
    place = complex(s / arb(unit))
    return (
        "a root lies on the edge of the region, or nearer to it than is decided: "
        f"near s = {place.real:.6g} {place.imag:+.6g}j 1/s"
    )


def count(
    h: Quasipolynomial, contour: Contour, pieces: Sequence[Sequence[float]], delays: Sequence[Any]
) -> int:
    """Return the number of roots to the right of a contour that has been covered.

    Raises:
        UndecidedError: The ball around the number holds none or several whole numbers.
    """
    change = arb(0)
    last = h.at(contour.lines[0].at(0.0), delays)
    for line, ends in zip(contour.lines, pieces, strict=True):
        for x in ends[1:]:
            value = h.at(line.at(x), delays)
            change += (value / last).arg()
            last = value
    end = contour.end
    ahead = (last / end**contour.degree).arg()
    number = (contour.degree * end.arg() + ahead - change) / arb.pi()
    whole = number.unique_fmpz()
    if whole is None:
        raise UndecidedError("the number of roots is not decided at this precision")
    return int(whole)


def exclude(
    h: Quasipolynomial,
    contour: Contour,
    pieces: Sequence[Sequence[float]],
    box: Box,
    unit: Any,
    effort: Effort,
    suspect: Callable[[Box], None],
) -> list[list[list[int]]]:
    """Prove that h has no zero on the contour for any delays of a box, by bisection.

    Args:
        h: The function.
        contour: Where no zero may be.
        pieces: A first cut of each line.
        box: The delays [s].
        unit: Unit of time of the polynomials [s].
        effort: What it may cost.
        suspect: Called with boxes that have been cut often in vain; may raise to end the search.

    Returns:
        For each line and piece the cuts in preorder: 0 cuts the piece, g + 1 the interval of group
        g, -1 is a leaf on which the test holds.
    """
    shortest = [delay_ball(tau, unit) for tau in box.low]
    longest = [delay_ball(tau, unit) for tau in box.high]
    trees: list[list[list[int]]] = []
    total, done = sum(len(ends) - 1 for ends in pieces), 0
    for line, ends in zip(contour.lines, pieces, strict=True):
        of_line: list[list[int]] = []
        for low, high in itertools.pairwise(ends):
            of_line.append(
                _tree(h, line, (low, high), box, unit, (shortest, longest), effort, suspect)
            )
            done += 1
            if effort.progress is not None:
                effort.progress(done / total)
        trees.append(of_line)
    return trees


def _tree(
    h: Quasipolynomial,
    line: Line,
    ends: tuple[float, float],
    box: Box,
    unit: Any,
    extremes: tuple[list[Any], list[Any]],
    effort: Effort,
    suspect: Callable[[Box], None],
) -> list[int]:
    cuts: list[int] = []
    shortest, longest = extremes
    expanded: dict[tuple[float, float], tuple[Piece, int]] = {}
    work: list[tuple[tuple[float, float], Box, int]] = [(ends, box, 0)]
    while work:
        piece_ends, part, depth = work.pop()
        if piece_ends not in expanded:
            piece = Piece(h, line, *piece_ends)
            state = (
                _DOMINATED
                if piece.dominated(longest, shortest)
                else _SHORTER_WILL_DO * piece.dominated_at_centre(longest, shortest)
            )
            expanded[piece_ends] = piece, state
        piece, state = expanded[piece_ends]
        if state == _DOMINATED:
            cuts.append(-1)
            continue
        effort.spend()
        low = [delay_ball(tau, unit) for tau in part.low]
        high = [delay_ball(tau, unit) for tau in part.high]
        middle = [(a + b) / 2 for a, b in zip(low, high, strict=True)]
        width = [(b - a) / 2 for a, b in zip(low, high, strict=True)]
        holds, shares = piece.excludes(middle, width)
        if holds:
            cuts.append(-1)
            continue
        if depth % _SUSPICIOUS == _SUSPICIOUS - 1:
            suspect(part)
        axis = max(range(len(shares)), key=lambda i: shares[i])
        if state == _SHORTER_WILL_DO:
            axis = 0
        cuts.append(axis)
        if axis == 0:
            middle_x = midway(*piece_ends)
            work.append(((middle_x, piece_ends[1]), part, depth + 1))
            work.append(((piece_ends[0], middle_x), part, depth + 1))
        else:
            below, above = part.halves(axis - 1)
            work.append((piece_ends, above, depth + 1))
            work.append((piece_ends, below, depth + 1))
    return cuts


_SUSPICIOUS = 12
_SHORTER_WILL_DO, _DOMINATED = 1, 2


def double_above(value: Any) -> float:
    """Return a double that is certainly not below a ball."""
    number = float(value.upper())
    while not arb(number) >= value:
        number = math.nextafter(number, math.inf)
    return number


def axis_contour(radius: float, degree: int, shift: Any = 0) -> Contour:
    """Return the vertical line through -shift, far enough up for roots of modulus over `radius`."""
    line = Line(acb(-arb(shift)), acb(0, 1))
    return Contour((line,), (radius,), degree)


def wedge_contour(radius: float, degree: int, damping: Any, height: float) -> Contour:
    """Return the contour around all roots with |Im s| <= height and damping ratio below `damping`.

    It runs from the origin along the ray of that damping ratio, then to the right at that height.
    """
    zeta = arb(damping)
    slope = (1 - zeta * zeta).sqrt()
    # The first line's length is a double; its end is at the height or a rounding above it.
    length = math.nextafter(double_above(arb(height) / slope), math.inf)
    first = Line(acb(0), acb(-zeta, slope))
    return Contour((first, Line(first.at(length), acb(1))), (length, radius + length), degree)
