"""Statistics of the benchmark: closed forms, exact counts, and rliable's own output."""

import re
import tracemalloc
from fractions import Fraction

import numpy as np
import pytest
from scipy import stats

from eval.scoring import bootstrap
from eval.scoring.statistics import (
    Aggregates,
    Interval,
    Resampling,
    aggregates,
    performance_profile,
    probability_of_improvement,
)
from railenv.errors import ArgumentError
from railenv.units import FloatArray

ROUNDING = 1e-12
"""Sums of some hundred numbers of order one."""

MANY = Resampling(draws=50_000)

# rliable 1.2.0 (numpy 2.4.6, scipy 1.17.1, arch 7.2.0, pandas 2.3.3, Python 3.11.7), run apart once
# on RUNS_X and RUNS_Y below (12 runs x 5 tasks). Its `random_state` has no effect, since it draws
# with `np.random.choice`; hence the global seed.
#   rng = np.random.Generator(np.random.PCG64(2021))
#   x = np.round(rng.normal(0.6, 0.3, (12, 5)) + np.linspace(-0.3, 0.3, 5), 2)
#   y = np.round(rng.normal(0.5, 0.4, (12, 5)) + np.linspace(-0.3, 0.3, 5), 2)
#   np.random.seed(1)
#   four = lambda s: np.array([metrics.aggregate_iqm(s), metrics.aggregate_mean(s),
#                              metrics.aggregate_median(s), metrics.aggregate_optimality_gap(s)])
#   library.get_interval_estimates({"x": x}, four, reps=50_000)          # the same for y
#   better = lambda a, b: np.array([metrics.probability_of_improvement(a, b)])
#   library.get_interval_estimates({"xy": [x, y]}, better, reps=20_000)
#   tau = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
#   for runs in (True, False):
#       library.create_performance_profile({"x": x}, tau, use_score_distribution=runs, reps=20_000)
# Numbers of draws: 50,000 for aggregates, 20,000 for the rest. The scores are kept in hundredths.
RUNS_X = """
    28 24 36 107 90   16 44 -19 50 44   44 33 89 86 53   35 24 56 81 69   54 51 59 33 76
    8 73 130 77 25   -7 72 31 157 44   55 46 45 61 72   52 22 62 52 145   62 54 46 54 106
    17 44 41 105 106   35 71 47 63 115
"""
RUNS_Y = """
    22 53 52 63 19   14 -22 0 31 159   49 38 72 117 62   -33 37 85 65 104   63 68 36 81 91
    31 59 85 13 83   -11 33 125 72 48   -5 18 80 75 91   93 88 -10 44 27   -10 62 30 94 49
    -31 107 43 178 122   35 56 -26 51 109
"""


def matrix(hundredths: str) -> FloatArray:
    return np.array(hundredths.split(), dtype=np.float64).reshape(12, 5) / 100.0


X, Y = list(matrix(RUNS_X).T), list(matrix(RUNS_Y).T)
TAU = np.array([0.0, 0.25, 0.5, 0.75, 1.0])

NAMES = ("interquartile_mean", "mean", "median", "optimality_gap")
RLIABLE = {  # estimate, low, high of NAMES
    "x": (
        (0.5343333333333332, 0.4733333333333332, 0.597),
        (0.5751666666666668, 0.5043333333333333, 0.6478333333333334),
        (0.5191666666666667, 0.41750000000000004, 0.6941666666666667),
        (0.45333333333333337, 0.39616666666666656, 0.5118333333333334),
    ),
    "y": (
        (0.5403333333333332, 0.4369916666666669, 0.6446666666666665),
        (0.5389999999999999, 0.44300000000000006, 0.6385),
        (0.49750000000000005, 0.3858333333333333, 0.6958333333333334),
        (0.49783333333333335, 0.4153333333333332, 0.5811666666666667),
    ),
}


def drawn(width: float, draws: int) -> float:
    """Return four standard errors of an end of a 95 % interval of this width, for a test."""
    # A quantile p has the error sqrt(p (1 - p) / draws) / density; with p = 0.025 of a normal
    # distribution that is 2.67 standard deviations / sqrt(draws), of which the width is 3.92.
    return 4.0 * 2.67 / 3.92 * width / np.sqrt(draws)


