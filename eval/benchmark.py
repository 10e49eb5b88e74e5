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

from eval.benchmark_stability import StabilityWork, stability_answer
from eval.cells import CellWork, described, run_package
from eval.entries import Entry
from eval.packages import PASSIVE, REFERENCE, Package, packages_of
from eval.scenarios import Suite, commitment
from eval.store.cell import Cell
from eval.store.schema import MEASURES
from eval.store.settings import RunSettings
from eval.store.store import Store
from eval.workers import Limits, Outcome, Pool
from railenv.config import to_dict

GIVE_UP = 3
"""Packages of one controller in which it may hang or eat its memory before the rest is left out."""

_COSTLY = ("timeout", "memory")
"""Ends of a package that cost a limit's worth of time."""

Work = CellWork | StabilityWork


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
    tell = progress or (lambda _spec, _cells: None)
    todo = missing(benchmark, store)
    lost = _lost_before(store)
    for outcome in pool.run(run_work, _allowed(todo, lost)):
        if isinstance(outcome.task, StabilityWork):
            _note_stability(store, outcome.task, outcome)
            continue
        package = outcome.task.package
        if outcome.status in _COSTLY:
            lost.setdefault(package.controller, []).append(outcome.status)
        _note(store, package, outcome.status, outcome.message, outcome.value, outcome.seconds)
        tell(package.controller, len(package.scenarios))
    for work in missing(benchmark, store):
        # What was left out.
        if isinstance(work, CellWork):
            package = work.package
            words = f"left out after {GIVE_UP} packages that hung or took too much memory"
            # The same word as of the packages before it, so that how many workers were at it
            # when it was given up cannot be told from the rows.
            _note(store, package, lost[package.controller][0], words, None, 0.0)
            tell(package.controller, len(package.scenarios))
        else:
            store.add_stability(*work.place, {"error": "left out"})


def run_work(work: Work) -> Any:
    """Do one piece of work, in a worker."""
    return run_package(work) if isinstance(work, CellWork) else stability_answer(work)


def missing(benchmark: Benchmark, store: Store) -> list[Work]:
    """Return the work that is not in the records."""
    done = store.done()
    answered = {
        (row["controller"], row["layout"], row["vehicle"], row["speed_kmh"])
        for row in store.stability()
    }
    work: list[Work] = [
        CellWork(benchmark.suite, benchmark.salt, package)
        for package in benchmark.packages
        if (package.controller, package.name) not in done
    ]
    layouts = list(dict.fromkeys(s.layout for s in benchmark.suite.scenarios))
    for entry in benchmark.everyone():
        if entry.spec == REFERENCE:
            continue  # it runs without delay, and for the yardstick alone
        for layout in layouts if entry.layout is None else [entry.layout]:
            question = StabilityWork(entry.spec, layout)
            if question.place not in answered:
                work.append(question)
    return work


def _lost_before(store: Store) -> dict[str, list[str]]:
    """Return by controller how the packages ended that earlier sessions have lost to a limit."""
    found: dict[str, dict[object, str]] = {}
    for status in _COSTLY:
        for row in store.rows(status=status):
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
    if status != "done":
        rows = [{**described(s), "status": status} for s in package.scenarios]
    cells: list[Cell] = []
    for row in rows:
        place = {name: value for name, value in row.items() if name not in MEASURES}
        measures = {name: row[name] for name in MEASURES if name in row}
        cells.append(Cell(**place, measures=measures, message="" if status == "done" else message))
    store.add_package(package.controller, package.name, cells, seconds, failed=status != "done")


def _note_stability(store: Store, work: StabilityWork, outcome: Outcome[Any]) -> None:
    answer = outcome.value if outcome.status == "done" else {"error": outcome.message}
    store.add_stability(*work.place, answer)
