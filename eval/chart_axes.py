"""Axes of a stability chart, and the loop at each of its points."""

import argparse
import typing
from dataclasses import dataclass, fields

import numpy as np

from baselines import make_controller, registered_controllers
from eval.arguments import layout_of, parse_number, parse_whole
from eval.chart_plot import AxisText
from eval.stability_answers import delay_system
from railenv.actuation import ActuatorSpec
from railenv.errors import ArgumentError, check_count, check_positive, unknown_name
from railenv.stability import DelaySystem
from railenv.units import FloatArray
from railenv.vehicle import VehicleParameters, get_vehicle, lateral17

MOST_POINTS = 100_000
"""Larger charts are refused: they take hours."""

_FORM = "NAME=LOW:HIGH:NUMBER, NAME=LOW:HIGH:NUMBER:log or NAME=VALUE"


@dataclass(frozen=True, eq=False)
class Axis:
    """One axis of the chart.

    Attributes:
        name: As typed, before the equals sign.
        kind: "speed_kmh", "actuator_lag", "setting" (of the controller), "parameter" (of the
            vehicle) or "multiple" (of parameters of the vehicle).
        targets: What is changed; several only for a multiple.
        text: Words and unit.
        values: Linear or logarithmic, rising.
    """

    name: str
    kind: str
    targets: tuple[str, ...]
    text: AxisText
    values: FloatArray


@dataclass(frozen=True, eq=False)
class VariedLoop:
    """Builds the loop at given values of its axes; holds plain values, to go to worker processes.

    Attributes:
        controller: SPEC.
        layout: "passive", "2" or "4".
        vehicle: Name of the vehicle.
        speed_kmh: Speed unless it is an axis [km/h].
        actuator_lag: Lag unless it is an axis [s].
        axes: What varies.
    """

    controller: str
    layout: str
    vehicle: str
    speed_kmh: float
    actuator_lag: float
    axes: tuple[Axis, ...]

    def __call__(self, *values: float) -> DelaySystem:
        """Return the loop at one value per axis."""
        spec, speed, lag = self.controller, self.speed_kmh, self.actuator_lag
        parameters = get_vehicle(self.vehicle).parameters
        changes: dict[str, float] = {}
        for axis, value in zip(self.axes, values, strict=True):
            if axis.kind == "speed_kmh":
                speed = value
            elif axis.kind == "actuator_lag":
                lag = value
            elif axis.kind == "setting":
                spec += f"{',' if ':' in spec else ':'}{axis.name}={value!r}"
            elif axis.kind == "parameter":
                changes[axis.name] = value
            else:
                changes |= {name: value * getattr(parameters, name) for name in axis.targets}
        # A law with a model in it is designed once, for the vehicle and speed the axes start from.
        controller = make_controller(spec, self.layout, self.vehicle, self.speed_kmh)
        layout = getattr(controller, "layout", self.layout)
        vehicle = lateral17(parameters.replace(**changes), layout, speed)
        return delay_system(controller, vehicle, ActuatorSpec(lag=lag))


def parse_chart(options: argparse.Namespace) -> VariedLoop:
    """Return what builds the chart's loops.

    Raises:
        ArgumentError: An axis or the loop is not usable.
    """
    x, y = (parse_axis(getattr(options, end), options) for end in "xy")
    number = len(x.values) * len(y.values)
    if number > MOST_POINTS:
        raise ArgumentError(
            f"the chart has {number} points, more than {MOST_POINTS}; give fewer per axis"
        )
    return varied_loop(options, (x, y))


def varied_loop(options: argparse.Namespace, axes: tuple[Axis, ...]) -> VariedLoop:
    """Return what builds the loops over some axes.

    Raises:
        ArgumentError: Two axes change the same, or the loop is not usable.
    """
    for k, axis in enumerate(axes):
        for other in axes[:k]:
            both = ", ".join(sorted(set(axis.targets) & set(other.targets)))
            if both:
                raise ArgumentError(
                    f"{other.name!r} and {axis.name!r} both change {both}; choose another"
                )
    speed = check_positive("speed_kmh", parse_number("speed_kmh", options.speed_kmh), "km/h")
    controller = make_controller(options.controller, options.layout, options.vehicle, speed)
    if not hasattr(controller, "to_delay_system"):
        raise ArgumentError(
            f"controller {options.controller!r} is not linear (it has no to_delay_system); choose "
            "a linear one"
        )
    lag = ActuatorSpec(lag=parse_number("actuator_lag", options.actuator_lag)).lag
    layout = str(layout_of(options.controller, controller, options.layout))
    return VariedLoop(options.controller, layout, options.vehicle, speed, lag, axes)


