"""The railway vehicle: coordinates, parameters, the linear lateral model and its modes."""

from railenv.errors import check_positive
from railenv.units import from_kmh
from railenv.vehicle.catalogue import Vehicle, get_vehicle, vehicle_names
from railenv.vehicle.coordinates import parse_layout
from railenv.vehicle.linear import LateralVehicle
from railenv.vehicle.modes import mode_name
from railenv.vehicle.parameters import VehicleParameters
from railenv.vehicle.statespace import StateSpace, state_space

__all__ = [
    "LateralVehicle",
    "StateSpace",
    "Vehicle",
    "VehicleParameters",
    "get_vehicle",
    "lateral17",
    "mode_name",
    "state_space",
    "vehicle_names",
]


def lateral17(
    vehicle: str | VehicleParameters = "paper_fit",
    layout: object = 4,
    speed_kmh: float = 300.0,
) -> LateralVehicle:
    """Return the linear 17-coordinate lateral vehicle.

    Args:
        vehicle: Name of a catalogued vehicle, or parameters of your own.
        layout: "passive", 2 or 4: how many lateral dampers are replaced by actuators.
        speed_kmh: Running speed [km/h], above zero.

    Returns:
        The vehicle; `state_space(vehicle)` gives its matrices.

    Raises:
        ArgumentError: Unknown vehicle or layout, or a speed that is not above zero.
    """
    parameters = get_vehicle(vehicle).parameters if isinstance(vehicle, str) else vehicle
    speed = from_kmh(check_positive("speed_kmh", speed_kmh, "km/h"))
    return LateralVehicle(parameters, parse_layout(layout), speed)
