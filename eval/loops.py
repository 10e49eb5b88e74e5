"""The loop that --controller or --system means: continuous, or sampled with its hold."""

import argparse

from baselines import Controller
from eval.arguments import parse_loop, parse_stepping, parse_whole
from eval.sampled_answers import sampled_loop
from eval.simulations import Vehicle
from eval.stability_answers import delay_system, is_sampled_only
from eval.system_file import load_system
from railenv.errors import ArgumentError, check_count
from railenv.stability import DelaySystem, SampledLoop
from railenv.vehicle import LateralVehicle

_OF_A_VEHICLE = ("layout", "speed_kmh", "vehicle", "actuator_lag")


def parse_linear_loop(
    options: argparse.Namespace,
) -> tuple[DelaySystem | SampledLoop, LateralVehicle | None]:
    """Return the loop that --controller or --system means, and its vehicle if it has one.

    A sampled law, or a file of --system that holds a sampled loop, gives a `SampledLoop`.

    Raises:
        ArgumentError: The controller is not linear, an option for vehicles stands beside --system,
            or --control-period beside a loop that has its own.
        InputFileError: The file of --system or of a saved policy cannot be used.
    """
    if options.controller is not None:
        controller, vehicle = parse_loop(options)
        return controllers_loop(options, controller, vehicle), vehicle
    for name in _OF_A_VEHICLE:
        if is_typed(options, name):
            raise ArgumentError(
                f"--{name.replace('_', '-')} says something of a vehicle and {options.system!r} is "
                "a loop of its own; drop the option, or give --controller instead of --system"
            )
    loop = load_system(options.system)
    if isinstance(loop, SampledLoop) and is_typed(options, "control_period"):
        raise ArgumentError(
            f"control_period = {options.control_period} is given, and {options.system!r} is a "
            f"sampled loop with a period of its own, {loop.period:g} s; drop --control-period"
        )
    return loop, None


def controllers_loop(
    options: argparse.Namespace, controller: Controller, vehicle: LateralVehicle
) -> DelaySystem | SampledLoop:
    """Return the loop of a controller: continuous, or sampled for a law that is only that.

    Raises:
        ArgumentError: The controller is not linear.
    """
    stepping = parse_stepping(options)
    if is_sampled_only(controller):
        return sampled_loop(controller, vehicle, stepping.control_period, stepping.actuator)
    return delay_system(controller, vehicle, stepping.actuator)


def is_typed(options: argparse.Namespace, name: str) -> bool:
    """Whether an option was given, not left to its default."""
    return not getattr(getattr(options, name), "is_default", False)


def parse_sampled_loop(options: argparse.Namespace) -> SampledLoop:
    """Return the loop of --controller with the hold of the control period.

    The controller's own `to_sampled_loop` says what it does from sample to sample; a law that has
    none is taken as a continuous one whose output is held.

    Raises:
        ArgumentError: The controller is not linear.
    """
    controller, vehicle = parse_loop(options)
    stepping = parse_stepping(options)
    if hasattr(controller, "to_sampled_loop"):
        return sampled_loop(controller, vehicle, stepping.control_period, stepping.actuator)
    system = delay_system(controller, vehicle, stepping.actuator)
    return SampledLoop.from_delay_system(system, stepping.control_period)


def loop_name(options: argparse.Namespace, vehicle: Vehicle | None) -> str:
    """Return the title of the loop that is meant."""
    if vehicle is None:
        return str(options.system)
    return f"{options.controller}, layout {vehicle.layout}"


def parse_method(text: str, plain: tuple[str, ...]) -> tuple[str, int | None]:
    """Return the name of a method and the order of a Pade model.

    Args:
        text: One of `plain`, or "pade:N".
        plain: Methods without an order.
    """
    name, colon, order = text.partition(":")
    if name == "pade" and colon:
        return name, check_count("order", parse_whole("order", order))
    if text in plain:
        return text, None
    raise ArgumentError(f"method = {text!r} does not exist; choose {', '.join(plain)} or pade:N")
