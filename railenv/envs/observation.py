"""What a controller sees: sensors, then the actions still in the pipe.

The standard sensors are what a railway vehicle can carry: lateral velocity and acceleration of the
carbody at the actuators, lateral acceleration of the bogies, roll and yaw rate of the carbody and
the strokes of the secondary suspension. `observation="state"` gives the model's states instead.

Simulation, benchmark and environment share this module, so that a column means the same in each.
"""

import math
from dataclasses import dataclass

import numpy as np

from railenv.errors import ArgumentError, check_not_negative, unknown_name
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle, state_space
from railenv.vehicle.coordinates import (
    DAMPER_POSITIONS,
    Layout,
    actuator_positions,
    damper_positions,
)

DEFAULT_ACTION_SCALE = 3000.0
"""Force of an action of one [N]; normal forces are 0.1 to 1 kN, the force limit stands apart."""

DEFAULT_MAX_DELAY = 0.3
"""Longest delay whose pipe of actions is observed [s]."""

OBSERVATIONS = ("sensors", "state")
SCALES = ("controlled", "si")

# By what the name says: bound, unit, and the scale of the controlled response. Normal motion stays
# far inside the bounds: they are where a real transducer of the kind ends, and finite as agents
# require. The scales are the root mean squares of the 4-actuator vehicle `paper_fit` at 300 km/h on
# track German low under sky-hook 10 kN s/m without delay, rounded (tests/test_envs_observation.py).
_SENSORS = (
    ("rail_offset", 1.0, "m", 0.002),
    ("displacement", 1.0, "m", 0.005),
    ("stroke_rate", 5.0, "m/s", 0.08),
    ("stroke", 0.5, "m", 0.006),
    ("bogie1_roll_rate", 5.0, "rad/s", 0.015),
    ("bogie2_roll_rate", 5.0, "rad/s", 0.015),
    ("bogie1_yaw_rate", 5.0, "rad/s", 0.02),
    ("bogie2_yaw_rate", 5.0, "rad/s", 0.02),
    ("roll_rate", 2.0, "rad/s", 0.007),
    ("yaw_rate", 2.0, "rad/s", 0.001),
    ("roll_acceleration", 20.0, "rad/s^2", 0.06),
    ("yaw_acceleration", 20.0, "rad/s^2", 0.014),
    ("carbody_lateral_velocity", 5.0, "m/s", 0.02),
    ("bogie1_lateral_acceleration", 200.0, "m/s^2", 1.7),
    ("bogie2_lateral_acceleration", 200.0, "m/s^2", 1.7),
    ("lateral_acceleration", 50.0, "m/s^2", 0.15),
)
_STATE_BOUND = 100.0
# The first part of a state's name that fits tells its scale.
_STATE_SCALES = (
    ("carbody_lateral_velocity", 0.02),
    ("carbody_yaw_velocity", 0.001),
    ("carbody_roll_velocity", 0.007),
    ("lateral_velocity", 0.07),
    ("yaw_velocity", 0.02),
    ("roll_velocity", 0.015),
    ("lateral_damper", 0.006),
    ("yaw_damper", 0.0009),
    ("carbody_yaw", 0.00016),
    ("roll", 0.001),
    ("yaw", 0.0009),
    ("lateral", 0.004),
)


def sensor_names(layout: Layout) -> tuple[str, ...]:
    """Return the standard sensors of a layout, in the order of the observation's columns."""
    places = actuator_positions(layout) or damper_positions(layout)
    return (
        *(f"carbody_lateral_velocity_{k}" for k in places),
        *(f"carbody_lateral_acceleration_{k}" for k in places),
        "bogie1_lateral_acceleration",
        "bogie2_lateral_acceleration",
        "carbody_roll_rate",
        "carbody_yaw_rate",
        *(f"suspension_stroke_{k}" for k in DAMPER_POSITIONS),
    )


def measured_names(vehicle: LateralVehicle, observation: str) -> tuple[str, ...]:
    """Return the measured columns of an observation.

    Args:
        vehicle: Gives layout and states.
        observation: "sensors" or "state".

    Raises:
        ArgumentError: Any other word.
    """
    if observation == "sensors":
        return sensor_names(vehicle.layout)
    if observation == "state":
        return state_space(vehicle).states
    raise unknown_name("observation", observation, OBSERVATIONS)


def bound(name: str) -> tuple[float, str, float]:
    """Return the largest reading of a measured column, its unit, and its controlled response.

    Raises:
        ArgumentError: It is neither a motion that a sensor reads nor a state of the linear vehicle.
    """
    for part, limit, unit, scale in _SENSORS:
        if part in name and not name.endswith(("_velocity", "_node")):
            return limit, unit, scale
    scale = next((scale for part, scale in _STATE_SCALES if part in name), None)
    if scale is None or name.startswith("track_roll") or name.endswith("_force"):
        raise ArgumentError(
            f"{name!r} has no controlled response on record; choose a sensor or a state"
        )
    angular = name.split("_")[1] in ("yaw", "roll") and not name.endswith("_node")
    unit = ("rad" if angular else "m") + ("/s" if name.endswith("_velocity") else "")
    return _STATE_BOUND, unit, scale


def pipe_length(max_delay: float, control_period: float) -> int:
    """Return how many issued actions can still be on their way or just arriving.

    Args:
        max_delay: Longest delay [s].
        control_period: Time between actions [s].
    """
    periods = check_not_negative("max_delay", max_delay, "seconds") / control_period
    # 0.3 / 0.01 is a hair above 30: rounding must not add a column.
    return math.ceil(periods - 1e-9)


@dataclass
class Observer:
    """Builds observations for a batch: measured columns, then past actions, newest first.

    Attributes:
        names: Measured columns.
        num_channels: Channels of an action.
        length: Past actions kept.
    """

    names: tuple[str, ...]
    num_channels: int
    length: int

    def __post_init__(self) -> None:
        self._pipe = np.zeros((1, self.length, self.num_channels))

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of all columns; `action_2_ago_1` is channel 1's action of two periods ago."""
        past = (
            f"action_{age}_ago_{channel}"
            for age in range(1, self.length + 1)
            for channel in range(1, self.num_channels + 1)
        )
        return (*self.names, *past)

    def reset(self, num_lanes: int) -> None:
        """Empty the pipe."""
        self._pipe = np.zeros((num_lanes, self.length, self.num_channels))

    def push(self, actions: FloatArray) -> None:
        """Note the actions just issued, shape (lanes, channels) [1]."""
        if self.length:
            self._pipe[:, 1:] = self._pipe[:, :-1].copy()
            self._pipe[:, 0] = actions

    def observe(self, measured: FloatArray) -> FloatArray:
        """Return the observation, shape (lanes, columns), a new array.

        Args:
            measured: Measured columns now, shape (lanes, len(names)), SI units.
        """
        lanes = measured.shape[0]
        return np.concatenate([measured, self._pipe.reshape(lanes, -1)], axis=1)
