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
from eval.scoring.board_text import WIDTH, boards_text, critical_text
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
    # The reference's own index at the one delay that it was run at, beside one that has all four.
    found = board(tmp_path, {"half": rows_of(1.2), "whole": rows_of(1.3, 1.5, 1.7, "diverged")})
    assert [(s.controller, s.missing) for s in found.standings] == [("whole", 0), ("half", 6)]
    assert "half: no result in 6 runs that others are scored by" in boards_text([found])
    assert plain_board(found)["standings"][1]["missing"] == 6


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
    assert one.score.score.estimate == pytest.approx((0.3 - 3.0) / 4, abs=1e-14)


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


# What is printed.

HOSTILE = [
    "x" * 500,
    "\x1b[2Jclear",
    "line\nbreak\r\ttab",
    "\u202eright to left",
    "汉" * 60,
    "e\u0301" * 50,
    "%s {delay} <b>",
    "\N{ZERO WIDTH SPACE}",
]


def test_the_table_is_at_most_120_columns_whatever_the_names(tmp_path: Path) -> None:
    rows = {spec: rows_of(1.9, "failed", 1.3, "diverged") for spec in HOSTILE}
    for own in rows.values():
        for one in own:
            one["message"] = "y" * 400 + "\x07" + "汉" * 100 if one["status"] == "failed" else ""
    long = {"method": "simulation", "critical_delay_s": 1.2345678}
    found = board(tmp_path, rows, stability=dict.fromkeys(HOSTILE, long))
    text = boards_text([found])
    assert max(len(line) for line in text.splitlines()) <= WIDTH == 120
    # Nothing that moves the cursor, turns the direction, or takes two columns or none.
    assert all(c == "\n" or (c.isprintable() and c.isascii()) for c in text)


def test_numbers_at_their_longest_fit_too(tmp_path: Path) -> None:
    rows = {f"law-number-{k}:gain=35e3": rows_of(*(["diverged"] * 4)) for k in range(3)}
    rows["b" * 90] = rows_of(12.34, 12.34, 12.34, 12.34)
    for one in rows["b" * 90]:
        one["force_rms"] = 29999.0
    text = boards_text([board(tmp_path, rows)])
    assert all(len(line) <= WIDTH for line in text.splitlines())
    table = [line for line in text.splitlines() if line.startswith(("b", "law"))]
    assert len(table) == 4
    assert any(line.endswith("30.00") for line in table)


def test_long_names_are_cut_in_the_middle_where_they_differ_least(tmp_path: Path) -> None:
    spec = "some_module.of_mine:" + "x" * 100 + ":gain=35e3"
    text = boards_text([board(tmp_path, {spec: rows_of(1.9)})])
    assert "some_module" in text
    assert "gain=35e3" in text


def test_a_row_has_score_and_interval_and_ride_indices(tmp_path: Path) -> None:
    rows = {"skyhook:gain=1e3": rows_of(1.9, 2.0, 2.1, 2.2), "a": rows_of(1.2, 1.3, 1.4, 1.5)}
    lines = boards_text([board(tmp_path, rows)]).splitlines()
    cells = next(line for line in lines if line.startswith("a ")).split()
    assert cells[1:6] == ["untold", "0.850", "0.85", "to", "0.85"]
    assert cells[6:] == ["1.00", "-", "0", "1.20", "1.30", "1.40", "1.50", "0.00"]


@pytest.mark.parametrize(
    ("answer", "text"),
    [
        ({}, "-"),
        ({"error": "it raised"}, "-"),
        ({"method": "exact", "critical_delay_s": None, "longest_s": None}, "none"),
        ({"method": "exact", "critical_delay_s": None, "longest_s": 2.0}, ">2000"),
        ({"method": "exact", "critical_delay_s": 0.2024, "proved": True}, "202 p"),
        ({"method": "exact", "critical_delay_s": 0.2024, "proved": False}, "202 e"),
        ({"method": "exact", "critical_delay_s": 0.2, "unstable_roots_without_delay": 2}, "0"),
        ({"method": "sampled", "critical_delay_s": 0.07, "proved": False}, "70 e"),
        ({"method": "simulation", "critical_delay_s": 0.3, "proved": False}, "300 s"),
    ],
)
def test_a_critical_delay_says_how_it_is_known(answer: dict, text: str) -> None:
    assert critical_text(answer) == text


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
