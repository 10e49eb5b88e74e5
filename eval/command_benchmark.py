"""`railenv benchmark` and `railenv report`."""

import argparse
import shlex
import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from baselines import make_controller
from eval.arguments import parse_whole, print_json, progress_bar
from eval.benchmark import run_benchmark
from eval.report import missing_for_report, write_report
from eval.scenarios import load_suite
from eval.summary import summary_table
from railenv.errors import ControllerError, check_count
from railenv.files import make_folder


def command_benchmark(options: argparse.Namespace) -> None:
    """Run a suite, print its table and write its report."""
    suite = load_suite(options.suite)
    if options.controller:
        suite = replace(suite, controllers=tuple(dict.fromkeys(options.controller)))
    jobs = check_count("jobs", parse_whole("jobs", options.jobs))
    for spec, layout, speed_kmh in suite.groups():
        # A mistyped SPEC stops here; a controller of the user's own that fails is a result.
        with suppress(ControllerError):
            make_controller(spec, layout, suite.vehicle, speed_kmh)
    missing = missing_for_report()
    if missing:
        print(
            f"railenv benchmark: no page will be written, since {missing} is not installed: "
            'pip install "railenv[report]"',
            file=sys.stderr,
        )
    folder = Path(options.out or Path("runs") / options.suite)
    make_folder(folder)
    command = shlex.join(["railenv", *sys.argv[1:]])
    total = len(list(suite.groups()))
    with progress_bar(options, total, "group") as bar:

        def tell(group: tuple[str, str, float]) -> None:
            bar.set_postfix_str(f"{group[0]}, layout {group[1]}", refresh=False)
            bar.update()

        records = run_benchmark(suite, folder, command, jobs, tell)
    if options.json:
        print_json(records)
    else:
        print(summary_table(records))
        print(f"records: {folder / 'records.json'}")
    if not missing:
        page = _page(options, folder)
        if not options.json:
            print(f"report:  {page}")


def command_report(options: argparse.Namespace) -> None:
    """Write a benchmark's HTML page."""
    print(_page(options, Path(options.folder)))


def _page(options: argparse.Namespace, folder: Path) -> Path:
    with progress_bar(options, None, "chart") as bar:

        def tell(word: str) -> None:
            bar.set_postfix_str(word, refresh=False)
            bar.update()

        return write_report(folder, tell)
