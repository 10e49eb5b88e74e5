"""Proofs for constant delays: at a point, in an interval, in a box of independent delays.

STABLE: the number of roots in the region is proved to be zero at the middle of the box, and no root
passes the region's edge for any delays of the box. UNSTABLE: the number is proved to be above zero
at one point of the box (floating point only proposes which).
"""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from flint import arb

from railenv.errors import ArgumentError
from railenv.stability.delay_system import DelaySystem
from railenv.stability.modes import Mode
from railenv.stability.proof.axis_crossings import proved_crossings
from railenv.stability.proof.characteristic import Characteristic, characteristic
from railenv.stability.proof.contour import Box, Quasipolynomial, delay_ball
from railenv.stability.proof.counting import Contour, Effort, count, cover, exclude
from railenv.stability.proof.polynomials import UndecidedError
from railenv.stability.proof.precision import precision
from railenv.stability.proof.region import Region
from railenv.stability.spectrum import rightmost_roots

_FIRST_BITS = 128
_MOST_BITS = 4096
# Pieces of one contour; the vehicle's has some 250.
_MOST_PIECES = 10_000
# Corners of a box that are looked at before the proof is tried.
_MOST_CORNERS = 32
# Next to a crossing or a touch the exclusion becomes long; the list of crossings then is the proof.
_TESTS_BEFORE_CROSSINGS = 5_000
# Crossings of an interval that are looked through for an unstable part.
_MOST_EVENTS = 20_000
_LOOKED_AT = 8
"""Roots that floating point looks at to propose an unstable delay."""


@dataclass(frozen=True, eq=False)
class Proof:
    """What came out.

    Attributes:
        verdict: "STABLE", "UNSTABLE" or "UNDECIDED".
        roots: Number of roots in the region; None if not known. The evidence's own number, of
            its own region, is under its key "roots".
        reason: Why undecided, or where unstable.
        evidence: What re-checking needs.
    """

    verdict: str
    roots: int | None
    reason: str
    evidence: dict[str, Any]


class _WitnessError(Exception):
    """A box in which floating point sees roots in the region."""

    def __init__(self, delays: tuple[float, ...]) -> None:
        super().__init__(delays)
        self.delays = delays


@dataclass(frozen=True, eq=False)
class _Loop:
    system: DelaySystem
    h: Characteristic
    region: Region

    def channel_delays(self, delays: Sequence[float]) -> list[float]:
        """Spread one delay per group over the channels."""
        values = [0.0] * self.system.num_channels
        for group, tau in zip(self.h.groups, delays, strict=True):
            for channel in group:
                values[channel] = float(tau)
        return values

    def seems_unstable(self, delays: Sequence[float]) -> bool:
        """Whether floating point sees a root in the region; False also if it cannot tell."""
        return any(self.region.contains(mode) for mode in self.estimates(delays, _LOOKED_AT))

    def estimates(self, delays: Sequence[float], count: int) -> list[Mode]:
        """Return rightmost roots in floating point; none if they cannot be had."""
        if self.system.neutral:
            return []
        try:
            with np.errstate(all="ignore"):
                return rightmost_roots(self.system, self.channel_delays(delays), count)
        except (ArgumentError, ArithmeticError, ValueError):
            return []


def prove_box(
    system: DelaySystem,
    groups: Sequence[Sequence[int]],
    box: Box,
    region: Region,
    most_tests: int,
    progress: Callable[[float], None] | None = None,
) -> Proof:
    """Decide whether the region is free of roots for all constant delays of a box.

    Args:
        system: The loop.
        groups: Channels that share one delay each.
        box: One interval of delays per group [s].
        region: Where no root may be.
        most_tests: Tests the exclusion may take before it is given up.
        progress: Called with the share of the contour that is done.
    """
    loop = _Loop(system, characteristic(system, groups), region)
    try:
        witness = _proposed_witness(loop, box)
        for suspicious in (True, False):
            if witness is not None:
                proof = _unstable(loop, witness)
                if proof.verdict != "UNDECIDED":
                    return proof
            # Estimates may see roots beyond the edge that are not: the proof has the last word.
            try:
                return _stable(loop, box, most_tests, suspicious, progress)
            except _WitnessError as found:
                witness = found.delays
    except UndecidedError as error:
        return Proof("UNDECIDED", None, str(error), {})
    raise AssertionError("the second search raises no suspicion")


