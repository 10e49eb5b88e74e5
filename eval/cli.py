"""The command line, `railenv`: arguments, exit status, and which command does what.

Exit status: 0 done, 1 the run failed (also: cannot write), 2 bad arguments or bad input file, 130
interrupted. Errors are one line on standard error. `--json` prints one object on standard output
and nothing else; progress goes to standard error.

Commands import what they need when they run, so that `railenv --help` is quick.
"""

import argparse
import importlib
import os
import signal
import sys
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

from eval.benchmark_arguments import add_benchmark_arguments
from eval.conicity_arguments import add_conicity_arguments
from eval.full50_arguments import add_model_arguments
from eval.hunting_arguments import add_hunting_arguments
from eval.loop_arguments import (
    Default,
    add_certify_arguments,
    add_chart_arguments,
    add_json_argument,
    add_loop_arguments,
)
from eval.policy_arguments import add_policy_arguments
from eval.score_arguments import add_score_arguments
from eval.training_arguments import add_training_arguments

# One numeric thread: the matrices are small, and a threaded library on few cores is many times
# slower. Set before numpy is loaded; what the user sets wins.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

_COMMANDS = {
    "list": ("eval.command_simulate", "command_list"),
    "simulate": ("eval.command_simulate", "command_simulate"),
    "critical-delay": ("eval.command_stability", "command_critical_delay"),
    "roots": ("eval.command_roots", "command_roots"),
    "benchmark": ("eval.command_benchmark", "command_benchmark"),
    "report": ("eval.command_benchmark", "command_report"),
    "certify": ("eval.command_certify", "command_certify"),
    "chart": ("eval.command_chart", "command_chart"),
    "conicity": ("eval.command_conicity", "command_conicity"),
    "hunting": ("eval.command_hunting", "command_hunting"),
    "bench-speed": ("eval.command_bench", "command_bench_speed"),
    "score": ("eval.command_score", "command_score"),
    "train": ("eval.command_train", "command_train"),
    "search": ("eval.command_train", "command_search"),
    "export": ("eval.command_export", "command_export"),
    "convert-sb3": ("eval.command_export", "command_convert_sb3"),
}

_LONGEST_LINE = 600
"""Longest error line; what a user gave may be of any length."""

EXIT_FAILED = 1
EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130


class _Parser(argparse.ArgumentParser):
    """Reports a bad argument in one line."""

    def error(self, message: str) -> NoReturn:
        line = " ".join(message.split())[:_LONGEST_LINE]
        self.exit(EXIT_BAD_INPUT, f"{self.prog}: {line}; see {self.prog} --help\n")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    try:
        options = _parser().parse_args(arguments)
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else EXIT_BAD_INPUT
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        return _guarded(options)
    except KeyboardInterrupt:
        return _fail(options.command, "interrupted", EXIT_INTERRUPTED)


def _guarded(options: argparse.Namespace) -> int:
    from railenv.errors import ArgumentError, InputFileError, RailenvError

    try:
        status = _run(options) or 0
        sys.stdout.flush()
    except (ArgumentError, InputFileError) as error:
        return _fail(options.command, error, EXIT_BAD_INPUT)
    except RailenvError as error:
        return _fail(options.command, error, EXIT_FAILED)
    except BrokenPipeError:
        _silence_stdout()  # the reader of the pipe has left; nothing more can be said to it
        return EXIT_FAILED
    except OSError as error:
        _silence_stdout()
        return _fail(options.command, f"cannot write the result: {error}", EXIT_FAILED)
    return status


def _interrupt(*_: object) -> NoReturn:
    """Let SIGTERM end a run as Ctrl-C does: temporary files and workers are cleared away."""
    raise KeyboardInterrupt


