"""Draws of tracks that conditions share: each condition as before, and all of them together."""

import numpy as np
import pytest
from score_examples import key, row, yardsticks

from eval.packages import PASSIVE, REFERENCE
from eval.scoring import bootstrap as module
from eval.scoring.baseline import baselines_of
from eval.scoring.bootstrap import Resampling, bootstrap
from eval.scoring.gain import improvement, score_of
from eval.scoring.statistics import (
    aggregates,
    performance_profile,
    probability_of_improvement,
)
from railenv.errors import ArgumentError

MANY, FEW = Resampling(20_000), Resampling(500)
Y = [0.1, 0.9, 0.3, 0.4, 0.8]
FIVE = list(range(5))


def drawn(tracks: list[list[int]], draws: int = 20_000) -> np.ndarray:
    """Return the track that every run of every draw is of, shape (draws, runs)."""
    seen: list[np.ndarray] = []
    numbers = np.array([number for own in tracks for number in own])

    def note(index: np.ndarray) -> np.ndarray:
        seen.append(numbers[index])
        return np.zeros((len(index), 1))

    bootstrap(note, np.array([len(own) for own in tracks]), Resampling(draws), tracks)
    return np.concatenate(seen[1:])


def test_conditions_with_the_same_tracks_draw_the_same_ones() -> None:
    picks = drawn([FIVE, FIVE], 300)
    assert np.array_equal(picks[:, :5], picks[:, 5:])
    assert len(np.unique(picks, axis=0)) > 200


def test_every_condition_draws_each_of_its_tracks_alike_and_independently() -> None:
    tracks = [FIVE, [0, 1, 2], [3, 7]]
    picks = drawn(tracks)
    first = 0
    for own in tracks:
        mine = picks[:, first : first + len(own)]
        first += len(own)
        for column in mine.T:
            shares = [float(np.mean(column == number)) for number in own]
            # Four standard errors of a share of 20,000 draws: 4 sqrt(0.25 / 20,000) = 0.014.
            assert shares == pytest.approx([1 / len(own)] * len(own), abs=0.014)
        both = float(np.mean(mine[:, 0] == mine[:, 1]))
        assert both == pytest.approx(1 / len(own), abs=0.014)


def test_conditions_that_share_some_tracks_agree_as_often_as_they_can() -> None:
    picks = drawn([FIVE, [0, 1, 2]])
    # The first of five picks one of the shared three in 3/5 of all draws, and then both agree.
    assert float(np.mean(picks[:, 0] == picks[:, 5])) == pytest.approx(0.6, abs=0.014)


def test_many_conditions_on_the_same_tracks_are_no_surer_than_one() -> None:
    alone = aggregates([Y], resampling=FEW, tracks=[FIVE]).mean
    often = aggregates([Y] * 20, resampling=FEW, tracks=[FIVE] * 20).mean
    apart = aggregates([Y] * 20, resampling=FEW).mean
    # The very same draws, and means over equal tasks.
    assert often.low == pytest.approx(alone.low, abs=1e-14)
    assert often.high == pytest.approx(alone.high, abs=1e-14)
    # As if there were a hundred tracks: narrower by the square root of twenty, or so.
    assert apart.high - apart.low < 0.3 * (alone.high - alone.low)


def test_what_a_track_gives_in_one_condition_and_takes_in_another_leaves_no_doubt() -> None:
    opposite = [1.0 - y for y in Y]
    found = aggregates([Y, opposite], resampling=FEW, tracks=[FIVE, FIVE]).mean
    assert (found.low, found.high) == pytest.approx((0.5, 0.5), abs=1e-14)


def test_estimates_do_not_depend_on_which_tracks_are_the_same() -> None:
    tasks, others = [Y, Y[:3]], [Y[::-1], Y[2:]]
    numbers = [FIVE, [0, 1, 2]]
    edges = [0.2, 0.5]
    assert (
        aggregates(tasks, resampling=FEW, tracks=numbers).mean.estimate
        == aggregates(tasks, resampling=FEW).mean.estimate
    )
    assert (
        probability_of_improvement(tasks, others, FEW, (numbers, numbers)).estimate
        == probability_of_improvement(tasks, others, FEW).estimate
    )
    np.testing.assert_array_equal(
        performance_profile(tasks, edges, FEW, tracks=numbers).estimate,
        performance_profile(tasks, edges, FEW).estimate,
    )