def _proposed_witness(loop: _Loop, box: Box) -> tuple[float, ...] | None:
    """Propose delays of the box at which a root lies in the region."""
    if len(box.low) == 1 and not box.is_point and loop.region == Region():
        return _in_unstable_window(loop, box)
    corners: list[tuple[float, ...]] = [box.centre]
    if not box.is_point:
        ends = itertools.product(*zip(box.low, box.high, strict=True))
        corners += itertools.islice(ends, _MOST_CORNERS)
        corners.append(box.high)
    return next((corner for corner in corners if loop.seems_unstable(corner)), None)


def _in_unstable_window(loop: _Loop, box: Box) -> tuple[float, ...] | None:
    """Look through the exact crossings; an early unstable part of the interval is proposed."""
    low, high = box.low[0], box.high[0]
    try:
        found = proved_crossings(loop.h)
    except UndecidedError:
        return next((d for d in (box.centre, box.low, box.high) if loop.seems_unstable(d)), None)
    events: list[tuple[float, int]] = []
    unstable = found.unstable_without_delay
    unit = float(loop.h.unit.p) / float(loop.h.unit.q)
    turn = 2 * math.pi
    # Where crossings are too many to be listed, the first ones of the interval are.
    rate = sum(float(c.frequency.mid()) for c in found.crossings) / unit / turn
    if (high - low) * rate > _MOST_EVENTS:
        high = low + _MOST_EVENTS / rate
    for crossing in found.crossings:
        omega, phase = float(crossing.frequency.mid()) / unit, float(crossing.phase.mid())
        first = phase / omega
        step = 2 * crossing.direction * crossing.multiplicity
        passed = max(0, math.floor((low - first) * omega / turn) + 1)
        # A root that is on the axis without delay and turns stable was never counted.
        counted = passed - int(crossing.phase.is_zero() and step < 0 and passed > 0)
        unstable += step * counted
        for k in range(passed, passed + _MOST_EVENTS + 1):
            tau = (phase + turn * k) / omega
            if tau > high:
                break
            if tau > low:
                events.append((tau, step))
    windows: list[tuple[float, float]] = []
    start = low
    for tau, change in [*sorted(events), (high, 0)]:
        if unstable > 0 and tau > start:
            windows.append((tau - start, (tau + start) / 2))
        start, unstable = tau, unstable + change
    if windows:
        # The first that is not narrow: short delays are counted more quickly.
        widest = max(width for width, _ in windows)
        return (next(middle for width, middle in windows if width >= widest / 10.0),)
    if found.marginal:
        raise UndecidedError(
            f"{found.marginal} root(s) stay on the imaginary axis whatever the delay: the loop is "
            "never asymptotically stable"
        )
    return None


def _stable(
    loop: _Loop,
    box: Box,
    most_tests: int,
    suspicious: bool,
    progress: Callable[[float], None] | None,
) -> Proof:
    """Count at the middle, then exclude the contour for the whole box."""
    number, evidence, (h, contour, pieces) = _counted(loop, box.centre, box.high)
    if number:
        return _found(box.centre, number, evidence)
    if not box.is_point:
        calls = itertools.count(1)

        def suspect(part: Box) -> None:
            # At the first, second, fourth, ... call only: looking costs more than a test.
            look = suspicious and next(calls).bit_count() == 1
            if look and loop.seems_unstable(part.centre):
                raise _WitnessError(part.centre)

        common = len(box.low) == 1 and loop.region == Region()
        allowed = min(most_tests, _TESTS_BEFORE_CROSSINGS) if common else most_tests
        with precision(int(evidence["bits"])):
            effort = Effort(allowed, progress=progress)
            try:
                evidence["cuts"] = exclude(h, contour, pieces, box, loop.h.unit, effort, suspect)
            except UndecidedError:
                if not (common and _no_crossing_in(loop, box)):
                    raise
                evidence["method"] = "crossings"
    return Proof("STABLE", 0, "", evidence)


