"""Every crossing of the imaginary axis under one common delay, proved.

At a crossing s = j omega, h(s, z) = sum_k p_k(s) z^k = 0 with |z| = 1, and then the reversed
polynomial h*(s, z) = sum_k p_k(-s) z^(r-k) has the same zero z. Their resultant in z is even in s;
with s^2 = -w it is a polynomial R(w) with exact coefficients, and

    R(omega^2) = c |p_r|^(2r) prod_(i,j) (1 - z_i conj z_j),   i, j = 1..r

over the zeros z_i of h(j omega, .). Descartes' rule isolates all its positive zeros: no crossing
is elsewhere. At a simple zero exactly one z_i lies on the circle and it crosses; at a multiple one,
h is split into its irreducible factors over the rationals first (loops side by side), and within
one factor an even zero is a touch, if just one z_i is on the circle. Whatever stays open then is
said to be undecided.

A crossing moves one root and its conjugate, in the direction of the sign of
Re( h_s / (s z h_z) ), the same for all delays (phase + 2 pi k) / omega at which it happens.
"""

from dataclasses import dataclass
from typing import Any

from flint import acb, acb_poly, arb, fmpq, fmpq_poly

from railenv.stability.proof.characteristic import Characteristic
from railenv.stability.proof.polynomials import (
    UndecidedError,
    positive_zeros,
    refined,
    squarefree_factors,
    unstable_zeros,
)
from railenv.stability.proof.precision import precision
from railenv.stability.proof.resultant import irreducible_factors, resultant

Ball = Any
Polynomial = Any

_FIRST_BITS = 320
# Critical delays are enclosed at least this narrowly, so that their doubles are right.
_NARROW = 1e-18
_MOST_BITS = 6144


@dataclass(frozen=True, eq=False)
class ProvedCrossing:
    """A pair of roots on the imaginary axis at the delays (phase + 2 pi k) / frequency.

    Attributes:
        frequency: Ball around omega > 0 [rad/s].
        phase: Ball around omega tau in [0, 2 pi); exactly zero if the root is on the axis without
            delay.
        direction: +1 if the pair turns unstable as the delay grows, -1 if stable, 0 if it touches.
        multiplicity: Number of pairs that do so together (identical loops).
    """

    frequency: Ball
    phase: Ball
    direction: int
    multiplicity: int


@dataclass(frozen=True, eq=False)
class ProvedCrossings:
    """All crossings for every common delay, and the count they start from.

    Attributes:
        crossings: By rising frequency.
        unstable_without_delay: Roots with positive real part without delay.
        marginal: Roots that stay on the imaginary axis whatever the delay (the origin included).
        roots_on_axis_without_delay: Roots on the axis at delay zero that move with the delay.
    """

    crossings: tuple[ProvedCrossing, ...]
    unstable_without_delay: int
    marginal: int
    roots_on_axis_without_delay: int


