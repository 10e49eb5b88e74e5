"""What broken controllers, limits and lost yardsticks cost: their own rows, and what is said."""

from pathlib import Path
from typing import Any

import pytest
from benchmark_examples import (
    BROKEN,
    LIMITS,
    SHORT,
    Ends,
    benchmark_of,
    block,
    cells,
    ended,
    run,
    suite_of,
)

from eval.benchmark import GIVE_UP, Benchmark, missing, open_store, run_benchmark
from eval.cells import CellWork
from eval.entries import Entry
from eval.packages import PASSIVE, REFERENCE
from eval.report import write_report
from eval.scoring.board import boards_of, plain_board
from eval.scoring.board_text import boards_text
from eval.scoring.finished import check_finished
from eval.store.digest import digest
from eval.store.reader import Reader
from eval.workers import InlinePool, Limits, LocalPool, Outcome
from railenv.errors import ArgumentError

pytestmark = pytest.mark.slow

SPEC = "skyhook:gain=15e3"
WIDE = benchmark_of(
    SPEC,
    "zero",
    suite=suite_of(block(delays_ms=(0.0, 100.0), speeds_kmh=(200.0, 250.0, 300.0, 350.0))),
)
"""Four packages of two scenarios per controller."""


FAILURES = {
    "Raises": "the controller's act raised RuntimeError: gave up",
    "RaisesInReset": "the controller's reset raised RuntimeError: not today",
    "RaisesLate": "the controller's act raised ZeroDivisionError: late",
    "Nan": "act returned a value that is not finite",
    "WrongShape": "act returned shape (4,); it must be (4, 4): (lanes, channels)",
    "Complex": "the controller's act raised TypeError: actions of type complex128",
    "BeyondColumns": "act returned shape (4, 0); it must be (4, 4)",
    "OnlyTwo": "act returned shape (4, 2); it must be (4, 4)",
    "nothing": "returned NoneType; a controller needs",
    "not_made": "raised RuntimeError: no licence",
}


def test_what_a_broken_controller_does_is_said_and_costs_its_own_rows_alone(
    tmp_path: Path,
) -> None:
    specs = [f"{BROKEN}{name}" for name in FAILURES]
    folder = run(tmp_path, benchmark_of(*specs, "zero", suite=SHORT))
    statuses = ended(folder)
    assert statuses.pop("zero") == ["ok"] * 4
    assert statuses.pop("passive") == statuses.pop("reference") == ["ok"] * 2
    assert statuses == {spec: ["failed"] * 4 for spec in specs}
    for name, words in FAILURES.items():
        rows = cells(folder, controller=f"{BROKEN}{name}")
        assert all(words in row["message"] for row in rows), rows[0]["message"]
        assert {row["ride_index_rear"] for row in rows} == {None}
    with Reader.open(folder) as reader:
        answers = {row["controller"]: row["answer"] for row in reader.stability()}
        motion = {row["controller"]: row["answer"] for row in reader.motion()}
    assert all("error" in answers[spec] for spec in specs)
    for name, words in FAILURES.items():
        # Shapes differ: three delays are shown.
        assert words.partition(" (4")[0] in motion[f"{BROKEN}{name}"]["error"]
    assert motion.keys() == {*specs, "zero", "passive"}
    assert "runs" in motion["zero"]


@pytest.mark.parametrize("status", ["timeout", "memory", "crashed"])
def test_a_controller_that_hangs_in_three_packages_is_left_out_of_the_rest(
    tmp_path: Path, status: str
) -> None:
    assert GIVE_UP == 3
    pool = Ends("zero", status)
    told: list[tuple[str, int]] = []
    with open_store(WIDE, tmp_path, resume=False) as store:
        run_benchmark(WIDE, store, pool, "test", lambda *done: told.append(done))
    assert pool.asked == 3
    rows = cells(tmp_path, controller="zero")
    # As a word for all, so that the number of workers makes no difference.
    assert {row["status"] for row in rows} == {status}
    left = [row for row in rows if row["message"].startswith("left out after 3 packages")]
    assert (len(rows), len(left)) == (8, 2)
    assert ended(tmp_path)[SPEC] == ["failed"] * 8
    assert sum(number for _, number in told) == 8 + 8 + 4 + 4
    with Reader.open(tmp_path) as reader:
        (answer,) = (r["answer"] for r in reader.stability() if r["controller"] == "zero")
        (picture,) = (r["answer"] for r in reader.motion() if r["controller"] == "zero")
    assert answer == picture == {"error": "left out"}


