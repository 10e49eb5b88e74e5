"""Worker processes: what a task that fails, hangs, eats memory or dies costs, and whom."""

import ctypes
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from eval.workers import InlinePool, Limits, LocalPool, Outcome
from railenv.errors import ArgumentError, ControllerError, RailenvError

# Beside test_eval_benchmark.py and test_eval_store.py, which the default run has.
pytestmark = pytest.mark.slow

MIB = 2**20
LIMITS = Limits(seconds=0.8)
LITTLE_MEMORY = Limits(seconds=20.0, memory_bytes=400 * MIB)


def work(task: tuple[str, Any]) -> Any:
    """Do what the task says; most of it is bad."""
    kind, content = task
    return _KINDS[kind](content)


def _mean_of_noise(seed: int) -> tuple[float, bytes]:
    noise = np.random.default_rng(seed).standard_normal((40, 40))
    return float(np.linalg.svd(noise @ noise.T)[1].mean()), noise.tobytes()


def _refuse(text: str) -> None:
    raise ControllerError(text)


def _raise(error: Exception) -> None:
    raise error


def _loop(_: object) -> None:
    while True:
        pass


def _hold_the_lock(seconds: int) -> None:
    ctypes.PyDLL(None).sleep(seconds)  # PyDLL keeps the interpreter's lock


