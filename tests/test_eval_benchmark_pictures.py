"""Time histories and roots in a benchmark's run: resumed, lost without harm, of a public track."""

import shutil
import sqlite3
from pathlib import Path
from typing import Any

import pytest
from benchmark_examples import benchmark_of, block, cells, run, suite_of

from eval.benchmark_motion import MotionWork
from eval.store.digest import digest
from eval.store.reader import Reader
from eval.workers import InlinePool, Outcome

pytestmark = pytest.mark.slow

SPEC = "skyhook:gain=15e3"
SHORT = suite_of(block())


def test_what_is_lost_over_a_picture_costs_nothing_else(tmp_path: Path) -> None:
    class Hangs(InlinePool):
        """Loses every worker that is at a picture."""

        def run(self, function: Any, tasks: Any) -> Any:
            for task in tasks:
                if isinstance(task, MotionWork):
                    yield Outcome(task, "timeout", None, "stopped after 8 s", 8.0)
                else:
                    yield from super().run(function, [task])

    wanted = benchmark_of(*(f"skyhook:gain={k}e3" for k in range(1, 5)), suite=SHORT)
    folder = run(tmp_path, wanted, Hangs())
    assert {row["status"] for row in cells(folder)} == {"ok"}
    with Reader.open(folder) as reader:
        assert [row["answer"] for row in reader.motion()] == [{"error": "stopped after 8 s"}] * 5
        assert all("error" not in row["answer"] for row in reader.stability())


def test_records_without_motion_get_it_when_they_are_resumed(tmp_path: Path) -> None:
    wanted = benchmark_of(SPEC, "zero", suite=SHORT)
    whole = run(tmp_path / "whole", wanted)
    folder = shutil.copytree(whole, tmp_path / "old")
    made = sqlite3.connect(folder / "records.sqlite")
    with made:
        made.execute("DROP TABLE motion")
        made.execute("UPDATE meta SET value = '2' WHERE name = 'schema'")
    made.close()
    asked: list[object] = []

    class Counts(InlinePool):
        def run(self, function: Any, tasks: Any) -> Any:
            for outcome in super().run(function, tasks):
                asked.append(outcome.task)
                yield outcome

    run(folder, wanted, Counts(), resume=True)
    assert [type(task) for task in asked] == [MotionWork] * 3
    assert digest(folder) == digest(whole)


def test_pictures_are_of_a_public_track_whatever_the_salt(tmp_path: Path) -> None:
    found: list[Any] = []
    for name, salt in (("public", ""), ("private", "sixteen characters or more")):
        folder = run(tmp_path / name, benchmark_of(SPEC, suite=SHORT, salt=salt))
        with Reader.open(folder) as reader:
            found.append(reader.motion())
    assert found[0] == found[1]
    assert len(found[0]) == 2
