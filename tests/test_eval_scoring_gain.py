"""The delay-robust score on rows typed by hand: every number can be worked out in the head."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from score_examples import PLACE, key, row, yardsticks

from eval.packages import PASSIVE, REFERENCE
from eval.scoring.baseline import LEAST_GAIN, Baseline, baselines_of, worse_end
from eval.scoring.gain import ControllerScore, gains_of, improvement, score_matrix, score_of
from eval.scoring.statistics import Resampling
from eval.store.schema import LOST

BASE = Baseline(2.2, 1.2)
FEW = Resampling(draws=200)
SLOW_PLACE = PLACE.replace("/300/", "/200/")
finite = st.floats(0.0, 10.0)


def scored(rows, base=None, resampling=None) -> ControllerScore:
    """The score of some rows beside passive at 2.2 and the reference at 1.2 on tracks 0 to 9."""
    found = score_of(rows, base or bases(), resampling)
    assert found is not None
    return found


def bases(*places: str, **values):
    """Passive and reference on tracks 0 to 9 of some places."""
    found = {}
    for place in places or (PLACE,):
        own = yardsticks(seeds=10, place=place, **values)
        found |= baselines_of(own[PASSIVE], own[REFERENCE])
    return found


# One run.


@pytest.mark.parametrize(
    ("index", "gain"),
    [
        (2.2, 0.0),  # as passive
        (1.2, 1.0),  # as the reference
        (1.7, 0.5),
        (2.7, -0.5),
        (0.4, 1.0),  # better than the reference: cut
        (9.0, -1.0),  # more than twice the distance: cut
    ],
)
def test_the_gain_is_the_share_of_the_way_from_passive_to_reference(
    index: float, gain: float
) -> None:
    # Differences of numbers with one digit, exact to a few roundings.
    assert BASE.gain(row(key(), index)) == pytest.approx(gain, abs=1e-14)


@pytest.mark.parametrize("status", ["diverged", *LOST])
def test_a_run_that_diverged_or_was_lost_counts_minus_one(status: str) -> None:
    assert BASE.gain(row(key(), status)) == -1.0


def test_a_run_that_diverged_counts_minus_one_whatever_its_ride_index_was() -> None:
    # As of a loop that grows by the oracle's word but has not got far within the run.
    one = {**row(key(), 1.2), "status": "diverged"}
    assert BASE.gain(one) == -1.0
    assert worse_end(one) is None


def test_the_worse_floor_end_counts() -> None:
    for ends in ((1.7, 1.0), (1.0, 1.7)):
        both = {**row(key(), 1.0), "ride_index_front": ends[0], "ride_index_rear": ends[1]}
        assert worse_end(both) == 1.7
        assert BASE.gain(both) == pytest.approx(0.5, abs=1e-14)


@given(finite, st.floats(0.2, 5.0), st.floats(0.1, 10.0), st.floats(0.0, 3.0))
def test_the_unit_and_the_zero_of_the_index_do_not_matter(
    index: float, span: float, unit: float, shift: float
) -> None:
    plain = Baseline(2.2, 2.2 - span).gain(row(key(), index))
    other = Baseline(2.2 * unit + shift, (2.2 - span) * unit + shift)
    # Shifts of the size of the numbers: a few roundings over the smallest span of 0.02.
    assert other.gain(row(key(), index * unit + shift)) == pytest.approx(plain, abs=1e-11)


@given(finite, finite)
def test_a_lower_index_never_gains_less(a: float, b: float) -> None:
    low, high = sorted((a, b))
    assert BASE.gain(row(key(), low)) >= BASE.gain(row(key(), high))


# What is scored.


@pytest.mark.parametrize(
    ("passive", "reference", "is_scored"),
    [
        (2.2, 1.2, True),
        (2.2, 2.0, True),
        (2.2, 2.2 - 0.99 * LEAST_GAIN, False),  # hardly better
        (2.2, 2.5, False),  # worse
        (None, 1.2, False),  # passive diverged: worn wheels beyond their critical speed
        (2.2, None, False),  # the reference diverged
    ],
)
def test_a_run_is_scored_where_there_is_comfort_to_be_had(
    passive: float | None, reference: float | None, is_scored: bool
) -> None:
    assert Baseline(passive, reference).scored is is_scored


def test_what_is_not_scored_is_named_and_counts_nothing() -> None:
    worn = PLACE.replace("nominal", "worn")
    base = bases() | bases(worn, passive="diverged")
    rows = [row(key(), 1.7), row(key(place=worn), "diverged")]
    found = scored(rows, base)
    assert found.unscored == (key(place=worn),)
    assert found.score.estimate == pytest.approx(0.5, abs=1e-14)


def test_a_run_without_passive_or_reference_on_its_track_is_not_scored() -> None:
    assert gains_of([row(key(), 1.7)], {}) == ([], [key()])
    own = yardsticks()
    alone = baselines_of(own[PASSIVE], [])
    assert gains_of([row(key(), 1.7)], alone) == ([], [key()])


def test_a_controller_without_a_scored_run_has_no_score() -> None:
    assert score_of([row(key(), 1.7)], {}) is None
    assert score_of([], bases()) is None


def test_passive_and_reference_are_those_of_the_own_vehicle_track_and_seed() -> None:
    rough = PLACE.replace("german_low", "tb3352")
    base = bases() | bases(rough, passive=3.0, reference=1.0)
    on = {
        each.key: each.gain
        for each in gains_of([row(key(place=p), 2.0) for p in (PLACE, rough)], base)[0]
    }
    assert on[key()] == pytest.approx(0.2, abs=1e-14)
    assert on[key(place=rough)] == pytest.approx(0.5, abs=1e-14)
    differ = yardsticks(seeds=2)
    differ[PASSIVE][1]["ride_index_rear"] = 3.2
    found = baselines_of(differ[PASSIVE], differ[REFERENCE])
    gains = gains_of([row(key(seed=k), 2.2) for k in (0, 1)], found)[0]
    assert [each.gain for each in gains] == pytest.approx([0.0, 0.5], abs=1e-14)


def test_passive_and_reference_without_delay_stand_for_every_delay_and_channel() -> None:
    rows = [row(key(channel), 1.7) for channel in ("constant:300", "jitter:100", "spread:0")]
    assert [each.gain for each in gains_of(rows, bases())[0]] == pytest.approx([0.5] * 3, abs=1e-14)


# Means.


def test_conditions_weigh_alike_whatever_their_numbers_of_tracks_and_delays() -> None:
    many = [row(key(f"constant:{d}", k), 2.2) for d in (0, 100, 200, 300) for k in range(10)]
    few = [row(key(f"jitter:{d}", k), 1.2) for d in (0, 300) for k in range(2)]
    # Gain 0 in forty runs and 1 in four; a mean over runs would be 0.09.
    assert scored(many + few).score.estimate == pytest.approx(0.5, abs=1e-14)


@pytest.mark.parametrize(
    "other",
    [
        key("jitter:0"),
        key(place=PLACE.replace("german_low", "fra6")),
        key(place=SLOW_PLACE),
        key(place=PLACE.replace("nominal", "soft")),
        key(place=PLACE.replace("lateral17", "full50")),
    ],
)
def test_channel_track_speed_vehicle_and_model_make_a_condition_of_their_own(other: str) -> None:
    places = (PLACE, other.rsplit("/", 2)[0])
    gains = gains_of([row(key(), 1.7), row(other, 1.7)], bases(*places))[0]
    assert len({each.condition for each in gains}) == 2


def test_delay_and_seed_make_none() -> None:
    gains = gains_of([row(key("constant:0", 0), 1.7), row(key("constant:50", 1), 1.7)], bases())[0]
    assert len({each.condition for each in gains}) == 1


def test_a_condition_has_one_number_per_track() -> None:
    rows = [
        row(key(f"constant:{d}", k), 2.2 - 0.1 * k - 0.001 * d) for d in (0, 300) for k in (0, 1, 2)
    ]
    (matrix,) = score_matrix(gains_of(rows, bases())[0]).values()
    # Mean over the delays of 0.1 k + 0.001 d is 0.1 k + 0.15.
    np.testing.assert_allclose(matrix, [0.15, 0.25, 0.35], rtol=1e-12)


def test_a_track_that_is_not_scored_leaves_the_others_of_its_condition() -> None:
    base = bases() | baselines_of([row(key(seed=1), "diverged")], [row(key(seed=1), 1.2)])
    rows = [row(key(seed=k), index) for k, index in enumerate((1.2, 9.0, 2.2))]
    found = scored(rows, base)
    assert found.score.estimate == pytest.approx(0.5, abs=1e-14)
    assert found.unscored == (key(seed=1),)


def test_tracks_of_unequal_number_still_have_an_interval() -> None:
    rows = [row(key("constant:0", k), 1.2 + 0.1 * k) for k in range(5)]
    rows += [row(key("jitter:0", k), 1.5) for k in range(2)]
    whole = scored(rows, resampling=FEW).score
    assert whole.low <= whole.estimate <= whole.high
    assert whole.low < whole.high


def test_equal_runs_leave_no_doubt_and_one_track_alone_leaves_no_interval() -> None:
    rows = [row(key(seed=k), 1.7) for k in range(2)]
    sure = scored(rows, resampling=FEW).score
    assert (sure.low, sure.high) == (sure.estimate, sure.estimate)
    alone = scored(rows[:1], resampling=FEW).score
    assert np.isnan(alone.low)
    assert np.isnan(alone.high)


def test_the_mean_by_delay_is_over_the_conditions_that_have_it() -> None:
    rows = [row(key(f"constant:{d}"), 1.2) for d in (0, 50, 100)]
    rows += [row(key(f"jitter:{d}", k), 2.2) for d in (0, 100) for k in range(3)]
    assert scored(rows).by_delay == pytest.approx({0.0: 0.5, 0.05: 1.0, 0.1: 0.5}, abs=1e-14)


def test_the_worst_run_is_named_and_of_equals_the_first_by_key() -> None:
    rows = [row(key(seed=k), index) for k, index in enumerate((1.7, "diverged", "failed"))]
    assert scored(rows).worst.key == key(seed=1)
    assert scored(rows[::-1]).worst.key == key(seed=1)
    assert scored(rows).worst.gain == -1.0


@given(st.lists(st.one_of(finite, st.sampled_from(["diverged", *LOST])), min_size=1, max_size=10))
def test_a_score_lies_between_the_worst_run_and_the_best(indices: list) -> None:
    found = scored([row(key(seed=k), index) for k, index in enumerate(indices)])
    gains = [each.gain for each in found.gains]
    assert -1.0 <= min(gains) <= max(gains) <= 1.0
    # A mean may leave its summands by a rounding.
    assert min(gains) - 1e-15 <= found.score.estimate <= max(gains) + 1e-15


@given(st.permutations(range(6)))
def test_the_order_of_the_rows_does_not_matter(order: list[int]) -> None:
    rows = [row(key(f"constant:{100 * (k % 2)}", k // 2), 1.2 + 0.17 * k) for k in range(6)]
    assert (
        scored([rows[k] for k in order], resampling=FEW).score == scored(rows, resampling=FEW).score
    )


# One beside another.


def beside(own, other, base=None):
    """Probability that the first rows are better than the second."""
    found = improvement(scored(own, base), scored(other, base), FEW)
    assert found is not None
    return found


def test_a_controller_that_is_better_on_every_track_is_better_for_certain() -> None:
    good = [row(key(seed=k), 1.3 + 0.01 * k) for k in range(3)]
    bad = [row(key(seed=k), 1.9 + 0.01 * k) for k in range(3)]
    assert beside(good, bad).estimate == 1.0
    assert beside(bad, good).estimate == 0.0
    assert beside(good, good).estimate == pytest.approx(0.5, abs=1e-15)


def test_an_improvement_is_over_common_conditions_alone() -> None:
    good = [row(key(seed=k), 1.3) for k in range(2)]
    other = [row(key("jitter:0", k), 1.9) for k in range(2)]
    assert improvement(scored(good), scored(other), FEW) is None
    both = other + [row(key(seed=k), 1.2) for k in range(2)]
    assert beside(good, both).estimate == 0.0


def test_a_condition_of_one_track_leaves_the_interval_of_the_others_and_is_named() -> None:
    rows = [row(key(seed=k), index) for k, index in enumerate((1.2, 2.2))]
    pair = scored(rows, resampling=FEW).score
    found = scored([*rows, row(key("jitter:0"), 1.7)], resampling=FEW)
    # Two conditions weigh alike: half of the first one's interval, and half of 0.5.
    assert found.score.low == pytest.approx((pair.low + 0.5) / 2, abs=1e-14)
    assert found.score.high == pytest.approx((pair.high + 0.5) / 2, abs=1e-14)
    assert [condition[-1] for condition in found.single] == ["jitter"]


def test_an_improvement_of_one_track_has_no_interval() -> None:
    one = [row(key(), 1.3)]
    assert np.isnan(beside(one, one).low)
    assert beside(one, one).estimate == 0.5
