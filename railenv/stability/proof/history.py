"""Proofs about loops with a law of finite history, over true delay and told delay at once.

The eigenvalues outside the unit circle are as many for all pairs of true and told delay that hang
together, unless one of them meets the circle on the way. So for each number d of whole periods

1. they are counted at one pair (see `history_count`), and
2. the characteristic function is shown to have no zero on the unit circle for any delay d T + r,
   r in [0, T], with anything that may be told with it (see `history_boxes`).

With feedthrough the loop jumps where a delay is a whole number of periods; both sides belong to
cases of their own and each is proved. The answer is for constant delays and constant told delays.

What the floating-point part rests on is in `history_models`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from railenv.errors import ArgumentError
from railenv.stability.certificate import STABLE, UNDECIDED, UNSTABLE
from railenv.stability.history_loop import FiniteHistoryLoop
from railenv.stability.proof.ball_matrices import rational
from railenv.stability.proof.history_boxes import BoolArray, Boxes, Cover, IntArray
from railenv.stability.proof.history_count import count_outside, first_arcs
from railenv.stability.proof.history_function import Arc, HistoryFunction
from railenv.stability.proof.history_modes import ModesError, held_modes
from railenv.stability.proof.history_range import HistoryRange
from railenv.stability.proof.sampled_pieces import DelayRange

MOST_BOXES = 2_000_000
"""Boxes after which a proof is given up."""

_SIGNALS = 2
# Arcs of the half circle to begin with: f turns by about a radian on each half of one, but not
# fewer than these; and the shortest one's half width in t.
_FEWEST_ARCS, _SHORTEST = 8, 2.0**-27
# Longest delay in periods: the function turns that often around the circle.
_LONGEST = 400
# Where in each period instability is looked for first, in periods.
_NEAR = (0.002, 0.998)
# Where instability is looked for around a box that was not proved: rests of the delay, in periods.
_RESTS = (-1.0, -0.3, -0.1, -0.03, -0.01, -0.003, 0.0, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0)


@dataclass(frozen=True)
class HistoryProof:
    """The answer for every delay in a range and everything told with it.

    Attributes:
        verdict: "STABLE" (everywhere), "UNSTABLE" (at the witness) or "UNDECIDED".
        unstable_roots: Proved number of eigenvalues outside the unit circle; None if undecided.
        witness: Delay that is proved unstable [s], or None.
        witness_told: What is told there [s], or None.
        reason: Why there is no verdict, or where it is unstable.
        arcs: Arcs of the circle that were looked at.
        boxes: Boxes of delay and told delay that were looked at, all arcs together.
    """

    verdict: str
    unstable_roots: int | None = None
    witness: float | None = None
    witness_told: float | None = None
    reason: str = ""
    arcs: int = 0
    boxes: int = 0


class _FoundError(Exception):
    """The search ends here; the proof is the first argument."""


def prove_history(
    loop: FiniteHistoryLoop,
    low: float,
    high: float,
    told_error: float = 0.0,
    most_boxes: int = MOST_BOXES,
    progress: Callable[[float], None] | None = None,
) -> HistoryProof:
    """Prove a loop stable for every delay in a range and everything told, or unstable somewhere.

    Args:
        loop: The loop, with one or two command signals.
        low: Smallest delay, common to all forces [s].
        high: Largest delay [s].
        told_error: A scheduled law is told max(0, delay + e) with any constant |e| up to this [s].
        most_boxes: How many boxes may be looked at.
        progress: Called with the share that is done.

    Raises:
        ArgumentError: The loop has more than two signals, or the delay is too many periods.
    """
    if loop.num_signals > _SIGNALS:
        raise ArgumentError(
            f"the law has {loop.num_signals} command signals; the proof over a range is for one or "
            'two: let the actuators of a bogie share one (action="bogies")'
        )
    if high > _LONGEST * loop.period:
        raise ArgumentError(
            f"delay = {high:g} s is more than {_LONGEST} periods of {loop.period:g} s; give a "
            "shorter one"
        )
    try:
        search = _Search(loop, HistoryRange(low, high, told_error, loop.period, loop.told))
    except ModesError as error:
        return HistoryProof(UNDECIDED, reason=str(error))
    search.most, search.progress = most_boxes, progress
    # What overflows is no bound, and treated so.
    with np.errstate(all="ignore"):
        try:
            return search.run()
        except _FoundError as found:
            return found.args[0]


class _Search:
    """One search for a proof."""

    most: int
    progress: Callable[[float], None] | None

    def __init__(self, loop: FiniteHistoryLoop, wanted: HistoryRange) -> None:
        self.loop, self.range = loop, wanted
        r = loop.num_signals
        # A single signal gets a second one beside it that does nothing.
        spread = np.pad(loop.spread, ((0, 0), (0, _SIGNALS - r)))
        measured = np.pad(loop.measured, ((0, 0), (0, 0), (0, _SIGNALS - r), (0, 0)))
        commanded = np.pad(loop.commanded, ((0, 0), (0, 0), *[(0, _SIGNALS - r)] * 2))
        modes = held_modes(
            loop.A,
            rational(loop.B) * rational(spread),
            loop.C,
            rational(loop.D) * rational(spread),
            loop.period,
        )
        self.function = HistoryFunction(modes, measured, commanded, wanted.last)
        # The highest power of w, twice: two signals.
        power = 2 * (loop.measured.shape[1] + max(loop.commanded.shape[1], wanted.last))
        self.first = max(_FEWEST_ARCS, 2 ** round(np.log2(power / 2)))
        self.arcs, self.boxes = 0, 0

    def run(self) -> HistoryProof:
        """Count at one pair of each period, then cover all others."""
        members = self.members()
        counts = self.look(self.samples(), members)
        for (d, rest, _), count in zip(members, counts, strict=True):
            if count != 0:
                number = "could not be counted" if count is None else f"are {count} outside"
                place = d * self.loop.period + rest
                raise _FoundError(self.undecided(f"eigenvalues {number} at delay = {place:.9g} s"))
        self.cover()
        return HistoryProof(STABLE, 0, arcs=self.arcs, boxes=self.boxes)

    def members(self) -> list[tuple[int, float, float]]:
        """Return one triple of d, r and told delay for each number d of whole periods."""
        T, members = self.loop.period, list[tuple[int, float, float]]()
        for d in range(self.range.first, self.range.last + 1):
            ends = (max(self.range.low - d * T, 0.0), min(self.range.high - d * T, T))
            rest = min(max(sum(ends) / 2, 0.0), T)
            members.append((d, rest, d * T + rest))
        return members

    def samples(self) -> list[tuple[float, float]]:
        """Return pairs of delay and told delay at which instability is looked for first.

        Near both ends of each period: with feedthrough the loop jumps there.
        """
        r, T = self.range, self.loop.period
        delays = {r.low, r.high}
        if r.high > r.low:
            places = [(d + share) * T for d in range(r.first, r.last + 1) for share in _NEAR]
            delays |= {place for place in places if r.low <= place <= r.high}
        return [(delay, told) for delay in sorted(delays) for told in self.told(delay)]

    def told(self, delay: float) -> list[float]:
        """Return what may be told at the least, exactly, and at the most."""
        if not self.loop.scheduled:
            return [delay]
        knots = tuple(self.loop.told.tolist())
        r = self.range
        return DelayRange(r.low, r.high, r.period, knots, r.error).told(delay)

    def look(
        self,
        pairs: list[tuple[float, float]],
        members: list[tuple[int, float, float]] | None = None,
    ) -> list[int | None]:
        """End the search if one of some pairs of delay and told delay is unstable.

        Returns:
            The eigenvalues outside the unit circle of the triples `members`.
        """
        T = Fraction(self.loop.period)
        triples = [*(members or [])]
        number = len(triples)
        for delay, told in pairs:
            whole = Fraction(delay) // T
            triples.append((whole, float(Fraction(delay) - whole * T), told))
        counts = list[int | None]()
        if triples:
            points = self.range.points(triples)
            counts = count_outside(self.function, *points, self.first, _SHORTEST)
        for (delay, told), count in zip(pairs, counts[number:], strict=True):
            if count:
                shown = f", told {told:.9g} s" if self.loop.scheduled else ""
                text = f"{count} eigenvalues outside the unit circle at delay {delay:.9g} s{shown}"
                named = told if self.loop.scheduled else None
                raise _FoundError(
                    HistoryProof(UNSTABLE, count, delay, named, text, self.arcs, self.boxes)
                )
        return counts[:number]

    def undecided(self, reason: str) -> HistoryProof:
        """Return that there is no verdict."""
        return HistoryProof(UNDECIDED, reason=reason, arcs=self.arcs, boxes=self.boxes)

    def cover(self) -> None:
        """Show that f has no zero on the circle anywhere in the range."""
        wholes, intervals, boxes = self.range.cases()
        stack = [(arc, boxes) for arc in first_arcs(self.first)[::-1]]
        while stack:
            arc, waiting = stack.pop()
            used, number = np.unique(waiting.case, return_inverse=True)
            d, k = wholes[used], intervals[used]

            def wanted(b: Boxes, d: IntArray = d, k: IntArray = k) -> BoolArray:
                return self.range.wanted(d[b.case], k[b.case], b)

            cover = Cover(self.function.on(arc, d, k), self.most - self.boxes)
            failed = cover.run(Boxes(number, waiting.middle, waiting.half), wanted)
            self.arcs, self.boxes = self.arcs + 1, self.boxes + cover.looked
            rest = Boxes(used[failed.case], failed.middle, failed.half)
            if len(rest):
                self.refine(arc, rest, wholes, intervals, stack)
            if self.progress is not None:
                self.progress(arc.t - arc.s if len(rest) else arc.t + arc.s)

    def refine(
        self,
        arc: Arc,
        rest: Boxes,
        wholes: IntArray,
        intervals: IntArray,
        stack: list[tuple[Arc, Boxes]],
    ) -> None:
        """Put the halves of an arc on the stack for boxes left over, or give up."""
        if arc.s / 2 >= _SHORTEST and self.boxes < self.most:
            first, second = arc.halves()
            stack += [(second, rest), (first, rest)]
            return
        case = rest.case[0]
        delay, told = self.range.place(int(wholes[case]), int(intervals[case]), rest.middle[0])
        self.look(self.around(delay, told))
        frequency = arc.t / (2 * self.loop.period)
        shown = f", told {told:.6g} s" if self.loop.scheduled else ""
        what = "no proof was found"
        if self.boxes >= self.most:
            what = "the work allowed was used up"
        raise _FoundError(
            self.undecided(f"{what} at {frequency:.6g} Hz, delay = {delay:.6g} s{shown}")
        )

    def around(self, delay: float, told: float) -> list[tuple[float, float]]:
        """Return pairs around one that could not be proved, all in the range."""
        pairs: list[tuple[float, float]] = []
        for share in _RESTS:
            moved = delay + share * self.loop.period
            place = min(max(moved, self.range.low), self.range.high)
            ends = self.told(place)
            shifted = [min(max(told + s * (place - delay), ends[0]), ends[-1]) for s in (0, 1)]
            pairs += [(place, value) for value in (*shifted, *ends)]
        return sorted({*pairs})
