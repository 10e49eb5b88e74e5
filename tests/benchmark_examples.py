"""Suites that take seconds, and runs of them, for the tests of the benchmark."""

from pathlib import Path
from typing import Any

from eval.benchmark import Benchmark, open_store, run_benchmark
from eval.cells import CellWork, run_package
from eval.entries import entries_of
from eval.packages import packages_of
from eval.scenarios import Suite
from eval.scenarios.suite import Block
from eval.store.reader import Reader
from eval.workers import InlinePool, Limits, Outcome, Pool

LIMITS = Limits(60.0, 2 * 2**30)
BROKEN = "py:broken_controllers:"

TEXT = """
name = "tiny"
version = "v0"
controllers = ["skyhook:gain=15e3"]
seconds = 5.0
skip = 1.0

[[blocks]]
name = "delay"
models = ["lateral17"]
vehicles = ["nominal"]
layouts = ["4"]
speeds_kmh = [300.0]
tracks = ["german_low"]
channels = ["constant", "jitter"]
delays_ms = [0.0, 100.0]
seeds = 2

[[blocks]]
name = "speed"
models = ["lateral17"]
vehicles = ["nominal"]
layouts = ["4"]
speeds_kmh = [250.0]
tracks = ["german_low"]
channels = ["constant"]
delays_ms = [100.0]
seeds = 1
"""
"""The suite `SUITE`."""


def block(**changes: Any) -> Block:
    """A block of one scenario: nominal vehicle, 300 km/h, 100 ms."""
    fields: dict[str, Any] = {
        "name": "only",
        "models": ("lateral17",),
        "vehicles": ("nominal",),
        "layouts": ("4",),
        "speeds_kmh": (300.0,),
        "tracks": ("german_low",),
        "channels": ("constant",),
        "delays_ms": (100.0,),
        "seeds": 1,
    }
    return Block(**{**fields, **changes})


def suite_of(*blocks: Block, **changes: Any) -> Suite:
    """A suite with the shortest run that there is."""
    fields: dict[str, Any] = {
        "name": "tiny",
        "version": "v0",
        "controllers": ("zero",),
        "blocks": blocks or (block(),),
        "seconds": 5.0,
        "full_seconds": 5.0,
        "skip": 1.0,
    }
    return Suite(**{**fields, **changes})


SUITE = suite_of(
    block(channels=("constant", "jitter"), delays_ms=(0.0, 100.0), seeds=2),
    block(name="speed", speeds_kmh=(250.0,)),
)
"""Nine scenarios at two places, so two packages per controller."""


def rows_of(suite: Suite, spec: str, salt: str = "") -> dict[str, dict[str, Any]]:
    """The rows of a controller by their keys, run in this process."""
    return {
        row["key"]: row
        for package in packages_of(suite, spec)
        for row in run_package(CellWork(suite, salt, package))
    }


def benchmark_of(
    *specs: str, suite: Suite = SUITE, limits: Limits = LIMITS, salt: str = ""
) -> Benchmark:
    return Benchmark(suite, tuple(entries_of(specs)), limits, salt)


def run(folder: Path, benchmark: Benchmark, pool: Pool | None = None, resume: bool = False) -> Path:
    """Run a benchmark into a folder, in this process if no pool is given; return the folder."""
    with open_store(benchmark, folder, resume=resume) as store:
        run_benchmark(benchmark, store, pool or InlinePool(), "railenv benchmark")
    return folder


def cells(folder: Path, **where: Any) -> list[dict[str, Any]]:
    """The recorded rows."""
    with Reader.open(folder) as reader:
        return list(reader.rows(**where))


def ended(folder: Path) -> dict[str, list[str]]:
    """How the cells of every controller ended."""
    found: dict[str, list[str]] = {}
    for row in cells(folder):
        found.setdefault(row["controller"], []).append(row["status"])
    return found


class Ends(InlinePool):
    """Does nothing: lets every task of one controller end in some way, and others in failure."""

    def __init__(self, spec: str, status: str, stop_at: int | None = None) -> None:
        self.spec, self.status, self.asked, self.stop_at = spec, status, 0, stop_at

    def run(self, function: Any, tasks: Any) -> Any:
        for task in tasks:
            spec = task.package.controller if isinstance(task, CellWork) else task.controller
            self.asked += spec == self.spec
            if self.asked == self.stop_at:
                raise KeyboardInterrupt
            status: Any = self.status if spec == self.spec else "failed"
            yield Outcome(task, status, None, "stopped", 1.0)


SHORT = suite_of(block(delays_ms=(0.0, 100.0), seeds=2))
"""One package of four scenarios per controller."""
