"""`railenv bench-speed`: how long things take, beside another way to do them, in one run."""

import argparse
import shlex
import sys
import time
from collections.abc import Callable

from eval.arguments import parse_whole, print_json, progress_bar
from eval.bench import Section, numeric_threads, timed_section
from eval.records import provenance
from railenv.errors import check_count, unknown_name


def _oracle() -> Section:
    from eval.bench_oracle import OracleQuestions, oracle_entries, vehicle_loop

    return timed_section(oracle_entries(OracleQuestions(vehicle_loop)))


def _env() -> Section:
    from eval.bench_env import Sizes, env_section

    return env_section(Sizes())


def _models() -> Section:
    from eval.bench_models import ModelSizes, models_section

    return models_section(ModelSizes())


SECTIONS: dict[str, Callable[[], Section]] = {"oracle": _oracle, "env": _env, "models": _models}
"""Sections by name; each imports what it needs when it is asked for."""


def command_bench_speed(options: argparse.Namespace) -> None:
    """Measure the sections and print a table or one JSON object."""
    repeat = check_count("repeat", parse_whole("repeat", options.repeat))
    if options.only is not None and options.only not in SECTIONS:
        raise unknown_name("section", options.only, SECTIONS)
    names = list(SECTIONS) if options.only is None else [options.only]
    start = time.perf_counter()
    sections = {name: SECTIONS[name]() for name in names}
    with progress_bar(options, sum(s.total for s in sections.values()), "entry") as bar:

        def tell(word: str) -> None:
            bar.set_postfix_str(word, refresh=False)
            bar.update()

        answer = {name: section.measure(repeat, tell) for name, section in sections.items()}
    if options.json:
        command = shlex.join(["railenv", *sys.argv[1:]])
        about = provenance(command, time.perf_counter() - start)
        about["numeric_threads"] = numeric_threads()
        print_json({"provenance": about, "sections": answer})
        return
    for name, rows in answer.items():
        print(name)
        print("\n".join(sections[name].table(rows)))
