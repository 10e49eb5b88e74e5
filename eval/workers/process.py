"""One worker process seen from the pool: what it is at, how it is watched, how it ends."""

import multiprocessing
import os
import pickle
import signal
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, Literal

import psutil

from eval.workers.outcome import Limits, Reply, Status, last_line
from eval.workers.worker import START_SECONDS, THREAD_NAMES, serve
from railenv.errors import ArgumentError

_OUTSIDE = tuple(
    -number for name in ("SIGKILL", "SIGTERM") if (number := getattr(signal, name, None))
)
"""Exit codes of a process that was ended from outside."""

_END_SECONDS = 10.0
"""Longest wait for a killed process to be gone [s]."""


@dataclass
class Job:
    """A task on its way through the pool.

    Attributes:
        task: As given.
        attempts: How often it was begun.
    """

    task: Any
    attempts: int = 0


class WorkerProcess:
    """A worker process with a connection of its own.

    Nothing is shared between workers, neither a pipe nor a lock: one that dies at any moment, also
    in the middle of an answer, disturbs no other.

    Attributes:
        phase: "starting" until the function is loaded, "idle", "running" a task, or "reading" an
            answer into this process.
        job: What it runs.
        since: When the phase began, as `time.monotonic` counts [s].
        verdict: Why the pool killed it, if it did: status and message.
    """

    def __init__(self, limits: Limits, function: Callable[[Any], Any]) -> None:
        context = multiprocessing.get_context("spawn")
        self.limits = limits
        self.phase: Literal["starting", "idle", "running", "reading"] = "starting"
        self.job: Job | None = None
        self.verdict: tuple[Status, str] | None = None
        self.since = time.monotonic()
        self._rest_bytes = 0
        self.connection, far_end = context.Pipe()
        self.process = context.Process(
            target=serve, args=(far_end, limits.seconds), name="railenv-worker", daemon=True
        )
        try:
            with _worker_environment():
                self.process.start()
            self.observed = psutil.Process(self.process.pid)
            self.send("function", function)
        except BaseException:
            self.end()
            raise
        finally:
            far_end.close()

    def begin(self, job: Job | None) -> None:
        """Note that a task, or without one the start, begins now; `send` comes after."""
        if job is not None:
            job.attempts += 1
        self.phase = "running" if job is not None else "starting"
        self.job, self.since = job, time.monotonic()

    def send(self, kind: Literal["function", "task"], content: object) -> None:
        """Send a function to load or a task to run.

        Raises:
            ArgumentError: The content cannot be pickled.
        """
        try:
            message = pickle.dumps((kind, content))
        except Exception as error:  # pickling calls users' code
            raise ArgumentError(
                f"run: the {kind} cannot be sent to a worker process ({last_line(error, False)}); "
                "give what can be pickled, such as a function of a module"
            ) from None
        with suppress(OSError):  # it just died: the pool will see that, and say of what
            self.connection.send_bytes(message)

    def read(self) -> Reply | None:
        """Return the answer that is there, or None if the process died without one."""
        try:
            if not self.connection.poll():
                return None
            message = self.connection.recv_bytes()
        except (EOFError, OSError):
            return None
        try:
            return pickle.loads(message)  # noqa: S301 - written by our own worker
        except Exception as error:  # unpickling calls users' code
            return Reply("failed", message=f"the value cannot be read: {last_line(error)}")

    def memory(self) -> int:
        """Return the resident memory [byte]; zero of a process that is dead."""
        try:
            return int(self.observed.memory_info().rss)
        except psutil.Error:
            return 0

    def rest(self, first: bool) -> bool:
        """Become idle; return whether it is fit for another task.

        What a task leaves in memory must not count against later ones.

        Args:
            first: Whether nothing has run yet, so that the memory is what a worker needs at rest.
        """
        self.phase, self.job = "idle", None
        memory = self.memory()
        if first:
            self._rest_bytes = memory
        return memory - self._rest_bytes <= 0.5 * self.limits.memory_bytes

    def watch(self) -> None:
        """Kill the process if it is beyond a limit, and say why."""
        if self.verdict is not None or self.phase == "idle":
            return
        elapsed = time.monotonic() - self.since
        memory = self.memory()
        if memory == 0:
            # Dead, yet what it has forked may hold the connection open.
            self.kill_group()
        elif self.phase != "starting" and memory > self.limits.memory_bytes:
            limit = self.limits.memory_bytes / 2**20
            self._condemn("memory", f"stopped above the memory limit of {limit:g} MiB")
        elif self.phase == "starting" and elapsed > START_SECONDS:
            self._condemn("timeout", f"not ready after {START_SECONDS:g} s")
        elif self.phase == "reading" and elapsed > self.limits.seconds:
            self._condemn("timeout", "stopped in the middle of its answer")
        elif (
            self.phase == "running"
            and elapsed > self.limits.seconds
            # An answer that waits to be read was given in time.
            and not self.connection.poll()
        ):
            self._condemn("timeout", f"stopped after the time limit of {self.limits.seconds:g} s")

    def _condemn(self, status: Status, message: str) -> None:
        self.verdict = status, message
        self.kill_group()

    def kill_group(self) -> None:
        """Kill the process and what it has started, without waiting."""
        pid = self.process.pid
        if pid is not None and hasattr(os, "killpg"):
            with suppress(ProcessLookupError, PermissionError):  # no session of its own yet
                os.killpg(pid, signal.SIGKILL)
        with suppress(AttributeError):  # it was never started
            self.process.kill()

    def end(self) -> None:
        """Kill the process and wait until it is gone."""
        self.kill_group()
        if self.process.pid is not None:
            self.process.join(_END_SECONDS)
        self.connection.close()

    def cause_of_death(self) -> tuple[Status, str, bool]:
        """Wait for the end of a process that has stopped answering.

        Returns:
            Status, message, and whether it was killed by somebody else than the pool.
        """
        self.process.join(1.0)
        code = self.process.exitcode
        self.end()
        if self.verdict is not None:
            return *self.verdict, False
        if code is None:
            return "crashed", "the worker process closed its connection", False
        if code in _OUTSIDE:
            name = signal.Signals(-code).name
            return "crashed", f"the worker process was killed from outside ({name})", True
        if code < 0:
            try:
                name = signal.Signals(-code).name
            except ValueError:
                name = f"signal {-code}"
            return "crashed", f"the worker process died of {name}", False
        return "crashed", f"the worker process ended itself with exit code {code}", False


@contextmanager
def _worker_environment() -> Generator[None, None, None]:
    """Give a new process one numeric thread, and hold Ctrl-C back while it starts."""
    before = {name: os.environ.get(name) for name in THREAD_NAMES}
    mask = getattr(signal, "pthread_sigmask", None)
    held = mask(signal.SIG_BLOCK, {signal.SIGINT}) if mask is not None else None
    os.environ.update(dict.fromkeys(THREAD_NAMES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
        if mask is not None:
            mask(signal.SIG_SETMASK, held)
