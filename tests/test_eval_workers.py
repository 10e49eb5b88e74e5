"""Worker processes: what a task that fails, hangs, eats memory or dies costs, and whom."""

import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from worker_tasks import LIMITS, MIB, NotReadable, alive, gone, mean_of_noise, only, work

from eval.workers import Limits, LocalPool
from railenv.errors import ArgumentError

# Beside test_eval_benchmark.py and test_eval_store.py, which the default run has.
pytestmark = pytest.mark.slow

LITTLE_MEMORY = Limits(seconds=20.0, memory_bytes=400 * MIB)


@pytest.fixture(scope="module")
def pool() -> Iterator[LocalPool]:
    with LocalPool(1, LIMITS) as made:
        yield made


def test_a_value_comes_back_with_its_task_and_its_time(pool: LocalPool) -> None:
    outcome = only(pool.run(work, [("sleep", 0.1)]))
    assert (outcome.status, outcome.task, outcome.message) == ("done", ("sleep", 0.1), "")
    assert 0.1 <= outcome.seconds < LIMITS.seconds


def test_an_error_of_railenv_is_a_failure_with_its_message(pool: LocalPool) -> None:
    outcome = only(pool.run(work, [("refuse", "the force is not finite")]))
    assert (outcome.status, outcome.message) == ("failed", "the force is not finite")


def test_another_error_is_a_failure_with_kind_last_line_and_place(pool: LocalPool) -> None:
    outcome = only(pool.run(work, [("raise", ValueError("first\nlast \x1b[31m"))]))
    assert outcome.status == "failed"
    assert outcome.message.startswith("ValueError: last ?[31m (worker_tasks.py, line ")


def _kind(value: object) -> str:
    return f" {value}" if isinstance(value, int) else f" {type(value).__name__}"


@pytest.mark.parametrize(
    ("task", "status", "message"),
    [
        (("exit", 3), "failed", "SystemExit: 3"),
        (("unsendable", 0), "failed", "the value cannot be sent back: "),
        (("unreadable", 0), "failed", "the value cannot be read: FileNotFoundError: settings"),
        (("value", NotReadable()), "failed", "cannot be read by a worker: FileNotFoundError"),
        (("raise", MemoryError("Unable to allocate 1 EiB")), "memory", "MemoryError: Unable"),
        (("loop", 0), "timeout", "stopped after the time limit of 0.8 s"),
        (("hold", 1000), "timeout", "stopped after the time limit of 0.8 s"),
        (("_exit", 0), "crashed", "the worker process ended itself with exit code 0"),
        (("_exit", 5), "crashed", "the worker process ended itself with exit code 5"),
        (("null", 0), "crashed", "the worker process died of SIGSEGV"),
        (("fork and die", 0), "crashed", "the worker process ended itself with exit code 4"),
        (("half", 0), "crashed", "the worker process died of SIGSEGV"),
        (("half and hang", 0), "timeout", "stopped in the middle of its answer"),
        (("kill", 0), "crashed", "was killed from outside (SIGKILL) in each of 2 attempts"),
    ],
    # Of an object the name of its class: where it lies in memory is no name.
    ids=lambda value: str(value) if not isinstance(value, tuple) else value[0] + _kind(value[1]),
)
def test_a_bad_task_costs_itself_alone(
    pool: LocalPool, task: tuple[str, Any], status: str, message: str
) -> None:
    outcomes = list(pool.run(work, [("noise", 1), task, ("noise", 2)]))
    assert [(o.status, o.value) for o in outcomes if o.task[0] == "noise"] == [
        ("done", mean_of_noise(1)),
        ("done", mean_of_noise(2)),
    ]
    (bad,) = (o for o in outcomes if o.task is task)
    assert bad.status == status
    assert message in bad.message
    # One look every 0.05 s; the rest is a machine that is busy with other things.
    assert bad.seconds < LIMITS.seconds + 1.0


def test_a_worker_that_dies_while_its_answer_is_half_read_costs_its_task_alone() -> None:
    with LocalPool(2, Limits(seconds=20.0)) as pool:
        outcomes = {
            o.task: o for o in pool.run(work, [("half", 0), *(("value", k) for k in (1, 2))])
        }
    assert [outcomes["value", k].value for k in (1, 2)] == [1, 2]
    assert outcomes["half", 0].status == "crashed"
    assert "SIGSEGV" in outcomes["half", 0].message


