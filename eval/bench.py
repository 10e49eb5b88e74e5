"""How `railenv bench-speed` measures: entries that are timed, and steppers whose rate is taken.

An entry of a task answers a question once; the first entry of a task is ours and the others are
measured in its multiples. What an entry needs is prepared anew and not timed before every run, so
that nothing is remembered from the run before.

A stepper takes environment steps over and over; its rate is that of windows of `WINDOW` seconds.
"""

import itertools
import os
import statistics
import textwrap
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

START_UP = 1.0
"""A first run shorter than this [s] is thrown away: imports and caches are in it."""

LONG_ENOUGH = 10.0
"""An entry that has run for this long in all [s] is not repeated any more."""

WINDOW = 0.6
"""Time over which a rate is taken [s]."""

WARM_UP = 8
"""Calls of a stepper before its first window: compilation and first allocations are in them."""

WIDTH = 110
"""Most characters of a line of a table."""

Row = dict[str, Any]
Tell = Callable[[str], None]

Outcome = tuple[str, bool]
"""The answer in a few words, alike for all that find the same, and whether it is proved."""


@dataclass(frozen=True)
class Section:
    """What is measured together and shown in one table.

    Attributes:
        total: How many times `measure` says what comes next.
        measure: Takes the number of repetitions and whom to tell what comes next; returns rows.
        table: Returns the lines of these rows.
    """

    total: int
    measure: Callable[[int, Tell], list[Row]]
    table: Callable[[Sequence[Row]], list[str]]


@dataclass(frozen=True)
class Entry:
    """One thing to be timed.

    Attributes:
        task: The question.
        method: Who answers it, and how.
        prepare: Makes what `run` needs; called before every run and not timed.
        run: What is timed.
        note: What must be known to compare it.
    """

    task: str
    method: str
    prepare: Callable[[], Any]
    run: Callable[[Any], Outcome]
    note: str = ""


@dataclass(frozen=True)
class Stepper:
    """Something that takes environment steps.

    Attributes:
        step: Takes the number of the call, steps once, returns how many environment steps it took.
        close: Gives back what it holds.
    """

    step: Callable[[int], int]
    close: Callable[[], None] = lambda: None


def timed_section(entries: Sequence[Entry]) -> Section:
    """Return the section of entries that are timed."""
    return Section(len(entries), lambda repeat, tell: measure_section(entries, repeat, tell), table)


def measure(entry: Entry, repeat: int) -> Row:
    """Time an entry `repeat` times, or until that has taken `LONG_ENOUGH` seconds in all."""
    seconds, outcome = _timed(entry)
    times = [] if seconds < START_UP else [seconds]
    while len(times) < repeat and sum(times) < LONG_ENOUGH:
        seconds, outcome = _timed(entry)
        times.append(seconds)
    return {
        "task": entry.task,
        "method": entry.method,
        "best_s": min(times),
        "median_s": statistics.median(times),
        "runs": len(times),
        "answer": outcome[0],
        "proved": outcome[1],
        "note": entry.note,
    }


def _timed(entry: Entry) -> tuple[float, Outcome]:
    given = entry.prepare()
    start = time.perf_counter()
    outcome = entry.run(given)
    return time.perf_counter() - start, outcome


def measure_section(
    entries: Sequence[Entry], repeat: int, progress: Tell = lambda _: None
) -> list[Row]:
    """Measure entries; `ratio` is the best time over that of the task's first entry."""
    rows: list[Row] = []
    for entry in entries:
        progress(f"{entry.task}: {entry.method}")
        row = measure(entry, repeat)
        base = next((r["best_s"] for r in rows if r["task"] == entry.task), row["best_s"])
        rows.append({**row, "ratio": row["best_s"] / base})
    return rows


