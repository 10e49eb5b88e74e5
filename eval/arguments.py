"""Arguments of the command line in the library's own terms, progress bars and JSON output."""

import argparse
import json
import sys
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from baselines import Controller, make_controller
from baselines.policies import HistoryPolicy
from eval.loop_arguments import Default
from eval.rollout import Stepping
from eval.simulations import Vehicle
from railenv.actuation import ActuatorSpec
from railenv.errors import (
    ArgumentError,
    OutputError,
    check_not_negative,
    check_positive,
    check_text,
    unknown_name,
)
from railenv.files import make_folder
from railenv.vehicle import LateralVehicle, lateral17
from railenv.vehicle.coordinates import parse_layout
from railenv.vehicle.nonlinear import ContactSettings, full50

MODELS = {
    "lateral17": "linear, 17 lateral coordinates: exact stepping and the stability oracle",
    "full50": "nonlinear, 50 coordinates: wheels on rails, dampers that blow off, bump stops",
}
"""Models of a vehicle and what they are."""

LONGEST_CONTROL_PERIOD = 100.0
"""Longest time between commands that is taken [s]."""


def parse_loop(options: argparse.Namespace) -> tuple[Controller, LateralVehicle]:
    """Return the controller and the vehicle; a controller that has a layout decides it."""
    speed = parse_number("speed_kmh", options.speed_kmh)
    controller = make_controller(options.controller, options.layout, options.vehicle, speed)
    if isinstance(controller, HistoryPolicy) and getattr(
        options.control_period, "is_default", False
    ):
        # A trained policy acts at a period of its own.
        options.control_period = Default(repr(controller.control_period))
    layout = layout_of(options.controller, controller, options.layout)
    return controller, lateral17(options.vehicle, layout, speed)


def layout_of(spec: str, controller: object, layout: str) -> str:
    """Return the layout that is run: the controller's own, or that of --layout if it has none.

    Args:
        spec: Names the controller in messages.
        controller: The controller.
        layout: What --layout says; a `Default` if it was left out.

    Raises:
        ArgumentError: --layout was typed and the controller acts on another one.
    """
    own = getattr(controller, "layout", None)
    if own is None:
        return layout
    # Without actuators nothing acts, and every layout is as good.
    typed = not getattr(layout, "is_default", False) and own != "passive"
    if typed and parse_layout(layout) != str(own):
        raise ArgumentError(
            f"layout = {str(layout)!r} is given, and {spec!r} acts on layout {str(own)!r}, its own;"
            f" drop --layout, or give a controller for layout {str(layout)!r}"
        )
    return str(own)


def parse_run(options: argparse.Namespace) -> tuple[Controller, Vehicle]:
    """Return the controller and the vehicle that --model means, with its wheels and rails.

    Raises:
        ArgumentError: The model does not exist, or an option about wheel and rail stands beside the
            linear vehicle.
    """
    typed = {
        field: getattr(options, option)
        for option, field in _CONTACT.items()
        if getattr(options, option) is not None
    }
    if options.model not in MODELS:
        raise unknown_name("model", options.model, MODELS)
    if options.model == "lateral17":
        if typed:
            option = next(o for o, field in _CONTACT.items() if field in typed)
            raise ArgumentError(
                f"--{option.replace('_', '-')} says something of wheel and rail, which "
                "--model lateral17 has as coefficients; give --model full50"
            )
        return parse_loop(options)
    if "friction" in typed:
        typed["friction"] = check_not_negative(
            "friction", parse_number("friction", typed["friction"])
        )
    speed = parse_number("speed_kmh", options.speed_kmh)
    controller = make_controller(options.controller, options.layout, options.vehicle, speed)
    layout = layout_of(options.controller, controller, options.layout)
    return controller, full50(options.vehicle, layout, speed, ContactSettings(**typed))


_CONTACT = {"wheel": "wheel", "rail": "rail", "friction": "friction", "creep_law": "law"}


def parse_stepping(options: argparse.Namespace) -> Stepping:
    """Return control period, a physics step that fits into it, and the actuator."""
    period = check_positive(
        "control_period", parse_number("control_period", options.control_period), "seconds"
    )
    if period > LONGEST_CONTROL_PERIOD:
        raise ArgumentError(
            f"control_period = {period:g} s is no control; "
            f"give {LONGEST_CONTROL_PERIOD:g} s or less"
        )
    lag = check_not_negative("actuator_lag", parse_number("actuator_lag", options.actuator_lag))
    # The physics step is 5 ms, or the largest whole part of the control period below that.
    parts = max(1, int(np.ceil(period / 0.005 - 1e-9)))
    return Stepping(period, period / parts, ActuatorSpec(lag=lag))


def parse_delay(text: str) -> float | tuple[float, ...]:
    """Return one delay [s], or one per channel from a list with commas."""
    values = tuple(
        check_not_negative("delay", parse_number("delay", t), "seconds") for t in text.split(",")
    )
    return values[0] if len(values) == 1 else values


def parse_delay_box(text: str) -> float | tuple[float, float] | list[Any]:
    """Return what `railenv.stability.certify` takes: numbers, low:high intervals, one per channel.

    Args:
        text: "0.19", "0:0.19", or one of either per channel with commas between.
    """
    entries = [_delay_entry(entry) for entry in text.split(",")]
    return entries[0] if len(entries) == 1 else entries


def _delay_entry(text: str) -> float | tuple[float, float]:
    ends = [
        check_not_negative("delay", parse_number("delay", t), "seconds") for t in text.split(":")
    ]
    if len(ends) > 2:
        raise ArgumentError(f"delay = {text!r} has more than two ends; give low:high")
    return ends[0] if len(ends) == 1 else (ends[0], ends[1])


def parse_number(name: str, text: str) -> float:
    """Return a finite number, or raise `ArgumentError` with the argument's name."""
    return check_text(name, text)


def parse_whole(name: str, text: str) -> int:
    """Return a whole number, or raise `ArgumentError` with the argument's name."""
    try:
        return int(text)
    except ValueError:
        raise ArgumentError(f"{name} = {text!r} is not a whole number") from None


def parse_output(text: str | None, endings: tuple[str, ...]) -> Path | None:
    """Check an output file before the work is done."""
    if text is None:
        return None
    path = Path(text)
    if path.suffix not in endings:
        raise ArgumentError(f"{text!r} must end in {' or '.join(endings)}")
    if path.is_dir():
        raise OutputError(f"cannot write {path}: it is a folder")
    make_folder(path.parent)
    return path


def folder_name(path: str | Path) -> str:
    """Return the last part of a path; of one that ends in . or .., that of the folder meant."""
    name = Path(path).name
    return (Path(path).resolve().name if name in ("", "..") else name) or str(path)


@contextmanager
def progress_bar(
    options: argparse.Namespace, total: int | None, unit: str
) -> Generator[Any, None, None]:
    """Progress on standard error, after a second, with the remaining time where it is known."""
    with tqdm(
        total=total, unit=unit, file=sys.stderr, desc=f"railenv {options.command}", delay=1.0
    ) as bar:
        yield bar


def print_json(value: object) -> None:
    """Print one JSON object; a value that is not finite is a mistake, not output."""
    print(json.dumps(value, allow_nan=False))
