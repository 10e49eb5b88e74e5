"""Leaderboards in a terminal: within their width whatever the names, every number at its place."""

from pathlib import Path
from typing import Any

import pytest
from score_examples import PLACE, key, record, row, yardsticks

from eval.scoring.board import Board, boards_of
from eval.scoring.board_text import WIDTH, boards_text, critical_text
from eval.scoring.statistics import Resampling
from eval.store.reader import Reader

FEW = Resampling(draws=200)
DELAYS = (0, 100, 200, 300)


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


def test_conditions_of_one_track_are_counted_below_the_table(tmp_path: Path) -> None:
    rows = [*rows_of(1.9), row(key("jitter:0", 0), 1.9)]
    assert "a condition has one scored track, of which intervals hold nothing" in boards_text(
        [board(tmp_path, {"a": rows})]
    )