def test_an_interval_covers_the_truth_where_tracks_are_shared_and_not_if_taken_for_others() -> None:
    generator = np.random.default_rng(8)
    conditions, tracks, rounds = 20, 12, 200
    numbers = [list(range(tracks))] * conditions
    within = {True: 0, False: 0}
    for _ in range(rounds):
        # What a track does in all conditions, and a little in each; the truth is zero.
        common = generator.normal(size=tracks)
        scores = list(common + 0.3 * generator.normal(size=(conditions, tracks)))
        for shared in within:
            found = aggregates(scores, resampling=FEW, tracks=numbers if shared else None).mean
            within[shared] += found.low <= 0.0 <= found.high
    # 95 % less what percentile intervals of twelve runs lack, and three standard errors of 2 %.
    assert within[True] / rounds > 0.85
    assert within[False] / rounds < 0.5


def test_a_controllers_score_is_no_surer_for_more_conditions_on_the_same_tracks() -> None:
    own = yardsticks(seeds=5)
    base = baselines_of(own[PASSIVE], own[REFERENCE])

    def scored(indices: list[float], kinds: tuple[str, ...]):
        rows = [row(key(f"{kind}:0", k), x) for kind in kinds for k, x in enumerate(indices)]
        found = score_of(rows, base, FEW)
        assert found is not None
        return found

    one, all_kinds = ("constant",), ("constant", "spread", "jitter", "dropout")
    first, second = [1.3, 2.0, 1.5, 1.6, 1.9], [1.4, 1.7, 1.8, 1.5, 2.1]
    alone, often = (scored(first, kinds) for kinds in (one, all_kinds))
    assert alone.score.low < alone.score.high
    # The very same draws, and means over equal conditions.
    assert often.score.low == pytest.approx(alone.score.low, abs=1e-14)
    assert often.score.high == pytest.approx(alone.score.high, abs=1e-14)
    better = [improvement(scored(first, k), scored(second, k), FEW) for k in (one, all_kinds)]
    assert better[0] is not None
    assert better[0].low < better[0].high
    assert better[1] == better[0]


def test_results_do_not_depend_on_how_many_draws_are_made_at_a_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    numbers = [FIVE, [0, 3]]
    whole = aggregates([Y, Y[:2]], resampling=FEW, tracks=numbers)
    monkeypatch.setattr(module, "_ELEMENTS", 7 * 25)
    assert aggregates([Y, Y[:2]], resampling=FEW, tracks=numbers) == whole


@pytest.mark.parametrize(
    ("tracks", "words"),
    [
        ([FIVE], "a number for every run of every task"),
        ([FIVE, [0]], "a number for every run of every task"),
        ([FIVE, [1, 1]], "a number twice in a task"),
    ],
)
def test_tracks_that_do_not_fit_the_scores_are_refused(tracks: list, words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        aggregates([Y, Y[:2]], resampling=FEW, tracks=tracks)


def test_a_condition_of_one_track_is_the_same_in_every_draw() -> None:
    pair = [0.0, 1.0]
    alone = aggregates([pair], resampling=MANY).mean
    beside = aggregates([pair, [0.25]], resampling=MANY).mean
    # Mean over the tasks of {0, 1/2, 1} and 1/4.
    assert beside.estimate == 0.375
    assert (beside.low, beside.high) == ((alone.low + 0.25) / 2, (alone.high + 0.25) / 2)
    assert (alone.low, alone.high) == (0.0, 1.0)


def test_one_pair_of_runs_is_enough_for_an_interval_of_an_improvement() -> None:
    found = probability_of_improvement([[0.0, 1.0], [2.0]], [[0.5, 0.5], [1.0]], MANY)
    assert (found.low, found.estimate, found.high) == (0.5, 0.75, 1.0)
