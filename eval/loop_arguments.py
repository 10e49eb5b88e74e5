"""Arguments that say which loop is meant. Loads nothing, so that help is quick."""

import argparse


class Default(str):
    """A default value, so that an option that was left out can be told from one that was typed."""

    __slots__ = ()
    is_default = True


def add_certify_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of a proof."""
    add_loop_arguments(parser, own=True, required=False)
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


def add_loop_arguments(
    parser: argparse.ArgumentParser, own: bool = False, required: bool = True
) -> None:
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
    add_json_argument(parser)


def add_chart_arguments(parser: argparse.ArgumentParser) -> None:
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
        parser.add_argument(option, default=Default(default), help=text)
    parser.add_argument("--plot", help="draw the chart into this .png, .svg or .pdf file")
    parser.add_argument("--out", help="write the chart's data to this .npz file")
    add_json_argument(parser)


def add_json_argument(parser: argparse.ArgumentParser) -> None:
    """Add `--json`."""
    parser.add_argument(
        "--json", action="store_true", help="print one JSON object and nothing else"
    )
