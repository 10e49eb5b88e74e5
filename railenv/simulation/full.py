"""A batch of nonlinear vehicles, each lane with its own vehicle, delays, clock and track.

It stands where `railenv.simulation.batch.VehicleBatch` stands for the linear model: somebody writes
commands before a control period and reads outputs after it.
"""

from collections.abc import Sequence

import numpy as np

from railenv.actuation import ActuatorSpec, DelayLine
from railenv.actuation.delay_line import BoolArray, IntArray
from railenv.errors import ArgumentError, check_positive
from railenv.simulation.excitation import Places
from railenv.simulation.full_outputs import output_rows
from railenv.simulation.full_stepping import (
    RUNNING,
    FullLanes,
    RunningGear,
    advance_full,
    sample_rails,
)
from railenv.simulation.lateral import whole_multiple
from railenv.track.irregularity import flat
from railenv.track.table import (
    FULL_CHANNELS,
    PooledTrack,
    TrackArrays,
    single_track,
    table_of,
)
from railenv.units import FloatArray
from railenv.vehicle.nonlinear import FullVehicle, rate_of_change
from railenv.vehicle.nonlinear.curve import CurveArrays, straight_line
from railenv.vehicle.nonlinear.rates import WHEEL_COLUMNS, FullArrays
from railenv.vehicle.nonlinear.steady import steady_rolling

DEFAULT_FULL_STEP = 0.0005
"""Physics step [s]; docs/full50.md shows what halving it changes."""

_STABLE = 2.5  # of 2.78 for the classical method on a real root