def test_what_an_earlier_session_lost_is_counted(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, WIDE, Ends("zero", "timeout", stop_at=3))
    pool = Ends("zero", "timeout")
    run(tmp_path, WIDE, pool, resume=True)
    assert pool.asked == 1
    assert ended(tmp_path)["zero"] == ["timeout"] * 8


def test_what_costs_no_time_is_tried_to_the_end(tmp_path: Path) -> None:
    pool = Ends("zero", "failed")
    run(tmp_path, WIDE, pool)
    # Four packages, its stability and its motion.
    assert pool.asked == 4 + 2
    assert ended(tmp_path)["zero"] == ["failed"] * 8


@pytest.mark.parametrize("jobs", [1, 2])
def test_what_hangs_eats_or_exits_is_stopped_within_its_limits(tmp_path: Path, jobs: int) -> None:
    limits = Limits(8.0, 700 * 2**20)
    ends = {"Hangs": "timeout", "EatsMemory": "memory", "Exits": "crashed", "Raises": "failed"}
    specs = [f"{BROKEN}{name}" for name in ends]
    benchmark = benchmark_of(*specs, SPEC, suite=SHORT, limits=limits)
    with LocalPool(jobs, limits) as pool:
        run(tmp_path / "pool", benchmark, pool)
    statuses = ended(tmp_path / "pool")
    assert statuses[SPEC] == ["ok"] * 4
    for name, status in ends.items():
        assert statuses[f"{BROKEN}{name}"] == [status] * 4
    words = {row["status"]: row["message"] for row in cells(tmp_path / "pool")}
    assert words["timeout"] == "stopped after the time limit of 8 s"
    assert words["memory"] == "stopped above the memory limit of 700 MiB"
    assert words["crashed"] == "the worker process ended itself with exit code 3"
    alone = run(tmp_path / "alone", benchmark_of(SPEC, suite=SHORT))
    rows = {row["key"]: row for row in cells(alone, controller=SPEC)}
    assert rows == {row["key"]: row for row in cells(tmp_path / "pool", controller=SPEC)}


def test_an_entry_that_was_never_made_fails_by_its_packages(tmp_path: Path) -> None:
    spec = f"{BROKEN}not_made"
    wanted = Benchmark(SHORT, (Entry(spec, "untold", None),), LIMITS)
    folder = run(tmp_path, wanted)
    assert ended(folder)[spec] == ["failed"] * 4


class Loses(InlinePool):
    """Lets the packages of one controller end in some way, and does the others."""

    def __init__(self, spec: str, status: Any = "timeout") -> None:
        self.spec, self.status = spec, status

    def run(self, function: Any, tasks: Any) -> Any:
        for task in tasks:
            if isinstance(task, CellWork) and task.package.controller == self.spec:
                yield Outcome(task, self.status, None, "stopped after the time limit of 1 s", 1.0)
            else:
                yield from super().run(function, [task])


@pytest.mark.parametrize("spec", [PASSIVE, REFERENCE])
def test_a_lost_yardstick_is_said_everywhere_and_refused_for_publication(
    tmp_path: Path, spec: str
) -> None:
    run(tmp_path, benchmark_of("zero", suite=SHORT), Loses(spec))
    with Reader.open(tmp_path) as reader:
        boards = boards_of(reader)
        page = write_report(reader, boards).read_text(encoding="utf-8")
        with pytest.raises(ArgumentError, match=f"2 lost runs of {spec}: timeout, stopped after"):
            check_finished(reader)
    words = f"{spec}: timeout, stopped after the time limit of 1 s"
    assert plain_board(boards[0])["lost_baselines"] == {words: 2}
    text = " ".join(boards_text(boards).split())
    assert "WARNING: runs of passive or the reference were lost on 2 of 2 tracks" in text
    assert words in text
    assert words in page
    assert "the passive vehicle diverges" not in page


def test_a_yardstick_that_diverged_is_a_result_and_no_loss(tmp_path: Path) -> None:
    class Diverges(InlinePool):
        def run(self, function: Any, tasks: Any) -> Any:
            for outcome in super().run(function, tasks):
                task = outcome.task
                if isinstance(task, CellWork) and task.package.controller == PASSIVE:
                    for row in outcome.value:
                        row["status"] = "diverged"
                yield outcome

    run(tmp_path, benchmark_of("zero", suite=SHORT), Diverges())
    with Reader.open(tmp_path) as reader:
        boards = boards_of(reader)
        page = write_report(reader, boards).read_text(encoding="utf-8")
        check_finished(reader)
    assert not boards[0].lost_baselines
    assert "WARNING" not in boards_text(boards)
    assert "the passive vehicle diverges" in page


