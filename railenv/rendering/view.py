"""What a picture of the running vehicle shows: plain numbers in SI units, no drawing.

Axes are those of `railenv.vehicle.coordinates`: x forward, y right, z down; positive roll puts the
right side down, positive yaw turns the nose to the right; an actuator's force is positive to the
right on the carbody, its reaction acts on the bogie. Whoever fills a `View` decides what is true;
this room only draws it.
"""

import dataclasses
from dataclasses import dataclass, field

import numpy as np

from railenv.errors import (
    ArgumentError,
    check_finite,
    check_not_negative,
    check_positive,
)
from railenv.units import (
    Dimensionless,
    FloatArray,
    MetrePerSecond,
    Newton,
    Second,
)
from railenv.vehicle import VehicleParameters, get_vehicle
from railenv.vehicle.coordinates import (
    NUM_COORDINATES,
    WHEELSETS,
    actuator_positions,
    coordinate_index,
    lateral_of_point,
    parse_layout,
)
from railenv.vehicle.linear import FASTEST

NUM_FLOORS = 2
"""Floor places whose acceleration and ride index are shown: front, rear."""

ENDINGS = ("", "gauge", "divergence", "derailment")
"""Why an episode ended; the empty text while it goes on."""

LARGEST = 1e100
"""Larger values are refused, in any unit: geometry could overflow, and nothing runs there."""

LONGEST_TIME = 1e6
"""Longest time and delay that are labelled [s]."""

_NOT_YET_KNOWN = ("ride_index",)
_OF_WHEELSETS = ("wheelset_roll", "wheelset_lift")


def _default_parameters() -> VehicleParameters:
    return get_vehicle("paper_fit").parameters


