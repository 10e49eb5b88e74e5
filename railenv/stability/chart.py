"""Stability charts: the critical delay over any two parameters of a loop.

A chart asks `critical_delays` at every point of a grid and keeps what the points answer; it adds no
numerics of its own. What x and y are is decided by the function that builds the loop from them, so
this module knows nothing of vehicles or controllers. Points are independent of each other: the
chart does not depend on the number of worker processes.

No array of a chart holds NaN. A critical delay is 0 where the loop is not stable without delay,
+inf where no crossing was found up to the longest delay, and -inf where the point has no answer, so
that `delay < chart.critical_delay` is true only where stability at that delay was found.
"""

import json
import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from railenv.errors import ArgumentError, RailenvError, check_count, check_finite, check_positive
from railenv.files import replacing
from railenv.stability.critical_delay import critical_delays
from railenv.stability.delay_system import DelaySystem
from railenv.units import FloatArray

MakeSystem = Callable[[float, float], DelaySystem]
"""Builds the loop for one value of x and one of y."""

# A point that raises one of these has no answer and says why; anything else (a misspelt name, say)
# is a fault in the function itself and stops the chart.
_NO_ANSWER = (RailenvError, ValueError, ArithmeticError)


@dataclass(frozen=True, eq=False)
class StabilityChart:
    """Critical delays on a grid; arrays have shape (number of y, number of x), read-only.

    Attributes:
        x_name: What changes along a row.
        x_values: Its values, shape (number of x,).
        y_name: What changes along a column.
        y_values: Its values, shape (number of y,).
        max_delay: Longest delay searched [s].
        critical_delay: Delay at which stability is first lost [s]; 0 where not stable without
            delay, +inf where no crossing was found up to `max_delay`, -inf without an answer.
        frequency_hz: Frequency of the crossing at the critical delay [Hz]; 0 where there is none.
        stable_windows: Number of delay intervals up to `max_delay` in which the loop is stable; the
            first begins at delay zero unless the loop is unstable there.
        proved: Whether the point's answer is a proof, as `critical_delays` says; False without one.
        delay_independent: Where it is proved that no delay at all changes the loop's stability.
        failures: Why a point has no answer, by (row, column).
        unproved: Why the proof of a point's answer failed, by (row, column).
    """

    x_name: str
    x_values: FloatArray
    y_name: str
    y_values: FloatArray
    max_delay: float
    critical_delay: FloatArray
    frequency_hz: FloatArray
    stable_windows: NDArray[np.int64]
    proved: NDArray[np.bool_]
    delay_independent: NDArray[np.bool_]
    failures: dict[tuple[int, int], str]
    unproved: dict[tuple[int, int], str]

    @property
    def status(self) -> NDArray[np.str_]:
        """What each point is.

        "critical": stability is lost at the critical delay; "unstable": it is not stable without
        delay; "none": no crossing was found up to `max_delay`; "always": proved to be stable for
        any delay; "failed": no answer.
        """
        tau = self.critical_delay
        endless = np.where(self.delay_independent, "always", "none")
        words = np.where(tau == 0.0, "unstable", np.where(np.isinf(tau), endless, "critical"))
        return np.where(np.isneginf(tau), "failed", words)

    @property
    def stable_again(self) -> NDArray[np.bool_]:
        """Where delays beyond the critical one are stable again, up to `max_delay`."""
        return self.stable_windows > (self.critical_delay > 0.0)

    def save(self, path: Path, settings: dict[str, Any] | None = None) -> None:
        """Write the chart to a `.npz` file without pickled objects.

        Args:
            path: Target; an existing file is replaced as a whole or kept.
            settings: What was asked, plain values only; stored as JSON text.

        Raises:
            OutputError: The file cannot be written.
        """
        places = sorted(self.failures)
        with replacing(path) as stream:
            np.savez_compressed(
                stream,
                allow_pickle=False,
                x_name=np.array(self.x_name),
                x_values=self.x_values,
                y_name=np.array(self.y_name),
                y_values=self.y_values,
                max_delay=np.array(self.max_delay),
                critical_delay=self.critical_delay,
                frequency_hz=self.frequency_hz,
                stable_windows=self.stable_windows,
                proved=self.proved,
                delay_independent=self.delay_independent,
                status=self.status,
                failed_points=np.array(places, dtype=np.int64).reshape(-1, 2),
                failed_reasons=np.array([self.failures[place] for place in places], dtype=np.str_),
                settings=np.array(json.dumps(settings or {})),
            )


@dataclass(frozen=True)
class _Point:
    """One point's answer; the defaults are those of a point without one."""

    critical_delay: float = -np.inf
    frequency_hz: float = 0.0
    stable_windows: int = 0
    proved: bool = False
    delay_independent: bool = False
    failure: str | None = None
    unproved: str | None = None


