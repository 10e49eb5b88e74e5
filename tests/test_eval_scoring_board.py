"""Leaderboards from records typed by hand: who stands where, beside whom, and what is printed."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from score_examples import PLACE, key, record, row, yardsticks

from eval.packages import PASSIVE, REFERENCE
from eval.scoring.board import Board, Standing, boards_of, plain_board
from eval.scoring.board_text import boards_text
from eval.scoring.statistics import Resampling
from eval.store.reader import Reader

FEW = Resampling(draws=200)
DELAYS = (0, 100, 200, 300)
TWO = PLACE.replace("/4/", "/2/")


def rows_of(*indices: float | str, place: str = PLACE) -> list[dict[str, Any]]:
    """Rows of two tracks by delay, alike on both."""
    return [
        row(key(f"constant:{delay}", seed, place), index)
        for delay, index in zip(DELAYS, indices, strict=False)
        for seed in (0, 1)
    ]


def boards(folder: Path, rows: dict[str, list], **more: Any) -> list[Board]:
    """The boards of records."""
    with Reader.open(record(folder, rows, **more)) as reader:
        return boards_of(reader, FEW)


def board(folder: Path, rows: dict[str, list], **more: Any) -> Board:
    """The one board of some rows beside the yardsticks of layout 4."""
    (found,) = boards(folder, {**yardsticks(), **rows}, **more)
    return found


def standing(found: Board, spec: str) -> Standing:
    """A controller's standing."""
    return next(s for s in found.standings if s.controller == spec)


def test_the_best_score_stands_first_and_passive_and_reference_do_not_compete(
    tmp_path: Path,
) -> None:
    found = board(tmp_path, {"mild": rows_of(1.9), "sharp": rows_of(1.3), "lame": rows_of(2.5)})
    assert [s.controller for s in found.standings] == ["sharp", "mild", "lame"]
    scores = [s.score.score.estimate for s in found.standings if s.score]
    assert scores == pytest.approx([0.9, 0.3, -0.3], abs=1e-14)
    assert found.passive.controller == PASSIVE
    assert found.passive.score is None


def test_a_controller_that_lacks_runs_stands_below_those_that_have_them_all(
    tmp_path: Path,
) -> None:
    # The reference's own index on the one condition that it was run on, beside one that has both.
    whole = rows_of(1.3, 1.5) + [row(key("jitter:0", k), 2.2) for k in (0, 1)]
    found = board(tmp_path, {"half": rows_of(1.2, 1.2), "whole": whole})
    assert [(s.controller, s.missing) for s in found.standings] == [("whole", 0), ("half", 2)]
    assert standing(found, "half").score is not None
    assert "half: no result in 2 runs that others are scored by" in boards_text([found])
    assert plain_board(found)["standings"][1]["missing"] == 2


def test_a_track_that_lacks_delays_others_have_is_left_out_and_not_scored_over_the_rest(
    tmp_path: Path,
) -> None:
    # Records of a run that was stopped: both tracks of one, and one track of the other, end early.
    cut = rows_of(1.2, 1.2, 1.2)
    some = [*rows_of(1.2, 1.7, 1.7)[:-1], row(key("constant:300", 0), 1.7)]
    found = board(tmp_path, {"cut": cut, "some": some, "whole": rows_of(1.3, 1.5, 1.7, "diverged")})
    assert [(s.controller, s.missing) for s in found.standings] == [
        ("whole", 0),
        ("some", 2),
        ("cut", 2),
    ]
    assert standing(found, "cut").score is None
    score = standing(found, "some").score
    assert score is not None
    assert {each.seed for each in score.gains} == {0}
    assert score.partial == (key("constant:0", 1), key("constant:100", 1))
    # Of 1, 0.5, 0.5, 0.5 on the track that is whole.
    assert score.score.estimate == pytest.approx((0.75 + 0.5 + 0.5) / 3, abs=1e-14)


def test_what_is_scored_is_the_same_for_all_controllers_whatever_they_do(tmp_path: Path) -> None:
    rows = yardsticks(seeds=3)
    rows[PASSIVE][1] = row(key(seed=1), "diverged")
    rows[REFERENCE][2] = row(key(seed=2), 2.15)  # hardly better than passive
    for spec, index in (("a", 1.3), ("b", 9.0), ("c", "diverged"), ("d", "failed")):
        rows[spec] = [
            row(key(f"{kind}:{d}", k), index)
            for kind in ("constant", "jitter")
            for d in (0, 300)
            for k in range(3)
        ]
    (found,) = boards(tmp_path, rows)
    scores = [s.score for s in found.standings if s.score]
    assert len(scores) == 4
    assert len({tuple(each.key for each in score.gains) for score in scores}) == 1
    assert len({score.unscored for score in scores}) == 1
    assert {each.seed for each in scores[0].gains} == {0}
    assert len(scores[0].gains) == 4


