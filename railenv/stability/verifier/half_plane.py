"""Balls that show a quasi-polynomial not to vanish on a piece of a line, for delays in a box."""

from typing import Any

from flint import acb, acb_poly, arb

from railenv.stability.verifier.quasipolynomial import CharacteristicFunction, rational, total

_SERIES = 14
"""Order of the exponential series on a piece."""


def stays_in_half_plane(
    h: CharacteristicFunction,
    start: Any,
    direction: Any,
    ends: tuple[float, float],
    middle: list[Any],
    half: list[Any],
) -> bool:
    """Check that Re(conj(w) h) > 0 on a piece, for some w and all delays within half of middle.

    h is expanded about the centre: constant, linear in t (the place on the piece, from -1 to 1) and
    in each delay, and a bound on all the rest. What holds is said of every line that begins in the
    ball `start`.

    Args:
        h: The function.
        start: Where the line begins.
        direction: Where it goes, of length one.
        ends: The piece's ends on the line.
        middle: Middle of each group's delay, in the unit of time.
        half: Half the width of its interval.
    """
    a, b = (arb(rational(x)) for x in ends)
    centre, step = start + direction * ((a + b) / 2), direction * ((b - a) / 2)
    reach = abs(centre) + abs(step)
    lateral = abs(centre.real) + abs(step.real)
    whole, by_delay = acb_poly(), [acb_poly() for _ in middle]
    rest = arb(0)
    for exponents, p in h.terms:
        T = total(exponents, middle)
        moved = p(acb_poly([centre, step])) * (-centre * T).exp()
        size = sum((abs(c) for c in moved.coeffs()), arb(0))
        x = -step * T
        series, term = [acb(1)], acb(1)
        for k in range(1, _SERIES + 1):
            term = term * x / k
            series.append(term)
        # |e^x - series| <= |x|^(N+1) / (N+1)! e^|x|
        left_out = abs(term) * abs(x) / (_SERIES + 1) * abs(x).exp()
        product = moved * acb_poly(series)
        whole += product
        spread = total(exponents, half)
        for g, k in enumerate(exponents):
            if k:
                by_delay[g] += k * product
        # e^(-s u) = 1 - s u + r, |r| <= |s u|^2 / 2 e^|Re(s) u|
        second = (reach * spread) ** 2 / 2 * (lateral * spread).exp()
        rest += size * (left_out * (1 + reach * spread) + abs(x).exp() * second)
    constant = whole[0]
    if constant.contains(0):
        return False
    linear = [whole[1]]
    rest += sum((abs(c) for c in whole.coeffs()[2:]), arb(0))
    for slope, width in zip(by_delay, half, strict=True):
        moved = slope * acb_poly([centre, step])
        linear.append(moved[0] * width)
        rest += sum((abs(c) for c in moved.coeffs()[1:]), arb(0)) * width
    return _one_side(constant, linear, rest)


def _one_side(constant: Any, linear: list[Any], rest: Any) -> bool:
    """Whether a constant plus linear terms plus a rest stay on one side of a line through zero."""
    linear = [z / constant for z in linear]
    rest = rest / abs(constant)
    directions = [1.0 + 0.0j]
    for z in linear:
        number = complex(z)
        if number != 0:
            normal = 1j * number / abs(number)
            directions.append(normal if normal.real > 0 else -normal)
    for w in directions:
        x, y = arb(w.real), arb(w.imag)
        against = sum((abs(x * z.real + y * z.imag) for z in linear), arb(0))
        if x - against > (x * x + y * y).sqrt() * rest:
            return True
    return False


def one_outweighs(
    h: CharacteristicFunction,
    start: Any,
    direction: Any,
    ends: tuple[float, float],
    shortest: list[Any],
    longest: list[Any],
) -> bool:
    """Whether the polynomial without delay is larger than all others together on a piece."""
    a, b = (arb(rational(x)) for x in ends)
    centre, step = start + direction * ((a + b) / 2), direction * ((b - a) / 2)
    left = -centre.real + abs(step.real)
    own, others = arb(0), arb(0)
    for exponents, p in h.terms:
        sizes = [abs(c) for c in p(acb_poly([centre, step])).coeffs()]
        if not any(exponents):
            own = sizes[0] - sum(sizes[1:], arb(0))
            continue
        # |exp(-s T)| <= exp(left T), which rises or falls in T: it is largest at an end.
        at_ends = [(left * total(exponents, taus)).exp() for taus in (shortest, longest)]
        others += sum(sizes, arb(0)) * at_ends[0].max(at_ends[1])
    return bool(own > others)
