"""Aggregates of scores over runs and tasks, with stratified bootstrap intervals.

Practice and definitions are those of Agarwal et al., "Deep reinforcement learning at the edge of
the statistical precipice", NeurIPS 2021 (arXiv 2108.13264), and of its library rliable 1.2.0. A
*run* is one track seed; a *task* is a family of cells: everything of a cell but the seed.

Scores come as one vector per task [1], higher is better. Tasks may differ in their number of runs:
a cell that is reported and not scored leaves its task with one run less, and to fill it in or to
drop the rest of the task would change the score silently. With equal numbers every definition is
rliable's. With unequal ones what pools (interquartile mean, optimality gap, profile of runs) counts
every run alike, and what averages tasks (mean, median, improvement, profile of means) every task.

The bootstrap draws runs with replacement within each task; the tasks are fixed. Intervals are
percentile ones, as in rliable: with n runs per task they are too narrow, by a factor
sqrt((n - 1) / n) at least. Tasks are drawn independently, as in rliable, unless `tracks` says which
runs are of one track: these are drawn together, see `eval.scoring.bootstrap`.

A task of one run has no spread to draw from: it is the same in every draw and adds nothing to the
width. Where all tasks have one run, only the estimate can be asked for (`resampling=None`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from eval.scoring.bootstrap import RESAMPLING, IndexArray, Labels, Resampling, bootstrap
from railenv.errors import ArgumentError, check_finite
from railenv.units import Dimensionless, FloatArray

__all__ = [
    "RESAMPLING",
    "Aggregates",
    "Interval",
    "Profile",
    "Resampling",
    "aggregates",
    "performance_profile",
    "probability_of_improvement",
]


@dataclass(frozen=True)
class Interval:
    """A number with its percentile interval.

    Attributes:
        estimate: The number, of the scores as they are.
        low, high: Ends of the interval; NaN where no resampling was asked for.
    """

    estimate: Dimensionless
    low: Dimensionless
    high: Dimensionless


@dataclass(frozen=True)
class Aggregates:
    """What one controller's scores come to, all from the same draws.

    Attributes:
        interquartile_mean: Mean of the middle half of all runs of all tasks: of n runs the
            floor(n / 4) lowest and as many highest are left out. rliable's `aggregate_iqm`, which
            is `scipy.stats.trim_mean(scores, 0.25, axis=None)`.
        mean: Mean over tasks of each task's mean, rliable's `aggregate_mean`.
        median: Median over tasks of each task's mean, rliable's `aggregate_median`.
        optimality_gap: target - mean of min(score, target) over all runs, lower is better: nothing
            above the target makes up for another run. rliable's `aggregate_optimality_gap`.
    """

    interquartile_mean: Interval
    mean: Interval
    median: Interval
    optimality_gap: Interval


@dataclass(frozen=True, eq=False)
class Profile:
    """Shares strictly above thresholds; the intervals hold for each threshold by itself.

    Attributes:
        thresholds: Scores [1], ascending, shape (thresholds,).
        estimate: Shares [1], shape (thresholds,).
        low, high: Ends of the intervals, likewise; NaN where no resampling was asked for.
    """

    thresholds: FloatArray
    estimate: FloatArray
    low: FloatArray
    high: FloatArray


def aggregates(
    scores: Sequence[ArrayLike],
    target: float = 1.0,
    resampling: Resampling | None = RESAMPLING,
    tracks: Labels | None = None,
) -> Aggregates:
    """Return the four aggregates, with the intervals of rliable's `StratifiedBootstrap`.

    Args:
        scores: One vector of shape (runs,) per task [1]; at least one has two runs, unless there is
            no resampling.
        target: Score that is good enough, rliable's gamma [1].
        resampling: How runs are drawn; None for the estimates alone.
        tracks: Number of every run's track, in the shape of the scores; None for tracks that no two
            tasks share.

    Raises:
        ArgumentError: There is no task, a task has the wrong shape, all have one run, or a score or
            the target is not finite.
    """
    target = check_finite("target", target)
    pool = _Pool("scores", scores, resampling, tracks)

    def statistic(index: IndexArray) -> FloatArray:
        drawn = pool.values[index]
        means = pool.task_means(drawn)
        gap = target - np.minimum(drawn, target).mean(axis=1)
        drawn.sort(axis=1)
        cut = drawn.shape[1] // 4
        middle = drawn[:, cut : drawn.shape[1] - cut].mean(axis=1)
        return np.stack([middle, means.mean(axis=1), np.median(means, axis=1), gap], axis=1)

    ends = bootstrap(statistic, pool.counts, resampling, tracks)
    return Aggregates(*(Interval(*map(float, column)) for column in ends.T))


def probability_of_improvement(
    scores: Sequence[ArrayLike],
    others: Sequence[ArrayLike],
    resampling: Resampling | None = RESAMPLING,
    tracks: tuple[Labels, Labels] | None = None,
) -> Interval:
    """Return P(X > Y) + P(X = Y) / 2, averaged over tasks.

    rliable's `probability_of_improvement`: the Mann-Whitney U of each task over its number of
    pairs. Every run of X meets every run of Y, not seed by seed. The interval is that of its
    `StratifiedIndependentBootstrap`, X and Y drawn independently of each other, unless their
    tracks are told.

    Args:
        scores: X, one vector of shape (runs,) per task [1], as in `aggregates`.
        others: Y, the same tasks in the same order; the numbers of runs may differ [1].
        resampling: How runs are drawn; None for the estimate alone.
        tracks: Track numbers of X and of Y, as in `aggregates`.

    Raises:
        ArgumentError: As in `aggregates`, or X and Y differ in their number of tasks.
    """
    of_x, of_y = (None, None) if tracks is None else tracks
    x, y = _Pool("scores", scores, resampling, of_x), _Pool("others", others, resampling, of_y)
    if x.counts.size != y.counts.size:
        raise ArgumentError(
            f"scores has {x.counts.size} tasks and others has {y.counts.size}; give the same tasks "
            "in the same order"
        )
    split = x.values.size
    # How many runs of Y, sorted within their task, stand below each of X and how many not above.
    parts = list(zip(y.first, map(np.sort, y.tasks), x.tasks, strict=True))
    below = np.concatenate([at + np.searchsorted(of, v, "left") for at, of, v in parts])
    reached = np.concatenate([at + np.searchsorted(of, v, "right") for at, of, v in parts])
    start = np.repeat(y.first, x.counts)

    def statistic(index: IndexArray) -> FloatArray:
        # How often the runs of Y before each place, in sorted order, were drawn.
        before = np.zeros((index.shape[0], y.values.size + 1), dtype=np.intp)
        np.cumsum(_tally(index[:, split:] - split, y.values.size), axis=1, out=before[:, 1:])
        wins = before[:, below] + before[:, reached] - 2 * before[:, start]
        met = np.take_along_axis(wins, index[:, :split], axis=1)
        return (np.add.reduceat(met, x.first, axis=1) / (2 * x.counts * y.counts)).mean(axis=1)

    labels = None if of_x is None or of_y is None else [*of_x, *of_y]
    ends = bootstrap(statistic, np.concatenate([x.counts, y.counts]), resampling, labels)
    return Interval(*map(float, ends))


def performance_profile(
    scores: Sequence[ArrayLike],
    thresholds: ArrayLike,
    resampling: Resampling | None = RESAMPLING,
    *,
    of_means: bool = False,
    tracks: Labels | None = None,
) -> Profile:
    """Return the share of all runs above each threshold, or of the tasks' means.

    rliable's `create_performance_profile`: its run-score and its average-score distribution.

    Args:
        scores: One vector of shape (runs,) per task [1], as in `aggregates`.
        thresholds: Scores [1], finite and strictly ascending, shape (thresholds,).
        resampling: How runs are drawn; None for the estimates alone.
        of_means: Whether tasks are counted by their mean, instead of runs.
        tracks: As in `aggregates`.

    Raises:
        ArgumentError: As in `aggregates`, or the thresholds break their rule.
    """
    pool, edges = _Pool("scores", scores, resampling, tracks), _vector("thresholds", thresholds)
    if np.any(np.diff(edges) <= 0.0):
        raise ArgumentError("thresholds must ascend strictly; sort them and drop repeated ones")
    passed = np.searchsorted(edges, pool.values)  # number of thresholds strictly below

    def statistic(index: IndexArray) -> FloatArray:
        number = passed[index]
        if of_means:
            number = np.searchsorted(edges, pool.task_means(pool.values[index]))
        tally = _tally(number, edges.size + 1)
        return tally[:, :0:-1].cumsum(axis=1)[:, ::-1] / number.shape[1]

    return Profile(edges, *bootstrap(statistic, pool.counts, resampling, tracks))


class _Pool:
    """The runs of all tasks, one after another, checked; a task of two runs where one draws."""

    def __init__(
        self,
        name: str,
        scores: Sequence[ArrayLike],
        by: Resampling | None,
        tracks: Labels | None,
    ) -> None:
        if not isinstance(scores, list | tuple) or not scores:
            # Of a matrix nobody knows whether rows are runs, as in rliable, or tasks.
            raise ArgumentError(
                f"{name} is an empty list or none but {type(scores).__name__}; give one vector "
                f"per task, for a matrix (runs, tasks) list({name}.T)"
            )
        self.tasks = [_vector(f"{name}[{k}]", task) for k, task in enumerate(scores)]
        self.counts = np.array([task.size for task in self.tasks], dtype=np.intp)
        if by is not None and self.counts.max() == 1:
            raise ArgumentError(
                f"{name} has one run per task, of which no interval can be drawn; give two or more "
                "in one task at least, or resampling=None for the estimate alone"
            )
        if tracks is not None and [len(own) for own in tracks] != self.counts.tolist():
            raise ArgumentError(f"tracks of {name} must have a number for every run of every task")
        self.values = np.concatenate(self.tasks)
        self.first = np.cumsum(self.counts) - self.counts

    def task_means(self, drawn: FloatArray) -> FloatArray:
        """Return the mean of every task, (draws, runs of all tasks) to (draws, tasks)."""
        return np.add.reduceat(drawn, self.first, axis=1) / self.counts


def _vector(name: str, values: ArrayLike) -> FloatArray:
    try:
        array = np.asarray(values)
    except ValueError:
        raise ArgumentError(f"{name} has rows of unequal length; give one vector") from None
    if array.ndim != 1 or array.size == 0 or array.dtype.kind not in "iuf":
        raise ArgumentError(
            f"{name} has shape {array.shape} and type {array.dtype}; give a vector of real numbers"
        )
    for k in np.flatnonzero(~np.isfinite(array)):
        raise ArgumentError(
            f"{name}[{k}] = {array[k]} must be finite; leave out a run that is not scored"
        )
    return array.astype(np.float64)


def _tally(index: IndexArray, size: int) -> IndexArray:
    """Return how often each of 0 .. size - 1 is in every row, (rows, any) to (rows, size)."""
    rows = index.shape[0]
    flat = (index + size * np.arange(rows)[:, None]).ravel()
    return np.bincount(flat, minlength=rows * size).reshape(rows, size)
