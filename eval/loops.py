"""The loop that --controller or --system means: continuous, or sampled with its hold."""

import argparse
import inspect
from collections.abc import Callable
from typing import Any

from baselines.controller import users_own_code
from eval.arguments import parse_loop, parse_stepping
from eval.stability_answers import delay_system
from eval.system_file import load_system
from railenv.actuation import ActuatorSpec
from railenv.errors import ArgumentError, ControllerError, RailenvError
from railenv.stability import DelaySystem, SampledLoop
from railenv.vehicle import LateralVehicle

_OF_A_VEHICLE = ("layout", "speed_kmh", "vehicle", "actuator_lag")


def parse_linear_loop(
    options: argparse.Namespace,
) -> tuple[DelaySystem | SampledLoop, LateralVehicle | None]:
    """Return the loop that --controller or --system means, and its vehicle if it has one.

    Only a file of --system gives a `SampledLoop`.

    Raises:
        ArgumentError: The controller is not linear, an option for vehicles stands beside --system,
            or --control-period beside a loop that has its own.
        InputFileError: The file of --system or of a saved policy cannot be used.
    """
    if options.controller is not None:
        controller, vehicle = parse_loop(options)
        return delay_system(controller, vehicle, parse_stepping(options).actuator), vehicle
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
    convert = getattr(controller, "to_sampled_loop", None)
    if convert is not None:
        return _sampled(convert, vehicle, stepping.control_period, stepping.actuator)
    system = delay_system(controller, vehicle, stepping.actuator)
    return SampledLoop.from_delay_system(system, stepping.control_period)


def _sampled(
    convert: Callable[..., Any], vehicle: LateralVehicle, period: float, actuator: ActuatorSpec
) -> SampledLoop:
    """Return what a controller's `to_sampled_loop` says, actuator included."""
    given: tuple[Any, ...] = (vehicle, period, actuator)
    try:
        inspect.signature(convert).bind(*given)
    except (TypeError, ValueError):
        # A controller of the user's own that knows no actuators.
        if actuator.lag > 0.0:
            raise ArgumentError(
                f"actuator_lag = {actuator.lag:g} s is not known to the controller's "
                "to_sampled_loop; give it a third argument, actuator, or drop --actuator-lag"
            ) from None
        given = (vehicle, period)
    try:
        with users_own_code("the controller's to_sampled_loop"):
            loop = convert(*given)
    except ControllerError as error:
        # What the library itself refuses (another period, another layout) is said in its own words.
        if isinstance(error.__cause__, RailenvError):
            raise error.__cause__ from None
        raise
    if not isinstance(loop, SampledLoop):
        raise ControllerError(
            f"the controller's to_sampled_loop returned {type(loop).__name__}; "
            "it must return a SampledLoop"
        )
    return loop
