"""One cell of a benchmark alone, without records."""

from typing import Any

from eval.benchmark import Benchmark, run_work
from eval.cells import CellWork, described
from eval.packages import PASSIVE, REFERENCE, packages_of, references_of
from eval.scenarios import MODELS, Scenario
from eval.workers import Pool
from railenv.errors import ArgumentError


def rows_of_cell(key: str, benchmark: Benchmark, pool: Pool) -> list[dict[str, Any]]:
    """Run the package that holds a cell, of every controller.

    Args:
        key: The cell's key.
        benchmark: Whose suite and controllers.
        pool: Runs the packages.

    Returns:
        The cell's rows, in the order of the controllers; without numbers where a run was lost.

    Raises:
        ArgumentError: The suite has no such cell, or nobody runs it.
    """
    wanted = Scenario.of(key)
    found = [
        package
        for entry in benchmark.everyone()
        for package in packages_of(benchmark.suite, entry.spec, entry.layout, entry.models)
        if wanted in package.scenarios
    ]
    if not found:
        suite = benchmark.suite
        if wanted in (*suite.scenarios, *references_of(suite)):
            raise ArgumentError(
                f"cell {key!r} is in suite {suite.name!r}, and no controller given here runs it "
                f"({_names(benchmark)}); give one that does with --controller"
            )
        raise ArgumentError(
            f"cell {key!r} is not in suite {suite.name!r}; its keys are in the "
            "column key of --export"
        )
    work = [CellWork(benchmark.suite, benchmark.salt, package) for package in found]
    made: dict[str, dict[str, Any]] = {}
    for outcome in pool.run(run_work, work):
        spec = outcome.task.package.controller
        own = {**described(wanted), "status": outcome.status, "message": outcome.message}
        for row in outcome.value or ():
            if row["key"] == wanted.key:
                own = row
        made[spec] = {"controller": spec, **own}
    return [made[package.controller] for package in found]


def _names(benchmark: Benchmark) -> str:
    """Return who runs, and why that may not be everywhere."""
    own = [
        f"{entry.spec}: layout {entry.layout or 'any'}, {', '.join(entry.models or MODELS)}"
        for entry in benchmark.entries
        if entry.spec != PASSIVE
    ]
    return "; ".join([f"{PASSIVE}, {REFERENCE}: without delay alone", *own])
