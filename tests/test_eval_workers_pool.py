"""A pool of worker processes: order, number, who shares a worker, and how it ends."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest
from worker_tasks import LIMITS, NotImportable, alive, gone, only, work

from eval.workers import InlinePool, LocalPool
from railenv.errors import ArgumentError, RailenvError

# Beside test_eval_benchmark.py and test_eval_store.py, which the default run has.
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def pool() -> Iterator[LocalPool]:
    with LocalPool(1, LIMITS) as made:
        yield made


def test_a_worker_serves_many_tasks_and_many_runs(pool: LocalPool) -> None:
    first = {outcome.value for outcome in pool.run(work, [("pid", i) for i in range(20)])}
    second = {outcome.value for outcome in pool.run(work, [("pid", i) for i in range(20)])}
    assert len(first) == 1
    assert first == second


def owner_of(task: tuple[str, Any]) -> str | None:
    return None if task[1] == "nobody" else task[1]


def test_a_worker_that_ran_somebodys_code_runs_nobody_elses() -> None:
    with LocalPool(1, LIMITS, owner_of) as pool:
        spoilt = only(pool.run(work, [("spoil", "A")])).value
        tasks = [("division", owner) for owner in ("A", "B", "nobody", "B")]
        found = [outcome.value for outcome in pool.run(work, tasks)]
    # Its own process goes on being A's, with what A has changed there.
    assert found[0] == (spoilt, "raise")
    assert [setting for _, setting in found[1:]] == ["warn"] * 3

    assert spoilt not in [pid for pid, _ in found[1:]]


def test_what_is_nobodys_shares_workers_also_with_the_first_owner() -> None:
    with LocalPool(1, LIMITS, owner_of) as pool:
        tasks = [("division", owner) for owner in ("nobody", "nobody", "A", "A")]
        assert len({outcome.value[0] for outcome in pool.run(work, tasks)}) == 1


def test_no_worker_serves_two_owners_however_their_tasks_are_mixed() -> None:
    with LocalPool(2, LIMITS, owner_of) as pool:
        tasks = [("division", owner) for owner in "AABBABBABAAB"]
        seen: dict[Any, set[int]] = {"A": set(), "B": set()}
        for outcome in pool.run(work, tasks):
            seen[outcome.task[1]].add(outcome.value[0])
    assert not seen["A"] & seen["B"]


@pytest.mark.parametrize("jobs_compared", [(1, 2), (3, 4)], ids=str)
def test_values_are_the_same_for_every_number_of_workers_and_inline(
    jobs_compared: tuple[int, ...],
) -> None:
    tasks = [("noise", seed) for seed in range(60)]
    with InlinePool() as inline:
        expected = {outcome.task: outcome.value for outcome in inline.run(work, tasks)}
    for jobs in jobs_compared:
        with LocalPool(jobs) as pool:
            outcomes = list(pool.run(work, tasks))
        assert len(outcomes) == len(tasks)
        assert {outcome.task: outcome.value for outcome in outcomes} == expected


def test_the_inline_pool_knows_the_same_failures() -> None:
    tasks: list[tuple[str, Any]] = [("refuse", "no"), ("exit", 3), ("value", 4)]
    with InlinePool() as pool:
        outcomes = list(pool.run(work, tasks))
    assert [outcome.status for outcome in outcomes] == ["failed", "failed", "done"]


def test_the_inline_pool_lets_an_interruption_through() -> None:
    with InlinePool() as pool, pytest.raises(KeyboardInterrupt):
        list(pool.run(work, [("raise", KeyboardInterrupt())]))


def test_outcomes_come_in_order_of_completion_and_a_hang_blocks_nobody() -> None:
    tasks: list[tuple[str, Any]] = [("hold", 1000), *(("value", i) for i in range(10))]
    with LocalPool(2, LIMITS) as pool:
        outcomes = list(pool.run(work, tasks))
    assert [outcome.value for outcome in outcomes[:10]] == list(range(10))
    assert outcomes[-1].status == "timeout"


def test_tasks_are_taken_only_as_workers_get_free(pool: LocalPool) -> None:
    taken = 0

    def endless() -> Iterator[tuple[str, int]]:
        nonlocal taken
        while True:
            taken += 1
            yield "value", taken

    outcomes = pool.run(work, endless())
    for seen in range(1, 6):
        next(outcomes)
        # One is finished and shown, one runs, one waits.
        assert taken <= seen + 2
    outcomes.close()  # type: ignore[attr-defined]


def test_closing_the_iterator_stops_a_worker_that_hangs() -> None:
    others = set(multiprocessing.active_children())  # of the pool that the tests share
    with LocalPool(2) as pool:
        outcomes = pool.run(work, [("pid", 0), ("hold", 1000), ("value", 1)])
        next(outcomes)
        children = set(multiprocessing.active_children()) - others
        assert children
        started = time.monotonic()
        outcomes.close()  # type: ignore[attr-defined]
        assert time.monotonic() - started < 2.0
        assert all(gone(child.pid or 0, within=0.0) for child in children)
        # The pool itself is still of use.
        assert only(pool.run(work, [("value", 7)])).value == 7


def test_a_pool_is_used_once_at_a_time_and_not_after_its_end(pool: LocalPool) -> None:
    first = pool.run(work, [("value", 1), ("value", 2)])
    next(first)
    with pytest.raises(ArgumentError, match="at work"):
        next(pool.run(work, [("value", 3)]))
    assert next(first).value == 2
    first.close()  # type: ignore[attr-defined]
    with LocalPool() as ended:
        pass
    with pytest.raises(ArgumentError, match="closed"):
        ended.run(work, [])


def test_what_cannot_be_sent_is_refused_and_finished_work_is_kept(pool: LocalPool) -> None:
    with pytest.raises(ArgumentError, match=r"the function cannot be sent .*of a module"):
        list(pool.run(lambda task: task, [1]))
    with pytest.raises(ArgumentError, match="function cannot be read by a worker: FileNotFound"):
        list(pool.run(NotImportable(), [1]))
    outcomes = pool.run(work, [("value", 1), ("value", lambda: 0)])
    assert next(outcomes).value == 1
    with pytest.raises(ArgumentError, match="the task cannot be sent"):
        next(outcomes)


SCRIPT = """
import sys, time
from eval.workers import Limits, LocalPool
from worker_tasks import work

