"""`railenv benchmark` and `railenv report`."""

import argparse
import os
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from eval.arguments import parse_number, parse_output, parse_whole, print_json, progress_bar
from eval.benchmark import Benchmark, Work, missing, open_store, run_benchmark
from eval.benchmark_cell import rows_of_cell
from eval.cells import CellWork
from eval.check_controller import CheckWork, Finding, check_work
from eval.entries import entries_of
from eval.report import missing_for_report, write_report
from eval.scenarios import load_suite
from eval.scoring.board import Board, boards_of, plain_board
from eval.scoring.board_text import boards_text
from eval.store.export import ENDINGS, check_export, export
from eval.store.reader import Reader
from eval.store.store import Store
from eval.workers import Limits, LocalPool, Pool, RayPool
from railenv.errors import (
    ArgumentError,
    InputFileError,
    OutputError,
    RailenvError,
    check_count,
    check_positive,
)

_GIB = 2**30
_MOST_MEMORY = 2.0**34
"""Most memory that any address can name, 2^64 bytes [GiB]."""

_RECORDED = ("out", "resume", "export")
_RUN = ("controller", "jobs", "ray", "private_salt", "cell", *_RECORDED)
_IGNORED = {
    "template": (
        "writes a file and nothing else",
        ("suite", "seconds", "memory", "check", *_RUN),
    ),
    "check": ("looks at one controller and runs nothing else", _RUN),
    "cell": ("shows cells and writes no records", _RECORDED),
}
"""Options that decide what is done, and those that would say nothing beside them."""


def command_benchmark(options: argparse.Namespace) -> None:
    """Run a suite, print its leaderboards and write its records."""
    _refuse_ignored(options)
    if options.template is not None:
        _template(options)
        return
    suite = load_suite(str(options.suite))
    limits = _limits(options)
    if options.check is not None:
        _check(options, CheckWork(suite, options.check), limits)
        return
    jobs = None
    if options.jobs is not None:
        jobs = check_count("jobs", parse_whole("jobs", options.jobs))
    exported = parse_output(options.export, ENDINGS)
    if exported is not None:
        check_export(exported)
    salt = _salt(options.private_salt)
    with LocalPool(1, limits, _owner_of_spec) as pool:
        entries = entries_of(options.controller or suite.controllers, pool)
    benchmark = Benchmark(suite, tuple(entries), limits, salt)
    folder = Path(options.out or Path("runs") / suite.name)
    rows: list[dict[str, Any]] = []
    with _pool(options.ray, jobs, limits) as pool:
        if options.cell is not None:
            rows = rows_of_cell(options.cell, benchmark, pool)
        else:
            with open_store(benchmark, folder, resume=options.resume) as store:
                _run(options, benchmark, store, pool)
    # After the pool's end: what is printed before may go to standard error.
    if options.cell is not None:
        _show_cells(options, rows)
    else:
        _check_baselines(_show(options, folder))


def _run(options: argparse.Namespace, benchmark: Benchmark, store: Store, pool: Pool) -> None:
    """Run what is missing, with a progress bar over the cells."""
    total = sum(len(p.scenarios) for p in benchmark.packages)
    todo = [work for work in missing(benchmark, store) if isinstance(work, CellWork)]
    there = total - sum(len(work.package.scenarios) for work in todo)
    with progress_bar(options, total, "cell") as bar:
        bar.update(there)

        def tell(spec: str, cells: int) -> None:
            bar.set_postfix_str(spec, refresh=False)
            bar.update(cells)

        run_benchmark(benchmark, store, pool, _called(benchmark.salt), tell)


def _limits(options: argparse.Namespace) -> Limits:
    seconds = check_positive("seconds", parse_number("seconds", options.seconds), "s")
    memory = check_positive("memory", parse_number("memory", options.memory), "GiB")
    if memory > _MOST_MEMORY:
        raise ArgumentError(
            f"memory = {memory:g} GiB is more than any machine has; "
            f"give {_MOST_MEMORY:g} GiB or less"
        )
    return Limits(seconds, int(_GIB * memory))


def _pool(address: str | None, jobs: int | None, limits: Limits) -> LocalPool | RayPool:
    """Return worker processes of this machine, or of the Ray cluster at an address."""
    if address is not None:
        return RayPool(address, limits, jobs, _owner_of_work)
    return LocalPool(jobs or os.cpu_count() or 1, limits, _owner_of_work)