def table(rows: Sequence[Row]) -> list[str]:
    """Return the lines of a table of times."""
    lines = [f"{'':32}best      median   runs   times ours   proved   answer"]
    for task, group in itertools.groupby(rows, lambda r: r["task"]):
        lines.append(f"  {task}")
        for row in group:
            lines.append(
                f"    {row['method']:<24}{_time(row['best_s'])}{_time(row['median_s'])}"
                f"{row['runs']:>5}{row['ratio']:>13.3g}{'yes' if row['proved'] else 'no':>9}   "
                f"{row['answer']}"
            )
            lines += [f"      ({row['note']})"] if row["note"] else []
    return lines


def _time(seconds: float) -> str:
    return f"{1000 * seconds:9.3g} ms" if seconds < 1.0 else f"{seconds:10.3g} s"


def rates(stepper: Stepper, windows: int, seconds: float | None = None) -> list[float]:
    """Return the steps per second of windows of `seconds` (`WINDOW`), after a warm-up."""
    length = WINDOW if seconds is None else seconds
    found: list[float] = []
    calls = itertools.count()
    for call in itertools.islice(calls, WARM_UP):
        stepper.step(call)
    for _ in range(windows):
        taken, start = 0, time.perf_counter()
        while (passed := time.perf_counter() - start) < length:
            taken += stepper.step(next(calls))
        found.append(taken / passed)
    return found


@contextmanager
def closing(stepper: Stepper) -> Iterator[Stepper]:
    """Close a stepper at the end."""
    try:
        yield stepper
    finally:
        stepper.close()


def rate_row(
    task: str, method: str, lanes: int, threads: int, found: Sequence[float], note: str = ""
) -> Row:
    """Return the row of measured rates [steps/s]."""
    return {
        "task": task,
        "method": method,
        "lanes": lanes,
        "threads": threads,
        "median_per_s": statistics.median(found),
        "lowest_per_s": min(found),
        "highest_per_s": max(found),
        "windows": len(found),
        "reference": "",
        "ours_over_this": None,
        "note": note,
    }


def missing_row(task: str, method: str, why: str) -> Row:
    """Return the row of something that cannot be measured here."""
    return {"task": task, "method": method, "missing": why, "note": ""}


def compare(row: Row, reference: Row) -> None:
    """Write how many times the rate of `row` the rate of `reference` is."""
    row["reference"] = f"{reference['method']}, {reference['lanes']} x {reference['threads']}"
    row["ours_over_this"] = reference["median_per_s"] / row["median_per_s"]


def numeric_threads() -> dict[str, str]:
    """Return the thread counts set for the numeric libraries."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    return {name: os.environ.get(name, "not set") for name in names}


def rate_table(rows: Sequence[Row]) -> list[str]:
    """Return the lines of a table of rates; a row without one shows its own text."""
    windows = max((row["windows"] for row in rows if "windows" in row), default=0)
    lines = [
        f"{os.cpu_count()} cores; medians of {windows} windows of {WINDOW:g} s",
        "threads of numeric libraries: "
        + ", ".join(f"{name}={value}" for name, value in numeric_threads().items()),
        f"{'environment steps per second':<44}{'lanes':>6}{'threads':>8}"
        f"{'median':>12}{'lowest':>12}{'highest':>12}{'ours/this':>11}",
    ]
    for task, group in itertools.groupby(rows, lambda r: r["task"]):
        lines.append(f"  {task}")
        for row in group:
            lines.append(_rate_line(row))
            if row["note"]:
                lines += textwrap.wrap(
                    f"({row['note']})", WIDTH, initial_indent=" " * 6, subsequent_indent=" " * 7
                )
    return lines


def _rate_line(row: Row) -> str:
    if "median_per_s" not in row:
        return f"    {row['method']:<40}{row.get('missing') or row['shown']}"
    ratio = row["ours_over_this"]
    shown = "" if ratio is None else f"{ratio:.3g}"
    return (
        f"    {row['method']:<40}{row['lanes']:>6}{row['threads']:>8}{row['median_per_s']:>12,.0f}"
        f"{row['lowest_per_s']:>12,.0f}{row['highest_per_s']:>12,.0f}{shown:>11}"
    )
