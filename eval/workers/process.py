"""One worker process seen from the pool: what it is at, how it is watched, how it ends.

Whether a worker has ended is asked of the system: what it has forked holds its connection and its
sentinel open for as long as it likes. A child that left the worker's group (`setsid`) is killed
where its line of parents up to the worker is alive when the worker is killed; one whose worker has
ended before cannot be found any more, and lives on without being waited for.
"""

import multiprocessing
import os
import pickle
import signal
import socket
import time
from collections.abc import Callable, Generator, Hashable
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, Literal

import psutil

from eval.workers.outcome import Limits, Reply, Status, last_line
from eval.workers.worker import NUMBER_BYTES, START_SECONDS, THREAD_NAMES, serve
from railenv.errors import ArgumentError

_OUTSIDE = tuple(
    -number for name in ("SIGKILL", "SIGTERM") if (number := getattr(signal, name, None))
)
"""Exit codes of a process that was ended from outside."""

_END_SECONDS = 10.0
"""Longest wait for a killed process to be gone [s]."""

_LAST_WORDS = 1.0
"""Longest time that an ended process's connection is read or written on [s]."""

_LOOK = 0.002
"""Time between two looks at a process that is about to end [s]."""


def packed(kind: str, content: object) -> bytes:
    """Return a function or a task as it is sent to a worker.

    Args:
        kind: Names it in the message.
        content: What is sent.

    Raises:
        ArgumentError: The content cannot be pickled.
    """
    try:
        return pickle.dumps(content)
    except Exception as error:  # pickling calls users' code
        raise ArgumentError(
            f"run: the {kind} cannot be sent to a worker process ({last_line(error, False)}); "
            "give what can be pickled, such as a function of a module"
        ) from None


def opened(message: bytes | memoryview) -> Reply:
    """Return a worker's answer; of a value that cannot be read, that its task has failed."""
    try:
        return pickle.loads(message)  # noqa: S301 - written by our own worker
    except Exception as error:  # unpickling calls users' code
        return Reply("failed", message=f"the value cannot be read: {last_line(error)}")


@dataclass(eq=False)
class Job:
    """A task on its way through the pool.

    Attributes:
        task: As given.
        owner: Whose own code it runs; None if nobody's.
        attempts: How often it was begun.
    """

    task: Any
    owner: Hashable | None = None
    attempts: int = 0