def main(limits=None):
    with LocalPool(2, limits) as pool:
        tasks = [("pid", 0), ("pid", 1), ("hold", 1000), ("loop", 1000)]
        try:
            for outcome in pool.run(work, tasks):
                print(outcome.value, flush=True)
        except KeyboardInterrupt:
            print("interrupted", flush=True)

MAIN
"""


def started_script(folder: Path, main: str) -> "subprocess.Popen[str]":
    script = folder / "script.py"
    script.write_text(SCRIPT.replace("MAIN", main))
    tests = Path(__file__).parent
    return subprocess.Popen(
        [sys.executable, script],
        env={**os.environ, "PYTHONPATH": f"{tests}{os.pathsep}{tests.parent}"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


GUARDED = 'if __name__ == "__main__":\n    main()'


def hanging_workers(process: "subprocess.Popen[str]") -> list[int]:
    """Wait until the script's tasks hang; return every process that it has started."""
    assert process.stdout is not None
    for _ in range(2):
        process.stdout.readline()
    time.sleep(0.3)
    return [child.pid for child in psutil.Process(process.pid).children(recursive=True)]


def test_ctrl_c_stops_all_workers_at_once_and_leaves_no_process(tmp_path: Path) -> None:
    with started_script(tmp_path, GUARDED) as process:
        workers = hanging_workers(process)
        assert len(workers) >= 2
        # As a terminal does: to the whole group.
        os.killpg(process.pid, signal.SIGINT)
        out, err = process.communicate(timeout=5.0)
    assert (out, err, process.returncode) == ("interrupted\n", "", 0)
    assert all(gone(pid) for pid in workers)


def test_a_script_without_a_guard_is_told_so(tmp_path: Path) -> None:
    with started_script(tmp_path, "main()") as process:
        _, err = process.communicate(timeout=30.0)
    assert process.returncode == 1
    assert RailenvError.__name__ in err
    assert 'under `if __name__ == "__main__":`' in err.splitlines()[-1]


def test_workers_end_when_their_parent_is_killed(tmp_path: Path) -> None:
    main = GUARDED.replace("main()", "main(Limits(seconds=5.0))")
    with started_script(tmp_path, main) as process:
        workers = hanging_workers(process)
        process.kill()
        process.wait()
    # One loops in Python and ends at once. The other holds the interpreter's lock: the watchdog in
    # its own process ends it ten seconds after its time limit.
    try:
        time.sleep(3.0)
        assert sum(alive(pid) for pid in workers) < len(workers)
        assert all(gone(pid, within=30.0) for pid in workers)
    finally:
        for pid in filter(alive, workers):
            os.kill(pid, signal.SIGKILL)