def proved_crossings(h: Characteristic) -> ProvedCrossings:
    """Find every crossing of a loop whose channels share one delay.

    Raises:
        UndecidedError: Two roots pass the axis in a way that is not told apart, or a root stays at
            s = 0 while another passes there.
    """
    terms = _coefficients(h)
    common = fmpq_poly([0])
    for p in terms:
        common = common.gcd(p)
    fixed_unstable, marginal, _ = unstable_zeros(common)
    terms = [p // common for p in terms]
    without = sum(terms, fmpq_poly([0]))
    if without[0] == 0:
        marginal += _root_at_origin(terms)
    unstable, on_axis, axis_polynomial = unstable_zeros(without)
    on_axis -= int(without[0] == 0)
    crossings = _crossings(terms, axis_polynomial, split=True)
    for crossing in crossings:
        if crossing.phase.is_zero() and crossing.direction == 0:
            raise UndecidedError("a root touches the imaginary axis without delay")
    return ProvedCrossings(
        tuple(sorted(crossings, key=lambda c: float(c.frequency.mid()))),
        fixed_unstable + unstable,
        marginal,
        on_axis,
    )


def _root_at_origin(terms: list[Polynomial]) -> int:
    """Return 1 for a root that stays at s = 0 for every delay and lets no other pass.

    There h_s = sum p_k'(0) - tau sum k p_k(0): where it vanishes, a real root passes the origin.
    """
    constant = sum((p[1] for p in terms), fmpq(0))
    slope = sum((k * p[0] for k, p in enumerate(terms)), fmpq(0))
    if constant == 0 or (slope != 0 and constant / slope > 0):
        raise UndecidedError(
            "a root stays at s = 0 whatever the delay, and another passes it at some delay"
        )
    return 1


def _coefficients(h: Characteristic) -> list[Polynomial]:
    if len(h.groups) != 1:
        raise ValueError("one common delay has one group of channels")
    degree = max(k for (k,) in h.terms)
    return [h.terms.get((k,), fmpq_poly([0])) for k in range(degree + 1)]


def _crossings(
    terms: list[Polynomial], axis_polynomial: Polynomial, split: bool
) -> list[ProvedCrossing]:
    if len(terms) < 2:
        return []
    eliminated = resultant(terms)
    if eliminated.is_zero():
        raise UndecidedError("the loop gain has magnitude one at every frequency")
    found: list[ProvedCrossing] = []
    for factor, power in squarefree_factors(eliminated):
        for interval in positive_zeros(factor):
            if split and power > 1 and _meets_circle(terms, factor, interval):
                return [
                    ProvedCrossing(c.frequency, c.phase, c.direction, c.multiplicity * times)
                    for part, times in irreducible_factors(terms)
                    for c in _crossings(part, _axis_polynomial(part), split=False)
                ]
            crossing = _crossing(terms, factor, power, interval, axis_polynomial)
            if crossing is not None:
                found.append(crossing)
    return found


def _axis_polynomial(terms: list[Polynomial]) -> Polynomial:
    """Return e(omega^2) whose zeros are the roots on the axis without delay."""
    return unstable_zeros(sum(terms, fmpq_poly([0])))[2]


def _meets_circle(terms: list[Polynomial], factor: Any, interval: tuple[Any, Any]) -> bool:
    """Whether a zero z may lie on the circle; if balls exclude it, a pair z_i conj z_j is one."""
    with precision(4 * _FIRST_BITS):
        try:
            roots = _phases(terms, refined(factor, *interval, 4 * _FIRST_BITS).sqrt())
        except UndecidedError:
            return True
        return any(abs(z).contains(1) for z in roots)


def _crossing(
    terms: list[Polynomial],
    factor: Any,
    power: int,
    interval: tuple[Any, Any],
    axis_polynomial: Polynomial,
) -> ProvedCrossing | None:
    """Enclose the crossing or touch at an isolated zero of the resultant; None if it is neither."""
    bits = _FIRST_BITS
    while True:
        with precision(bits):
            try:
                return _enclosed(terms, factor, power, interval, axis_polynomial, bits)
            except UndecidedError:
                if bits >= _MOST_BITS:
                    raise
        bits *= 2


def _enclosed(
    terms: list[Polynomial],
    factor: Any,
    power: int,
    interval: tuple[Any, Any],
    axis_polynomial: Polynomial,
    bits: int,
) -> ProvedCrossing | None:
    w = refined(factor, *interval, bits)
    omega = w.sqrt()
    roots = _phases(terms, omega)
    on_circle = [z for z in roots if abs(z).contains(1)]
    if not on_circle:
        return None
    if len(on_circle) != 1:
        raise UndecidedError("several roots pass the imaginary axis at one frequency")
    z = on_circle[0]
    phase = _phase(z, factor, interval, axis_polynomial)
    if phase.rad() > phase * _NARROW:
        raise UndecidedError("a critical delay is not known to double precision")
    if power == 1:
        return ProvedCrossing(omega, phase, _direction(terms, omega, z), 1)
    others = [u for u in roots if u is not z]
    if any((1 - u * v.conjugate()).contains(0) for u in others for v in roots):
        raise UndecidedError("several roots pass the imaginary axis at one frequency")
    if power % 2 == 0:
        return ProvedCrossing(omega, phase, 0, 1)
    raise UndecidedError("a root crosses the imaginary axis tangentially")


def _phases(terms: list[Polynomial], omega: Ball) -> list[Any]:
    """Return balls around the zeros z of h(j omega, .)."""
    at = acb(0, omega)
    values = [acb_poly(p)(at) for p in terms]
    if values[-1].contains(0):
        raise UndecidedError("the leading coefficient in z vanishes")
    if len(values) == 2:
        return [-values[0] / values[1]]
    polynomial = acb_poly(values)
    try:
        roots = polynomial.roots()
    except ValueError:
        raise UndecidedError("the zeros z are not told apart") from None
    slope = polynomial.derivative()
    return [_narrowed(polynomial, slope, z) for z in roots]


def _narrowed(polynomial: Any, slope: Any, z: Any) -> Any:
    """Narrow an isolated simple zero by interval Newton, as far as the coefficients allow."""
    for _ in range(16):
        steep = slope(z)
        if steep.contains(0):
            return z
        centre = z.mid()
        better = centre - polynomial(centre) / steep
        if not z.contains(better) or better.rad() * 2 > z.rad():
            return z
        z = better
    return z


def _phase(z: Any, factor: Any, interval: tuple[Any, Any], axis: Polynomial) -> Ball:
    """Return omega tau = -arg z in [0, 2 pi), exactly zero for a root on the axis without delay."""
    if z.contains(1):
        shared = fmpq_poly(factor).gcd(axis) if not axis.is_zero() else fmpq_poly([1])
        for part, _ in squarefree_factors(shared):
            low, high = interval
            if _changes_sign(part, low, high):
                return arb(0)
        raise UndecidedError("a phase is not told from zero")
    # The cut of arg lies on the negative numbers: to the left, the angle of -z is taken.
    if z.real > 0:
        angle = -z.arg()
        if angle < 0:
            return angle + 2 * arb.pi()
        if angle > 0:
            return angle
        raise UndecidedError("a phase is not told from zero")
    return arb.pi() - (-z).arg()


def _changes_sign(polynomial: Any, low: Any, high: Any) -> bool:
    """Whether a divisor of a squarefree polynomial has the zero isolated in (low, high)."""
    return bool(polynomial(low) * polynomial(high) < 0)


def _direction(terms: list[Polynomial], omega: Ball, z: Any) -> int:
    s = acb(0, omega)
    by_s, by_z = acb(0), acb(0)
    for k, p in enumerate(terms):
        by_s += acb_poly(p.derivative())(s) * z**k
        if k:
            by_z += k * acb_poly(p)(s) * z**k
    if by_z.contains(0):
        raise UndecidedError("a direction of crossing is not decided")
    value = (by_s / (s * by_z)).real
    if value > 0:
        return 1
    if value < 0:
        return -1
    raise UndecidedError("a direction of crossing is not decided")
