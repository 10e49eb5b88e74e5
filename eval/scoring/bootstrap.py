"""The stratified bootstrap: draws of runs within tasks, together where runs are of one track.

A benchmark drives the same tracks in many conditions: track 3 at 200 and at 300 km/h has the same
phases, and what it does to a score it does in both alike. Drawn independently from condition to
condition, as if they were hundreds of tracks, the mean's interval comes out up to three times too
narrow. So the draws are coupled: each pick gives every track number a random key, and every task
picks, of the tracks that it has, the one with the smallest key. Each task by itself is then drawn
uniformly with replacement, as without the coupling; tasks with the same tracks draw the same ones;
of tasks whose tracks are partly the same, the picks agree as often as they can.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from railenv.errors import ArgumentError, check_count, check_finite
from railenv.units import Dimensionless, FloatArray

IndexArray = NDArray[np.intp]

Labels = Sequence[Sequence[int]]
"""For every task the numbers of its runs' tracks, each once."""

_SEED = 20_260_801

_ELEMENTS, _ROWS = 2**17, 256
"""Most runs and most draws at a time: a few MiB, whatever the number of draws. Results do not
depend on them, since the generator hands out its numbers draw by draw and run by run."""


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


def bootstrap(
    statistic: Callable[[IndexArray], FloatArray],
    counts: IndexArray,
    by: Resampling | None,
    tracks: Labels | None = None,
) -> FloatArray:
    """Return the estimate and the ends of its interval, shape (3, ...).

    Args:
        statistic: Maps indices of runs, shape (draws, runs of all tasks), to shape (draws, ...).
        counts: Runs of each task, shape (tasks,); the tasks' runs are numbered one after another.
        by: How runs are drawn; None leaves the ends NaN.
        tracks: Track of every run, so that runs of one track are drawn together; None to draw the
            tasks independently.
    """
    estimate = statistic(np.arange(counts.sum())[None, :])[0]
    if by is None:
        return np.stack([estimate, *np.full((2, *estimate.shape), np.nan)])
    generator = by.generator or np.random.Generator(np.random.PCG64(_SEED))
    draws = _Independent(counts) if tracks is None else _Coupled(counts, tracks)
    rows = max(1, min(_ROWS, _ELEMENTS // draws.size))
    drawn = list[FloatArray]()
    for begin in range(0, by.draws, rows):
        drawn.append(statistic(draws.indices(generator, min(rows, by.draws - begin))))
    tail = (1.0 - by.coverage) / 2.0
    return np.stack([estimate, *np.quantile(np.concatenate(drawn), [tail, 1.0 - tail], axis=0)])


class _Independent:
    """Draws of every task by itself."""

    def __init__(self, counts: IndexArray) -> None:
        self._first = np.repeat(np.cumsum(counts) - counts, counts)
        self._counts = np.repeat(counts, counts)
        self.size = self._counts.size

    def indices(self, generator: np.random.Generator, rows: int) -> IndexArray:
        # A share is a multiple of 2^-53 below one; times n it stays below n after rounding.
        shares = generator.random((rows, self.size))
        return self._first + (shares * self._counts).astype(np.intp)


class _Coupled:
    """Draws of tasks that share tracks."""

    def __init__(self, counts: IndexArray, tracks: Labels) -> None:
        self._first = np.repeat(np.cumsum(counts) - counts, counts)
        self._tasks = [tuple(own) for own in tracks]
        if any(len(set(own)) < len(own) for own in self._tasks):
            raise ArgumentError("tracks has a number twice in a task; give each run its own")
        numbers = sorted({number for own in self._tasks for number in own})
        place = {number: k for k, number in enumerate(numbers)}
        self._places = {own: [place[number] for number in own] for own in set(self._tasks)}
        self._shape = (int(counts.max()), len(numbers))
        self.size = max(self._first.size, self._shape[0] * self._shape[1])

    def indices(self, generator: np.random.Generator, rows: int) -> IndexArray:
        keys = generator.random((rows, *self._shape))
        picks = {
            own: keys[:, : len(own), places].argmin(axis=2) for own, places in self._places.items()
        }
        return self._first + np.concatenate([picks[own] for own in self._tasks], axis=1)
