"""Re-checks certificates for constant delays in a box.

What is recomputed: the characteristic function from the matrices; the bound beyond which no root
can be; on every piece of the contour and every part of the box, that the function stays in a
half-plane; the number of roots from the change of argument. What is taken from the certificate:
only where the contour and the box are cut.
"""

import math
from typing import Any

import flint
from flint import acb, acb_poly, arb

from railenv.stability.verifier.crossings import check_no_crossing
from railenv.stability.verifier.quasipolynomial import (
    CharacteristicFunction,
    RejectedError,
    rational,
    total,
)

_SERIES = 14
"""Order of the exponential series on a piece."""

_MOST_BITS = 1 << 14


def check_delay_box(certificate: dict[str, Any]) -> None:
    """Check a certificate whose claim is of the kind "delay box".

    Raises:
        RejectedError: It proves nothing.
    """
    claim, evidence = certificate["claim"], certificate["evidence"]
    groups, low, high = claim["groups"], claim["low"], claim["high"]
    _check_box(claim)
    if evidence.get("method") == "neutral":
        _check_neutral(certificate)
        return
    delays = evidence["delays"]
    if len(delays) != len(groups) or not all(
        a <= tau <= b for a, tau, b in zip(low, delays, high, strict=True)
    ):
        raise RejectedError("the delays of the evidence are not in the box of the claim")
    region, asked = evidence["region"], claim["region"]
    stable = certificate["verdict"] == "STABLE"
    if region != asked and (
        stable
        or region["damping_ratio"] is not None
        or asked["damping_ratio"] is not None
        or not region["decay_rate"] <= asked["decay_rate"]
    ):
        raise RejectedError("the evidence is about another region than the claim")
    before = flint.ctx.prec
    flint.ctx.prec = _bits(evidence["bits"]) + 32
    try:
        h, lines = contour(certificate["system"], groups, high if stable else delays, evidence)
        roots = count_roots(h, lines, evidence)
        if roots != certificate["unstable_roots"]:
            raise RejectedError(
                f"there are {roots} roots in the region, not {certificate['unstable_roots']}"
            )
        if stable != (roots == 0):
            raise RejectedError(
                f"{roots} roots in the region do not make it {certificate['verdict']}"
            )
        if stable and low != high:
            if evidence["method"] == "crossings":
                if region["damping_ratio"] is not None or region["decay_rate"] != 0:
                    raise RejectedError("crossings are those of the imaginary axis")
                check_no_crossing(h, low, high)
            else:
                _check_cuts(h, lines, evidence, low, high)
    finally:
        flint.ctx.prec = before


def _check_box(claim: dict[str, Any]) -> None:
    groups, low, high = claim["groups"], claim["low"], claim["high"]
    if not len(groups) == len(low) == len(high):
        raise RejectedError("the claim has not one interval of delays per group of channels")
    for group, a, b in zip(groups, low, high, strict=True):
        if not 0 <= rational(a) <= rational(b):
            raise RejectedError(f"[{a}, {b}] is no interval of delays")
        if len(group) > 1 and len(groups) > 1 and a != b:
            raise RejectedError("channels with intervals of their own are held together")