def fields(found: Aggregates) -> list[Interval]:
    return [getattr(found, name) for name in NAMES]


def ends(found: Interval) -> tuple[float, float]:
    return found.low, found.high


class TestEstimates:
    def test_the_interquartile_mean_of_an_even_ladder_is_its_middle(self) -> None:
        tasks = list(np.arange(100.0).reshape(5, 20))
        found = aggregates(tasks, resampling=None).interquartile_mean.estimate
        assert found == pytest.approx(49.5, rel=ROUNDING)

    def test_the_interquartile_mean_leaves_out_whole_runs_rounded_down(self) -> None:
        squares = np.arange(10.0) ** 2  # 10 / 4 = 2.5: two at either end, 4 to 49 stay
        found = aggregates([squares[:4], squares[4:]], resampling=None)
        expected = (4 + 9 + 16 + 25 + 36 + 49) / 6
        assert found.interquartile_mean.estimate == pytest.approx(expected, rel=ROUNDING)

    @pytest.mark.parametrize("runs", range(1, 12))
    def test_the_interquartile_mean_is_scipys_trimmed_mean(self, runs: int) -> None:
        scores = np.random.Generator(np.random.PCG64(runs)).normal(size=(3, runs))
        found = aggregates(list(scores), resampling=None).interquartile_mean.estimate
        expected = stats.trim_mean(scores, 0.25, axis=None)
        assert found == pytest.approx(expected, rel=ROUNDING, abs=ROUNDING)

    def test_tasks_of_unequal_runs_count_alike_in_mean_and_median(self) -> None:
        found = aggregates([[1.0], [3.0, 5.0], [0.0, 0.0, 0.0, 24.0]], resampling=None)
        assert found.mean.estimate == pytest.approx((1.0 + 4.0 + 6.0) / 3.0, rel=ROUNDING)
        assert found.median.estimate == pytest.approx(4.0, rel=ROUNDING)

    def test_the_optimality_gap_counts_every_run_and_nothing_above_the_target(self) -> None:
        found = aggregates([[0.5], [-1.0, 9.0, 0.25]], 1.0, None).optimality_gap.estimate
        assert found == pytest.approx((0.5 + 2.0 + 0.0 + 0.75) / 4.0, rel=ROUNDING)

    def test_the_optimality_gap_follows_its_target(self) -> None:
        found = aggregates([[0.5], [-1.0, 9.0, 0.25]], 0.5, None).optimality_gap.estimate
        assert found == pytest.approx((0.0 + 1.5 + 0.0 + 0.25) / 4.0, rel=ROUNDING)

    def test_improvement_is_the_exact_count_of_pairs_with_ties_counted_half(self) -> None:
        dice = np.random.Generator(np.random.PCG64(7))
        x = [dice.integers(1, 7, size=n) for n in (5, 8, 3)]
        y = [dice.integers(0, 6, size=n) for n in (4, 8, 9)]
        shares = [
            Fraction(sum(2 * int(a > b) + int(a == b) for a in p for b in q), 2 * p.size * q.size)
            for p, q in zip(x, y, strict=True)
        ]
        found = probability_of_improvement(x, y, None).estimate
        assert found == pytest.approx(float(sum(shares, Fraction(0)) / 3), rel=ROUNDING)

    @pytest.mark.parametrize("shift", range(-7, 8))
    def test_improvement_of_a_shifted_ladder_has_its_closed_form(self, shift: int) -> None:
        # Two dice of n faces, one moved by s: (n - s)(n - s - 1) / 2 pairs lose, n - s are equal.
        n, s = 6, min(abs(shift), 6)
        lost = ((n - s) * (n - s - 1) / 2 + (n - s) / 2) / n**2
        faces = np.arange(n)
        found = probability_of_improvement([faces + shift] * 2, [faces] * 2, None).estimate
        assert found == pytest.approx(1.0 - lost if shift > 0 else lost, rel=ROUNDING, abs=0.0)

    def test_the_improvements_of_x_over_y_and_of_y_over_x_add_up_to_one(self) -> None:
        both = [probability_of_improvement(p, q, None).estimate for p, q in ((X, Y), (Y, X))]
        assert sum(both) == pytest.approx(1.0, rel=ROUNDING)

    def test_the_profile_of_uniform_scores_falls_straight(self) -> None:
        tasks = list(np.arange(1, 101).reshape(4, 25) / 100)
        thresholds = np.arange(0, 101, 5) / 100  # strictly above: a score on its threshold is not
        found = performance_profile(tasks, thresholds, None).estimate
        np.testing.assert_allclose(found, 1.0 - thresholds, rtol=0.0, atol=ROUNDING)

    def test_the_profile_of_means_counts_tasks(self) -> None:
        tasks = [[0.0, 1.0], [0.5, 1.0], [-2.0, 9.0, 2.0]]  # means 0.5, 0.75, 3
        found = performance_profile(tasks, [0.4, 0.5, 0.6, 0.75, 3.5], None, of_means=True)
        assert found.estimate == pytest.approx([1.0, 2 / 3, 2 / 3, 1 / 3, 0.0], rel=ROUNDING)

    def test_without_resampling_no_end_is_claimed(self) -> None:
        found = fields(aggregates([[1.0], [2.0, 3.0]], resampling=None))
        assert np.all(np.isnan([ends(one) for one in found]))


