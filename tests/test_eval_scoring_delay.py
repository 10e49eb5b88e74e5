"""The mean over the delay: of the line through the delays that were run, whatever their grid."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from score_examples import key, row, yardsticks

from eval.packages import PASSIVE, REFERENCE
from eval.scoring.baseline import baselines_of
from eval.scoring.gain import ControllerScore, delay_mean, score_of
from eval.scoring.statistics import Resampling

FEW = Resampling(draws=200)


def scored(rows, resampling=None) -> ControllerScore:
    """The score of some rows beside passive at 2.2 and the reference at 1.2 on tracks 0 to 9."""
    own = yardsticks(seeds=10)
    found = score_of(rows, baselines_of(own[PASSIVE], own[REFERENCE]), resampling)
    assert found is not None
    return found


def curve(*points: tuple[float, float | str]):
    """Rows of one track by delay [ms]."""
    return [row(key(f"constant:{delay:g}"), index) for delay, index in points]


@pytest.mark.parametrize(
    ("points", "mean"),
    [
        ({0.1: 0.3}, 0.3),  # one delay
        ({0.0: 0.4, 0.3: 0.4}, 0.4),
        ({0.0: 1.0, 0.3: 0.0}, 0.5),
        # By hand: widths 100, 50 and 150 ms, means of the ends 0.75, 0.25 and -0.5.
        ({0.0: 1.0, 0.1: 0.5, 0.15: 0.0, 0.3: -1.0}, (75.0 + 12.5 - 75.0) / 300.0),
    ],
)
def test_the_mean_over_the_delay_is_that_of_the_line_through_the_points(
    points: dict[float, float], mean: float
) -> None:
    assert delay_mean(points) == pytest.approx(mean, abs=1e-15)


grids = st.lists(st.integers(0, 300), min_size=1, max_size=12, unique=True)
share = st.floats(-1.0, 1.0)


@given(grids, st.sampled_from([-1.0, 0.0, 1.0]))
def test_a_curve_at_a_bound_has_that_very_mean(delays: list[int], level: float) -> None:
    assert delay_mean({d / 1000: level for d in delays}) == level


@given(grids, share, share)
def test_a_straight_curve_has_its_middle_whatever_the_grid(
    delays: list[int], start: float, slope: float
) -> None:
    middle = start + slope * (min(delays) + max(delays)) / 600.0
    found = delay_mean({d / 1000: start + slope * d / 300.0 for d in delays})
    # A dozen roundings of numbers up to two.
    assert found == pytest.approx(middle, abs=1e-14)


@given(st.lists(st.tuples(st.integers(0, 300), share), min_size=2, max_size=12), st.data())
def test_a_delay_more_on_the_line_changes_nothing(points: list, data: st.DataObject) -> None:
    known = dict(points)
    delays = sorted(known)
    more = data.draw(st.integers(delays[0], delays[-1]))
    value = float(np.interp(more, delays, [known[d] for d in delays]))
    plain = delay_mean({d / 1000: gain for d, gain in known.items()})
    denser = delay_mean({d / 1000: gain for d, gain in (known | {more: value}).items()})
    # As above; a mean over the runs would move by a tenth or so.
    assert denser == pytest.approx(plain, abs=1e-14)


def test_the_score_is_the_mean_over_the_delay_of_the_gains() -> None:
    rows = curve((0, 1.2), (50, 1.7), (150, 2.2), (300, "diverged"))
    # Gains 1, 0.5, 0 and -1: widths 50, 100, 150, means of the ends 0.75, 0.25, -0.5.
    expected = (37.5 + 25.0 - 75.0) / 300.0
    assert scored(rows).score.estimate == pytest.approx(expected, abs=1e-14)


def test_suites_with_other_grids_agree_where_the_curve_is_straight_between_their_delays() -> None:
    def index(delay: float) -> float:
        return 1.2 + delay / 300.0

    one, other = (
        scored(curve(*((d, index(d)) for d in grid))).score.estimate
        for grid in ((0, 100, 200, 300), (0, 10, 20, 30, 40, 50, 300))
    )
    assert one == pytest.approx(0.5, abs=1e-14)
    assert other == pytest.approx(one, abs=1e-14)


def test_every_interval_is_of_means_over_the_delay() -> None:
    # Equal at the ends and opposite in the middle, which weighs half: means 0.5 and -0.5 + 0.5.
    rows = [
        row(key(f"constant:{d}", k), index)
        for k, indices in enumerate(((1.7, 1.2, 1.7), (1.7, 2.2, 1.7)))
        for d, index in zip((0, 150, 300), indices, strict=True)
    ]
    whole = scored(rows, resampling=FEW)
    assert whole.score.low == pytest.approx(0.25, abs=1e-14)
    assert whole.score.high == pytest.approx(0.75, abs=1e-14)
    assert whole.aggregates.interquartile_mean.estimate == pytest.approx(0.5, abs=1e-14)


def test_a_track_that_was_not_run_at_every_delay_is_left_out() -> None:
    rows = [row(key(f"constant:{d}", k), 1.2) for d in (0, 300) for k in range(3)]
    rows += [row(key("constant:0", 3), 2.2)]
    found = scored(rows)
    assert found.score.estimate == 1.0
    assert found.partial == (key("constant:0", 3),)
    assert found.unscored == ()
