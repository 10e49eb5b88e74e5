"""What becomes of a task: its limits, its outcome, and the words for what went wrong.

A function is given one task and returns a value. What it raises never leaves the pool as an
exception: it is an outcome of that task.
"""

import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import PurePath
from types import TracebackType
from typing import Any, Generic, Literal, Protocol, Self, TypeVar

from railenv.errors import RailenvError, check_count, check_positive

Task = TypeVar("Task")
Status = Literal["done", "failed", "timeout", "memory", "crashed"]

_LONGEST_MESSAGE = 500
"""Characters of a message; what users' code raises may be of any length."""


@dataclass(frozen=True)
class Limits:
    """What one task may use.

    Attributes:
        seconds: Longest time of one task [s], without the start of its worker process.
        memory_bytes: Largest resident memory of a worker process [byte], the interpreter and its
            libraries included.
    """

    seconds: float = 120.0
    memory_bytes: int = 2 * 2**30

    def __post_init__(self) -> None:
        check_positive("seconds", self.seconds, "s")
        check_count("memory_bytes", self.memory_bytes)


@dataclass(frozen=True)
class Outcome(Generic[Task]):
    """What became of one task.

    Attributes:
        task: The task as it was given.
        status: "done"; "failed" (the function raised), "timeout", "memory" (above the limit, or
            the function ran out of memory by itself), "crashed" (the process died).
        value: What the function returned; None unless done.
        message: What went wrong, one line that is the same in every run; empty if done.
        seconds: Time from the task's start to its end [s].
    """

    task: Task
    status: Status
    value: Any
    message: str
    seconds: float


@dataclass(frozen=True)
class Reply:
    """A worker's answer to one message.

    Attributes:
        status: As in `Outcome`.
        value: What the function returned.
        message: What went wrong.
        seconds: Time that the function took [s].
        clean: Whether the worker is fit for another task.
    """

    status: Status
    value: Any = None
    message: str = ""
    seconds: float = 0.0
    clean: bool = True


class Pool(Protocol):
    """Runs a function over tasks."""

    def run(
        self, function: Callable[[Task], Any], tasks: Iterable[Task]
    ) -> Iterator[Outcome[Task]]:
        """Yield the outcome of each task, in order of completion."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...


class InlinePool:
    """Runs tasks one after another in this process, without limits: for tests and debuggers."""

    def run(
        self, function: Callable[[Task], Any], tasks: Iterable[Task]
    ) -> Iterator[Outcome[Task]]:
        """Yield the outcome of each task in the order given; see `LocalPool.run`."""
        for task in tasks:
            reply = attempt(function, task)
            yield Outcome(task, reply.status, reply.value, reply.message, reply.seconds)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        return None


def attempt(function: Callable[[Any], Any], task: object) -> Reply:
    """Call the function and answer with its value or with what it raised."""
    started = time.perf_counter()
    value: Any = None
    message = ""
    status: Status = "done"
    try:
        value = function(task)
    except RailenvError as error:
        status, message = "failed", one_line(_text(error))
    except MemoryError as error:
        status, message = "memory", last_line(error)
    except (Exception, SystemExit) as error:  # users' code may raise anything
        status, message = "failed", last_line(error)
    return Reply(status, value, message, time.perf_counter() - started)


def last_line(error: BaseException, with_place: bool = True) -> str:
    """Return the kind of an exception, the last line of its text, and where it was raised."""
    lines = [line for line in _text(error).splitlines() if line.strip()]
    said = f": {lines[-1].strip()}" if lines else ""
    frames = traceback.extract_tb(error.__traceback__)
    place = (
        f" ({PurePath(frames[-1].filename).name}, line {frames[-1].lineno})"
        if frames and with_place
        else ""
    )
    # The place is short and says most: a long text must not push it out.
    return one_line(f"{type(error).__name__}{said}"[: _LONGEST_MESSAGE - 100] + place)


def one_line(text: str) -> str:
    """Return a text as one printable line of bounded length."""
    text = " ".join(text.split())
    return "".join(c if c.isprintable() else "?" for c in text)[:_LONGEST_MESSAGE]


def _text(error: BaseException) -> str:
    try:
        return str(error)
    except Exception:  # a text that raises is users' code too
        return "(its text cannot be shown)"