class FullBatch:
    """Lanes of nonlinear vehicles.

    Args:
        vehicles: Vehicles to choose from, of one layout and contact.
        num_lanes: Number of lanes.
        tracks: Tracks to choose from, with all four channels; see `railenv.track.table`.
        recorded: Names of the outputs recorded inside a control period.
        sampled: Names of the outputs at its end.
        actuator: Force and rate limit; its lag is the vehicle's.
        longest_delay: Longest delay, jitter included, that a lane may get [s].
        control_period: Time between commands [s], a whole multiple of `record_step`.
        record_step: Time between records [s], a whole multiple of `time_step`.
        time_step: Physics step [s].
        curves: The line; None for straight track.
        specific_force: Accelerometers measure y'' - g roll.

    Attributes:
        step: Physics steps since each lane's start, shape (lanes,).
        commands: Wanted forces of the coming period, shape (lanes, channels) [N].
        later: What these are late beyond the delay, shape (lanes, channels) [s].
        lost: Which of these get lost, shape (lanes, channels).
        active: Lanes that take part in the coming period, shape (lanes,).
        recorded: Outputs after each record step of the last period, (lanes, records, p).
        sampled: Outputs at its end, shape (lanes, q).
        places: Where the lanes run.

    Raises:
        ArgumentError: Vehicles differ in layout, contact or lag, a step does not divide the next
            one, or the physics step is too long for the slowest vehicle.
    """

    def __init__(
        self,
        vehicles: Sequence[FullVehicle],
        num_lanes: int,
        tracks: Sequence[PooledTrack] = (),
        *,
        recorded: Sequence[str] = (),
        sampled: Sequence[str] = (),
        actuator: ActuatorSpec | None = None,
        longest_delay: float = 0.0,
        control_period: float = 0.01,
        record_step: float = 0.005,
        time_step: float = DEFAULT_FULL_STEP,
        curves: CurveArrays | None = None,
        specific_force: bool = False,
    ) -> None:
        spec = ActuatorSpec() if actuator is None else actuator
        self.vehicles, self.time_step = tuple(vehicles), _checked_step(time_step, vehicles)
        first = self.vehicles[0]
        _check_alike(self.vehicles, spec)
        every = whole_multiple("record_step", record_step, "time_step", time_step)
        records = whole_multiple("control_period", control_period, "record_step", record_step)
        self.steps_per_command = every * records
        self._rows = output_rows(
            self.vehicles,
            recorded,
            sampled,
            every=every,
            time_step=time_step,
            specific_force=specific_force,
        )
        self._contact, self._creep = first.contact_arrays, first.creep_arrays
        self._stack = stacked(self.vehicles)
        self._gear = RunningGear(
            speed=np.array([vehicle.speed for vehicle in self.vehicles]),
            setback=np.array([vehicle.wheelset_setback for vehicle in self.vehicles]),
        )
        self._curves = straight_line() if curves is None else curves
        pool = tracks or (single_track(flat(1.0), FULL_CHANNELS),)
        self._tracks = table_of(pool)
        m = first.num_actuators
        self.line = DelayLine(num_lanes, m, time_step, self.steps_per_command, longest_delay, spec)
        self.lanes = FullLanes(
            vehicle=np.zeros(num_lanes, dtype=np.int64),
            state=np.zeros((num_lanes, first.num_states)),
            step=np.zeros(num_lanes, dtype=np.int64),
            force=np.zeros((num_lanes, m)),
            ended=np.zeros(num_lanes, dtype=np.int64),
            wheels=np.zeros((num_lanes, 8, len(WHEEL_COLUMNS))),
        )
        self.places = Places(
            track=np.zeros(num_lanes, dtype=np.int64),
            start=np.zeros(num_lanes),
            taper=np.array([pool[0].taper] * num_lanes),
            running=np.zeros(num_lanes, dtype=bool),
            amplitude=np.ones(num_lanes),
        )
        self.commands: FloatArray = np.zeros((num_lanes, m))
        self.later: FloatArray = np.zeros((num_lanes, m))
        self.lost: BoolArray = np.zeros((num_lanes, m), dtype=bool)
        self.active: BoolArray = np.ones(num_lanes, dtype=bool)
        self.recorded: FloatArray = np.zeros((num_lanes, records, len(recorded)))
        self.sampled: FloatArray = np.zeros((num_lanes, len(sampled)))
        self._rest = steady_rolling(self.vehicles)

    @property
    def step(self) -> IntArray:
        """Physics steps since each lane's start, shape (lanes,)."""
        return self.lanes.step

    @property
    def num_lanes(self) -> int:
        """Number of lanes."""
        return len(self.lanes.step)

    def run_on(self, tracks: TrackArrays) -> None:
        """Put other tracks in place of those there are; `places` must fit them."""
        self._tracks = tracks

    def rails(self, lane: int) -> FloatArray:
        """Return places and rates of the rails under the wheels of one lane now, shape (8, 4).

        Columns are those of `railenv.simulation.full_stepping.sample_rails`.
        """
        car, rails = int(self.lanes.vehicle[lane]), np.zeros((8, 4))
        lead = float(self._gear.speed[car]) * self.time_step * int(self.lanes.step[lane])
        sample_rails(self._tracks, self.places, self._gear, lane, car, lead, rails)
        return rails

    def start(
        self,
        lanes: IntArray,
        vehicles: IntArray,
        delays: FloatArray,
        state: FloatArray | None = None,
    ) -> None:
        """Put lanes back to time zero; `places` must say where they run.

        Args:
            lanes: Lane numbers, shape (k,).
            vehicles: Vehicle of each, shape (k,).
            delays: Delay of every channel, shape (k, channels) [s].
            state: States, shape (k, states); None for steady rolling.
        """
        here = self.lanes
        here.vehicle[lanes] = vehicles
        here.state[lanes] = self._rest[vehicles] if state is None else state
        here.step[lanes] = 0
        here.force[lanes] = 0.0
        here.ended[lanes] = 0
        here.wheels[lanes] = 0.0
        self.line.start(lanes, delays)
        for lane in lanes:
            self._measure(int(lane))

    def _measure(self, lane: int) -> None:
        """Take the outputs of a lane before anything has moved."""
        here, rows = self.lanes, self._rows
        car = int(here.vehicle[lane])
        rails = self.rails(lane)
        state = here.state[lane]
        rate, wheels = rate_of_change(self.vehicles[car], state, rails)
        here.wheels[lane] = wheels
        n = len(self.vehicles[car].arrays.mass)
        vector = np.concatenate(
            [state[: 2 * n], rate[n : 2 * n], here.force[lane], rails[:, 0], rails[:, 1]]
        )
        products = rows.value[car] * vector[rows.column]
        values = np.array(
            [products[a:b].sum() for a, b in zip(rows.start, rows.start[1:], strict=False)]
        )
        self.recorded[lane] = values[: rows.recorded]
        self.sampled[lane] = values[rows.recorded :]

    def advance(self, first: int, end: int) -> None:
        """Send the commands of the lanes from `first` to before `end` and advance them a period."""
        here = self.lanes
        # Time stands still in a lane that has ended: commands would pile up there.
        running = self.active & (here.ended == RUNNING)
        self.line.issue(here.step, running, first, end, self.commands, self.later, self.lost)
        advance_full(
            self._stack,
            self._contact,
            self._creep,
            self._gear,
            self._curves,
            here,
            self.line.arrays,
            self._tracks,
            self.places,
            self._rows,
            self.active,
            self.steps_per_command,
            first,
            end,
            self.recorded,
            self.sampled,
        )