@pytest.mark.parametrize("spec", [PASSIVE, REFERENCE])
@pytest.mark.parametrize("status", ["timeout", "failed"])
def test_a_lost_yardstick_is_run_again_on_resume_and_the_run_is_then_as_any_other(
    tmp_path: Path, spec: str, status: str
) -> None:
    wanted = benchmark_of("zero", suite=SHORT)
    run(tmp_path / "lost", wanted, Loses(spec, status))
    run(tmp_path / "lost", wanted, resume=True)
    assert digest(tmp_path / "lost") == digest(run(tmp_path / "whole", wanted))
    with Reader.open(tmp_path / "lost") as reader:
        check_finished(reader)


def test_what_is_lost_of_a_controller_stays_its_result(tmp_path: Path) -> None:
    wanted = benchmark_of("zero", suite=SHORT)
    run(tmp_path, wanted, Loses("zero"))
    with open_store(wanted, tmp_path, resume=True) as store:
        assert missing(wanted, store) == []


def test_yardsticks_are_never_given_up(tmp_path: Path) -> None:
    pool = Ends(PASSIVE, "timeout")
    run(tmp_path, WIDE, pool)
    again = Ends(PASSIVE, "timeout")
    run(tmp_path, WIDE, again, resume=True)
    # Four packages each time; its stability and its motion once.
    assert (pool.asked, again.asked) == (4 + 2, 4)
    assert not any("left out" in row["message"] for row in cells(tmp_path, controller=PASSIVE))


@pytest.mark.parametrize("how", ["another's", "fewer", "none", "no rows", "another status"])
def test_rows_of_another_package_are_never_written(tmp_path: Path, how: str) -> None:
    other = suite_of(block(speeds_kmh=(200.0,), delays_ms=(0.0, 100.0), seeds=2))

    class Confused(InlinePool):
        def run(self, function: Any, tasks: Any) -> Any:
            for outcome in super().run(function, tasks):
                task = outcome.task
                value: Any = outcome.value
                if isinstance(task, CellWork) and task.package.controller == "zero":
                    rows = list(value)
                    value = {
                        "another's": [
                            {**row, "key": s.key}
                            for row, s in zip(rows, other.scenarios, strict=True)
                        ],
                        "fewer": rows[:-1],
                        "none": None,
                        "no rows": "four",
                        "another status": [{**row, "status": "timeout"} for row in rows],
                    }[how]
                yield Outcome(task, outcome.status, value, outcome.message, outcome.seconds)

    run(tmp_path, benchmark_of("zero", suite=SHORT), Confused())
    rows = cells(tmp_path, controller="zero")
    assert {row["key"] for row in rows} == {s.key for s in SHORT.scenarios}
    assert {row["status"] for row in rows} == {"failed"}
    assert {row["message"] for row in rows} == {
        "the worker gave rows that are not those of its package"
    }


def test_an_unfinished_run_says_so_with_everybody_who_is_still_to_run(tmp_path: Path) -> None:
    class Stops(InlinePool):
        def run(self, function: Any, tasks: Any) -> Any:
            for number, outcome in enumerate(super().run(function, tasks)):
                if number == 2:
                    raise KeyboardInterrupt
                yield outcome

    wanted = benchmark_of("zero", SPEC, suite=SHORT)
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, wanted, Stops())
    with Reader.open(tmp_path) as reader:
        boards = boards_of(reader)
        page = write_report(reader, boards).read_text(encoding="utf-8")
    plain = plain_board(boards[0])
    assert (plain["runs"], plain["planned_runs"]) == (4, 12)
    assert plain["unfinished"] == {spec: {"runs": 0, "planned_runs": 4} for spec in ("zero", SPEC)}
    assert "WARNING: not finished, 4 of 12 runs: " in boards_text(boards)
    assert "not finished, 4 of 12 runs: " in page
    run(tmp_path, wanted, resume=True)
    with Reader.open(tmp_path) as reader:
        (board,) = boards_of(reader)
    assert (board.unfinished, sum(a for a, _ in board.progress.values())) == ({}, 12)


def test_a_resumed_run_with_fewer_controllers_still_lacks_the_others(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, benchmark_of("zero", SPEC, suite=SHORT), Ends("zero", "failed", stop_at=1))
    run(tmp_path, benchmark_of("zero", suite=SHORT), resume=True)
    with Reader.open(tmp_path) as reader:
        (board,) = boards_of(reader)
    assert board.unfinished == {SPEC: (0, 4)}
