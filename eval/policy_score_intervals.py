"""Intervals of ride indices and of differences between two controllers, by bootstrap.

Tracks are drawn with replacement, and where there are several training seeds of one recipe the
seeds are drawn first (tracks are common to all of them, so that both draws are crossed). Every
number of one score uses the same draws: an interval of a difference is that of a paired one.

The interval is the expanded percentile one (Hesterberg 2015, "What teachers should know about the
bootstrap", The American Statistician 69, 371-386): of a sample of n the plain percentile interval
is too narrow, by sqrt((n - 1) / n) and by what Student's t is wider than the normal distribution,
and its tails are moved outwards by as much. With several seeds n is the number of seeds or of
tracks, whichever is smaller.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from eval.policy_score_runs import Comfort
from railenv.errors import ArgumentError, check_count
from railenv.units import FloatArray

DRAWS = 10_000
"""Draws of a bootstrap."""

COVERAGE = 0.95
"""Probability that an interval stands for."""

_SEED = 20_260_101


@dataclass(frozen=True, eq=False)
class Estimate:
    """A mean with its interval, at every delay; NaN where a run left every bound.

    Attributes:
        value: Shape (delays,).
        low: Lower end, shape (delays,).
        high: Upper end, shape (delays,).
    """

    value: FloatArray
    low: FloatArray
    high: FloatArray


class Bootstrap:
    """Draws of seeds and tracks.

    Args:
        tracks: Number of tracks.
        seeds: Number of training seeds; 1 leaves the seed as it is.
        draws: Number of draws.

    Raises:
        ArgumentError: A number is not above zero.
    """

    def __init__(self, tracks: int, seeds: int = 1, draws: int = DRAWS) -> None:
        self.tracks, self.seeds = check_count("tracks", tracks), check_count("seeds", seeds)
        generator = np.random.Generator(
            np.random.PCG64([_SEED, tracks, check_count("draws", draws)])
        )
        # Tracks first: what is drawn of them is then the same for one seed and for several, so that
        # both pair with the same draws of a reference.
        self._tracks = _shares(generator, tracks, draws)
        self._seeds = _shares(generator, seeds, draws)

    def means(self, values: FloatArray) -> FloatArray:
        """Return the mean over the drawn tracks, shape (draws, delays).

        Args:
            values: Shape (delays, tracks).
        """
        return self._tracks @ values.T

    def worse(self, runs: Sequence[Comfort]) -> FloatArray:
        """Return what the ride index of the worse end is in every draw, shape (draws, delays).

        Of each policy it is the larger of the two ends' means over the drawn tracks; over policies
        it is the mean over the drawn seeds.

        Args:
            runs: The comfort of every seed's policy, or of one controller.

        Raises:
            ArgumentError: There are neither as many runs as seeds nor one.
        """
        each = [np.maximum(self.means(run.front), self.means(run.rear)) for run in runs]
        if len(each) == 1:
            return each[0]
        if len(each) != self.seeds:
            raise ArgumentError(
                f"runs has {len(each)} entries and the bootstrap draws from {self.seeds} seeds; "
                "give as many runs as seeds, or one"
            )
        return np.einsum("bs,sbd->bd", self._seeds, np.stack(each))

    def index(self, runs: Sequence[Comfort]) -> Estimate:
        """Return the ride index of the worse end, mean over the policies."""
        return self._estimate(_mean_worse(runs), self.worse(runs), len(runs))

    def margin(self, reference: Comfort, runs: Sequence[Comfort]) -> Estimate:
        """Return by how much the ride index is below a reference's; above zero is better."""
        value = reference.worse - _mean_worse(runs)
        return self._estimate(value, self.worse([reference]) - self.worse(runs), len(runs))

    def _estimate(self, value: FloatArray, drawn: FloatArray, runs: int) -> Estimate:
        sample = self.tracks if runs == 1 else min(self.tracks, runs)
        tail = expanded_tail(sample)
        blank = np.isnan(value)
        low, high = np.quantile(np.where(blank, 0.0, drawn), [tail, 1.0 - tail], axis=0)
        return Estimate(value, np.where(blank, np.nan, low), np.where(blank, np.nan, high))


def expanded_tail(sample: int) -> float:
    """Return the share of a bootstrap's draws beyond either end of the interval.

    Phi(-sqrt(n / (n - 1)) t), t the quantile of Student's distribution with n - 1 degrees of
    freedom; half of one minus the coverage for large n.

    Args:
        sample: Size n of the sample that is drawn from; for one there is no interval, and all
            draws are alike.
    """
    if check_count("sample", sample) == 1:
        return 0.5
    t = stats.t.ppf(0.5 + COVERAGE / 2.0, sample - 1)
    return float(stats.norm.cdf(-np.sqrt(sample / (sample - 1.0)) * t))


def _mean_worse(runs: Sequence[Comfort]) -> FloatArray:
    return np.mean([run.worse for run in runs], axis=0)


def _shares(generator: np.random.Generator, number: int, draws: int) -> FloatArray:
    """Return the share of each of some things in every draw with replacement, (draws, number)."""
    counts = generator.multinomial(number, np.full(number, 1.0 / number), size=draws)
    return counts / float(number)
