"""What a controller of the nonlinear vehicle sees: the same sensors, or that vehicle's own states.

Scales of the states are the root mean squares of the 4-actuator vehicle `paper_fit` at 300 km/h on
track German low under sky-hook 10 kN s/m without delay, rounded (tests/test_envs_full_state.py).
Where the lateral model has a state of the same name, its scale is the same.
"""

from railenv.envs.observation import OBSERVATIONS, bound, sensor_names
from railenv.errors import unknown_name
from railenv.vehicle.nonlinear import FullVehicle
from railenv.vehicle.nonlinear.coordinates import MOTIONS

_STATE_BOUND = 100.0
# By body: places, then rates, in the order of `MOTIONS` [m, rad, m/s, rad/s].
_SCALES = {
    "carbody": (
        (0.002, 0.004, 0.0035, 0.001, 0.00025, 0.00016),
        (0.002, 0.02, 0.015, 0.007, 0.002, 0.001),
    ),
    "bogie": (
        (0.002, 0.004, 0.0035, 0.001, 0.0007, 0.0009),
        (0.007, 0.07, 0.035, 0.015, 0.035, 0.02),
    ),
    "wheelset": (
        (0.002, 0.004, 0.0035, 0.001, 0.4, 0.0009),
        (0.007, 0.07, 0.055, 0.06, 0.13, 0.02),
    ),
    "axle_box": ((0.003,) * 6, (0.15,) * 6),
}


def measured_names(vehicle: FullVehicle, observation: str) -> tuple[str, ...]:
    """Return the measured columns of an observation.

    Args:
        vehicle: Gives layout and states.
        observation: "sensors" or "state"; states are those of bodies and dampers, without the
            forces of lagged actuators.

    Raises:
        ArgumentError: Any other word.
    """
    if observation == "sensors":
        return sensor_names(vehicle.layout)
    if observation == "state":
        return tuple(name for name in vehicle.states if not name.startswith("actuator_force"))
    raise unknown_name("observation", observation, OBSERVATIONS)


def bound_of(name: str) -> tuple[float, str, float]:
    """Return the largest reading of a measured column, its unit, and its controlled response.

    Args:
        name: A sensor, or one of `FullVehicle.states`.
    """
    rate = name.endswith("_velocity")
    body, _, motion = name.removesuffix("_velocity").rpartition("_")
    if motion not in MOTIONS:
        return bound(name)
    scales = next(scales for part, scales in _SCALES.items() if body.startswith(part))
    column = MOTIONS.index(motion)
    unit = ("m" if column < MOTIONS.index("roll") else "rad") + ("/s" if rate else "")
    return _STATE_BOUND, unit, scales[rate][column]
