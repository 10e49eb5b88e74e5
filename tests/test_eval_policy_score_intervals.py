"""Intervals of a score: closed forms of the bootstrap over tracks and seeds."""

import numpy as np
import pytest
from scipy import stats

from eval.policy_score_intervals import Bootstrap, expanded_tail
from eval.policy_score_runs import Comfort
from railenv.errors import ArgumentError
from railenv.units import FloatArray

DRAWN = 0.05
"""Relative error of what 10 000 draws give: 1.4 % for a variance (sqrt(2 / draws)), 1 to 2 % for
the end of an interval; three times that."""


def comfort(front: FloatArray, rear: FloatArray | None = None) -> Comfort:
    """Return comfort of which only the ride index counts; the rear end is better if not given."""
    other = front - 1.0 if rear is None else rear
    return Comfort(front, other, front, front, np.zeros(front.shape, dtype=bool))


def normal_sample(number: int, mean: float, deviation: float) -> FloatArray:
    """Return quantiles of a normal distribution, scaled to exactly this sample deviation."""
    sample = stats.norm.ppf((np.arange(number) + 0.5) / number)
    return mean + deviation * sample / sample.std(ddof=1)


def test_the_interval_of_a_mean_is_students() -> None:
    sample = normal_sample(20, 2.0, 0.1)
    found = Bootstrap(20).index([comfort(sample[None, :])])
    half = stats.t.ppf(0.975, 19) * 0.1 / np.sqrt(20)
    assert found.value[0] == pytest.approx(2.0)
    assert found.high[0] - 2.0 == pytest.approx(half, rel=DRAWN)
    assert 2.0 - found.low[0] == pytest.approx(half, rel=DRAWN)


def test_a_large_sample_has_the_plain_percentile_interval() -> None:
    assert expanded_tail(10**6) == pytest.approx(0.025, rel=1e-4)


def test_one_track_has_no_interval() -> None:
    found = Bootstrap(1).index([comfort(np.array([[2.0]]))])
    assert (found.low[0], found.value[0], found.high[0]) == (2.0, 2.0, 2.0)


def test_a_margin_is_paired_track_by_track() -> None:
    sample = normal_sample(20, 2.0, 0.3)[None, :]
    margin = Bootstrap(20).margin(comfort(sample), [comfort(sample - 0.4)])
    ends = (margin.low[0], margin.value[0], margin.high[0])
    assert ends == pytest.approx((0.4, 0.4, 0.4))  # unpaired draws would spread by 0.1


def test_seeds_and_tracks_add_their_variances() -> None:
    seeds, tracks = normal_sample(5, 0.0, 0.2), normal_sample(20, 2.0, 0.3)
    runs = [comfort((a + tracks)[None, :]) for a in seeds]
    draws = Bootstrap(20, 5).worse(runs)[:, 0]
    # Of what is drawn with replacement the variance of the sample itself counts, not its estimate.
    expected = seeds.var() / 5 + tracks.var() / 20
    assert draws.var() == pytest.approx(expected, rel=DRAWN)


def test_the_interval_over_seeds_counts_the_seeds_not_the_tracks() -> None:
    seeds = normal_sample(5, 2.0, 0.1)
    found = Bootstrap(20, 5).index([comfort(np.full((1, 20), a)) for a in seeds])
    # Of five seeds the tail is 0.1 %, near the draws of one seed only: no closer than Student's
    # interval is to three standard errors.
    half = (found.high[0] - found.low[0]) / 2.0
    assert half == pytest.approx(stats.t.ppf(0.975, 4) * 0.1 / np.sqrt(5), rel=0.15)


def test_the_worse_end_is_taken_after_the_mean_over_tracks() -> None:
    front, rear = np.array([[1.0, 3.0]]), np.array([[2.5, 1.0]])
    # Means 2.0 and 1.75; track by track the worse end would be 2.75.
    run = [comfort(front, rear)]
    assert Bootstrap(2).index(run).value[0] == pytest.approx(2.0)
    assert set(Bootstrap(2).worse(run)[:, 0]) == {2.0, 2.5, 3.0}  # both tracks, or either twice


def test_the_worse_end_of_every_policy_counts_before_the_mean_over_seeds() -> None:
    low, high = np.array([[1.0, 1.0]]), np.array([[3.0, 3.0]])
    found = Bootstrap(2, 2).index([comfort(low, high), comfort(high, low)])
    assert found.value[0] == pytest.approx(3.0)
    assert found.low[0] == pytest.approx(3.0)


def test_a_delay_at_which_a_track_is_lost_leaves_the_others_alone() -> None:
    values = np.array([[2.0, 2.2, 2.1], [2.0, np.nan, 2.1]])
    found = Bootstrap(3).index([comfort(values)])
    assert np.isnan([found.value[1], found.low[1], found.high[1]]).all()
    assert found.low[0] < found.value[0] < found.high[0]


def test_draws_are_the_same_every_time() -> None:
    run = [comfort(normal_sample(20, 2.0, 0.1)[None, :])]
    first, second = Bootstrap(20).index(run), Bootstrap(20).index(run)
    assert (first.low[0], first.high[0]) == (second.low[0], second.high[0])


def test_as_many_runs_as_seeds_are_asked_for() -> None:
    run = comfort(np.ones((1, 3)))
    with pytest.raises(ArgumentError, match="runs has 2 entries"):
        Bootstrap(3, 5).index([run, run])