def _no_crossing_in(loop: _Loop, box: Box) -> bool:
    """Whether the list of all crossings proves that none is at a delay of an interval."""
    found = proved_crossings(loop.h)
    with precision(_MOST_BITS):
        low, high = (delay_ball(tau, loop.h.unit) for tau in (box.low[0], box.high[0]))
        for crossing in found.crossings:
            turn = 2 * arb.pi()
            first = ((low * crossing.frequency - crossing.phase) / turn).ceil()
            last = ((high * crossing.frequency - crossing.phase) / turn).floor()
            if not first > last:
                return False
    return not found.marginal


def _unstable(loop: _Loop, delays: tuple[float, ...]) -> Proof:
    """Prove that there are roots in the region at these delays."""
    try:
        number, evidence, _ = _counted(loop, delays, delays)
    except UndecidedError as error:
        shifted = _right_of_the_axis(loop, delays)
        if shifted is None:
            return Proof("UNDECIDED", None, str(error), {})
        line, number, evidence = shifted
        if number:
            # Others may be between the edge of the region and this line: the number is not known.
            text = f"at least {number} roots, right of {line:.3g} 1/s, at delay {_said(delays)}"
            return Proof("UNSTABLE", None, text, {**evidence, "roots": number})
    if number == 0:
        return Proof(
            "UNDECIDED",
            None,
            f"estimates see a root in the region at delay {_said(delays)}, the count does not",
            {},
        )
    return _found(delays, number, evidence)


def _right_of_the_axis(
    loop: _Loop, delays: tuple[float, ...]
) -> tuple[float, int, dict[str, Any]] | None:
    """Count to the right of a line half-way to the rightmost root, past others on the contour."""
    if loop.region.damping_ratio is not None:
        return None
    estimates = loop.estimates(delays, 1)
    if not estimates:
        return None
    edge = (estimates[0].root.real - loop.region.decay_rate) / 2
    if not edge > -loop.region.decay_rate:
        return None
    smaller = _Loop(loop.system, loop.h, Region(decay_rate=-edge))
    try:
        number, evidence, _ = _counted(smaller, delays, delays)
    except UndecidedError:
        return None
    return edge, number, evidence


def _found(delays: tuple[float, ...], number: int, evidence: dict[str, Any]) -> Proof:
    roots = f"{number} root{'s' if number > 1 else ''}"
    text = f"{roots} at delay {_said(delays)}"
    return Proof("UNSTABLE", number, text, {**evidence, "roots": number})


def _said(delays: Sequence[float]) -> str:
    shown = ", ".join(f"{tau:.6g}" for tau in delays)
    return f"({shown}) s" if len(delays) != 1 else f"{shown} s"


_Counted = tuple[int, dict[str, Any], tuple[Quasipolynomial, Contour, list[list[float]]]]


def _counted(loop: _Loop, delays: Sequence[float], longest: Sequence[float]) -> _Counted:
    """Count the roots in the region at one point; the evidence is the cut of the contour."""
    _refuse_marginal(loop)
    bits = max(_FIRST_BITS, 4 * loop.h.degree)
    while True:
        try:
            with precision(bits):
                return _counted_once(loop, delays, longest, bits)
        except UndecidedError:
            if bits >= _MOST_BITS:
                raise
        bits *= 4


def _counted_once(
    loop: _Loop, delays: Sequence[float], longest: Sequence[float], bits: int
) -> _Counted:
    unit = loop.h.unit
    h = Quasipolynomial.of(loop.h)
    contour = loop.region.contour(
        h, loop.h.degree, unit, [delay_ball(tau, unit) for tau in longest]
    )
    balls = [delay_ball(tau, unit) for tau in delays]
    pieces = cover(h, contour, balls, Effort(_MOST_PIECES), unit)
    number = count(h, contour, pieces, balls)
    evidence: dict[str, Any] = {
        "method": "contour",
        "bits": bits,
        "unit": float(unit.p) / float(unit.q),
        "region": loop.region.to_plain(),
        "delays": [float(tau) for tau in delays],
        "pieces": pieces,
    }
    return number, evidence, (h, contour, pieces)


def _refuse_marginal(loop: _Loop) -> None:
    """Name the one case that no contour can get around: a root at s = 0 for every delay."""
    if loop.region.decay_rate == 0.0 and loop.h.without_delay[0] == 0:
        raise UndecidedError(
            "a root stays at s = 0 whatever the delay: the loop is never asymptotically stable"
        )