def test_runs_that_are_not_scored_are_not_missed(tmp_path: Path) -> None:
    worn = PLACE.replace("nominal", "worn")
    rows = yardsticks()
    extra = yardsticks(passive="diverged", place=worn)
    rows = {spec: rows[spec] + extra[spec] for spec in rows}
    rows |= {"a": rows_of(1.9) + rows_of(1.9, place=worn), "b": rows_of(1.8)}
    (found,) = boards(tmp_path, rows)
    assert [s.missing for s in found.standings] == [0, 0]
    a = standing(found, "a")
    assert a.score is not None
    assert len(a.score.unscored) == 2


def test_the_best_sky_hook_of_a_constant_gain_is_what_others_are_compared_with(
    tmp_path: Path,
) -> None:
    rows = {
        "skyhook:gain=1e3": rows_of(2.0),
        "skyhook:gain=2e3": rows_of(1.7),
        "skyhook:gain=3e3": rows_of(1.9),
        "skyhook-acc": rows_of(1.5),
        "between": rows_of(1.8),
    }
    found = board(tmp_path, rows)
    better = {s.controller: s.improvement and s.improvement.estimate for s in found.standings}
    assert better == {
        "skyhook-acc": 1.0,
        "skyhook:gain=2e3": None,
        "between": 0.0,
        "skyhook:gain=3e3": 0.0,
        "skyhook:gain=1e3": 0.0,
    }


def test_a_sky_hook_whose_gain_is_the_delay_is_nobodys_rival(tmp_path: Path) -> None:
    odd = "skyhook:gain={delay}"
    rows = {odd: rows_of(1.2, 1.2, 1.2, 1.2), "skyhook": rows_of(1.7, 1.7, 1.7, 1.7)}
    found = board(tmp_path, rows, told=[odd])
    assert standing(found, "skyhook").improvement is None
    better = standing(found, odd).improvement
    assert better is not None
    assert better.estimate == 1.0


def test_without_a_sky_hook_nobody_is_compared(tmp_path: Path) -> None:
    found = board(tmp_path, {"mild": rows_of(1.9), "skyhook-acc": rows_of(1.7)})
    assert [s.improvement for s in found.standings] == [None, None]


def test_every_layout_has_a_board_and_four_actuators_come_first(tmp_path: Path) -> None:
    four, two = yardsticks(), yardsticks(place=TWO)
    rows = {spec: four[spec] + two[spec] for spec in four}
    rows |= {"both": rows_of(1.9) + rows_of(1.3, place=TWO), "only": rows_of(1.7)}
    found = boards(tmp_path, rows)
    assert [b.layout for b in found] == ["4", "2"]
    assert [[s.controller for s in b.standings] for b in found] == [["only", "both"], ["both"]]


def test_divisions_are_those_of_the_records(tmp_path: Path) -> None:
    found = board(tmp_path, {"a": rows_of(1.5), "b": rows_of(1.9)}, told=["a"])
    assert [s.division for s in found.standings] == ["told", "untold"]


def test_runs_without_an_end_are_counted_by_how_they_ended(tmp_path: Path) -> None:
    found = board(tmp_path, {"a": rows_of(1.9, "failed", "timeout", "diverged")})
    (one,) = found.standings
    assert one.lost == {"failed": 2, "timeout": 2}
    assert (one.diverged, one.runs, one.message) == (2, 8, "it raised")
    assert one.score is not None
    # Trapezoid rule over 0, 100, 200 and 300 ms of 0.3, -1, -1, -1.
    assert one.score.score.estimate == pytest.approx((-0.35 - 1.0 - 1.0) / 3, abs=1e-14)


def test_a_controller_with_failures_alone_has_the_worst_score_and_no_numbers(
    tmp_path: Path,
) -> None:
    found = board(tmp_path, {"a": rows_of("failed", "crashed"), "b": rows_of(2.9, 2.9)})
    last = found.standings[-1]
    assert last.controller == "a"
    assert last.score is not None
    assert last.score.score.estimate == -1.0
    assert (last.force_rms, last.stroke_peak, last.derailment_quotient) == (None, None, None)
    assert "a: it raised" in boards_text([found])


