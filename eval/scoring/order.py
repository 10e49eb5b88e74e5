"""Whether controllers stand in one order on disjoint sets of tracks.

A *seed set* holds the scores of every controller on tracks that no other set has: of one run with
tracks of its own salt, or a share of one run's tracks. Two controllers are compared in a set by the
difference of their scores on the tracks that both have: paired, since both drive the same tracks,
with a bootstrap interval over the tracks. A pair is *ordered* in a set by the difference's sign and
*separated* if its interval holds no zero. The question is not whether the order moves at all, which
it must where controllers are alike, but whether a pair that is separated in one set is ordered the
other way in another.

No interval is drawn of fewer than six tracks, which all point one way by chance once in 2^(n - 1)
times, more often than the 5 % that an interval allows; nor where a condition has one track alone.
With few tracks intervals are too narrow: more pairs are called separated than are, so that
reversals are rather found where there are none than missed.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import stats

from eval.scoring.gain import Condition
from eval.scoring.statistics import RESAMPLING, Interval, Resampling, aggregates

Scores = Mapping[str, Mapping[Condition, Mapping[int, float]]]
"""By controller, condition and track number: the mean gain over the delay [1]."""

FEWEST_TRACKS = 6
"""Fewest tracks of an interval: 2^(1 - 6) is below 5 %."""

_NO_DIFFERENCE = 1e-12
"""Differences below are rounding [1]."""


@dataclass(frozen=True, eq=False)
class SeedSet:
    """One set of tracks of one layout and division.

    Attributes:
        name: What it is called.
        scores: Scores of its controllers.
        tracks: What its tracks are drawn from: commitment of the salt, and number.
    """

    name: str
    scores: Scores
    tracks: frozenset[tuple[str, int]]


@dataclass(frozen=True)
class Pair:
    """Two controllers in every set.

    Attributes:
        first, second: Controllers; the first is the better one in the first set.
        differences: Score of the first less that of the second, per set, on common tracks.
        together: The same on the tracks of all sets.
    """

    first: str
    second: str
    differences: tuple[Interval, ...]
    together: Interval

    @property
    def signs(self) -> list[int]:
        """Who is better in each set: 1 the first, -1 the second, 0 neither."""
        return [
            0 if abs(d.estimate) < _NO_DIFFERENCE else int(np.sign(d.estimate))
            for d in self.differences
        ]

    @property
    def swaps(self) -> bool:
        """Whether one is better in one set and the other in another."""
        return {1, -1} <= {*self.signs}

    @property
    def separated(self) -> list[bool]:
        """Whether the interval of each set leaves zero out; not where none was drawn."""
        return [bool(d.low > 0.0 or d.high < 0.0) for d in self.differences]

    @property
    def drawn(self) -> list[bool]:
        """Whether each set has an interval."""
        return [not math.isnan(d.low) for d in self.differences]

    @property
    def contradicts(self) -> bool:
        """Whether they are separated in one set and stand the other way round in another."""
        signs = self.signs
        known = {sign for sign, apart in zip(signs, self.separated, strict=True) if apart}
        return any(-sign in signs for sign in known)


@dataclass(frozen=True, eq=False)
class Comparison:
    """The same controllers in several sets of tracks.

    Attributes:
        sets: The sets, reduced to what all of them have.
        whole: Controllers that have every condition that any other has; they are ranked.
        lacking: Controllers that have not, which are in pairs alone.
        left_out: Conditions without a track in some set.
    """

    sets: tuple[SeedSet, ...]
    whole: tuple[str, ...]
    lacking: tuple[str, ...]
    left_out: tuple[Condition, ...]
    resampling: Resampling | None = RESAMPLING

    def score(self, number: int, spec: str) -> float:
        """Return a controller's delay-robust score in a set, over the conditions that it has."""
        conditions = self.sets[number].scores[spec].values()
        return float(np.mean([np.mean(list(tracks.values())) for tracks in conditions]))

    def ranks(self, number: int) -> dict[str, float]:
        """Return the ranks from 1 in a set; equal scores share the mean of their ranks."""
        scores = [-self.score(number, spec) for spec in self.whole]
        ranks = stats.rankdata(np.round(scores, 12))
        return dict(zip(self.whole, map(float, ranks), strict=True))

    def agreement(self, one: int, other: int) -> tuple[float, float] | None:
        """Return Kendall's tau-b and Spearman's rho between two sets; None where all are equal."""
        first, second = (list(self.ranks(number).values()) for number in (one, other))
        if len(set(first)) < 2 or len(set(second)) < 2:
            return None
        tau, rho = stats.kendalltau(first, second), stats.spearmanr(first, second)
        return float(tau.statistic), float(rho.statistic)

    @cached_property
    def pairs(self) -> list[Pair]:
        """All pairs that have a condition in common."""
        found: list[Pair] = []
        for one, other in itertools.combinations((*self.whole, *self.lacking), 2):
            differences = [self._difference([each], one, other) for each in self.sets]
            known = tuple(d for d in differences if d is not None)
            together = self._difference(self.sets, one, other)
            if len(known) == len(self.sets) and together is not None:
                pair = Pair(one, other, known, together)
                found.append(_turned(pair) if pair.signs[0] < 0 else pair)
        return found

    def _difference(self, among: Sequence[SeedSet], one: str, other: str) -> Interval | None:
        """Return the difference of two scores on the tracks of some sets; None without any."""
        runs: dict[Condition, list[float]] = {}
        numbers: dict[Condition, list[int]] = {}
        for k, each in enumerate(among):
            second = each.scores[other]
            for condition, tracks in each.scores[one].items():
                for n in sorted(tracks.keys() & second.get(condition, {}).keys()):
                    runs.setdefault(condition, []).append(tracks[n] - second[condition][n])
                    # Equal numbers are other tracks in another set.
                    numbers.setdefault(condition, []).append(n * len(among) + k)
        if not runs:
            return None
        several = {number for own in numbers.values() for number in own}
        drawn = min(map(len, runs.values())) > 1 and len(several) >= FEWEST_TRACKS
        resampling = self.resampling if drawn else None
        labels = list(numbers.values())
        return aggregates(list(runs.values()), resampling=resampling, tracks=labels).mean


def compared(sets: Sequence[SeedSet], resampling: Resampling | None = RESAMPLING) -> Comparison:
    """Reduce sets to the controllers and conditions that all of them have, and compare them.

    Args:
        sets: Two or more.
        resampling: Of the intervals of differences.
    """
    named = [each for each in sets[0].scores if all(each in other.scores for other in sets)]
    every = {c for each in sets for own in each.scores.values() for c in own}
    shared = {
        spec: [c for c in sets[0].scores[spec] if all(c in s.scores[spec] for s in sets)]
        for spec in named
    }
    there = {condition for own in shared.values() for condition in own}
    reduced = tuple(
        SeedSet(
            each.name,
            {spec: {c: each.scores[spec][c] for c in own} for spec, own in shared.items() if own},
            each.tracks,
        )
        for each in sets
    )
    known = [spec for spec in named if shared[spec]]
    whole = tuple(spec for spec in known if len(shared[spec]) == len(there))
    lacking = tuple(spec for spec in known if spec not in whole)
    return Comparison(reduced, whole, lacking, tuple(sorted(every - there)), resampling)


def _turned(pair: Pair) -> Pair:
    turned = tuple(map(_negative, pair.differences))
    return Pair(pair.second, pair.first, turned, _negative(pair.together))


def _negative(found: Interval) -> Interval:
    return Interval(-found.estimate, -found.high, -found.low)