def test_a_closed_connection_costs_the_task_alone(pool: LocalPool) -> None:
    closed, after = pool.run(work, [("close", 0), ("value", 1)])
    assert closed.status == "crashed"
    assert after.value == 1


def test_a_task_killed_from_outside_is_tried_once_more(pool: LocalPool, tmp_path: Path) -> None:
    outcome = only(pool.run(work, [("once", str(tmp_path))]))
    assert (outcome.status, outcome.value) == ("done", "second attempt")


def test_memory_counts_for_the_task_that_takes_it() -> None:
    with LocalPool(1, LITTLE_MEMORY) as pool:
        eater, after = pool.run(work, [("eat", 5000), ("value", 1)])
        assert eater.status == "memory"
        assert eater.message == "stopped above the memory limit of 400 MiB"
        # Eating 400 MiB takes some 2 s at worst; 5000 MiB would take ten times as long.
        assert eater.seconds < 10.0
        assert after.value == 1


def test_what_a_task_keeps_in_memory_does_not_count_against_later_ones() -> None:
    with LocalPool(1, LITTLE_MEMORY) as pool:
        # Together 4 x 110 MiB are above the limit, each alone is not.
        outcomes = list(pool.run(work, [("keep", 110)] * 4))
    assert [outcome.status for outcome in outcomes] == ["done"] * 4
    assert len({outcome.value for outcome in outcomes}) >= 2


def test_what_tasks_keep_in_memory_adds_up_over_runs_too() -> None:
    with LocalPool(1, LITTLE_MEMORY) as pool:
        # A new run does not make what the last one left the worker's own.
        outcomes = [only(pool.run(work, [("keep", 110)])) for _ in range(4)]
    assert [outcome.status for outcome in outcomes] == ["done"] * 4
    assert len({outcome.value for outcome in outcomes}) >= 2


def test_a_worker_with_a_thread_left_behind_is_replaced(pool: LocalPool) -> None:
    left, after = pool.run(work, [("thread", 0), ("pid", 0)])
    assert left.value != after.value
    assert gone(left.value)


def test_what_a_worker_has_forked_is_killed_with_it() -> None:
    with LocalPool(1, LIMITS) as pool:
        child = only(pool.run(work, [("fork", 0)])).value
        assert alive(child)
    assert gone(child)


def test_what_a_controller_prints_stays_out_of_standard_output(
    pool: LocalPool, capfd: pytest.CaptureFixture[str]
) -> None:
    with LocalPool(1, LIMITS) as pool:
        only(pool.run(work, [("print", "hello")]))
    seen = capfd.readouterr()
    assert "hello" not in seen.out
    assert "hello" in seen.err


def test_workers_compute_on_one_thread_and_the_parent_keeps_its_setting(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    monkeypatch.delenv("NUMBA_NUM_THREADS", raising=False)
    with LocalPool(1) as pool:
        assert only(pool.run(work, [("threads", 0)])).value == (1, 1, "1")
    assert os.environ["OMP_NUM_THREADS"] == "2"
    assert "NUMBA_NUM_THREADS" not in os.environ


def test_an_answer_given_in_time_may_wait_to_be_read(pool: LocalPool) -> None:
    # Larger than what a pipe holds: the worker is still writing when its time is over.
    outcomes = pool.run(work, [("value", 1), ("zeros", 4 * MIB)])
    assert next(outcomes).value == 1
    time.sleep(LIMITS.seconds + 0.5)  # the caller is busy beyond the limit
    assert next(outcomes).value == bytes(4 * MIB)
    assert list(outcomes) == []


def test_limits_must_be_usable() -> None:
    for seconds, memory_bytes in ((0.0, MIB), (float("inf"), MIB), (1.0, 0)):
        with pytest.raises(ArgumentError):
            Limits(seconds, memory_bytes)


def test_a_memory_limit_below_what_a_worker_needs_is_refused() -> None:
    little = LocalPool(1, Limits(memory_bytes=MIB))
    with little as pool, pytest.raises(ArgumentError, match="less than a worker needs at rest"):
        list(pool.run(work, [("value", 1)]))