class WorkerProcess:
    """A worker process with a connection of its own.

    Nothing is shared between workers, neither a pipe nor a lock: one that dies at any moment, also
    in the middle of an answer, disturbs no other.

    Attributes:
        phase: "starting" until the function is loaded, "idle", "running" a task, or "reading" an
            answer into this process.
        job: What it runs.
        owner: Whose own code it has run; it may have changed what others would find here.
        since: When the phase began, as `time.monotonic` counts [s].
        verdict: Why the pool killed it, if it did: status and message.
        rest_bytes: Resident memory before its first task [byte]; zero until then.
        stale: Whether it has answered what it was not asked.
    """

    def __init__(self, limits: Limits, function: Callable[[Any], Any]) -> None:
        context = multiprocessing.get_context("spawn")
        self.limits = limits
        self.phase: Literal["starting", "idle", "running", "reading"] = "starting"
        self.job: Job | None = None
        self.owner: Hashable | None = None
        self.verdict: tuple[Status, str] | None = None
        self.since = time.monotonic()
        self.rest_bytes = 0
        self.stale = False
        self._sent = 0
        self._cleared = False
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
            self.owner = self.owner if job.owner is None else job.owner
        self.phase = "running" if job is not None else "starting"
        self.job, self.since = job, time.monotonic()

    def send(self, kind: Literal["function", "task"], content: object) -> None:
        """Send a function to load or a task to run.

        Raises:
            ArgumentError: The content cannot be pickled.
        """
        content_bytes = packed(kind, (kind, content))
        self._sent += 1
        message = self._sent.to_bytes(NUMBER_BYTES, "big") + content_bytes
        with suppress(OSError):  # it just died: the pool will see that, and say of what
            self.connection.send_bytes(message)

    def read(self) -> Reply | Literal["stale"] | None:
        """Return the answer that is there.

        Returns:
            The answer; "stale" for one to another message than the last, which a task that has
            written on the connection by itself may leave; None if the process died without one.
        """
        try:
            if not self.connection.poll():
                return None
            message = self.connection.recv_bytes()
        except (EOFError, OSError):
            return None
        if int.from_bytes(message[:NUMBER_BYTES], "big") != self._sent:
            self.stale = True
            return "stale"
        return opened(memoryview(message)[NUMBER_BYTES:])

    def ended(self) -> bool:
        """Whether the process has ended, whoever holds its pipes."""
        return self.process.exitcode is not None

    def memory(self) -> int:
        """Return the resident memory [byte]; zero of a process that is dead."""
        try:
            return int(self.observed.memory_info().rss)
        except psutil.Error:
            return 0

    def rest(self) -> bool:
        """Become idle; return whether it is fit for another task.

        What a task leaves in memory must not count against later ones, also of a later run.
        """
        self.phase, self.job = "idle", None
        memory = self.memory()
        self.rest_bytes = self.rest_bytes or memory
        return memory - self.rest_bytes <= 0.5 * self.limits.memory_bytes and not self.stale

    def watch(self) -> None:
        """Kill the process if it is beyond a limit, and say why."""
        if self.phase == "idle":
            return
        elapsed = time.monotonic() - self.since
        if self.ended():
            # What it has forked may hold the connection open.
            self.kill_group()
            if elapsed > _LAST_WORDS:
                self._hang_up()
            return
        if self.verdict is not None:
            return
        memory = self.memory()
        if self.phase != "starting" and memory > self.limits.memory_bytes:
            limit = self.limits.memory_bytes / 2**20
            self._condemn("memory", f"stopped above the memory limit of {limit:g} MiB")
        elif self.phase == "starting" and elapsed > START_SECONDS:
            self._condemn("timeout", f"not ready after {START_SECONDS:g} s")
        elif self.phase == "reading" and elapsed > self.limits.seconds:
            self._condemn("timeout", "stopped in the middle of its answer")
        elif (
            self.phase == "running"
            and elapsed > self.limits.seconds
            # An answer that waits to be read was given in time, if it is one.
            and (self.stale or not self.connection.poll())
        ):
            self._condemn("timeout", f"stopped after the time limit of {self.limits.seconds:g} s")

    def _condemn(self, status: Status, message: str) -> None:
        self.verdict = status, message
        self.kill_group()

    def kill_group(self) -> None:
        """Kill the process and what it has started, without waiting."""
        if self._cleared:
            return  # its number may be another process's by now
        self._cleared = self.ended()
        pid, strays = self.process.pid, self._children()
        if pid is not None and hasattr(os, "killpg"):
            with suppress(ProcessLookupError, PermissionError):  # no session of its own yet
                os.killpg(pid, signal.SIGKILL)
        with suppress(AttributeError):  # it was never started
            self.process.kill()
        for stray in strays:  # those of them that have left its group
            with suppress(psutil.Error):
                stray.kill()

    def _children(self) -> list[psutil.Process]:
        """Return what the process has started, as far as its line of parents is alive."""
        try:
            return self.observed.children(recursive=True)
        except (AttributeError, psutil.Error):  # it was never started, or has ended
            return []

    def _hang_up(self) -> None:
        """End a read or a write of this process that waits for nobody."""
        with suppress(OSError), socket.socket(fileno=os.dup(self.connection.fileno())) as line:
            line.shutdown(socket.SHUT_RDWR)

    def end(self) -> None:
        """Kill the process and wait until it is gone."""
        self.kill_group()
        if self.process.pid is not None:
            self._await_end(_END_SECONDS)
        self.connection.close()

    def _await_end(self, seconds: float) -> None:
        # Not by `join`, which waits for the sentinel and then without an end.
        until = time.monotonic() + seconds
        while not self.ended() and time.monotonic() < until:
            time.sleep(_LOOK)

    def cause_of_death(self) -> tuple[Status, str, bool]:
        """Wait for the end of a process that has stopped answering.

        Returns:
            Status, message, and whether it was killed by somebody else than the pool.
        """
        self._await_end(_LAST_WORDS)
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
            known = {int(number) for number in signal.Signals}
            name = signal.Signals(-code).name if -code in known else f"signal {-code}"
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
