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

from eval.conicity_arguments import add_conicity_arguments
from eval.full50_arguments import add_model_arguments
from eval.hunting_arguments import add_hunting_arguments

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
    _json(listing)

    simulate = commands.add_parser("simulate", help="one run; prints ride index and the rest")
    _loop(simulate)
    simulate.add_argument("--delay", default="0", help="delay [s], or one per channel: 0.1,0.1 (0)")
    simulate.add_argument(
        "--track", default="tb3352", help="spectrum, flat, or a CSV file (tb3352)"
    )
    add_model_arguments(simulate)
    simulate.add_argument("--seconds", default="20", help="length of the run [s] (20)")
    simulate.add_argument("--skip", help="time left out of the measures at the start [s] (5)")
    simulate.add_argument("--seed", default="0", help="seed of track and noise (0)")
    simulate.add_argument("--sensor-noise", default="0", help="0.1: a tenth of usual readings (0)")
    simulate.add_argument("--out", help="write the signals to this .npz file")
    simulate.add_argument("--plot", help="draw the run into this .png, .svg or .pdf file")
    simulate.add_argument("--video", help="film the run into this .mp4 file")

    critical = commands.add_parser("critical-delay", help="every critical delay of a loop")
    _loop(critical, own=True)
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
    _loop(roots, own=True)
    roots.add_argument("--delay", required=True, help="delay [s], or one per channel: 0.1,0.1")
    roots.add_argument("--count", default="10", help="how many (10)")
    roots.add_argument("--method", default="exact", help="exact or pade:N (exact)")

    _certify(commands.add_parser("certify", help="a proof of stability or instability"))
    _chart(commands.add_parser("chart", help="critical delay over any two parameters"))
    conicity = commands.add_parser("conicity", help="equivalent conicity of a wheel on a rail")
    add_conicity_arguments(conicity)
    _json(conicity)

    hunting = commands.add_parser("hunting", help="critical speeds of the nonlinear vehicle")
    add_hunting_arguments(hunting)
    _json(hunting)

    benchmark = commands.add_parser("benchmark", help="score controllers; table and report")
    benchmark.add_argument("--suite", default="quick", help="name of a suite (quick)")
    benchmark.add_argument(
        "--controller", action="append", metavar="SPEC", help="instead of the suite's own; repeat"
    )
    benchmark.add_argument("--jobs", default="1", help="worker processes (1)")
    benchmark.add_argument("--out", help="folder for records and report (runs/<suite>)")
    _json(benchmark)

    report = commands.add_parser("report", help="one HTML page from a benchmark's records")
    report.add_argument("folder", help="folder of a finished benchmark")

    speed = commands.add_parser("bench-speed", help="times beside a generic method, in one run")
    speed.add_argument("--only", metavar="SECTION", help="one section: oracle or env (all)")
    speed.add_argument("--repeat", default="5", help="most runs of each entry (5)")
    _json(speed)
    return parser


def _version() -> str:
    from importlib import metadata

    return f"railenv {metadata.version('railenv')}"


class Default(str):
    """A default value, so that an option that was left out can be told from one that was typed."""

    __slots__ = ()
    is_default = True


def _certify(parser: argparse.ArgumentParser) -> None:
    """Arguments of a proof."""
    _loop(parser, own=True, required=False)
    for option, text in (
        ("--delay", "delay [s]: 0.19, every one in 0:0.19, or either per channel: 0:0.1,..."),
        ("--jitter", "delays that vary in time by up to this much more [s]"),
        ("--told-error", "largest error of the delay a scheduled sampled law is told [s]"),
        ("--decay-rate", "ask for roots left of its negative [1/s] (0)"),
        ("--damping-ratio", "ask for this damping ratio up to --max-frequency-hz [1]"),
        ("--max-frequency-hz", "highest damped frequency of that rule [Hz]"),
        ("--max-tests", "give up after so many tests"),
        ("--save", "write the certificate to this .json file"),
        ("--verify", "re-check this certificate; with a loop given, that it is about it"),
    ):
        parser.add_argument(option, help=text)
    parser.add_argument(
        "--vary",
        action="append",
        metavar="NAME=LOW:HIGH",
        help="prove it for a family: speed_kmh, conicity, carbody_mass*, a setting; repeat",
    )
    parser.add_argument(
        "--common-jitter", action="store_true", help="all channels share the varying delay"
    )


def _loop(parser: argparse.ArgumentParser, own: bool = False, required: bool = True) -> None:
    """Arguments that say which loop is meant; `own` takes one that is no vehicle's too."""
    place = parser.add_mutually_exclusive_group(required=required) if own else parser
    place.add_argument(
        "--controller",
        required=not own,
        metavar="SPEC",
        help="skyhook:gain=35e3, passive, gain.npz, py:module:function",
    )
    if own:
        place.add_argument(
            "--system",
            metavar="FILE.npz",
            help="a loop of your own: arrays A, B, K; or a sampled one: A, B, C, Dc, period",
        )
    # Only `certify` does without a loop (--verify), and it takes feedback as continuous.
    period = (
        "time between commands [s] (0.01)"
        if required
        else "commands are sampled and held for this time [s] (continuous feedback)"
    )
    for option, default, text in (
        ("--layout", "4", "passive, 2 or 4 (4)"),
        ("--speed-kmh", "300", "running speed [km/h] (300)"),
        ("--vehicle", "paper_fit", "name of a vehicle (paper_fit)"),
        ("--control-period", "0.01", period),
        ("--actuator-lag", "0", "first-order lag of the actuators [s] (0)"),
    ):
        parser.add_argument(option, default=Default(default), help=text)
    _json(parser)


def _chart(parser: argparse.ArgumentParser) -> None:
    """Arguments of a stability chart."""
    for option, text in (
        ("--controller", "skyhook, passive, gain.npz, py:module:function"),
        ("--x", "gain=10e3:100e3:19, conicity=0.02:0.5:9:log, carbody_mass*=0.8:1.3:11"),
        ("--y", "also speed_kmh, actuator_lag; a parameter in SI units; or NAME=VALUE"),
    ):
        metavar = "SPEC" if option == "--controller" else "NAME=LOW:HIGH:NUMBER"
        parser.add_argument(option, required=True, metavar=metavar, help=text)
    for option, default, text in (
        ("--layout", "4", "passive, 2 or 4 (4)"),
        ("--speed-kmh", "300", "running speed if no axis [km/h] (300)"),
        ("--vehicle", "paper_fit", "name of a vehicle (paper_fit)"),
        ("--actuator-lag", "0", "first-order lag of the actuators if no axis [s] (0)"),
        ("--max-delay", "2", "longest delay searched [s] (2)"),
        ("--jobs", "1", "worker processes (1)"),
    ):
        parser.add_argument(option, default=default, help=text)
    parser.add_argument("--plot", help="draw the chart into this .png, .svg or .pdf file")
    parser.add_argument("--out", help="write the chart's data to this .npz file")
    _json(parser)


def _json(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--json", action="store_true", help="print one JSON object and nothing else"
    )


def _entry() -> Any:
    sys.exit(main())


if __name__ == "__main__":
    _entry()
