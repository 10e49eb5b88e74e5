"""Aggregates of scores over runs and tasks, with stratified bootstrap intervals.

Practice and definitions are those of Agarwal et al., "Deep reinforcement learning at the edge of
the statistical precipice", NeurIPS 2021 (arXiv 2108.13264), and of its library rliable 1.2.0. A
*run* is one track seed; a *task* is a family of cells: everything of a cell but the seed.

Scores come as one vector per task [1], higher is better. Tasks may differ in their number of runs:
a cell that is reported and not scored leaves its task with one run less, and to fill it in or to
drop the rest of the task would change the score silently. With equal numbers every definition is
rliable's. With unequal ones what pools (interquartile mean, optimality gap, profile of runs) counts
every run alike, and what averages tasks (mean, median, improvement, profile of means) every task.

The bootstrap draws runs with replacement within each task, independently from task to task; the
tasks are fixed. Its intervals are percentile ones, as in rliable: with n runs per task they are too
narrow, by a factor sqrt((n - 1) / n) at least. A task of one run has no spread to draw from, its
interval would claim certainty: only the estimate can be asked for then (`resampling=None`).
Two controllers are drawn independently of each other, as in rliable, although both drive the same
tracks: that they do is not used to narrow the interval of an improvement.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from railenv.errors import ArgumentError, check_count, check_finite
from railenv.units import Dimensionless, FloatArray

_SEED = 20_260_801

_ELEMENTS, _ROWS = 2**17, 256
"""Most runs and most draws at a time: a few MiB, whatever the number of draws. Results do not
depend on them, since the generator hands out its numbers draw by draw and run by run."""

_IndexArray = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Resampling:
    """How the bootstrap draws.

    Attributes:
        draws: Number of draws, 100 or more; 10,000 place an end to about 1 % of the width.
        coverage: Probability that an interval stands for [1], above zero and below one.
        generator: Source of the draws, used up as they go; None draws the same at every call.
    """

    draws: int = 10_000
    coverage: Dimensionless = 0.95
    generator: np.random.Generator | None = None

    def __post_init__(self) -> None:
        check_count("draws", self.draws, minimum=100)
        if not 0.0 < check_finite("coverage", self.coverage) < 1.0:
            raise ArgumentError(
                f"coverage = {self.coverage} must lie above 0 and below 1; give 0.95 for 95 %"
            )
        if not isinstance(self.generator, np.random.Generator | None):
            raise ArgumentError(
                f"generator = {self.generator!r} is no numpy.random.Generator; give one or None"
            )


RESAMPLING = Resampling()
"""10,000 draws of the fixed seed, 95 %."""


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
    scores: Sequence[ArrayLike], target: float = 1.0, resampling: Resampling | None = RESAMPLING
) -> Aggregates:
    """Return the four aggregates, with the intervals of rliable's `StratifiedBootstrap`.

    Args:
        scores: One vector of shape (runs,) per task [1]; at least two runs each, or one without
            resampling.
        target: Score that is good enough, rliable's gamma [1].
        resampling: How runs are drawn; None for the estimates alone.

    Raises:
        ArgumentError: There is no task, a task has the wrong shape or too few runs, or a score or
            the target is not finite.
    """
    target = check_finite("target", target)
    pool = _Pool("scores", scores, resampling)

    def statistic(index: _IndexArray) -> FloatArray:
        drawn = pool.values[index]
        means = pool.task_means(drawn)
        gap = target - np.minimum(drawn, target).mean(axis=1)
        drawn.sort(axis=1)
        cut = drawn.shape[1] // 4
        middle = drawn[:, cut : drawn.shape[1] - cut].mean(axis=1)
        return np.stack([middle, means.mean(axis=1), np.median(means, axis=1), gap], axis=1)

    ends = _bootstrap(statistic, pool.counts, resampling)
    return Aggregates(*(Interval(*map(float, column)) for column in ends.T))


def probability_of_improvement(
    scores: Sequence[ArrayLike],
    others: Sequence[ArrayLike],
    resampling: Resampling | None = RESAMPLING,
) -> Interval:
    """Return P(X > Y) + P(X = Y) / 2, averaged over tasks.

    rliable's `probability_of_improvement`: the Mann-Whitney U of each task over its number of
    pairs. Every run of X meets every run of Y, not seed by seed. The interval is that of its
    `StratifiedIndependentBootstrap`: X and Y are drawn independently of each other.

    Args:
        scores: X, one vector of shape (runs,) per task [1], as in `aggregates`.
        others: Y, the same tasks in the same order; the numbers of runs may differ [1].
        resampling: How runs are drawn; None for the estimate alone.

    Raises:
        ArgumentError: As in `aggregates`, or X and Y differ in their number of tasks.
    """
    x, y = _Pool("scores", scores, resampling), _Pool("others", others, resampling)
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

    def statistic(index: _IndexArray) -> FloatArray:
        # How often the runs of Y before each place, in sorted order, were drawn.
        before = np.zeros((index.shape[0], y.values.size + 1), dtype=np.intp)
        np.cumsum(_tally(index[:, split:] - split, y.values.size), axis=1, out=before[:, 1:])
        wins = before[:, below] + before[:, reached] - 2 * before[:, start]
        met = np.take_along_axis(wins, index[:, :split], axis=1)
        return (np.add.reduceat(met, x.first, axis=1) / (2 * x.counts * y.counts)).mean(axis=1)

    ends = _bootstrap(statistic, np.concatenate([x.counts, y.counts]), resampling)
    return Interval(*map(float, ends))


def performance_profile(
    scores: Sequence[ArrayLike],
    thresholds: ArrayLike,
    resampling: Resampling | None = RESAMPLING,
    *,
    of_means: bool = False,
) -> Profile:
    """Return the share of all runs above each threshold, or of the tasks' means.

    rliable's `create_performance_profile`: its run-score and its average-score distribution.

    Args:
        scores: One vector of shape (runs,) per task [1], as in `aggregates`.
        thresholds: Scores [1], finite and strictly ascending, shape (thresholds,).
        resampling: How runs are drawn; None for the estimates alone.
        of_means: Whether tasks are counted by their mean, instead of runs.

    Raises:
        ArgumentError: As in `aggregates`, or the thresholds break their rule.
    """
    pool, edges = _Pool("scores", scores, resampling), _vector("thresholds", thresholds)
    if np.any(np.diff(edges) <= 0.0):
        raise ArgumentError("thresholds must ascend strictly; sort them and drop repeated ones")
    passed = np.searchsorted(edges, pool.values)  # number of thresholds strictly below

    def statistic(index: _IndexArray) -> FloatArray:
        number = passed[index]
        if of_means:
            number = np.searchsorted(edges, pool.task_means(pool.values[index]))
        tally = _tally(number, edges.size + 1)
        return tally[:, :0:-1].cumsum(axis=1)[:, ::-1] / number.shape[1]

    return Profile(edges, *_bootstrap(statistic, pool.counts, resampling))


class _Pool:
    """The runs of all tasks, one after another, checked; two runs per task where one draws."""

    def __init__(self, name: str, scores: Sequence[ArrayLike], by: Resampling | None) -> None:
        if not isinstance(scores, list | tuple) or not scores:
            # Of a matrix nobody knows whether rows are runs, as in rliable, or tasks.
            raise ArgumentError(
                f"{name} is an empty list or none but {type(scores).__name__}; give one vector "
                f"per task, for a matrix (runs, tasks) list({name}.T)"
            )
        self.tasks = [_vector(f"{name}[{k}]", task) for k, task in enumerate(scores)]
        self.counts = np.array([task.size for task in self.tasks], dtype=np.intp)
        if by is not None and self.counts.min() == 1:
            raise ArgumentError(
                f"{name}[{self.counts.argmin()}] has one run, of which no interval can be drawn; "
                "give two or more, or resampling=None for the estimate alone"
            )
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


def _tally(index: _IndexArray, size: int) -> _IndexArray:
    """Return how often each of 0 .. size - 1 is in every row, (rows, any) to (rows, size)."""
    rows = index.shape[0]
    flat = (index + size * np.arange(rows)[:, None]).ravel()
    return np.bincount(flat, minlength=rows * size).reshape(rows, size)


def _bootstrap(
    statistic: Callable[[_IndexArray], FloatArray], counts: _IndexArray, by: Resampling | None
) -> FloatArray:
    """Return the estimate and the ends of its interval, shape (3, ...).

    Args:
        statistic: Maps indices of runs, shape (draws, runs of all tasks), to shape (draws, ...).
        counts: Runs of each task, shape (tasks,); the tasks' runs are numbered one after another.
        by: How runs are drawn; None leaves the ends NaN.
    """
    estimate = statistic(np.arange(counts.sum())[None, :])[0]
    if by is None:
        return np.stack([estimate, *np.full((2, *estimate.shape), np.nan)])
    generator = by.generator or np.random.Generator(np.random.PCG64(_SEED))
    first, size = np.repeat(np.cumsum(counts) - counts, counts), np.repeat(counts, counts)
    rows = max(1, min(_ROWS, _ELEMENTS // size.size))
    drawn = list[FloatArray]()
    for begin in range(0, by.draws, rows):
        # A share is a multiple of 2^-53 below one; times n it stays below n after rounding.
        shares = generator.random((min(rows, by.draws - begin), size.size))
        drawn.append(statistic(first + (shares * size).astype(np.intp)))
    tail = (1.0 - by.coverage) / 2.0
    return np.stack([estimate, *np.quantile(np.concatenate(drawn), [tail, 1.0 - tail], axis=0)])