def stability_chart(
    make_system: MakeSystem,
    x_name: str,
    x_values: Sequence[float] | FloatArray,
    y_name: str,
    y_values: Sequence[float] | FloatArray,
    max_delay: float = 2.0,
    jobs: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> StabilityChart:
    """Compute the critical delay over two parameters.

    Args:
        make_system: Builds the loop from one x and one y. With more than one job it must be
            picklable: a function of a module, a `functools.partial` of one, or an instance of a
            class with `__call__`.
        x_name: What x is.
        x_values: Values of x, rising or falling.
        y_name: What y is.
        y_values: Values of y, rising or falling.
        max_delay: Longest delay searched [s].
        jobs: Worker processes; the result does not depend on it.
        progress: Called after every point with the number of points done and of all points.

    Returns:
        The chart. A point whose loop cannot be built or answered (`make_system` or the oracle
        raises a `RailenvError`, `ValueError` or `ArithmeticError`) is recorded with its reason.

    Raises:
        ArgumentError: A list of values is empty, not finite or not monotonic, `max_delay` is not
            above zero, `jobs` is below 1, or `make_system` cannot be sent to a worker.
        RailenvError: A worker process died.
    """
    xs, ys = _axis("x_values", x_values), _axis("y_values", y_values)
    longest = check_positive("max_delay", max_delay, "seconds")
    workers = check_count("jobs", jobs)
    grid = [(row, column) for row in range(len(ys)) for column in range(len(xs))]
    tasks = [(float(xs[column]), float(ys[row])) for row, column in grid]
    points = [_Point()] * len(tasks)
    with closing(_points(make_system, tasks, longest, workers)) as answers:
        for done, (index, point) in enumerate(answers, start=1):
            points[index] = point
            if progress is not None:
                progress(done, len(tasks))
    shape = (len(ys), len(xs))
    arrays: tuple[NDArray[Any], ...] = (
        xs,
        ys,
        np.array([p.critical_delay for p in points]).reshape(shape),
        np.array([p.frequency_hz for p in points]).reshape(shape),
        np.array([p.stable_windows for p in points], dtype=np.int64).reshape(shape),
        np.array([p.proved for p in points], dtype=np.bool_).reshape(shape),
        np.array([p.delay_independent for p in points], dtype=np.bool_).reshape(shape),
    )
    for array in arrays:
        array.setflags(write=False)
    return StabilityChart(
        x_name,
        xs,
        y_name,
        ys,
        longest,
        *arrays[2:],
        failures={g: p.failure for g, p in zip(grid, points, strict=True) if p.failure},
        unproved={g: p.unproved for g, p in zip(grid, points, strict=True) if p.unproved},
    )


def _axis(name: str, values: Sequence[float] | FloatArray) -> FloatArray:
    """Return an axis of the grid as a new array."""
    axis: FloatArray = np.array([check_finite(name, value) for value in values], dtype=np.float64)
    steps = np.diff(axis)
    if len(axis) == 0 or not (np.all(steps > 0.0) or np.all(steps < 0.0)):
        raise ArgumentError(
            f"{name} has {len(axis)} values that neither rise nor fall throughout; "
            "give at least one value, sorted, none twice"
        )
    return axis


def _point(make_system: MakeSystem, x: float, y: float, max_delay: float) -> _Point:
    """Answer one point."""
    try:
        answer = critical_delays(make_system(x, y), max_delay)
    except _NO_ANSWER as error:
        return _Point(failure=str(error) or type(error).__name__)
    proved = bool(answer.proved)
    first, critical = answer.first, answer.critical_delay
    return _Point(
        np.inf if critical is None else critical,
        0.0 if first is None else first.frequency_hz,
        len(answer.stable_windows),
        proved,
        proved and answer.delay_independent,
        unproved=None if proved else answer.reason,
    )


def _points(
    make_system: MakeSystem, tasks: list[tuple[float, float]], max_delay: float, jobs: int
) -> Generator[tuple[int, _Point], None, None]:
    """Answer all points, in any order."""
    if jobs == 1 or len(tasks) == 1:
        for index, (x, y) in enumerate(tasks):
            yield index, _point(make_system, x, y, max_delay)
        return
    try:
        pickle.dumps(make_system)
    except Exception as error:
        raise ArgumentError(
            f"make_system cannot be sent to a worker process ({error}); give a function of a "
            "module, or jobs = 1"
        ) from None
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(
        max_workers=min(jobs, len(tasks)),
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_start_worker,
        initargs=(make_system, max_delay),
    )
    futures: dict[Future[_Point], int] = {}
    finished = False
    try:
        with _interruption_held_back():
            futures = {pool.submit(_work, *task): index for index, task in enumerate(tasks)}
        for future in as_completed(futures):
            yield futures[future], future.result()
        finished = True
    except BrokenProcessPool:
        raise RailenvError(
            "a worker process of the chart died; run with jobs = 1 to see where (a script that "
            'asks for several jobs must do so under `if __name__ == "__main__":`)'
        ) from None
    finally:
        if not finished:  # after an interruption nobody waits for the points being worked on
            for process in set(multiprocessing.active_children()) - others:
                process.terminate()
        pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _interruption_held_back() -> Generator[None, None, None]:
    """Hold Ctrl-C back while workers start: they inherit that, and the parent alone acts on it."""
    mask = getattr(signal, "pthread_sigmask", None)
    if mask is None:  # not on Windows
        yield
        return
    before = mask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        mask(signal.SIG_SETMASK, before)


_worker: list[tuple[MakeSystem, float]] = []
"""In a worker process: what its points are made of."""


def _start_worker(make_system: MakeSystem, max_delay: float) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _worker[:] = [(make_system, max_delay)]
    parent = multiprocessing.parent_process()
    if parent is not None:  # should it be killed, nobody is left to end the worker

        def follow() -> None:
            parent.join()
            os._exit(1)

        threading.Thread(target=follow, daemon=True).start()


def _work(x: float, y: float) -> _Point:
    make_system, max_delay = _worker[0]
    return _point(make_system, x, y, max_delay)
