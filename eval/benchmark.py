"""Runs a suite: packages of cells over a pool of workers, into the records of a folder.

What is missing is run, what is there is kept. Whole packages are written at once; so a run that was
killed at any moment and is resumed has the rows of one that was not, bit for bit, on any number of
workers (`eval.packages`).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from eval.benchmark_motion import MotionWork, motion_answer
from eval.benchmark_stability import StabilityWork, stability_answer
from eval.cells import CellWork, described, run_package
from eval.entries import Entry
from eval.packages import PASSIVE, REFERENCE, Package, packages_of
from eval.scenarios import Suite, commitment
from eval.store.cell import Cell
from eval.store.schema import MEASURES
from eval.store.settings import RunSettings
from eval.store.store import Store
from eval.workers import Limits, Pool
from railenv.config import to_dict

GIVE_UP = 3
"""Packages that one controller may lose its worker in before the rest is left out."""

_COSTLY = ("timeout", "memory", "crashed")
"""Ends of a package that cost a limit's worth of time, or another worker's start."""

_YARDSTICKS = (PASSIVE, REFERENCE)
"""What is lost of these says nothing of a controller and spoils the scores of all: it is always
tried, and tried again."""

Work = CellWork | StabilityWork | MotionWork


@dataclass(frozen=True)
class Benchmark:
    """What is run.

    Attributes:
        suite: The suite.
        entries: Controllers that take part; passive and reference run besides.
        limits: What one package may use.
        salt: Private salt of the test tracks; "" for the public ones.
    """

    suite: Suite
    entries: tuple[Entry, ...]
    limits: Limits
    salt: str = ""

    def settings(self) -> RunSettings:
        """Return what the results depend on."""
        limits = {"seconds": self.limits.seconds, "memory_bytes": self.limits.memory_bytes}
        suite = self.suite
        return RunSettings(suite.name, suite.version, to_dict(suite), limits, commitment(self.salt))

    def everyone(self) -> list[Entry]:
        """Return all controllers, passive and reference first."""
        given = [entry for entry in self.entries if entry.spec != PASSIVE]
        return [Entry(PASSIVE, "untold", None), Entry(REFERENCE, "untold", None), *given]

    def planned(self) -> dict[str, dict[str, int]]:
        """Return the number of all runs by controller and layout."""
        found: dict[str, dict[str, int]] = {entry.spec: {} for entry in self.everyone()}
        for package in self.packages:
            layouts, layout = found[package.controller], package.scenarios[0].layout
            layouts[layout] = layouts.get(layout, 0) + len(package.scenarios)
        return found

    @cached_property
    def packages(self) -> list[Package]:
        """All packages; those of the nonlinear vehicle, which take longest, come first."""
        found = [
            package
            for entry in self.everyone()
            for package in packages_of(self.suite, entry.spec, entry.layout, entry.models)
        ]
        return sorted(found, key=lambda package: package.scenarios[0].model != "full50")


def open_store(benchmark: Benchmark, folder: Path, *, resume: bool) -> Store:
    """Open the records of a folder, new or to be resumed.

    Raises:
        ArgumentError: There are records and none is to be resumed, or other settings are in them.
        OutputError: The folder cannot be written.
    """
    settings = benchmark.settings()
    return Store.resume(folder, settings) if resume else Store.create(folder, settings)


def run_benchmark(
    benchmark: Benchmark,
    store: Store,
    pool: Pool,
    command: str,
    progress: Callable[[str, int], None] | None = None,
) -> None:
    """Run what is missing.

    Args:
        benchmark: What is run.
        store: Its records, open for writing.
        pool: Runs the packages.
        command: How the program was called, for the record.
        progress: Called with a controller and the number of its cells that are just done.

    Raises:
        ArgumentError: A controller is not the one that the records were begun with.
        OutputError: The records cannot be written.
    """
    store.begin_session(command)
    for entry in benchmark.everyone():
        store.add_controller(entry.spec, entry.division, entry.sha256)
    store.plan(benchmark.planned())
    tell = progress or (lambda _spec, _cells: None)
    todo = missing(benchmark, store)
    lost = _lost_before(store)
    for outcome in pool.run(run_work, _allowed(todo, lost)):
        if not isinstance(outcome.task, CellWork):
            answer = outcome.value if outcome.status == "done" else {"error": outcome.message}
            _note_answer(store, outcome.task, answer)
            continue
        package = outcome.task.package
        if outcome.status in _COSTLY and package.controller not in _YARDSTICKS:
            lost.setdefault(package.controller, []).append(outcome.status)
        _note(store, package, outcome.status, outcome.message, outcome.value, outcome.seconds)
        tell(package.controller, len(package.scenarios))
    for work in missing(benchmark, store):
        # What was left out.
        if isinstance(work, CellWork):
            package = work.package
            if package.controller in _YARDSTICKS:
                continue  # lost, not left out
            words = f"left out after {GIVE_UP} packages that hung, took too much memory or crashed"
            # The same word as of the packages before it, so that how many workers were at it
            # when it was given up cannot be told from the rows.
            _note(store, package, lost[package.controller][0], words, None, 0.0)
            tell(package.controller, len(package.scenarios))
        else:
            _note_answer(store, work, {"error": "left out"})


def run_work(work: Work) -> Any:
    """Do one piece of work, in a worker."""
    if isinstance(work, CellWork):
        return run_package(work)
    return stability_answer(work) if isinstance(work, StabilityWork) else motion_answer(work)


def missing(benchmark: Benchmark, store: Store) -> list[Work]:
    """Return the work that is not in the records, or has failed there of passive and reference."""
    done, whole = store.done(), store.done(with_failed=False)
    answered, shown = (
        {(row["controller"], row["layout"], row["vehicle"], row["speed_kmh"]) for row in rows}
        for rows in (store.stability(), store.motion())
    )
    work: list[Work] = [
        CellWork(benchmark.suite, benchmark.salt, package)
        for package in benchmark.packages
        if (package.controller, package.name)
        not in (whole if package.controller in _YARDSTICKS else done)
    ]
    layouts = list(dict.fromkeys(s.layout for s in benchmark.suite.scenarios))
    pictures: list[Work] = []
    for entry in benchmark.everyone():
        if entry.spec == REFERENCE:
            continue  # it runs without delay, and for the yardstick alone
        for layout in layouts if entry.layout is None else [entry.layout]:
            question = StabilityWork(entry.spec, layout)
            if question.place not in answered:
                work.append(question)
            picture = MotionWork(benchmark.suite, entry.spec, layout)
            if picture.place not in shown:
                pictures.append(picture)
    # Small pieces last: they fill the time in which the last long question is answered.
    return work + pictures


def _lost_before(store: Store) -> dict[str, list[str]]:
    """Return by controller how the packages ended that earlier sessions have lost to a limit."""
    found: dict[str, dict[object, str]] = {}
    for status in _COSTLY:
        for row in store.rows(status=status):
            if row["controller"] not in _YARDSTICKS:
                found.setdefault(str(row["controller"]), {})[row["package"]] = status
    return {spec: list(packages.values()) for spec, packages in found.items()}


def _allowed(todo: Sequence[Work], lost: dict[str, list[str]]) -> Iterator[Work]:
    """Yield the work of all controllers that have not been given up by then."""
    for work in todo:
        spec = work.package.controller if isinstance(work, CellWork) else work.controller
        if len(lost.get(spec, ())) < GIVE_UP:
            yield work


def _note(
    store: Store, package: Package, status: str, message: str, rows: Any, seconds: float
) -> None:
    """Write a package's rows; without numbers where its worker was lost."""
    if status == "done" and not _are_of(package, rows):
        status, message = "failed", "the worker gave rows that are not those of its package"
    whole = status == "done"
    cells: list[Cell] = []
    for number, scenario in enumerate(package.scenarios):
        row: dict[str, Any] = rows[number] if whole else {"status": status}
        measures = {name: row[name] for name in MEASURES if name in row}
        cells.append(
            Cell(
                **described(scenario),
                status=row["status"],
                measures=measures,
                message="" if whole else message,
                unstable=row.get("unstable"),
            )
        )
    store.add_package(package.controller, package.name, cells, seconds, failed=not whole)


def _are_of(package: Package, rows: Any) -> bool:
    """Whether a worker, which runs others' code too, has answered with the rows of a package."""
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        return False
    keys = [scenario.key for scenario in package.scenarios]
    known = ("ok", "diverged")
    return [row.get("key") for row in rows] == keys and all(
        row.get("status") in known for row in rows
    )


def _note_answer(store: Store, work: StabilityWork | MotionWork, answer: dict[str, Any]) -> None:
    if isinstance(work, StabilityWork):
        store.add_stability(*work.place, answer)
    else:
        store.add_motion(*work.place, answer)
