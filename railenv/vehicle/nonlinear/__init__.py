"""The nonlinear vehicle with 50 coordinates, on wheels that touch rails."""

from typing import Any

from railenv.errors import check_positive
from railenv.units import from_kmh
from railenv.vehicle.catalogue import get_vehicle
from railenv.vehicle.coordinates import parse_layout
from railenv.vehicle.nonlinear.equilibrium import (
    Equilibrium,
    NoEquilibriumError,
    equilibrium,
    linearised,
    rate_of_change,
)
from railenv.vehicle.nonlinear.model import ContactSettings, FullVehicle
from railenv.vehicle.nonlinear.parameters import FullParameters
from railenv.vehicle.parameters import VehicleParameters

__all__ = [
    "ContactSettings",
    "Equilibrium",
    "FullParameters",
    "FullVehicle",
    "NoEquilibriumError",
    "equilibrium",
    "full50",
    "linearised",
    "rate_of_change",
]


def full50(
    vehicle: str | VehicleParameters | FullParameters = "paper_fit",
    layout: object = 4,
    speed_kmh: float = 300.0,
    contact: ContactSettings | None = None,
    **settings: Any,
) -> FullVehicle:
    """Return the nonlinear 50-coordinate vehicle.

    Args:
        vehicle: Name of a catalogued vehicle, parameters of its lateral model, or all parameters.
        layout: "passive", 2 or 4: how many lateral dampers are replaced by actuators.
        speed_kmh: Running speed [km/h], above zero.
        contact: Wheel on rail; None for S1002 wheels (for 1353 mm between their backs) on CN60.
        settings: Further fields of `FullVehicle`.

    Raises:
        ArgumentError: Unknown vehicle, layout or setting, or a speed that is not above zero.
    """
    lateral = get_vehicle(vehicle).parameters if isinstance(vehicle, str) else vehicle
    if isinstance(lateral, VehicleParameters):
        lateral = FullParameters(lateral=lateral)
    speed = from_kmh(check_positive("speed_kmh", speed_kmh, "km/h"))
    bare = FullVehicle(lateral, parse_layout(layout), speed, contact or ContactSettings())
    return bare.replace(**settings) if settings else bare
