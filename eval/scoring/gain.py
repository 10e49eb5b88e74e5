"""The score: how much of the comfort that can be had a controller has, whatever the delay.

Of one run, with W the ride index of the worse floor end:

    gain = (W_passive - W) / (W_passive - W_reference),  cut to [-1, 1].

Passive and reference are run on the same vehicle and track without delay; so zero is what the
dampers do and one what a sharp design does that has no delay to bear. A run that diverged counts
-1, and so does one whose controller crashed, hung or broke the protocol.

A *condition* is a scenario without delay and seed: vehicle, speed, track, kind of channel. The
score of a condition and a seed is the mean over its delays; the delay-robust score is the mean over
conditions, each of which counts alike, of the means over seeds.

A run is not scored, but reported, where the passive vehicle itself diverges (worn wheels beyond
their critical speed), or where the reference is hardly better than passive.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from eval.scenarios.channel import number_text
from eval.scoring.statistics import (
    RESAMPLING,
    Aggregates,
    Interval,
    Resampling,
    aggregates,
    probability_of_improvement,
)
from railenv.units import Dimensionless, FloatArray

LEAST_GAIN: Dimensionless = 0.1
"""Ride index by which the reference must be better than passive for a run to be scored."""

WORST = -1.0
"""What a run counts that diverged or came to no end."""

Row = Mapping[str, Any]
Condition = tuple[str, ...]


@dataclass(frozen=True)
class Baseline:
    """Passive and reference, on one vehicle and one track.

    Attributes:
        passive: Ride index of the worse floor end; None if the vehicle diverged [1].
        reference: The same of the reference [1].
    """

    passive: float | None
    reference: float | None

    @property
    def scored(self) -> bool:
        """Whether runs here are scored."""
        if self.passive is None or self.reference is None:
            return False
        return self.passive - self.reference >= LEAST_GAIN

    def gain(self, row: Row) -> float:
        """Return the comfort gain of a run."""
        worse = worse_end(row)
        if worse is None or self.passive is None or self.reference is None:
            return WORST
        share = (self.passive - worse) / (self.passive - self.reference)
        return float(np.clip(share, WORST, 1.0))


def worse_end(row: Row) -> float | None:
    """Return the ride index of the worse floor end; None if the run diverged or has no end."""
    if row["status"] != "ok":
        return None
    return max(row["ride_index_front"], row["ride_index_rear"])


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
    """

    gains: tuple[Gain, ...]
    aggregates: Aggregates
    worst: Gain
    by_delay: dict[float, float]
    unscored: tuple[str, ...]

    @property
    def score(self) -> Interval:
        """The delay-robust score."""
        return self.aggregates.mean


def baselines_of(passive: Sequence[Row], reference: Sequence[Row]) -> dict[Condition, Baseline]:
    """Return passive and reference by vehicle, track and seed.

    Args:
        passive: Rows of passive, without delay.
        reference: Rows of the reference on the same scenarios.
    """
    by_place = {_track_of(row): worse_end(row) for row in reference}
    return {
        _track_of(row): Baseline(worse_end(row), by_place.get(_track_of(row))) for row in passive
    }


def gains_of(
    rows: Sequence[Row], baselines: Mapping[Condition, Baseline]
) -> tuple[list[Gain], list[str]]:
    """Return the scored runs, and the keys of those that are not scored."""
    scored: list[Gain] = []
    unscored: list[str] = []
    for row in rows:
        here = baselines.get(_track_of(row))
        if here is None or not here.scored:
            unscored.append(row["key"])
            continue
        condition = (*_place(row), row["track"], row["channel"])
        own = Gain(row["key"], condition, row["delay_s"], row["seed"], here.gain(row))
        scored.append(own)
    return scored, unscored


def score_matrix(gains: Sequence[Gain]) -> dict[Condition, FloatArray]:
    """Return by condition the mean over its delays for every seed, shape (seeds,)."""
    found: dict[Condition, dict[int, list[float]]] = {}
    for each in gains:
        found.setdefault(each.condition, {}).setdefault(each.seed, []).append(each.gain)
    return {
        condition: np.array([math.fsum(runs) / len(runs) for _, runs in sorted(seeds.items())])
        for condition, seeds in sorted(found.items())
    }


def score_of(
    rows: Sequence[Row],
    baselines: Mapping[Condition, Baseline],
    resampling: Resampling | None = RESAMPLING,
) -> ControllerScore | None:
    """Return the score of one controller on one layout; None if no run is scored.

    Args:
        rows: Its rows.
        baselines: See `baselines_of`.
        resampling: Of the intervals.
    """
    gains, unscored = gains_of(rows, baselines)
    if not gains:
        return None
    matrix = list(score_matrix(gains).values())
    # An interval needs two tracks in every condition.
    alone = any(len(runs) < 2 for runs in matrix)
    whole = aggregates(matrix, resampling=None if alone else resampling)
    delays: dict[float, dict[Condition, list[float]]] = {}
    for each in gains:
        delays.setdefault(each.delay, {}).setdefault(each.condition, []).append(each.gain)
    by_delay = {
        delay: float(np.mean([np.mean(runs) for runs in conditions.values()]))
        for delay, conditions in sorted(delays.items())
    }
    worst = min(gains, key=lambda each: (each.gain, each.key))
    return ControllerScore(tuple(gains), whole, worst, by_delay, tuple(unscored))


def improvement(
    own: ControllerScore, other: ControllerScore, resampling: Resampling | None = RESAMPLING
) -> Interval | None:
    """Return the probability that a run of one is better than one of the other.

    Over the conditions that both have, mean over conditions; None if there is none.
    """
    first, second = score_matrix(own.gains), score_matrix(other.gains)
    common = [condition for condition in first if condition in second]
    if not common:
        return None
    x, y = [first[c] for c in common], [second[c] for c in common]
    alone = any(len(runs) < 2 for runs in (*x, *y))
    return probability_of_improvement(x, y, None if alone else resampling)


def _place(row: Row) -> Condition:
    return row["model"], row["vehicle"], row["layout"], number_text(row["speed_kmh"])


def _track_of(row: Row) -> Condition:
    return (*_place(row), row["track"], str(row["seed"]))
