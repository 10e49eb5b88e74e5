"""What a controller that can be named says of itself: one entry, beside the law it belongs to.

A SPEC's settings are numbers or words, each with its default and unit. `build` gets the vehicle of
the run, at its speed and with the layout that is wanted, and the settings.
"""

from collections.abc import Callable
from dataclasses import dataclass

from baselines.controller import Controller
from railenv.errors import ArgumentError, check_not_negative
from railenv.units import KilometrePerHour
from railenv.vehicle import LateralVehicle

OF_THE_RUN: KilometrePerHour = 0.0
"""Default of the setting `design_kmh`: the law is designed for the speed at which it runs."""


@dataclass(frozen=True)
class Registered:
    """A controller that can be named.

    Attributes:
        name: What is typed.
        description: One line.
        source: Where the law comes from.
        settings: Name, default and unit of each setting; a default that is a text makes it a word.
        build: Makes the controller from the vehicle of the run and the settings.
    """

    name: str
    description: str
    source: str
    settings: dict[str, tuple[float | str, str]]
    build: Callable[..., Controller]


def designed_for(vehicle: LateralVehicle, design_kmh: float) -> LateralVehicle:
    """Return the vehicle a law is designed for: that of the run, at its speed or at another one.

    Args:
        vehicle: The vehicle of the run.
        design_kmh: Speed of the design [km/h]; zero for that of the run.
    """
    speed = check_not_negative("design_kmh", design_kmh, "km/h")
    if speed == OF_THE_RUN:
        return vehicle
    return LateralVehicle(vehicle.parameters, vehicle.layout, speed / 3.6)


def check_switch(name: str, value: float) -> bool:
    """Return whether a setting that is 0 or 1 is 1.

    Raises:
        ArgumentError: It is another number.
    """
    if value not in (0.0, 1.0):
        raise ArgumentError(f"{name} = {value:g} must be 0 (no) or 1 (yes)")
    return bool(value)
