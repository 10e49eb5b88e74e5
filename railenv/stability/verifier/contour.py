"""Re-checks certificates for constant delays in a box.

What is recomputed: the characteristic function from the matrices; the bound beyond which no root
can be; on every piece of the contour and every part of the box, that the function stays in a
half-plane; the number of roots from the change of argument. What is taken from the certificate:
only where the contour and the box are cut.
"""

import math
from itertools import pairwise
from typing import Any

import flint
from flint import acb, arb

from railenv.stability.verifier.claim import Claim, Region, listed, read_claim, read_region
from railenv.stability.verifier.crossings import check_no_crossing
from railenv.stability.verifier.half_plane import one_outweighs, stays_in_half_plane
from railenv.stability.verifier.neutral import check_neutral
from railenv.stability.verifier.quasipolynomial import (
    CharacteristicFunction,
    RejectedError,
    System,
    rational,
    total,
)

_MOST_BITS = 1 << 14


def check_delay_box(certificate: dict[str, Any]) -> None:
    """Check a certificate whose claim is of the kind "delay box".

    Args:
        certificate: With `verdict`, `unstable_roots`, `claim`, `system` and `evidence`.

    Raises:
        RejectedError: It proves nothing.
    """
    verdict, claimed = certificate["verdict"], certificate["unstable_roots"]
    evidence = certificate["evidence"]
    if verdict not in ("STABLE", "UNSTABLE"):
        raise RejectedError("the verdict is neither STABLE nor UNSTABLE")
    system = System.read(certificate["system"])
    claim = read_claim(certificate["claim"], system.K.nrows())
    if evidence["method"] == "neutral":
        check_neutral(verdict, claimed, claim, system)
        return
    if evidence["method"] not in ("contour", "crossings"):
        raise RejectedError("the evidence follows no method that is known")
    delays = listed("delays", evidence["delays"])
    if not claim.holds(delays):
        raise RejectedError("the delays of the evidence are not in the box of the claim")
    region, stable = read_region(evidence["region"]), verdict == "STABLE"
    if region != claim.region and (stable or not _is_inside(region, claim.region)):
        raise RejectedError("the evidence is about another region than the claim")
    before = flint.ctx.prec
    flint.ctx.prec = _bits(evidence["bits"]) + 32
    try:
        unit = _unit(evidence["unit"])
        h = CharacteristicFunction(system, claim.groups, unit)
        lines = contour(h, region, claim.high if stable else delays, evidence["pieces"], stable)
        roots = count_roots(h, lines, delays)
        # To the right of a line there may be fewer than in the region asked for.
        known = roots if region == claim.region else None
        if type(claimed) is not type(known) or claimed != known:
            raise RejectedError(
                f"unstable_roots is {claimed!r:.40}, and {roots} are in the region of the evidence"
            )
        if stable != (roots == 0):
            raise RejectedError(f"{roots} roots in the region do not make it {verdict}")
        if stable and not claim.is_point:
            if evidence["method"] == "crossings":
                if region != Region(0, None, None):
                    raise RejectedError("crossings are those of the imaginary axis")
                check_no_crossing(h, claim.low, claim.high)
            else:
                _check_cuts(h, lines, listed("cuts", evidence["cuts"]), claim)
    finally:
        flint.ctx.prec = before


def _is_inside(region: Region, other: Region) -> bool:
    """Whether one half-plane lies in another."""
    return (
        region.damping_ratio is None
        and other.damping_ratio is None
        and bool(region.decay_rate <= other.decay_rate)
    )


def _bits(value: Any) -> int:
    if type(value) is not int or not 64 <= value <= _MOST_BITS:
        raise RejectedError(f"bits = {value!r:.40} is no precision")
    return value


def _unit(value: Any) -> Any:
    unit = rational(value)
    if not unit > 0:
        raise RejectedError("the unit of time is not above zero")
    return unit


Line = tuple[Any, Any, list[float]]
"""Start, direction and rising ends of the pieces."""


def contour(
    h: CharacteristicFunction, region: Region, longest: list[float], pieces: Any, stable: bool
) -> list[Line]:
    """Rebuild the contour, and check that no root can be beyond it.

    Args:
        h: The function.
        region: Where roots are counted.
        longest: Longest delay of each group [s].
        pieces: For each line the rising ends of its pieces.
        stable: Whether more than the region may be enclosed.

    Returns:
        The lines.

    Raises:
        RejectedError: Roots may be to the right of the contour and beyond its end.
    """
    pieces = [listed("the pieces of a line", ends) for ends in listed("pieces", pieces)]
    for ends in pieces:
        places = [rational(x) for x in ends]
        if len(places) < 2 or places[0] != 0 or not all(a < b for a, b in pairwise(places)):
            raise RejectedError("the pieces of a line do not follow each other from its start")
    if len(pieces) != (1 if region.damping_ratio is None else 2):
        raise RejectedError("the contour has not the lines of its region")
    if region.damping_ratio is None:
        shift = arb(region.decay_rate * h.unit)
        lines: list[Line] = [(acb(-shift), acb(0, 1), pieces[0])]
        radius = arb(rational(pieces[0][-1]))
        growth = shift if region.decay_rate > 0 else arb(0)
    else:
        lines = _wedge(h, region, pieces, stable)
        # The vertical line that closes the contour is to the right of the axis: no term grows.
        radius = lines[1][0].real + arb(rational(pieces[1][-1]))
        growth = arb(0)
    if not radius > 0:
        raise RejectedError("the contour does not reach beyond all roots")
    # |h / s^n - 1| < 1 for all |s| >= radius with Re s >= -growth: no root is there.
    taus = [arb(rational(tau) / h.unit) for tau in longest]
    rest = arb(0)
    for exponents, p in h.terms:
        size = (growth * total(exponents, taus)).exp()
        for power, c in enumerate(p.coeffs()):
            if any(exponents) or power < h.degree:
                rest += abs(c) * radius ** (power - h.degree) * size
    if not rest < 1:
        raise RejectedError("the contour does not reach beyond all roots")
    return lines