def parse_axis(text: str, options: argparse.Namespace) -> Axis:
    """Return the axis that a text names."""
    name, equals, numbers = text.partition("=")
    if not equals or not name:
        raise ArgumentError(f"axis {text!r} must be {_FORM}")
    values, log = _values(name, numbers)
    parameters = get_vehicle(options.vehicle).parameters
    settings = _controller_settings(options.controller)
    units = _parameter_units()
    if name.endswith("*"):
        targets = tuple(name[:-1].split("+"))
        for target in targets:
            if target not in units:
                raise unknown_name("vehicle parameter to multiply", target, units)
        words = ", ".join(_words(target) for target in targets)
        if len(targets) == 1:
            words += f" / {getattr(parameters, targets[0]):g} {units[targets[0]]}".removesuffix(
                " 1"
            )
        else:
            words += f": multiple of {options.vehicle}"
        label = AxisText(words, "1", log)
        return Axis(name, "multiple", targets, label, values)
    if name == "speed_kmh":
        return Axis(name, name, (name,), AxisText("speed", "km/h", log), values)
    if name == "actuator_lag":
        return Axis(name, name, (name,), AxisText("actuator lag", "s", log), values)
    if name in settings:
        given = options.controller.partition(":")[2].split(",")
        if name in {item.partition("=")[0] for item in given}:
            raise ArgumentError(
                f"{name} is an axis and stands in controller {options.controller!r}; "
                "take it out of the controller"
            )
        return Axis(name, "setting", (name,), AxisText(_words(name), settings[name], log), values)
    if name in units:
        return Axis(name, "parameter", (name,), AxisText(_words(name), units[name], log), values)
    hint = str(unknown_name("axis", name, ["speed_kmh", "actuator_lag", *settings, *units]))
    raise ArgumentError(
        f"{hint}; an axis is speed_kmh, actuator_lag, a setting of the controller "
        f"({', '.join(settings) or 'this one has none'}), a parameter of the vehicle, "
        "or NAME* for a multiple of one"
    )


def _values(name: str, text: str) -> tuple[FloatArray, bool]:
    """Return the values of an axis and whether they are logarithmic."""
    parts = text.split(":")
    log = len(parts) == 4 and parts[3] == "log"
    if len(parts) == 1:
        return np.array([parse_number(name, parts[0])]), False
    if len(parts) != 3 + log:
        raise ArgumentError(f"axis '{name}={text}' must be {_FORM}")
    low, high = parse_number(name, parts[0]), parse_number(name, parts[1])
    number = check_count(f"number of {name}", parse_whole(f"number of {name}", parts[2]), 2)
    if number > MOST_POINTS:
        raise ArgumentError(f"number of {name} = {number} is too large; give {MOST_POINTS} or less")
    if not low < high:
        raise ArgumentError(
            f"axis '{name}={text}' does not rise; give the lower value first, "
            f"or {name}=VALUE for a single one"
        )
    if log and low <= 0.0:
        raise ArgumentError(
            f"axis '{name}={text}' is logarithmic from {low:g}; start above zero, or drop ':log'"
        )
    return (np.geomspace if log else np.linspace)(low, high, number), log


def _controller_settings(spec: str) -> dict[str, str]:
    """Return the settings that a controller has, with their units."""
    name = spec.partition(":")[0]
    for entry in registered_controllers():
        if entry.name == name:
            return {k: u for k, (value, u) in entry.settings.items() if not isinstance(value, str)}
    return {}


def _parameter_units() -> dict[str, str]:
    hints = typing.get_type_hints(VehicleParameters, include_extras=True)
    return {f.name: hints[f.name].__metadata__[0] for f in fields(VehicleParameters)}


def _words(name: str) -> str:
    return name.replace("_", " ")