def test_the_ride_index_by_delay_is_the_mean_over_tracks_of_the_worse_end(tmp_path: Path) -> None:
    rows = rows_of(1.0, 2.0, "diverged")
    rows[1] = row(key("constant:0", 1), 1.6)
    rows[5] = row(key("constant:200", 1), 1.6)  # one track of two came to an end
    rows.append(row(key("constant:0", 0, PLACE.replace("/300/", "/200/")), 9.0))
    rows.append(row(key("jitter:0", 0), 9.0))
    (one,) = board(tmp_path, {"a": rows}).standings
    assert one.ride_index == {0.0: pytest.approx(1.3), 0.1: 2.0, 0.2: None}


def test_forces_are_root_mean_square_and_the_rest_is_the_largest(tmp_path: Path) -> None:
    own = [
        row(key("constant:0", 0), 1.9, force_rms=300.0, stroke_peak=0.01, wheel_unloading=0.4),
        row(key("constant:0", 1), 1.9, force_rms=400.0, stroke_peak=0.03, derailment_quotient=0.2),
        # What a run that diverged did is not what the controller does.
        row(key("constant:100", 0), "diverged", force_rms=9e3, stroke_peak=0.3),
    ]
    (one,) = board(tmp_path, {"a": own}).standings
    assert one.force_rms == pytest.approx(math.sqrt((300.0**2 + 400.0**2) / 2), rel=1e-15)
    assert (one.stroke_peak, one.wheel_unloading, one.derailment_quotient) == (0.03, 0.4, 0.2)


def test_the_force_of_the_reference_is_said(tmp_path: Path) -> None:
    rows = yardsticks()
    for one, force in zip(rows[REFERENCE], (600.0, 800.0), strict=True):
        one["force_rms"] = force
    (found,) = boards(tmp_path, rows | {"a": rows_of(1.9)})
    expected = math.sqrt((600.0**2 + 800.0**2) / 2)
    assert found.reference_force == pytest.approx(expected, rel=1e-15)
    assert "(reference: force 0.71 kN RMS)" in boards_text([found])


def test_records_of_a_run_that_was_stopped_early_have_a_board_without_scores(
    tmp_path: Path,
) -> None:
    (found,) = boards(tmp_path, {"a": rows_of(1.9)})
    assert [s.score for s in found.standings] == [None]
    assert (found.passive.runs, found.reference_force) == (0, None)
    assert "passive" in boards_text([found])


def test_records_without_a_cell_have_no_board(tmp_path: Path) -> None:
    assert boards(tmp_path, {}) == []
    assert "score: mean comfort gain" in boards_text([])


def test_a_boards_numbers_are_json_without_what_json_has_not(tmp_path: Path) -> None:
    # One track: no interval, whose ends are not numbers.
    rows = {**yardsticks(seeds=1), "a": [row(key(), 1.9)], "b": [row(key(), "failed")]}
    (found,) = boards(tmp_path, rows, stability={"a": {"method": "exact", "proved": True}})
    plain = json.loads(json.dumps(plain_board(found), allow_nan=False))
    assert [s["controller"] for s in plain["standings"]] == ["a", "b", PASSIVE]
    assert plain["standings"][0]["score"] == {
        "estimate": pytest.approx(0.3, abs=1e-14),
        "low": None,
        "high": None,
    }
    assert plain["standings"][0]["worst"]["key"] == key()
    assert plain["standings"][2]["score"] is None


def test_a_board_does_not_depend_on_the_order_of_the_rows(tmp_path: Path) -> None:
    rows = {**yardsticks(), "a": rows_of(1.9, 2.1), "b": rows_of(1.8, 1.3)}
    turned = {spec: own[::-1] for spec, own in reversed(rows.items())}
    one, other = (
        [plain_board(b) for b in boards(tmp_path / name, r)]
        for name, r in (("one", rows), ("other", turned))
    )
    assert one == other


def test_intervals_are_the_same_at_every_look(tmp_path: Path) -> None:
    rows = yardsticks()
    rows["a"] = [row(key("constant:0", k), 1.5 + 0.2 * k) for k in (0, 1)]
    folder = record(tmp_path, rows)
    found = []
    for _ in range(2):
        with Reader.open(folder) as reader:
            (one,) = boards_of(reader)[0].standings
        assert one.score is not None
        found.append(one.score.score)
    assert found[0] == found[1]
    assert np.isfinite(found[0].low)