def _silence_stdout() -> None:
    """Drop what is still buffered, so that the interpreter does not stumble over it at its end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _fail(command: str, error: object, status: int) -> int:
    text = "".join(c if c.isprintable() else " " for c in str(error))
    line = " ".join(text.split())
    if len(line) > _LONGEST_LINE:
        line = line[: _LONGEST_LINE // 2] + " ... " + line[-_LONGEST_LINE // 2 :]
    print(f"railenv {command}: {line}", file=sys.stderr)
    return status


def _run(options: argparse.Namespace) -> int | None:
    module, function = _COMMANDS[options.command]
    run: Callable[[argparse.Namespace], int | None]
    run = getattr(importlib.import_module(module), function)
    return run(options)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="railenv",
        description="Railway vehicles under delayed active suspension: simulate, judge, benchmark.",
    )
    parser.add_argument("--version", action="version", version=_version())
    commands = parser.add_subparsers(dest="command", required=True, metavar="command")

    listing = commands.add_parser("list", help="what can be named")
    listing.add_argument(
        "kind",
        nargs="?",
        choices=["vehicles", "models", "tracks", "controllers", "envs", "suites"],
        help="only this kind",
    )
    add_json_argument(listing)

    simulate = commands.add_parser("simulate", help="one run; prints ride index and the rest")
    add_loop_arguments(simulate)
    simulate.add_argument("--delay", default="0", help="delay [s], or one per channel: 0.1,0.1 (0)")
    simulate.add_argument(
        "--track", default="tb3352", help="spectrum, flat, or a CSV file (tb3352)"
    )
    add_model_arguments(simulate)
    simulate.add_argument("--seconds", default="20", help="length of the run [s] (20)")
    simulate.add_argument("--skip", help="time left out of the measures at the start [s] (5)")
    simulate.add_argument("--seed", default="0", help="seed of track and noise (0)")
    simulate.add_argument("--sensor-noise", default="0", help="0.1: a tenth of usual readings (0)")
    simulate.add_argument("--told-error", default="0", help="a policy is told this more [s] (0)")
    simulate.add_argument("--out", help="write the signals to this .npz file")
    simulate.add_argument("--plot", help="draw the run into this .png, .svg or .pdf file")
    simulate.add_argument("--video", help="film the run into this .mp4 file")

    critical = commands.add_parser("critical-delay", help="every critical delay of a loop")
    add_loop_arguments(critical, own=True)
    critical.add_argument("--method", default="exact", help="exact, pade:N or simulation (exact)")
    longest = "longest delay searched [s] (2; sampled laws 0.6)"
    critical.add_argument("--max-delay", default=Default("2"), help=longest)
    add_model_arguments(critical)
    critical.add_argument(
        "--prove-sampled",
        action="store_true",
        help="prove a bracket of the sampled critical delay; a sampled law's windows at one delay",
    )

    roots = commands.add_parser("roots", help="rightmost characteristic roots at one delay")
    add_loop_arguments(roots, own=True)
    roots.add_argument("--delay", required=True, help="delay [s], or one per channel: 0.1,0.1")
    roots.add_argument("--count", default="10", help="how many (10)")
    roots.add_argument("--method", default="exact", help="exact or pade:N (exact)")

    add_certify_arguments(
        commands.add_parser("certify", help="a proof of stability or instability")
    )
    add_chart_arguments(commands.add_parser("chart", help="critical delay over any two parameters"))
    conicity = commands.add_parser("conicity", help="equivalent conicity of a wheel on a rail")
    add_conicity_arguments(conicity)
    add_json_argument(conicity)

    hunting = commands.add_parser("hunting", help="critical speeds of the nonlinear vehicle")
    add_hunting_arguments(hunting)
    add_json_argument(hunting)

    add_benchmark_arguments(commands)
    report = commands.add_parser("report", help="one HTML page from a benchmark's records")
    report.add_argument("folder", help="folder of a benchmark's records")
    add_json_argument(report)

    add_training_arguments(commands)
    add_score_arguments(commands)
    add_policy_arguments(commands)

    speed = commands.add_parser("bench-speed", help="times beside a generic method, in one run")
    speed.add_argument("--only", metavar="SECTION", help="one section: oracle or env (all)")
    speed.add_argument("--repeat", default="5", help="most runs of each entry (5)")
    add_json_argument(speed)
    return parser


def _version() -> str:
    from importlib import metadata

    return f"railenv {metadata.version('railenv')}"


def _entry() -> Any:
    sys.exit(main())


if __name__ == "__main__":
    _entry()