def _eat(mib: int) -> None:
    held = [np.ones(10 * MIB // 8) for _ in range(mib // 10)]
    time.sleep(30.0)
    assert held


def _keep(mib: int) -> int:
    _kept.append(np.ones(mib * MIB // 8))
    return os.getpid()


_kept: list[Any] = []


def _once(folder: str) -> str:
    mark = Path(folder) / "begun"
    if mark.exists():
        return "second attempt"
    mark.touch()
    os.kill(os.getpid(), signal.SIGKILL)
    return "never"


def _fork(_: object) -> int:
    child = os.fork()
    if child == 0:
        time.sleep(60.0)
        os._exit(0)
    return child


def _fork_and_die(_: object) -> None:
    _fork(None)
    os._exit(4)


def _leave_a_thread(_: object) -> int:
    threading.Thread(target=time.sleep, args=(60.0,), daemon=True).start()
    return os.getpid()


def _threads(_: object) -> tuple[int, int, str]:
    import numba
    import torch

    return torch.get_num_threads(), numba.get_num_threads(), os.environ["OMP_NUM_THREADS"]


class _NotReadable:
    def __reduce__(self) -> tuple[Any, ...]:
        return _refuse_to_load, ()


class _NotImportable(_NotReadable):
    def __call__(self, task: object) -> None: ...


def _refuse_to_load() -> None:
    raise FileNotFoundError("settings of the controller")


_KINDS = {
    "value": lambda value: value,
    "zeros": bytes,
    "noise": _mean_of_noise,
    "refuse": _refuse,
    "raise": _raise,
    "exit": sys.exit,
    "loop": _loop,
    "hold": _hold_the_lock,
    "eat": _eat,
    "keep": _keep,
    "_exit": os._exit,
    "null": lambda _: ctypes.string_at(0),
    "kill": lambda _: os.kill(os.getpid(), signal.SIGKILL),
    "once": _once,
    "unsendable": lambda _: lambda: 0,
    "unreadable": lambda _: _NotReadable(),
    "pid": lambda _: os.getpid(),
    "sleep": time.sleep,
    "fork": _fork,
    "fork and die": _fork_and_die,
    "thread": _leave_a_thread,
    "threads": _threads,
    "print": lambda text: print(text, flush=True),
    "close": lambda _: os.closerange(3, 64),
}


@pytest.fixture(scope="module")
def pool() -> Iterator[LocalPool]:
    with LocalPool(1, LIMITS) as made:
        yield made


def only(outcomes: Iterator[Outcome[Any]]) -> Outcome[Any]:
    (outcome,) = outcomes
    return outcome


def alive(pid: int) -> bool:
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def gone(pid: int, within: float = 5.0) -> bool:
    until = time.monotonic() + within
    while alive(pid):
        if time.monotonic() > until:
            return False
        time.sleep(0.02)
    return True


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
    assert outcome.message.startswith("ValueError: last ?[31m (test_eval_workers.py, line ")


def _kind(value: object) -> str:
    return f" {value}" if isinstance(value, int) else f" {type(value).__name__}"


@pytest.mark.parametrize(
    ("task", "status", "message"),
    [
        (("exit", 3), "failed", "SystemExit: 3"),
        (("unsendable", 0), "failed", "the value cannot be sent back: "),
        (("unreadable", 0), "failed", "the value cannot be read: FileNotFoundError: settings"),
        (("value", _NotReadable()), "failed", "cannot be read by a worker: FileNotFoundError"),
        (("raise", MemoryError("Unable to allocate 1 EiB")), "memory", "MemoryError: Unable"),
        (("loop", 0), "timeout", "stopped after the time limit of 0.8 s"),
        (("hold", 1000), "timeout", "stopped after the time limit of 0.8 s"),
        (("_exit", 0), "crashed", "the worker process ended itself with exit code 0"),
        (("_exit", 5), "crashed", "the worker process ended itself with exit code 5"),
        (("null", 0), "crashed", "the worker process died of SIGSEGV"),
        (("fork and die", 0), "crashed", "the worker process ended itself with exit code 4"),
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
        ("done", _mean_of_noise(1)),
        ("done", _mean_of_noise(2)),
    ]
    (bad,) = (o for o in outcomes if o.task is task)
    assert bad.status == status
    assert message in bad.message
    # One look every 0.05 s; the rest is a machine that is busy with other things.
    assert bad.seconds < LIMITS.seconds + 1.0


def test_a_closed_connection_costs_the_task_alone(pool: LocalPool) -> None:
    closed, after = pool.run(work, [("close", 0), ("value", 1)])
    assert closed.status == "crashed"
    assert after.value == 1


def test_a_task_killed_from_outside_is_tried_once_more(pool: LocalPool, tmp_path: Path) -> None:
    outcome = only(pool.run(work, [("once", str(tmp_path))]))
    assert (outcome.status, outcome.value) == ("done", "second attempt")


def test_a_worker_serves_many_tasks_and_many_runs(pool: LocalPool) -> None:
    first = {outcome.value for outcome in pool.run(work, [("pid", i) for i in range(20)])}
    second = {outcome.value for outcome in pool.run(work, [("pid", i) for i in range(20)])}
    assert len(first) == 1
    assert first == second


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


@pytest.mark.parametrize(
    "jobs_compared", [(1, 2), pytest.param((3, 4), marks=pytest.mark.slow)], ids=str
)
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


def test_an_answer_given_in_time_may_wait_to_be_read(pool: LocalPool) -> None:
    # Larger than what a pipe holds: the worker is still writing when its time is over.
    outcomes = pool.run(work, [("value", 1), ("zeros", 4 * MIB)])
    assert next(outcomes).value == 1
    time.sleep(LIMITS.seconds + 0.5)  # the caller is busy beyond the limit
    assert next(outcomes).value == bytes(4 * MIB)
    assert list(outcomes) == []


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
        list(pool.run(_NotImportable(), [1]))
    outcomes = pool.run(work, [("value", 1), ("value", lambda: 0)])
    assert next(outcomes).value == 1
    with pytest.raises(ArgumentError, match="the task cannot be sent"):
        next(outcomes)


def test_limits_must_be_usable() -> None:
    for seconds, memory_bytes in ((0.0, MIB), (float("inf"), MIB), (1.0, 0)):
        with pytest.raises(ArgumentError):
            Limits(seconds, memory_bytes)


def test_a_memory_limit_below_what_a_worker_needs_is_refused() -> None:
    little = LocalPool(1, Limits(memory_bytes=MIB))
    with little as pool, pytest.raises(ArgumentError, match="less than a worker needs at rest"):
        list(pool.run(work, [("value", 1)]))


SCRIPT = """
import sys, time
from eval.workers import Limits, LocalPool
from test_eval_workers import work

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
