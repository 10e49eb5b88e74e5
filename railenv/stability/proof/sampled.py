"""Proofs about sampled loops: stable or not, at one delay and over whole ranges of delays.

A range of delays is cut into pieces, each within one sampling interval d T <= tau <= (d + 1) T,
where the lifted map keeps its size. A piece carries one matrix P that proves stability for the
convex hull of all its maps (see `sampled_stein` and `sampled_map`), so a proved piece also stands
for a delay, and a told delay, that vary from sample to sample within the piece. Pieces are split
where the proof fails; where the loop looks unstable in floating point, that is proved at one delay
instead.

Nothing in a verdict rests on floating point: doubles are taken as the exact numbers they are.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import inf
from time import monotonic
from typing import Any, Literal

import numpy as np
from flint import arb

from railenv.errors import ArgumentError, check_count, check_not_negative, check_positive
from railenv.stability.proof.ball_matrices import balls, exact, middles
from railenv.stability.proof.precision import precision
from railenv.stability.proof.sampled_map import SampledMap
from railenv.stability.proof.sampled_pieces import DelayRange, Piece
from railenv.stability.proof.sampled_stein import (
    balancing,
    common_proposal,
    directions,
    inertia,
    other_radii,
    point_proposal,
    proved_decrease,
)
from railenv.stability.sampled_loop import SampledLoop
from railenv.units import FloatArray, Second

# Rows of the largest lifted map that is tried; a proof at one delay takes a minute or two there.
_LARGEST_MAP = 1200
# Degrees of the control polygon that are tried; more corners follow a long curve more tightly.
_DEGREES = (4, 8)
# Delays of a range that are looked at before anything is proved.
_LOOKS = 5

Verdict = Literal["STABLE", "UNSTABLE", "UNDECIDED"]
Delay = float | tuple[float, ...]


@dataclass(frozen=True)
class SampledProof:
    """The answer for one delay, or for every delay in a range.

    Attributes:
        verdict: "STABLE" (everywhere in the range), "UNSTABLE" (at `witness`) or "UNDECIDED".
        low: Smallest delay, one for all channels or one per channel [s].
        high: Largest delay [s].
        told_error: Largest difference between told and true delay [s].
        unstable_roots: Proved number of eigenvalues outside the unit circle: 0 if stable, that at
            the witness if unstable, None if undecided or if roots on the circle, or very far from
            it, leave open how many there are.
        witness: Delay that is proved unstable [s], or None.
        witness_told: What a scheduled controller is told there [s], or None.
        reason: Why there is no verdict, or empty.
        evidence: Plain numbers that `railenv.stability.verifier.sampled` re-checks.
    """

    verdict: Verdict
    low: Delay
    high: Delay
    told_error: Second
    unstable_roots: int | None = None
    witness: Delay | None = None
    witness_told: Second | None = None
    reason: str = ""
    evidence: dict[str, Any] | None = None

    @property
    def claim(self) -> dict[str, Any]:
        """What is claimed, in plain numbers."""

        def plain(delay: Delay | None) -> Any:
            return list(delay) if isinstance(delay, tuple) else delay

        return {
            "verdict": self.verdict,
            "low": plain(self.low),
            "high": plain(self.high),
            "told_error": self.told_error,
            "unstable_roots": self.unstable_roots,
            "witness": plain(self.witness),
            "witness_told": self.witness_told,
        }


class _StopError(Exception):
    """The search ends here, without a verdict, for the reason given."""


def prove_sampled(
    loop: SampledLoop,
    low: float | Sequence[float],
    high: float | Sequence[float] | None = None,
    told_error: float = 0.0,
    max_pieces: int = 4000,
    budget_s: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> SampledProof:
    """Prove a sampled loop stable for every delay in a range, or unstable at one of them.

    Args:
        loop: The loop.
        low: Smallest delay, common to all channels [s]; or one delay per channel.
        high: Largest delay [s]; by default `low`. A range is of common delays only.
        told_error: A scheduled controller is told max(0, delay + e) with any |e| up to this [s].
        max_pieces: How many pieces may be tried.
        budget_s: After this many seconds of computing no further piece is tried; None for no limit.
        progress: Called with each delay up to which everything is proved [s].

    Returns:
        The verdict with its evidence; "UNDECIDED" with a reason when no proof was found.

    Raises:
        ArgumentError: An argument is out of its range, or the delay spans too many periods.
    """
    error = check_not_negative("told_error", told_error, "seconds")
    check_count("max_pieces", max_pieces)
    deadline = inf
    if budget_s is not None:
        deadline = monotonic() + check_positive("budget_s", budget_s, "seconds")
    if loop.told is not None and loop.num_channels == 0:
        raise ArgumentError("told schedules a loop without channels; there is no delay to be told")
    first, last = loop.delays(low), loop.delays(low if high is None else high)
    if np.any(last < first):
        raise ArgumentError(f"high = {high} s is below low = {low} s; give a range that rises")
    if len({*first.tolist()}) > 1 or len({*last.tolist()}) > 1:
        if not np.array_equal(first, last):
            raise ArgumentError(
                "low and high differ between channels; a range must be of common delays"
            )
        if loop.told is not None:
            raise ArgumentError(
                "a scheduled controller is told one delay; give one delay for all channels"
            )
    # Only floating-point proposals can overflow; balls say themselves when they are of no use.
    with np.errstate(all="ignore"):
        search = _Search(loop, tuple(first.tolist()), tuple(last.tolist()), error)
        search.attempts, search.deadline, search.progress = max_pieces, deadline, progress
        try:
            with precision(search.map.bits):
                return search.run()
        except _StopError as stop:
            return search.answer("UNDECIDED", reason=str(stop))


class _Search:
    """One search for a proof."""

    attempts: int
    deadline: float
    progress: Callable[[float], None] | None

    def __init__(
        self, loop: SampledLoop, first: tuple[float, ...], last: tuple[float, ...], error: float
    ) -> None:
        self.loop, self.first, self.last = loop, first, last
        self.common = len({*first}) <= 1
        knots = () if loop.told is None else tuple(loop.told.tolist())
        low, high = (values[0] if values else 0.0 for values in (first, last))
        self.range = DelayRange(low, high, loop.period, knots, error)
        # The map in doubles refuses what is far too large, before anything else is built.
        loop.lifted_matrix(last, high)
        groups = [[k for k, tau in enumerate(first) if tau == own] for own in sorted({*first})]
        self.map = SampledMap(loop, groups or [[]])

    def answer(self, verdict: Verdict, **found: Any) -> SampledProof:
        """Return the outcome."""
        low, high = (self.range.low, self.range.high) if self.common else (self.first, self.last)
        return SampledProof(verdict, low, high, self.range.error, **found)

    def run(self) -> SampledProof:
        """Look for instability where it is likely, then prove stability piece by piece."""
        low, high = self.range.low, self.range.high
        if self.first == self.last and len(self.range.told(high)) == 1:
            return self.at_one_delay()
        places = np.linspace(low, high, _LOOKS).tolist()
        unstable = self.unstable_among([(d, told) for d in places for told in self.range.told(d)])
        return self.over_range() if unstable is None else unstable

    def at_one_delay(self) -> SampledProof:
        """Prove the number of eigenvalues outside the unit circle at one delay."""
        told = self.range.told(self.range.high)[0]
        found = self.counted(self.first, told)
        if found is None:
            shown = ", ".join(f"{d:.9g}" for d in sorted({*self.first}))
            raise _StopError(
                f"no proof was found at delay = {shown} s; a root is on the unit circle, or within "
                "rounding of it"
            )
        if found[0] != 0:
            witness = self.range.high if self.common else self.first
            return self.unstable(witness, told, *found)
        return self.answer("STABLE", unstable_roots=0, evidence=found[1])

    def over_range(self) -> SampledProof:
        """Cover the range with proved pieces."""
        waiting, proved = self.range.pieces()[::-1], list[dict[str, Any]]()
        while waiting:
            piece = waiting.pop()
            start = self.range.start(piece)
            if self.attempts <= 0 or monotonic() > self.deadline:
                raise _StopError(f"the work allowed was used up at delay = {start:.9g} s")
            self.attempts -= 1
            P, told_first = self.attempt(piece)
            if P is not None:
                proved.append({**piece._asdict(), "P": _lower(P)})
                if self.progress is not None:
                    self.progress(self.range.end(piece))
                continue
            unstable = self.unstable_among(self.range.samples(piece))
            if unstable is not None:
                return unstable
            parts = self.range.parts(piece, told_first)
            if not parts:
                raise _StopError(
                    f"no proof was found at delay = {start:.12g} s; a root is on or close to the "
                    "unit circle there"
                )
            waiting.extend(parts[::-1])
        return self.answer("STABLE", unstable_roots=0, evidence={**self.frame(), "pieces": proved})

    def attempt(self, piece: Piece) -> tuple[FloatArray | None, bool]:
        """Return P if it is proved for the piece, and whether what is told matters most in it."""
        size = self.map.size([piece.whole])
        if size > _LARGEST_MAP:
            raise _StopError(
                f"the map has {size} states at delay = {self.range.start(piece):.6g} s, more than "
                f"the {_LARGEST_MAP} that are tried; give a longer period"
            )
        told_first = False
        for degree in _DEGREES:
            told = (piece.told_low, piece.told_high)
            hull = self.map.hull(piece.whole, piece.low, piece.high, told, degree)
            if hull is None:
                break
            maps = np.array([[middles(F) for F in row] for row in hull])
            if not np.all(np.isfinite(maps)):
                break
            scale = balancing(list(maps.reshape(-1, size, size)))
            maps = maps * scale / scale[:, None]
            by_delay, by_told, *others = directions(maps)
            told_first = bool(np.linalg.norm(by_told) > np.linalg.norm(by_delay))
            try:
                scaled = common_proposal(
                    list(maps.reshape(-1, size, size)), [by_delay, by_told, *others]
                )
            except (np.linalg.LinAlgError, ValueError):
                break
            if scaled is None:
                break
            P = scaled / scale / scale[:, None]
            if inertia(balls(P)) == 0 and all(proved_decrease(P, F) for row in hull for F in row):
                return P, told_first
        return None, told_first

    def unstable_among(self, places: list[tuple[float, float]]) -> SampledProof | None:
        """Prove instability at the place that looks most unstable; None if none does."""
        growth, delay, told = max((self.growth(d, t), d, t) for d, t in places)
        found = self.counted((delay,) * len(self.first), told) if growth > 0.0 else None
        if found is None or found[0] == 0:
            return None
        return self.unstable(delay, told, *found)

    def unstable(
        self, witness: Delay, told: float, count: int | None, evidence: dict[str, Any]
    ) -> SampledProof:
        """Return the outcome for a proved unstable delay."""
        return self.answer(
            "UNSTABLE",
            unstable_roots=count,
            witness=witness,
            witness_told=told if self.range.knots else None,
            evidence=evidence,
        )

    def growth(self, delay: float, told: float) -> float:
        """Return the growth rate in floating point; minus infinity where there is none."""
        try:
            return self.loop.growth_rate(delay, told)
        except (ValueError, np.linalg.LinAlgError):
            return -inf

    def counted(
        self, delays: tuple[float, ...], told: float
    ) -> tuple[int | None, dict[str, Any]] | None:
        """Return the proved count of eigenvalues outside the unit circle, with its evidence.

        The count is None if it is only proved that there are some: outside a larger circle.
        """
        T = Fraction(self.loop.period)
        own = [Fraction(delays[g.channels[0]]) if g.channels else T * 0 for g in self.map.groups]
        wholes = [tau // T for tau in own]
        if self.map.size(wholes) > _LARGEST_MAP:
            return None
        rests = [exact(tau - d * T) for tau, d in zip(own, wholes, strict=True)]
        F = self.map.at(wholes, rests, told)
        middle = middles(F)
        if not np.all(np.isfinite(middle)):
            return None
        scale = balancing([middle])
        balanced = middle * scale / scale[:, None]
        for radius in (1.0, *other_radii(balanced)):
            try:
                scaled = point_proposal(balanced / radius)
            except (np.linalg.LinAlgError, ValueError):
                continue
            P = np.zeros((0, 0)) if scaled is None else scaled / scale / scale[:, None]
            count = inertia(balls(P)) if len(P) else None
            if count is None or not proved_decrease(P, F * arb(1 / exact(radius))):
                continue
            if radius > 1.0 and count == 0:
                continue
            point = {"delays": list(delays), "told": told, "radius": radius, "P": _lower(P)}
            return count if radius == 1.0 else None, {**self.frame(), "point": point}
        return None

    def frame(self) -> dict[str, Any]:
        """Return what every evidence says first."""
        return {"method": "stein", "bits": self.map.bits, "exponents": self.map.exponents}


def _lower(P: FloatArray) -> list[list[float]]:
    """Return the lower triangle, row by row."""
    return [row[: i + 1] for i, row in enumerate(P.tolist())]