@dataclass(frozen=True, eq=False)
class View:
    """One instant of a run, with the past and the track around it that the picture needs.

    Attributes:
        time: Time since the start [s].
        speed: Running speed [m/s].
        layout: "2" or "4" actuators.
        coordinates: The vehicle's coordinates in the order of `COORDINATES`, shape (17,) [m, rad].
        force: Force that acts now in each actuator, shape (channels,) [N].
        command: Newest command of each actuator, shape (channels,) [N].
        force_limit: Largest force of an actuator [N]; None for none.
        delay: Delay of each actuator, shape (channels,) [s].
        max_delay: Longest delay on the pipe's axis [s].
        pipe_age: Age of each past command, newest first, shape (k,) [s].
        pipe_command: Those commands, shape (k, channels) [N].
        track_distance: Places ahead of the carbody's centre, rising, shape (d,) [m].
        track_alignment: Lateral alignment there, to the right, shape (d,) [m].
        track_cross_level: Cross level there, right rail down, shape (d,) [m].
        history_time: Past instants, rising up to 0, shape (h,) [s].
        history_acceleration: Lateral acceleration of floor front and rear, shape (h, 2) [m/s^2].
        ride_index: Running ride index of floor front and rear, shape (2,) [1]; NaN: not yet known.
        reward: Reward of the last step [1]; None where there is none.
        ended_by: "", "gauge", "divergence" or "derailment".
        parameters: The vehicle's numbers, for the proportions of the drawing.
        wheelset_roll: Roll of wheelsets 1 to 4, shape (4,) [rad]; None: as of the track there.
        wheelset_lift: Their heights above the rails, shape (4,) [m]; None: they stay on them.

    Raises:
        ArgumentError: An array has the wrong shape, a value is not finite, or an order is wrong.
    """

    time: Second
    speed: MetrePerSecond
    layout: str
    coordinates: FloatArray
    force: FloatArray
    command: FloatArray
    force_limit: Newton | None
    delay: FloatArray
    max_delay: Second
    pipe_age: FloatArray
    pipe_command: FloatArray
    track_distance: FloatArray
    track_alignment: FloatArray
    track_cross_level: FloatArray
    history_time: FloatArray
    history_acceleration: FloatArray
    ride_index: FloatArray
    reward: Dimensionless | None
    ended_by: str
    parameters: VehicleParameters = field(default_factory=_default_parameters)
    wheelset_roll: FloatArray | None = None
    wheelset_lift: FloatArray | None = None

    def __post_init__(self) -> None:
        check_not_negative("time", self.time, "seconds")
        check_positive("speed", self.speed, "m/s")
        check_not_negative("max_delay", self.max_delay, "seconds")
        if self.reward is not None:
            check_finite("reward", self.reward)
        longest = (("time", LONGEST_TIME), ("max_delay", LONGEST_TIME), ("speed", FASTEST))
        for name, largest in longest:
            if getattr(self, name) > largest:
                raise ArgumentError(
                    f"{name} = {getattr(self, name):g} is beyond what a picture can label; give "
                    f"{largest:g} or less"
                )
        if self.force_limit is not None:
            check_positive("force_limit", self.force_limit, "N")
        if self.ended_by not in ENDINGS:
            raise ArgumentError(
                f"ended_by = {self.ended_by!r} is no ending; give one of {', '.join(ENDINGS[1:])} "
                "or an empty text"
            )
        self._check_shapes()
        self._check_numbers()

    @property
    def num_actuators(self) -> int:
        """Number of actuator channels."""
        return len(actuator_positions(parse_layout(self.layout)))

    @property
    def places(self) -> tuple[int, ...]:
        """Damper place of each channel (1, 2 at the front bogie, 3, 4 at the rear one)."""
        return actuator_positions(parse_layout(self.layout))

    def coordinate(self, name: str) -> float:
        """Return one coordinate by name [m or rad]."""
        return float(self.coordinates[coordinate_index(name)])

    def lateral(self, body: str, x: float, height: float = 0.0) -> float:
        """Return the lateral displacement of a point of a body [m].

        Args:
            body: "carbody", "bogie1" or "bogie2".
            x: Place ahead of the body's centre [m].
            height: Body's centre of gravity minus point, positive where the point is lower [m].
        """
        return float(lateral_of_point(body, x, height) @ self.coordinates)

    def track_at(self, distance: float) -> tuple[float, float]:
        """Return alignment [m] and cross level [m] at a distance ahead of the carbody's centre.

        Beyond the ends of the given piece of track its last values stand.
        """
        alignment = np.interp(distance, self.track_distance, self.track_alignment)
        cross_level = np.interp(distance, self.track_distance, self.track_cross_level)
        return float(alignment), float(cross_level)

    def _check_shapes(self) -> None:
        channels = self.num_actuators
        if channels == 0:
            raise ArgumentError("layout = 'passive' has no actuator to show; give 2 or 4")
        ages, places, past = len(self.pipe_age), len(self.track_distance), len(self.history_time)
        if past == 0 or places == 0:
            raise ArgumentError(
                "history_time and track_distance must hold at least one value; give the present"
            )
        wanted = {
            "coordinates": (NUM_COORDINATES,),
            "force": (channels,),
            "command": (channels,),
            "delay": (channels,),
            "pipe_age": (ages,),
            "pipe_command": (ages, channels),
            "track_distance": (places,),
            "track_alignment": (places,),
            "track_cross_level": (places,),
            "history_time": (past,),
            "history_acceleration": (past, NUM_FLOORS),
            "ride_index": (NUM_FLOORS,),
        }
        for name, shape in wanted.items():
            found = getattr(self, name).shape
            if found != shape:
                raise ArgumentError(f"{name} has shape {found}; it must be {shape}")
        for name in _OF_WHEELSETS:
            given: FloatArray | None = getattr(self, name)
            if given is not None and given.shape != (len(WHEELSETS),):
                raise ArgumentError(
                    f"{name} has shape {given.shape}; it must be ({len(WHEELSETS)},), or None"
                )

    def _check_numbers(self) -> None:
        for entry in dataclasses.fields(self):
            if entry.type != FloatArray and entry.name not in _OF_WHEELSETS:
                continue
            values: FloatArray | None = getattr(self, entry.name)
            if values is None or entry.name in _NOT_YET_KNOWN:
                continue
            if not np.all(np.abs(values) <= LARGEST):
                raise ArgumentError(
                    f"{entry.name} holds a value that is not finite or beyond {LARGEST:g}; show "
                    "the last one within"
                )
        if np.any(np.isinf(self.ride_index)) or np.any(self.ride_index < 0.0):
            raise ArgumentError("ride_index must be zero or more, or NaN where it is not yet known")
        if np.any(self.delay < 0.0) or np.any(self.pipe_age < 0.0):
            raise ArgumentError("delay and pipe_age must not be negative; give seconds")
        for name in ("pipe_age", "track_distance", "history_time"):
            rising: FloatArray = getattr(self, name)
            if np.any(np.diff(rising) <= 0.0):
                raise ArgumentError(f"{name} must rise from value to value; sort it")
        if self.history_time[-1] > 0.0:
            raise ArgumentError(
                f"history_time ends at {self.history_time[-1]:g} s; it is the past, "
                "so it must not pass 0"
            )