class TestIntervals:
    def test_the_interval_of_a_mean_of_tasks_is_the_normal_one(self) -> None:
        rng = np.random.Generator(np.random.PCG64(3))
        tasks = [rng.uniform(k, k + 1.0 + 0.1 * k, size=10 + k) for k in range(20)]
        # Variance of a mean of n drawn from n: the sample's own over n, added up over the tasks.
        sigma = np.sqrt(sum(task.var() / task.size for task in tasks)) / len(tasks)
        found = aggregates(tasks, resampling=MANY).mean
        half = stats.norm.ppf(0.975) * sigma
        # Beside the draws' error: 20 bounded tasks are normal but for a kurtosis of order 1 / 400.
        near = drawn(2.0 * half, MANY.draws)
        assert found.low == pytest.approx(found.estimate - half, rel=0.0, abs=near)
        assert found.high == pytest.approx(found.estimate + half, rel=0.0, abs=near)

    def test_the_interval_follows_its_coverage(self) -> None:
        rng = np.random.Generator(np.random.PCG64(4))
        tasks = list(rng.uniform(size=(20, 12)))
        sigma = np.sqrt(sum(task.var() / task.size for task in tasks)) / len(tasks)
        found = aggregates(tasks, resampling=Resampling(50_000, 0.5)).mean
        # An end at the quartile has the error 1.36 sigma / sqrt(draws); the width, a difference of
        # two, at most sqrt(2) of it; four times that.
        near = 4.0 * np.sqrt(2.0) * 1.36 * sigma / np.sqrt(50_000)
        width = 2.0 * stats.norm.ppf(0.75) * sigma
        assert found.high - found.low == pytest.approx(width, rel=0.0, abs=near)

    def test_runs_are_never_drawn_from_another_task(self) -> None:
        tasks = [[0.0, 0.0], [1.0, 1.0, 1.0], [7.0, 7.0]]  # no spread within, much between
        for found in fields(aggregates(tasks, 8.0)):
            assert ends(found) == pytest.approx((found.estimate, found.estimate), rel=ROUNDING)

    def test_tasks_are_drawn_independently_of_each_other(self) -> None:
        # One task and its mirror: drawn alike, their mean would never move.
        ladder = np.arange(12.0)
        found = aggregates([ladder, -ladder], resampling=MANY).mean
        half = stats.norm.ppf(0.975) * np.sqrt(2.0 * ladder.var() / 12.0) / 2.0
        # Two uniform ladders of twelve are normal to about 1 % in the tails.
        near = drawn(2.0 * half, MANY.draws) + 0.01 * half
        assert ends(found) == pytest.approx((-half, half), rel=0.0, abs=near)

    def test_the_interval_of_a_profile_is_the_binomial_one(self) -> None:
        # 8 of 20 runs pass in one task, 3 of 10 in the other: a sum of two binomials, exactly.
        tasks = [np.r_[np.ones(8), np.zeros(12)], np.r_[np.ones(3), np.zeros(7)]]
        one, two = (stats.binom.pmf(np.arange(n + 1), n, p) for n, p in ((20, 0.4), (10, 0.3)))
        below = np.cumsum(np.convolve(one, two))
        low, high = (int(np.searchsorted(below, p)) for p in (0.025, 0.975))
        # No step of the distribution is near an end: four errors sqrt(p (1 - p) / draws) = 0.0028.
        near = below[[low - 1, low, high - 1, high]] - [0.025, 0.025, 0.975, 0.975]
        assert np.min(np.abs(near)) > 0.0028
        found = performance_profile(tasks, [0.5], MANY)
        assert (found.low[0], found.high[0]) == pytest.approx((low / 30, high / 30), rel=ROUNDING)

    def test_two_controllers_are_drawn_independently(self) -> None:
        # Half of n runs are 1, half 0, for both: P = 1/2 + (K - L) / 2n with K, L binomial, and
        # K - L + n is binomial of 2 n. Draws in pairs would leave P at 1/2.
        n = 20
        coins = [np.r_[np.ones(n // 2), np.zeros(n // 2)]]
        found = probability_of_improvement(coins, coins, MANY)
        low, high = (stats.binom.ppf(p, 2 * n, 0.5) / (2 * n) for p in (0.025, 0.975))
        assert (found.estimate, found.low, found.high) == pytest.approx((0.5, low, high))


class TestAgainstRliable:
    @pytest.mark.parametrize(("scores", "key"), [(X, "x"), (Y, "y")])
    def test_estimates_are_rliables(self, scores: list[FloatArray], key: str) -> None:
        found = [one.estimate for one in fields(aggregates(scores, resampling=None))]
        assert found == pytest.approx([row[0] for row in RLIABLE[key]], rel=0.0, abs=ROUNDING)

    @pytest.mark.parametrize(("scores", "key"), [(X, "x"), (Y, "y")])
    def test_intervals_are_rliables(self, scores: list[FloatArray], key: str) -> None:
        for one, (_, low, high) in zip(
            fields(aggregates(scores, resampling=MANY)), RLIABLE[key], strict=True
        ):
            near = np.sqrt(2.0) * drawn(high - low, 50_000)  # either side drew 50,000 times
            assert ends(one) == pytest.approx((low, high), rel=0.0, abs=near)

    def test_the_estimates_with_fewer_runs_are_rliables(self) -> None:
        nine = [task[:9] for task in Y]  # 45 runs, of which 11 are left out at either end
        found = [one.estimate for one in fields(aggregates(nine, resampling=None))]
        expected = [0.5386956521739131, 0.5255555555555557, 0.5833333333333334, 0.4977777777777779]
        assert found == pytest.approx(expected, rel=0.0, abs=ROUNDING)
        better = probability_of_improvement(X, nine, None).estimate
        assert better == pytest.approx(0.537037037037037, rel=0.0, abs=ROUNDING)

    def test_the_improvement_is_rliables(self) -> None:
        found = probability_of_improvement(X, Y, MANY)
        assert found.estimate == pytest.approx(0.5305555555555556, rel=0.0, abs=ROUNDING)
        low, high = 0.4243055555555556, 0.6354166666666667
        # 20,000 draws there, 50,000 here
        near = np.hypot(drawn(high - low, 20_000), drawn(high - low, 50_000))
        assert ends(found) == pytest.approx((low, high), rel=0.0, abs=near)

    def test_the_profile_of_runs_is_rliables(self) -> None:
        found = performance_profile(X, TAU, MANY)
        np.testing.assert_allclose(found.estimate * 60, [58, 51, 33, 14, 8], atol=1e-9)
        # Sixtieths. Exactly, some steps lie 0.001 from 0.025 or 0.975, as near as 20,000 draws
        # tell: such a quantile may fall on the step's other side.
        np.testing.assert_allclose(found.low * 60, [55, 46, 26, 9, 4], atol=1.0 + 1e-9)
        np.testing.assert_allclose(found.high * 60, [60, 56, 40, 19, 13], atol=1.0 + 1e-9)

    def test_the_profile_of_means_is_rliables(self) -> None:
        found = performance_profile(X, TAU, MANY, of_means=True)
        np.testing.assert_allclose(found.estimate * 5, [5, 5, 3, 2, 0], atol=1e-9)
        np.testing.assert_allclose(found.low * 5, [5, 4, 2, 0, 0], atol=1e-9)
        np.testing.assert_allclose(found.high * 5, [5, 5, 4, 2, 1], atol=1e-9)


class TestDraws:
    def test_a_report_draws_the_same_numbers_every_time(self) -> None:
        assert aggregates(X) == aggregates(X)

    def test_a_given_generator_is_used(self) -> None:
        def once(seed: int) -> Interval:
            rng = np.random.Generator(np.random.PCG64(seed))
            return aggregates(X, resampling=Resampling(100, generator=rng)).mean

        assert once(1) == once(1)
        assert once(1) != once(2)

    def test_results_do_not_depend_on_how_many_runs_are_drawn_at_a_time(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        few = Resampling(draws=500)
        whole = aggregates(X, resampling=few), probability_of_improvement(X, Y, few)
        monkeypatch.setattr(bootstrap, "_ELEMENTS", 7 * 60)
        assert (aggregates(X, resampling=few), probability_of_improvement(X, Y, few)) == whole

    def test_memory_does_not_grow_with_the_draws(self) -> None:
        tasks, thresholds = list(np.random.default_rng(5).normal(size=(60, 20))), np.arange(100.0)
        tracemalloc.start()
        aggregates(tasks, resampling=Resampling(2_000))
        probability_of_improvement(tasks, tasks, Resampling(2_000))
        performance_profile(tasks, thresholds, Resampling(2_000))
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        # All draws at once would be 2,000 x 1,200 x 8 bytes = 19 MB for every array; the results
        # kept are 2,000 x 100 x 8 bytes, twice.
        assert peak < 15e6


class TestRefusals:
    @pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
    def test_a_score_that_is_not_finite_is_named(self, value: float) -> None:
        with pytest.raises(ArgumentError, match=r"scores\[1\]\[2\] = -?(nan|inf) must be finite"):
            aggregates([[0.0, 1.0], [0.0, 1.0, value]])
        with pytest.raises(ArgumentError, match=r"others\[0\]\[0\]"):
            probability_of_improvement([[0.0, 1.0]], [[value, 1.0]])

    @pytest.mark.parametrize(
        ("scores", "message"),
        [
            (np.zeros((12, 5)), "none but ndarray; give one vector per task"),
            ([], "empty list"),
            ([[0.0, 1.0], []], r"scores[1] has shape (0,)"),
            ([0.0, 1.0], "scores[0] has shape ()"),
            ([[[0.0, 1.0]]], "scores[0] has shape (1, 2)"),
            ([[[0.0], [1.0, 2.0]]], "scores[0] has rows of unequal length"),
            ([["a", "b"]], "type <U1; give a vector of real numbers"),
            ([[True, False]], "type bool"),
            ([[1.0], [1.0]], "scores has one run per task"),
        ],
    )
    def test_scores_that_are_no_list_of_tasks_are_refused(
        self, scores: list[list[float]], message: str
    ) -> None:
        with pytest.raises(ArgumentError, match=re.escape(message)):
            aggregates(scores)

    def test_controllers_with_different_tasks_are_refused(self) -> None:
        with pytest.raises(ArgumentError, match="scores has 5 tasks and others has 4"):
            probability_of_improvement(X, Y[:4])

    @pytest.mark.parametrize("thresholds", [[0.5, 0.5], [1.0, 0.0], [0.0, np.nan], [], 0.5])
    def test_thresholds_that_do_not_ascend_are_refused(self, thresholds: list[float]) -> None:
        with pytest.raises(ArgumentError, match="thresholds"):
            performance_profile(X, thresholds)

    @pytest.mark.parametrize(
        ("setting", "value"),
        [
            ("draws", 99),
            ("draws", 1e4),
            ("coverage", 0.0),
            ("coverage", 1.0),
            ("coverage", 95),
            ("generator", 3),
            ("generator", np.random),
        ],
    )
    def test_a_resampling_that_makes_no_interval_is_refused(
        self, setting: str, value: object
    ) -> None:
        with pytest.raises(ArgumentError, match=setting):
            Resampling(**{setting: value})  # type: ignore[arg-type]

    def test_a_target_that_is_not_finite_is_refused(self) -> None:
        with pytest.raises(ArgumentError, match="target"):
            aggregates(X, np.nan)