def _owner_of_work(work: Work) -> str | None:
    """Return whose own code a piece of work runs, None for what railenv brings along."""
    return _owner_of_spec(
        work.package.controller if isinstance(work, CellWork) else work.controller
    )


def _owner_of_spec(spec: str) -> str | None:
    return spec if spec.startswith("py:") else None


def _refuse_ignored(options: argparse.Namespace) -> None:
    """Raise `ArgumentError` if an option was typed beside another that makes it say nothing."""
    for mode, (what, ignored) in _IGNORED.items():
        if getattr(options, mode) is None:
            continue
        for name in ignored:
            value = getattr(options, name)
            if value not in (None, False) and not getattr(value, "is_default", False):
                raise ArgumentError(
                    f"--{name.replace('_', '-')} says nothing beside --{mode}, which {what}; "
                    "drop one of them"
                )


def _salt(text: str | None) -> str:
    """Return the private salt that was typed, or that the file after an @ holds.

    Raises:
        ArgumentError: It is empty, or more than a line.
        InputFileError: The file cannot be read.
    """
    if text is None:
        return ""
    salt, where = text, "--private-salt"
    if text.startswith("@"):
        path = Path(text[1:])
        where = f"the file {path} of --private-salt"
        try:
            salt = path.read_text(encoding="utf-8")
        except OSError as error:
            raise InputFileError(f"cannot read {where}: {error.strerror}") from None
        except UnicodeDecodeError:
            raise InputFileError(f"cannot read {where}: it is no text in UTF-8") from None
        salt = salt.removesuffix("\n").removesuffix("\r")
    if len(salt.splitlines()) != 1:
        # An empty one would mean the public tracks.
        raise ArgumentError(f"{where} must hold one line, which is the salt; leave it out for none")
    return salt


def _template(options: argparse.Namespace) -> None:
    """Write the template of a controller, and say how to go on."""
    from eval.controller_template import write_template

    path = write_template(Path(options.template))
    spec = f"py:{path.stem}:controller"
    if options.json:
        print_json({"template": str(path), "controller": spec})
        return
    folder = path.resolve().parent
    print(f"template: {path}")
    print("next:")
    if folder != Path.cwd():
        print(f"  cd {shlex.quote(str(folder))}")
    print(f"  railenv benchmark --check {spec}")
    print(f"  railenv benchmark --controller {spec}")


def _called(salt: str) -> str:
    """Return how the program was called, for the records; they hold no private salt."""
    words = [word.replace(salt, "SALT") if salt else word for word in sys.argv[1:]]
    return shlex.join(["railenv", *words])


def command_report(options: argparse.Namespace) -> None:
    """Write the page of a folder's records and print their leaderboards."""
    _show(options, Path(options.folder), need_page=True)


def _show(options: argparse.Namespace, folder: Path, *, need_page: bool = False) -> Sequence[Board]:
    """Print the leaderboards, then raise if a file could not be written; return them."""
    with Reader.open(folder) as reader:
        boards = boards_of(reader)
        path = reader.path
        # A run is not lost for want of the package that writes the page.
        page, trouble = None, None
        if need_page or missing_for_report() is None:
            try:
                page = write_report(reader, boards)
            except OutputError as error:
                trouble = error
    if options.json:
        plain = [plain_board(board) for board in boards]
        shown = None if page is None else str(page)
        print_json({"records": str(path), "page": shown, "boards": plain})
    else:
        print(boards_text(boards))
        print(f"records: {path}")
        print(f"page:    {page or _no_page(trouble)}")
    if getattr(options, "export", None):
        export(folder, Path(options.export))
    if trouble is not None:
        raise trouble
    return boards


def _no_page(trouble: OutputError | None) -> str:
    if trouble is not None:
        return "not written"
    needs = 'pip install "railenv[report]", then railenv report'
    return f"not written, {missing_for_report()} is not installed; {needs}"


def _check_baselines(boards: Sequence[Board]) -> None:
    """Raise if runs were lost that everybody is scored by: a script must not take that for good."""
    lost = sum(board.lost_baselines.total() for board in boards)
    if lost:
        raise RailenvError(
            f"runs of passive or the reference were lost on {lost} tracks, where nothing is "
            "scored, see above; run again with --resume"
        )


def _show_cells(options: argparse.Namespace, rows: list[dict[str, Any]]) -> None:
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
