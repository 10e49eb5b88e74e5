"""`railenv benchmark` and `railenv report`."""

import argparse
import os
import shlex
import sys
from pathlib import Path
from typing import Any

from eval.arguments import parse_number, parse_output, parse_whole, print_json, progress_bar
from eval.benchmark import Benchmark, open_store, run_benchmark, run_work
from eval.cells import CellWork, described
from eval.check_controller import CheckWork, Finding, check_work
from eval.entries import entries_of
from eval.packages import packages_of
from eval.report import missing_for_report, write_report
from eval.scenarios import Scenario, load_suite
from eval.scoring.board import boards_of, plain_board
from eval.scoring.board_text import boards_text
from eval.store.export import ENDINGS, check_export, export
from eval.store.reader import Reader
from eval.workers import Limits, LocalPool
from railenv.errors import ArgumentError, RailenvError, check_count, check_positive

_GIB = 2**30


def command_benchmark(options: argparse.Namespace) -> None:
    """Run a suite, print its leaderboards and write its records."""
    suite = load_suite(options.suite)
    limits = Limits(
        check_positive("seconds", parse_number("seconds", options.seconds), "s"),
        int(_GIB * check_positive("memory", parse_number("memory", options.memory), "GiB")),
    )
    jobs = os.cpu_count() or 1
    if options.jobs is not None:
        jobs = check_count("jobs", parse_whole("jobs", options.jobs))
    if options.check is not None:
        _check(options, CheckWork(suite, options.check), limits)
        return
    exported = parse_output(options.export, ENDINGS)
    if exported is not None:
        check_export(exported)
    with LocalPool(1, limits) as pool:
        entries = entries_of(options.controller or suite.controllers, pool)
    benchmark = Benchmark(suite, tuple(entries), limits, options.private_salt)
    if options.cell is not None:
        _one_cell(options, benchmark, jobs)
        return
    folder = Path(options.out or Path("runs") / suite.name)
    with open_store(benchmark, folder, resume=options.resume) as store:
        done = store.done()
        packages = benchmark.packages
        total = sum(len(p.scenarios) for p in packages)
        there = sum(len(p.scenarios) for p in packages if (p.controller, p.name) in done)
        with progress_bar(options, total, "cell") as bar:
            bar.update(there)

            def tell(spec: str, cells: int) -> None:
                bar.set_postfix_str(spec, refresh=False)
                bar.update(cells)

            with LocalPool(jobs, limits) as pool:
                run_benchmark(benchmark, store, pool, _called(benchmark.salt), tell)
    _show(options, folder)


def _called(salt: str) -> str:
    """Return how the program was called, for the records; they hold no private salt."""
    words = [word.replace(salt, "SALT") if salt else word for word in sys.argv[1:]]
    return shlex.join(["railenv", *words])


def command_report(options: argparse.Namespace) -> None:
    """Write the page of a folder's records and print their leaderboards."""
    _show(options, Path(options.folder), need_page=True)


def _show(options: argparse.Namespace, folder: Path, *, need_page: bool = False) -> None:
    with Reader.open(folder) as reader:
        boards = boards_of(reader)
        path = reader.path
        # A run is not lost for want of the package that writes the page.
        page = None
        if need_page or missing_for_report() is None:
            page = write_report(reader, boards)
    if getattr(options, "export", None):
        export(folder, Path(options.export))
    if options.json:
        plain = [plain_board(board) for board in boards]
        shown = None if page is None else str(page)
        print_json({"records": str(path), "page": shown, "boards": plain})
        return
    print(boards_text(boards))
    print(f"records: {path}")
    needs = 'pip install "railenv[report]", then railenv report'
    print(f"page:    {page or f'not written, {missing_for_report()} is not installed; {needs}'}")


def _one_cell(options: argparse.Namespace, benchmark: Benchmark, jobs: int) -> None:
    """Run the package that holds a cell, of every controller, and show the cell."""
    wanted = Scenario.of(options.cell)
    found = [
        package
        for entry in benchmark.everyone()
        for package in packages_of(benchmark.suite, entry.spec, entry.layout, entry.models)
        if wanted in package.scenarios
    ]
    if not found:
        raise ArgumentError(
            f"cell {options.cell!r} is not in suite {benchmark.suite.name!r}; its keys are in the "
            "column key of --export"
        )
    work = [CellWork(benchmark.suite, benchmark.salt, package) for package in found]
    made: dict[str, dict[str, Any]] = {}
    with LocalPool(min(jobs, len(work)), benchmark.limits) as pool:
        for outcome in pool.run(run_work, work):
            spec = outcome.task.package.controller
            own = {**described(wanted), "status": outcome.status, "message": outcome.message}
            for row in outcome.value or ():
                if row["key"] == wanted.key:
                    own = row
            made[spec] = {"controller": spec, **own}
    rows = [made[package.controller] for package in found]
    if options.json:
        print_json({"cells": rows})
        return
    for row in rows:
        print(*(f"{name:28} {value}" for name, value in row.items()), sep="\n", end="\n\n")


def _check(options: argparse.Namespace, work: CheckWork, limits: Limits) -> None:
    """Say what is wrong with a controller; exit status 1 if something is."""
    with LocalPool(1, limits) as pool:
        (outcome,) = pool.run(check_work, [work])
    findings: list[Finding] = outcome.value or [Finding(outcome.status, False, outcome.message)]
    if options.json:
        plain = [{"name": f.name, "good": f.good, "words": f.words} for f in findings]
        print_json({"controller": options.check, "findings": plain})
    else:
        for finding in findings:
            mark = {True: "ok", False: "PROBLEM", None: ""}[finding.good]
            print(f"{mark:8} {finding.name}: {finding.words}")
    if any(finding.good is False for finding in findings):
        raise RailenvError(f"{options.check} is not fit for the benchmark, see above")