def stacked(vehicles: Sequence[FullVehicle]) -> FullArrays:
    """Put the arrays of vehicles of one structure side by side."""
    each = [vehicle.arrays for vehicle in vehicles]
    first = each[0]
    return FullArrays(
        mass=np.array([a.mass for a in each]),
        load=np.array([a.load for a in each]),
        start=first.start,
        column=first.column,
        stiffness=np.array([a.stiffness for a in each]),
        damping=np.array([a.damping for a in each]),
        row_start=first.row_start,
        row_column=first.row_column,
        row_value=np.array([a.row_value for a in each]),
        damper=np.array([a.damper for a in each]),
        stop=np.array([a.stop for a in each]),
        counts=first.counts,
        scalars=np.array([a.scalars for a in each]),
        law=first.law,
    )


def longest_step(vehicle: FullVehicle) -> float:
    """Return the longest physics step that is stable at the vehicle's speed [s].

    Explicit Runge-Kutta steps stay stable up to 2.78 / |s|. Creep damps a wheelset's rotation
    fastest, at a rate of 2 f_11 r_0^2 / (I_wy V); the largest frequency is some 2000 rad/s.
    """
    p = vehicle.parameters
    turning = 2.0 * p.lateral.creep_longitudinal * p.lateral.wheel_radius**2
    fastest = max(2000.0, 1.2 * turning / (p.wheelset_pitch_inertia * vehicle.speed))
    return _STABLE / fastest


def _check_alike(vehicles: Sequence[FullVehicle], actuator: ActuatorSpec) -> None:
    first = vehicles[0]
    for vehicle in vehicles:
        if vehicle.layout != first.layout or vehicle.contact != first.contact:
            raise ArgumentError("vehicles of one batch must share layout and contact settings")
        for name in ("start", "column", "row_start", "row_column"):
            if not np.array_equal(getattr(vehicle.arrays, name), getattr(first.arrays, name)):
                raise ArgumentError(
                    "vehicles of one batch must have the same elements; a coefficient is zero in "
                    "one and not in another"
                )
        if vehicle.actuator_lag != actuator.lag:
            raise ArgumentError(
                f"actuator_lag = {vehicle.actuator_lag:g} s of the vehicle differs from the "
                f"actuator's lag = {actuator.lag:g} s; give both the same"
            )


def _checked_step(time_step: float, vehicles: Sequence[FullVehicle]) -> float:
    step = check_positive("time_step", time_step, "seconds")
    for vehicle in vehicles:
        longest = longest_step(vehicle)
        if step > longest:
            raise ArgumentError(
                f"time_step = {step:g} s is too long at {vehicle.speed:.4g} m/s, where creep damps "
                f"the wheelsets' rotation fast; give {longest:.2g} s or less"
            )
    return step