def _wedge(
    h: CharacteristicFunction, region: Region, pieces: list[list[float]], stable: bool
) -> list[Line]:
    """Return the ray of the damping ratio and the level line from its end to the right.

    The ray's length is a double and so seldom ends at the claim's frequency exactly. No roots in
    more than the region are none in it. To count those in it, the level line stands for all lines
    between the claim's frequency and the ray's end: with no root on any, both hold as many.
    """
    zeta = arb(region.damping_ratio)
    slope = (1 - zeta * zeta).sqrt()
    length = arb(rational(pieces[0][-1]))
    needed = 2 * arb.pi() * arb(region.max_frequency_hz * h.unit) / slope
    if not stable:
        length = length.union(needed)
    elif not length >= needed:
        raise RejectedError("the contour ends below the frequency of the claim")
    ray = acb(-zeta, slope)
    return [(acb(0), ray, pieces[0]), (ray * length, acb(1), pieces[1])]


def count_roots(h: CharacteristicFunction, lines: list[Line], delays: list[float]) -> int:
    """Return the number of roots to the right of the contour at fixed delays.

    Raises:
        RejectedError: A root may be on the contour, or the number is not decided.
    """
    taus = [arb(rational(tau) / h.unit) for tau in delays]
    none = [arb(0)] * len(taus)
    place = lines[0][0]
    last, change = h.at(place, taus), arb(0)
    for start, direction, ends in lines:
        for low, high in pairwise(ends):
            if not stays_in_half_plane(h, start, direction, (low, high), taus, none):
                raise RejectedError(f"the function may vanish between x = {low} and {high}")
            place = start + direction * arb(rational(high))
            value = h.at(place, taus)
            change += (value / last).arg()
            last = value
    turns = h.degree * place.arg() + (last / place**h.degree).arg() - change
    whole = (turns / arb.pi()).unique_fmpz()
    if whole is None:
        raise RejectedError("the number of roots is not decided")
    return int(whole)


def _check_cuts(
    h: CharacteristicFunction, lines: list[Line], cuts: list[Any], claim: Claim
) -> None:
    """Walk the cuts of every piece and check each leaf."""
    if len(cuts) != len(lines):
        raise RejectedError("the cuts are not one list per line")
    for (start, direction, ends), of_line in zip(lines, cuts, strict=True):
        if len(listed("the cuts of a line", of_line)) != len(ends) - 1:
            raise RejectedError("the cuts are not one tree per piece")
        for piece, tree in zip(pairwise(ends), of_line, strict=True):
            _check_tree(h, (start, direction), piece, listed("a tree of cuts", tree), claim)


def _check_tree(
    h: CharacteristicFunction,
    line: tuple[Any, Any],
    piece: tuple[float, float],
    tree: list[Any],
    claim: Claim,
) -> None:
    """Walk one piece's cuts in preorder: parts still to come are on a stack."""
    shortest = [arb(rational(tau) / h.unit) for tau in claim.low]
    longest = [arb(rational(tau) / h.unit) for tau in claim.high]
    parts = [(piece, list(claim.low), list(claim.high))]
    for cut in tree:
        if not parts:
            raise RejectedError("a tree of cuts goes on after its last leaf")
        ends, low, high = parts.pop()
        if type(cut) is not int or not -1 <= cut <= len(low):
            raise RejectedError(f"{cut!r:.40} is no cut")
        if cut == -1:
            exact = [(rational(x), rational(y)) for x, y in zip(low, high, strict=True)]
            middle = [arb((x + y) / 2 / h.unit) for x, y in exact]
            half = [arb((y - x) / 2 / h.unit) for x, y in exact]
            if not one_outweighs(h, *line, ends, shortest, longest) and not (
                stays_in_half_plane(h, *line, ends, middle, half)
            ):
                raise RejectedError(
                    f"the function may vanish between x = {ends[0]} and {ends[1]} for delays in "
                    f"{low} to {high}"
                )
        elif cut == 0:
            x = _between(*ends)
            parts += [((x, ends[1]), low, high), ((ends[0], x), low, high)]
        else:
            g = cut - 1
            tau = _between(low[g], high[g])
            parts.append((ends, [*low[:g], tau, *low[g + 1 :]], high))
            parts.append((ends, low, [*high[:g], tau, *high[g + 1 :]]))
    if parts:
        raise RejectedError("a tree of cuts ends before its last leaf")


def _between(a: float, b: float) -> float:
    x = (a + b) / 2
    if not (math.isfinite(x) and a <= x <= b):
        raise RejectedError("a cut lies outside of its interval")
    return x