def _bits(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 64 <= value <= _MOST_BITS:
        raise RejectedError(f"bits = {value!r} is no precision")
    return value


Line = tuple[Any, Any, list[float]]
"""Start, direction and rising ends of the pieces."""


def contour(
    system: dict[str, Any], groups: list[list[int]], longest: list[float], evidence: dict[str, Any]
) -> tuple[CharacteristicFunction, list[Line]]:
    """Rebuild function and contour, and check that nothing can be beyond the contour.

    Args:
        system: The system's numbers.
        groups: Channels of each group.
        longest: Longest delay of each group [s].
        evidence: With `unit`, `region` and `pieces`.
    """
    unit = rational(evidence["unit"])
    if not unit > 0:
        raise RejectedError("the unit of time is not above zero")
    h = CharacteristicFunction(system, groups, unit)
    region, pieces = evidence["region"], evidence["pieces"]
    for ends in pieces:
        if len(ends) < 2 or ends[0] != 0 or any(not a < b for a, b in zip(ends, ends[1:])):  # noqa: B905, RUF007
            raise RejectedError("the pieces of a line do not follow each other from its start")
    if region["damping_ratio"] is None:
        if len(pieces) != 1:
            raise RejectedError("a vertical line is one line")
        shift = arb(rational(region["decay_rate"]) * unit)
        lines: list[Line] = [(acb(-shift), acb(0, 1), pieces[0])]
        radius = arb(rational(pieces[0][-1]))
        growth = shift if shift > 0 else arb(0)
    else:
        if len(pieces) != 2:
            raise RejectedError("a wedge has two lines")
        zeta = arb(rational(region["damping_ratio"]))
        slope = (1 - zeta * zeta).sqrt()
        corner = acb(-zeta, slope) * arb(rational(pieces[0][-1]))
        height = 2 * arb.pi() * arb(rational(region["max_frequency_hz"])) * arb(unit)
        if not corner.imag >= height:
            raise RejectedError("the contour ends below the frequency of the claim")
        lines = [(acb(0), acb(-zeta, slope), pieces[0]), (corner, acb(1), pieces[1])]
        radius = corner.real + arb(rational(pieces[1][-1]))
        growth = arb(0)
    if not radius > 0:
        raise RejectedError("the contour does not reach beyond all roots")
    taus = [arb(rational(tau) / unit) for tau in longest]
    rest = arb(0)
    for exponents, p in h.terms:
        size = (growth * total(exponents, taus)).exp()
        for power, c in enumerate(p.coeffs()):
            if any(exponents) or power < h.degree:
                rest += abs(c) * radius ** (power - h.degree) * size
    if not rest < 1:
        raise RejectedError("the contour does not reach beyond all roots")
    return h, lines


def count_roots(h: CharacteristicFunction, lines: list[Line], evidence: dict[str, Any]) -> int:
    """Return the number of roots to the right of the contour at the evidence's delays."""
    delays = [arb(rational(tau) / h.unit) for tau in evidence["delays"]]
    none = [arb(0)] * len(delays)
    start, _, _ = lines[0]
    last, change, place = h.at(start, delays), arb(0), start
    for start, direction, ends in lines:
        for low, high in zip(ends, ends[1:]):  # noqa: B905, RUF007
            if not stays_in_half_plane(h, start, direction, (low, high), delays, none):
                raise RejectedError(f"the function may vanish between x = {low} and {high}")
            place = start + direction * arb(rational(high))
            value = h.at(place, delays)
            change += (value / last).arg()
            last = value
    turns = h.degree * place.arg() + (last / place**h.degree).arg() - change
    whole = (turns / arb.pi()).unique_fmpz()
    if whole is None:
        raise RejectedError("the number of roots is not decided")
    return int(whole)


def _check_cuts(
    h: CharacteristicFunction,
    lines: list[Line],
    evidence: dict[str, Any],
    low: list[float],
    high: list[float],
) -> None:
    """Walk the cuts of every piece and check each leaf."""
    cuts = evidence["cuts"]
    if len(cuts) != len(lines):
        raise RejectedError("the cuts are not one list per line")
    for (start, direction, ends), of_line in zip(lines, cuts, strict=True):
        if len(of_line) != len(ends) - 1:
            raise RejectedError("the cuts are not one tree per piece")
        for a, b, tree in zip(ends[:-1], ends[1:], of_line, strict=True):
            _check_tree(h, start, direction, (a, b), list(tree), low, high)


def _check_tree(
    h: CharacteristicFunction,
    start: Any,
    direction: Any,
    ends: tuple[float, float],
    tree: list[int],
    low: list[float],
    high: list[float],
) -> None:
    shortest = [arb(rational(tau) / h.unit) for tau in low]
    longest = [arb(rational(tau) / h.unit) for tau in high]
    parts = [(ends, list(low), list(high))]
    for cut in tree:
        if not parts:
            raise RejectedError("a tree of cuts goes on after its last leaf")
        (a, b), below, above = parts.pop()
        if cut == -1:
            middle = [
                arb((rational(x) + rational(y)) / 2 / h.unit)
                for x, y in zip(below, above, strict=True)
            ]
            half = [
                arb((rational(y) - rational(x)) / 2 / h.unit)
                for x, y in zip(below, above, strict=True)
            ]
            if not _one_outweighs(h, start, direction, (a, b), shortest, longest) and not (
                stays_in_half_plane(h, start, direction, (a, b), middle, half)
            ):
                raise RejectedError(
                    f"the function may vanish between x = {a} and {b} for delays in "
                    f"{below} to {above}"
                )
        elif cut == 0:
            x = _between(a, b)
            parts += [((x, b), below, above), ((a, x), below, above)]
        elif 1 <= cut <= len(low):
            g = cut - 1
            tau = _between(below[g], above[g])
            parts.append(((a, b), [*below[:g], tau, *below[g + 1 :]], above))
            parts.append(((a, b), below, [*above[:g], tau, *above[g + 1 :]]))
        else:
            raise RejectedError(f"{cut!r} is no cut")
    if parts:
        raise RejectedError("a tree of cuts ends before its last leaf")


def _between(a: float, b: float) -> float:
    x = (a + b) / 2
    if not (math.isfinite(x) and a <= x <= b):
        raise RejectedError("a cut lies outside of its interval")
    return x


def _one_outweighs(
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
    own, others = arb(0), arb(0)
    for exponents, p in h.terms:
        sizes = [abs(c) for c in p(acb_poly([centre, step])).coeffs()]
        if not any(exponents):
            own = sizes[0] - sum(sizes[1:], arb(0))
            continue
        left = -centre.real + abs(step.real)
        growth = max(
            ((left * total(exponents, taus)).exp().upper() for taus in (shortest, longest)),
            key=float,
        )
        others += sum(sizes, arb(0)) * growth
    return bool(own > others)


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
    in each delay, and a bound on all the rest.
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


def _check_neutral(certificate: dict[str, Any]) -> None:
    """Check that det(I + z F) has a zero inside the unit circle, for one delay above zero."""
    claim, system = certificate["claim"], certificate["system"]
    if (
        certificate["verdict"] != "UNSTABLE"
        or certificate["unstable_roots"] is not None
        or len(claim["groups"]) != 1
        or not rational(claim["high"][0]) > 0
    ):
        raise RejectedError("a neutral loop proves instability under one delay above zero only")
    m = len(system["feedthrough"])
    F = [[rational(v) for v in row] for row in system["feedthrough"]]
    before = flint.ctx.prec
    flint.ctx.prec = 192
    try:
        # An eigenvalue of F of modulus above one, by the enclosed zeros of its minimal polynomial.
        polynomial: Any = flint.fmpq_mat(F).minpoly()
        if m == 0 or not any(
            abs(root) > 1
            for factor, _ in polynomial.numer().factor()[1]
            for root, _ in factor.complex_roots()
        ):
            raise RejectedError("the difference part is not shown to be unstable")
    finally:
        flint.ctx.prec = before
