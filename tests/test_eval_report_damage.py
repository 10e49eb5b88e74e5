"""Records of strangers: whatever is in them, one line says which row cannot be right."""

import copy
import json
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from report_examples import add_motion, exact, motion, passive_motion, scenarios, write
from report_pages import HOOK, page_of, usual

from eval.packages import PASSIVE
from eval.store.schema import RECORDS_FILE
from eval.store.shapes import wrong_field
from railenv.errors import InputFileError

pytestmark = pytest.mark.slow

RUN = scenarios()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Records with everything that a page shows."""
    made = write(tmp_path / "run", usual(), RUN)
    return add_motion(made, {PASSIVE: passive_motion(), HOOK: motion()})


def change(folder: Path, command: str, *values: Any) -> None:
    """Change the file as any program can, its own checks put off."""
    with closing(sqlite3.connect(folder / RECORDS_FILE)) as file, file:
        file.execute("PRAGMA ignore_check_constraints = ON")
        file.execute(command, values)


def refused(folder: Path) -> str:
    """The one line with which the records are refused."""
    with pytest.raises(InputFileError) as found:
        page_of(folder, None)
    message = str(found.value)
    assert "\n" not in message
    assert message.startswith(f"{folder / RECORDS_FILE} is damaged")
    return message


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("ride_index_front", None),
        ("ride_index_rear", None),
        ("ride_index_rear", "good"),
        ("ride_index_rear", float("inf")),
        ("force_rms", 1e300),
        ("stroke_peak", b"\0"),
        ("delay_s", "later"),
        ("delay_s", -0.1),
        ("speed_kmh", 0.0),
        ("seed", 0.5),
        ("status", "fine"),
        ("unstable", 2),
        ("layout", b"4"),
        ("message", b"\xff"),
    ],
)
def test_a_cell_that_cannot_be_right_is_named(folder: Path, column: str, value: Any) -> None:
    where = "WHERE key = ? AND controller = ?"
    change(folder, f"UPDATE cells SET {column} = ? {where}", value, RUN[1].key, HOOK)
    message = refused(folder)
    assert f"row '{HOOK}', '{RUN[1].key}' of cells has {column} = " in message


@pytest.mark.parametrize(
    ("table", "column", "value"),
    [
        ("controllers", "division", "best"),
        ("controllers", "sha256", b"7"),
        ("sessions", "command", b"railenv"),
        ("sessions", "versions", "[]"),
        ("packages", "seconds", "long"),
        ("packages", "status", "perhaps"),
        ("stability", "answer", "{"),
        ("stability", "answer", "7"),
        ("stability", "answer", "[" * 100000),
        ("motion", "answer", '{"runs": []}'),
        ("motion", "speed_kmh", "fast"),
    ],
)
def test_another_row_that_cannot_be_right_is_named(
    folder: Path, table: str, column: str, value: Any
) -> None:
    change(folder, f"UPDATE {table} SET {column} = ?", value)
    assert f" of {table} has " in refused(folder)


def test_a_text_that_is_not_utf_8_is_refused(folder: Path) -> None:
    change(folder, "UPDATE cells SET message = CAST(x'ff' AS TEXT)")
    refused(folder)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("critical_delay_s", "soon"),
        ("critical_delay_s", 1e300),
        ("method", ["exact"]),
        ("stable_windows_s", [[0.0], [1.0]]),
        ("bracket_s", [0.1, 0.2, 0.3]),
        ("frequency_hz", "slow"),
        ("error", 7),
    ],
)
def test_an_answer_on_stability_that_cannot_be_shown_is_named(
    folder: Path, field: str, value: Any
) -> None:
    text = json.dumps(exact(100.0) | {field: value})
    change(folder, "UPDATE stability SET answer = ? WHERE controller = ?", text, HOOK)
    words = f"row '{HOOK}', '4', 'nominal' of stability has an answer with a wrong {field}"
    assert words in refused(folder)


def places_of(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Every place in an answer; of a long list the first two and the last."""
    yield path
    if isinstance(value, dict):
        for name in value:
            yield from places_of(value[name], (*path, name))
    elif isinstance(value, list):
        for k in {0, 1, len(value) - 1} & {*range(len(value))}:
            yield from places_of(value[k], (*path, k))


def changed(answer: Any, path: tuple[Any, ...], value: Any) -> Any:
    """An answer with another value at a place; ... takes the place away."""
    if not path:
        return value
    answer = copy.copy(answer)
    if len(path) == 1 and value is ...:
        del answer[path[0]]
    else:
        answer[path[0]] = changed(answer[path[0]], path[1:], value)
    return answer


OTHERS = (None, -1, 1e300, "text", [], {}, float("nan"), ...)


@pytest.mark.parametrize(("spec", "whole"), [(HOOK, motion()), (PASSIVE, passive_motion())])
def test_a_motion_that_is_not_refused_can_be_drawn(spec: str, whole: dict[str, Any]) -> None:
    from eval.report.locus import locus_chart
    from eval.report.motion import history_chart, passive_signals, scale_of

    kept = 0
    for path in places_of(whole):
        for value in OTHERS:
            answer = changed(whole, path, value) if path else value
            if not isinstance(answer, dict) or wrong_field("motion", answer):
                continue
            if "error" in answer:
                continue
            kept += 1
            passive = answer if spec == PASSIVE else passive_motion()
            scale = scale_of("4", passive, [passive, answer])
            assert "nan" not in history_chart("a", answer, scale)
            passive_signals(scale, passive)
            if "none" not in answer["roots"]:
                locus_chart("b", answer["roots"], passive["roots"])
    # What is not shown may be anything, e.g. the width of a bin; and some numbers may be others.
    assert kept > 20
