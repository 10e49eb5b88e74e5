"""The score: how much of the comfort that can be had a controller has, whatever the delay.

Of one run, with W the ride index of the worse floor end:

    gain = (W_passive - W) / (W_passive - W_reference),  cut to [-1, 1].

Passive and reference are run on the same vehicle and track without delay; so zero is what the
dampers do and one what a sharp design does that has no delay to bear. A run that diverged counts
-1, and so does one whose controller crashed, hung or broke the protocol.

A *condition* is a scenario without delay and seed: vehicle, speed, track, kind of channel. The
score of a condition and a seed is the mean over the delay, from the condition's shortest to its
longest, of the gain as a piecewise linear function between the delays that are run (`delay_mean`):
so it does not depend on how finely or how evenly a suite samples the delay, as a mean over runs
would. The delay-robust score is the mean over conditions, each of which counts alike, of the means
over seeds. Weights end there: what statistics call a run is one track's mean over the delay, and
their intervals draw a track in all its conditions at once (`eval.scoring.bootstrap`).

A run is not scored, but reported, where the passive vehicle itself diverges (worn wheels beyond
their critical speed), or where the reference is hardly better than passive. That is said of a
vehicle, a speed, a spectrum and a seed, by passive and reference alone (`eval.scoring.baseline`);
so it is the same for every delay, channel and controller. A track that lacks a delay that others on
the board were run at, in records that are not finished, is left out: over part of the delays its
mean is another number.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from eval.scoring.baseline import Baseline, Condition, Row, place_of, track_of
from eval.scoring.statistics import (
    RESAMPLING,
    Aggregates,
    Interval,
    Resampling,
    aggregates,
    probability_of_improvement,
)
from railenv.units import FloatArray


@dataclass(frozen=True)
class Gain:
    """A scored run.

    Attributes:
        key: Of its scenario.
        condition: Model, vehicle, layout, speed, track, kind of channel.
        delay: Delay [s].
        seed: Number of the track.
        gain: Comfort gain [1].
    """

    key: str
    condition: Condition
    delay: float
    seed: int
    gain: float


@dataclass(frozen=True, eq=False)
class ControllerScore:
    """What the benchmark says of a controller on one layout.

    Attributes:
        gains: All scored runs.
        aggregates: Mean (the delay-robust score), interquartile mean, median and gap over
            conditions and seeds.
        worst: The run of the smallest gain.
        by_delay: Mean gain by delay [s], over the conditions that have it.
        unscored: Keys that are reported only.
        partial: Keys of tracks that lack some delays and are left out for that.
        single: Conditions with one track, of which an interval holds nothing.
    """

    gains: tuple[Gain, ...]
    aggregates: Aggregates
    worst: Gain
    by_delay: dict[float, float]
    unscored: tuple[str, ...]
    partial: tuple[str, ...] = ()
    single: tuple[Condition, ...] = ()

    @property
    def score(self) -> Interval:
        """The delay-robust score."""
        return self.aggregates.mean


def gains_of(
    rows: Sequence[Row], baselines: Mapping[Condition, Baseline]
) -> tuple[list[Gain], list[str]]:
    """Return the scored runs, and the keys of those that are not scored."""
    scored: list[Gain] = []
    unscored: list[str] = []
    for row in rows:
        here = baselines.get(track_of(row))
        if here is None or not here.scored:
            unscored.append(row["key"])
            continue
        own = Gain(row["key"], _condition_of(row), row["delay_s"], row["seed"], here.gain(row))
        scored.append(own)
    return scored, unscored


def delay_mean(gains: Mapping[float, float]) -> float:
    """Return the mean of a curve over the delay, linear between its points: the trapezoid rule.

        mean = sum_k (d_(k+1) - d_k) (g_k + g_(k+1)) / 2 / (d_n - d_0)

    Args:
        gains: Comfort gain [1] by delay [s]; of one point the mean is its gain.
    """
    delays = sorted(gains)
    if len(delays) == 1:
        return gains[delays[0]]
    pairs = list(itertools.pairwise(delays))
    widths = [late - early for early, late in pairs]
    # Over the sum of the very widths that weigh, so that a curve of -1 has the mean -1.
    areas = (w * (gains[a] + gains[b]) / 2.0 for w, (a, b) in zip(widths, pairs, strict=True))
    return math.fsum(areas) / math.fsum(widths)


def track_scores(gains: Sequence[Gain]) -> dict[Condition, dict[int, float]]:
    """Return by condition and seed the mean over the delay."""
    found: dict[Condition, dict[int, dict[float, float]]] = {}
    for each in gains:
        found.setdefault(each.condition, {}).setdefault(each.seed, {})[each.delay] = each.gain
    return {
        condition: {seed: delay_mean(curve) for seed, curve in sorted(seeds.items())}
        for condition, seeds in sorted(found.items())
    }


def score_matrix(gains: Sequence[Gain]) -> dict[Condition, FloatArray]:
    """Return by condition the mean over the delay for every seed, shape (seeds,)."""
    return {
        condition: np.array(list(seeds.values()))
        for condition, seeds in track_scores(gains).items()
    }


def delays_of(rows: Sequence[Row]) -> dict[Condition, frozenset[float]]:
    """Return the delays [s] at which a condition was run, on any track by any controller."""
    found: dict[Condition, set[float]] = {}
    for row in rows:
        found.setdefault(_condition_of(row), set()).add(row["delay_s"])
    return {condition: frozenset(delays) for condition, delays in found.items()}


def score_of(
    rows: Sequence[Row],
    baselines: Mapping[Condition, Baseline],
    resampling: Resampling | None = RESAMPLING,
    delays: Mapping[Condition, frozenset[float]] | None = None,
) -> ControllerScore | None:
    """Return the score of one controller on one layout; None if no run is scored.

    Args:
        rows: Its rows.
        baselines: See `baselines_of`.
        resampling: Of the intervals.
        delays: At which a track must have been run for it to count; None for those that the
            controller has on any track of the condition.
    """
    gains, unscored = gains_of(rows, baselines)
    gains, partial = _whole_tracks(gains, delays_of(rows) if delays is None else delays)
    if not gains:
        return None
    tracks = track_scores(gains)
    runs = [list(own.values()) for own in tracks.values()]
    numbers = [list(own) for own in tracks.values()]
    whole = aggregates(runs, resampling=resampling if _drawn(runs) else None, tracks=numbers)
    curves: dict[float, dict[Condition, list[float]]] = {}
    for each in gains:
        curves.setdefault(each.delay, {}).setdefault(each.condition, []).append(each.gain)
    by_delay = {
        delay: float(np.mean([np.mean(own) for own in conditions.values()]))
        for delay, conditions in sorted(curves.items())
    }
    return ControllerScore(
        gains=tuple(gains),
        aggregates=whole,
        worst=min(gains, key=lambda each: (each.gain, each.key)),
        by_delay=by_delay,
        unscored=tuple(unscored),
        partial=tuple(partial),
        single=tuple(condition for condition, own in tracks.items() if len(own) < 2),
    )


def improvement(
    own: ControllerScore, other: ControllerScore, resampling: Resampling | None = RESAMPLING
) -> Interval | None:
    """Return the probability that a run of one is better than one of the other.

    Over the conditions that both have, mean over conditions; None if there is none.
    """
    first, second = track_scores(own.gains), track_scores(other.gains)
    common = [condition for condition in first if condition in second]
    if not common:
        return None
    x, y = ([list(side[c].values()) for c in common] for side in (first, second))
    numbers = ([list(first[c]) for c in common], [list(second[c]) for c in common])
    drawn = resampling if _drawn(x) and _drawn(y) else None
    return probability_of_improvement(x, y, drawn, numbers)


def _drawn(runs: Sequence[Sequence[float]]) -> bool:
    """Whether there is a condition with two tracks, so that an interval can be drawn."""
    return any(len(own) > 1 for own in runs)


def _whole_tracks(
    gains: Sequence[Gain], delays: Mapping[Condition, frozenset[float]]
) -> tuple[list[Gain], list[str]]:
    """Return the runs of tracks that have every delay, and the keys of the others."""
    found: dict[tuple[Condition, int], set[float]] = {}
    for each in gains:
        found.setdefault((each.condition, each.seed), set()).add(each.delay)
    whole = {track for track, own in found.items() if own >= delays[track[0]]}
    kept = [each for each in gains if (each.condition, each.seed) in whole]
    return kept, [each.key for each in gains if (each.condition, each.seed) not in whole]


def _condition_of(row: Row) -> Condition:
    return (*place_of(row), row["track"], row["channel"])
