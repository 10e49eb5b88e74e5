"""A pool of local worker processes with limits on time and memory.

Users' controllers may raise, hang, eat memory or end their process: each costs its own task, and
the worker is replaced. The limits are kept by the pool from outside, so that code that holds the
interpreter's lock is stopped too. Memory is looked at every `WATCH_PERIOD`: a shorter peak is not
seen. What a worker starts is killed with it as far as it can be found, see `eval.workers.process`.

Not known here: progress, records, what a task means.
"""

import threading
import time
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Iterator
from multiprocessing.connection import wait
from types import TracebackType
from typing import Any, Self

from eval.workers.outcome import Limits, Outcome, Task
from eval.workers.process import Job, WorkerProcess
from railenv.errors import ArgumentError, RailenvError, check_count

WATCH_PERIOD = 0.05
"""Time between two looks at the workers [s]."""

_ATTEMPTS = 2
"""How often a task is begun whose worker is killed from outside."""

_STARTS = 3
"""Workers in a row that may die before they are ready."""


class LocalPool:
    """Runs a function over tasks in worker processes.

    Use it as a context manager; workers start when there is work, and serve many tasks.

    Args:
        jobs: Worker processes, one or more.
        limits: What one task may use; also with one job the work is done in a worker process.
        owner: Says of a task whose own code it runs, None for nobody's. A worker that has run
            somebody's code runs nobody else's tasks: that code may have changed numpy's error
            state, a module, or whatever else a process holds. None for tasks that trust each other.
    """

    def __init__(
        self,
        jobs: int = 1,
        limits: Limits | None = None,
        owner: Callable[[Any], Hashable | None] | None = None,
    ) -> None:
        self._jobs = check_count("jobs", jobs)
        self._owner = owner
        self._limits = limits if limits is not None else Limits()
        self._workers: list[WorkerProcess] = []
        # Held while a worker changes its phase or is judged by it.
        self._lock = threading.Lock()
        self._watcher: threading.Thread | None = None
        self._closing = threading.Event()
        self._running = False
        self._failed_starts = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Stop all workers at once; returns when no process is left."""
        self._closing.set()
        self._stop_workers()
        if self._watcher is not None:
            self._watcher.join()
            self._watcher = None

    def run(
        self, function: Callable[[Task], Any], tasks: Iterable[Task]
    ) -> Iterator[Outcome[Task]]:
        """Yield the outcome of each task, in order of completion.

        Tasks are taken from `tasks` as workers get free, never more than `jobs` ahead. Closing the
        iterator, or an exception such as Ctrl-C, stops all workers at once. A value does not
        depend on the number of workers as long as the function depends on its task alone.

        Args:
            function: Of a module, so that workers can import it.
            tasks: Anything that can be pickled; taken one by one.

        Returns:
            An iterator of outcomes.

        Raises:
            ArgumentError: Function or task cannot be sent to a worker; the pool is at work or
                closed; the memory limit is below what a worker needs at rest.
            RailenvError: No worker can be started.
        """
        self._check_open()
        return self._run(function, tasks)

    def _run(
        self, function: Callable[[Task], Any], tasks: Iterable[Task]
    ) -> Iterator[Outcome[Task]]:
        if self._running:
            raise ArgumentError("run: the pool is at work; finish or close the other run first")
        self._running = True
        waiting: deque[Job] = deque()
        finished = False
        try:
            source = iter(tasks)
            for worker in self._workers:
                with self._lock:
                    worker.begin(None)
                worker.send("function", function)
            more = True
            outcomes: list[Outcome[Task]] = []
            while True:
                try:
                    more = self._fill(waiting, source, more)
                    self._check_open()
                    self._assign(waiting, function)
                except Exception:
                    yield from outcomes  # what is finished is not lost
                    raise
                yield from outcomes
                if not more and not waiting and not any(w.job for w in self._workers):
                    break
                outcomes = self._collect(waiting)
            finished = True
        finally:
            self._running = False
            # After the last task, only those that are ready for another run stay.
            self._stop_workers(only_unready=finished)

    def _check_open(self) -> None:
        if self._closing.is_set():
            raise ArgumentError("run: the pool is closed; make a new one")

    def _fill(self, waiting: deque[Job], source: Iterator[Any], more: bool) -> bool:
        """Take as many tasks as there are free places; return whether there may be more."""
        free = self._jobs - sum(worker.job is not None for worker in self._workers)
        while more and len(waiting) < free:
            try:
                task = next(source)
            except StopIteration:
                return False
            waiting.append(Job(task, None if self._owner is None else self._owner(task)))
        return more

    def _assign(self, waiting: deque[Job], function: Callable[[Any], Any]) -> None:
        idle = [worker for worker in self._workers if worker.phase == "idle"]
        # Those of an owner take his tasks first, so that the others stay nobody's.
        for worker in sorted(idle, key=lambda worker: worker.owner is None):
            job = next((job for job in waiting if worker.owner in (None, job.owner)), None)
            if job is not None:
                waiting.remove(job)
                with self._lock:
                    worker.begin(job)
                # Without the lock: a task that is large waits for the worker to read it.
                worker.send("task", job.task)
        starting = sum(worker.phase == "starting" for worker in self._workers)
        while starting < len(waiting):
            if len(self._workers) == self._jobs:
                # One that is idle still is another owner's.
                spare = next((w for w in self._workers if w.phase == "idle"), None)
                if spare is None:
                    break
                self._remove(spare)
            self._start(function)
            starting += 1

    def _start(self, function: Callable[[Any], Any]) -> None:
        worker = WorkerProcess(self._limits, function)
        with self._lock:
            self._workers.append(worker)
        if self._watcher is None:
            self._watcher = threading.Thread(target=self._watch, daemon=True)
            self._watcher.start()

    def _watch(self) -> None:
        while not self._closing.wait(WATCH_PERIOD):
            with self._lock:
                for worker in self._workers:
                    worker.watch()

    def _collect(self, waiting: deque[Job]) -> list[Outcome[Any]]:
        """Wait until something has happened; return the tasks that have come to an end."""
        signs: dict[Any, WorkerProcess] = {}
        for worker in self._workers:
            signs[worker.connection] = signs[worker.process.sentinel] = worker
        # With an end, so that Ctrl-C is seen on every system.
        ready = wait(list(signs), timeout=0.5)
        heard = {id(signs[sign]): signs[sign] for sign in ready}
        # One that has ended may have left both signs to a process that it has forked.
        heard |= {id(worker): worker for worker in self._workers if worker.ended()}
        ended = (self._hear(worker, waiting) for worker in heard.values())
        return [outcome for outcome in ended if outcome is not None]

    def _hear(self, worker: WorkerProcess, waiting: deque[Job]) -> Outcome[Any] | None:
        with self._lock:
            job, started, phase = worker.job, worker.since, worker.phase
            starting = phase == "starting"
            worker.phase, worker.since = "reading", time.monotonic()
        reply = worker.read()
        elapsed = time.monotonic() - started
        if reply is None:
            return self._bury(worker, waiting, starting, elapsed)
        if reply == "stale":
            if worker.ended():  # whoever writes here now may never stop
                return self._bury(worker, waiting, starting, elapsed)
            with self._lock:
                worker.phase, worker.since = phase, started
            if phase == "idle":
                self._remove(worker)
            return None
        with self._lock:
            fit = worker.rest() and reply.clean
        if starting:
            self._failed_starts = 0
            self._check_start(worker, reply.message)
        # What its function loaded may well have left threads: only tasks must not.
        if worker.verdict is not None or not (fit or starting):
            self._remove(worker)
        if job is None:
            return None
        return Outcome(job.task, reply.status, reply.value, reply.message, reply.seconds)

    def _check_start(self, worker: WorkerProcess, message: str) -> None:
        if message:
            raise ArgumentError(f"run: the function {message}; give one that workers can import")
        needed, limit = worker.rest_bytes, self._limits.memory_bytes
        if needed > limit:
            raise ArgumentError(
                f"memory_bytes = {limit} is less than a worker needs at rest ({needed}); "
                "give several times as much"
            )

    def _bury(
        self, worker: WorkerProcess, waiting: deque[Job], starting: bool, elapsed: float
    ) -> Outcome[Any] | None:
        """Take a dead worker out; return its task's outcome unless it is tried again."""
        with self._lock:
            self._workers.remove(worker)  # first: the watcher must not look at what is closed
        status, message, from_outside = worker.cause_of_death()
        if starting:
            self._failed_starts += 1
            if self._failed_starts >= _STARTS:
                raise RailenvError(
                    f"no worker process can be started ({message}); a script that runs a pool "
                    'must do so under `if __name__ == "__main__":`'
                )
        job = worker.job
        if job is None:
            return None
        if from_outside and job.attempts < _ATTEMPTS:
            waiting.appendleft(job)  # perhaps not its fault
            return None
        if from_outside:
            message += f" in each of {job.attempts} attempts; is the machine short of memory?"
        return Outcome(job.task, status, None, message, elapsed)

    def _remove(self, worker: WorkerProcess) -> None:
        with self._lock:
            self._workers.remove(worker)
        worker.end()

    def _stop_workers(self, only_unready: bool = False) -> None:
        with self._lock:
            stopped = [w for w in self._workers if not (only_unready and w.phase == "idle")]
            self._workers = [w for w in self._workers if w not in stopped]
            for worker in stopped:  # all at once, then wait
                worker.kill_group()
        for worker in stopped:
            worker.end()
