"""Tasks that fork: what their children hold open, answer or leave behind stops nobody."""

import os
import signal
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import psutil
import pytest
from worker_tasks import LIMITS, alive, gone, only, work

from eval.workers import LocalPool

# Beside test_eval_benchmark.py and test_eval_store.py, which the default run has.
pytestmark = pytest.mark.slow


@pytest.fixture
def left(tmp_path: Path) -> Iterator[Path]:
    """A folder in which tasks note their children; those that live on are ended."""
    yield tmp_path
    for path in tmp_path.iterdir():
        with suppress(ProcessLookupError):
            os.kill(int(path.name), signal.SIGKILL)


def test_a_worker_that_dies_is_buried_while_a_child_holds_its_pipes(left: Path) -> None:
    started = time.monotonic()
    with LocalPool(1, LIMITS) as pool:
        ready = only(pool.run(work, [("value", 0)]))
        begun = time.monotonic()
        died, after = pool.run(work, [("escape and die", str(left)), ("value", 1)])
        assert (died.status, ready.value, after.value) == ("crashed", 0, 1)
        assert died.message == "the worker process ended itself with exit code 3"
        # One look every 0.5 s at worst, and the rest is a machine that is busy.
        assert died.seconds < 2.0
    # The second worker's start is in it; the wait for the pipes would take 100 s.
    assert time.monotonic() - begun < 8.0 + (begun - started)
    (child,) = (int(path.name) for path in left.iterdir())
    assert alive(child)  # else the test has shown nothing


def test_a_crash_is_no_timeout_where_the_caller_is_busy_beyond_the_limit(left: Path) -> None:
    with LocalPool(1, LIMITS) as pool:
        outcomes = pool.run(work, [("value", 0), ("escape and die", str(left))])
        next(outcomes)
        time.sleep(LIMITS.seconds + 0.5)
        assert next(outcomes).status == "crashed"


def test_the_limit_holds_for_a_task_whose_child_holds_its_pipes(left: Path) -> None:
    with LocalPool(1, LIMITS) as pool:
        hung, after = pool.run(work, [("escape and hang", str(left)), ("value", 1)])
        assert (hung.status, after.value) == ("timeout", 1)
        assert hung.seconds < LIMITS.seconds + 1.0
    (child,) = (int(path.name) for path in left.iterdir())
    assert gone(child)


def test_half_an_answer_that_a_child_holds_open_is_not_waited_for(left: Path) -> None:
    with LocalPool(1, LIMITS) as pool:
        died, after = pool.run(work, [("half and escape", str(left)), ("value", 1)])
    # Whichever comes first: that it has ended, or that its answer takes too long.
    assert (died.status, after.value) in (("crashed", 1), ("timeout", 1))
    assert died.seconds < LIMITS.seconds + 2.0


def test_a_child_that_has_left_the_group_is_killed_with_its_worker_without_a_wait() -> None:
    with LocalPool(1, LIMITS) as pool:
        child = only(pool.run(work, [("escape", "")])).value
        assert alive(child)
        started = time.monotonic()
    assert time.monotonic() - started < 2.0
    assert gone(child)


def test_a_worker_that_has_closed_all_and_lives_on_is_ended() -> None:
    with LocalPool(1, LIMITS) as pool:
        closed, after = pool.run(work, [("close and hang", 0), ("value", 1)])
    assert (closed.status, after.value) == ("crashed", 1)
    assert closed.message == "the worker process closed its connection"
    assert closed.seconds < LIMITS.seconds + 1.0


@pytest.mark.parametrize("seconds", [-0.3, 0.0, 0.2])
def test_a_child_that_returns_neither_answers_nor_takes_tasks(seconds: float) -> None:
    tasks = [("fork and return", seconds), *(("sleep", 0.05 * k) for k in range(1, 8))]
    with LocalPool(1, LIMITS) as pool:
        outcomes = {outcome.task: outcome for outcome in pool.run(work, tasks)}
        assert outcomes.pop(tasks[0]).value == "parent"
        assert [(o.status, o.value) for o in outcomes.values()] == [("done", None)] * 7


@pytest.mark.parametrize("times", [1, 2, 3])
def test_an_answer_too_many_is_nobodys(times: int) -> None:
    tasks = [("answer twice", times), *(("value", number) for number in range(5))]
    with LocalPool(1, LIMITS) as pool:
        outcomes = {outcome.task: outcome.value for outcome in pool.run(work, tasks)}
    assert outcomes.pop(tasks[0]) == "forged"  # of its own task it says what it likes
    assert outcomes == {("value", number): number for number in range(5)}


def test_a_child_that_returns_ends_there() -> None:
    with LocalPool(1, LIMITS) as pool:
        _, worker = pool.run(work, [("fork and return", 0.0), ("pid", 0)])
        children = psutil.Process(worker.value).children()
        assert all(gone(child.pid, within=2.0) for child in children)
