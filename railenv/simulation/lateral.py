"""Simulation of one linear lateral vehicle in many lanes on recorded tracks.

All lanes share the vehicle, the actuator and the step sizes; each lane has its own delays, track
and start. One call of `advance` takes one command per lane and channel and moves every lane by one
control period. Time is computed from the step count.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from railenv.actuation import ActuatorSpec
from railenv.errors import ArgumentError, check_positive
from railenv.simulation.batch import VehicleBatch
from railenv.simulation.late_commands import checked_delays, send
from railenv.simulation.plant import PlantTable
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle, StateSpace
from railenv.vehicle.suspension import NUM_TRACK

DEFAULT_CONTROL_PERIOD = 0.01
"""Control period [s]."""

DEFAULT_TIME_STEP = 0.005
"""Physics step [s]; the effect of the track's hold at this step is in docs/model.md."""

SHORTEST_STEP = 1e-5
"""Shortest physics step [s]; steps are exact, so nothing is gained below."""


class LateralSimulation:
    """A batch of linear lateral vehicles.

    Args:
        vehicle: The vehicle, shared by all lanes.
        outputs: Names of the outputs or states recorded at every physics step.
        actuator: Limits and lag, shared by all lanes.
        control_period: Time between commands [s], a whole multiple of `time_step`.
        time_step: Physics step [s].
        specific_force: Accelerometers measure y'' - g roll.

    Raises:
        ArgumentError: A step size is not above zero, the control period is no whole multiple of the
            physics step, or an output's name is unknown.
    """

    def __init__(
        self,
        vehicle: LateralVehicle,
        outputs: Sequence[str],
        *,
        actuator: ActuatorSpec | None = None,
        control_period: float = DEFAULT_CONTROL_PERIOD,
        time_step: float = DEFAULT_TIME_STEP,
        specific_force: bool = False,
    ) -> None:
        self.vehicle = vehicle
        self.actuator = ActuatorSpec() if actuator is None else actuator
        self.control_period = check_positive("control_period", control_period, "seconds")
        self.time_step = check_time_step(time_step)
        self.steps_per_command = whole_multiple(
            "control_period", self.control_period, "time_step", self.time_step
        )
        # What is recorded at every step serves for the start as well.
        self.outputs = tuple(outputs)
        self._table = PlantTable(
            [vehicle], outputs, outputs, self.actuator, self.time_step, specific_force
        )
        self.system: StateSpace = self._table.systems[0]
        self._start(1, 0.0)

    def _start(self, num_lanes: int, longest_delay: float) -> None:
        self.step_count, self._longest_jitter = 0, 0.0
        self._batch = VehicleBatch(
            self._table, num_lanes, self.steps_per_command, longest_delay, self.actuator
        )
        self._track: FloatArray | None = None
        self._track_of_lane: NDArray[np.int64] = np.zeros(num_lanes, dtype=np.int64)

    @property
    def num_lanes(self) -> int:
        """Number of lanes, fixed by the last reset."""
        return len(self._batch.step)

    @property
    def time(self) -> float:
        """Time since the reset [s]."""
        return self.step_count * self.time_step

    @property
    def state(self) -> FloatArray:
        """States of all lanes, forces of lagged actuators last, shape (lanes, states)."""
        return self._batch.states()

    @property
    def amplitude(self) -> FloatArray:
        """Largest amplitude of a vehicle's modes, shape (lanes,).

        A mode of amplitude one moves the state by a vector of length one [m, rad, m/s, rad/s].
        """
        return np.abs(self._batch.lanes.state).max(axis=1)

    def stop(self, lanes: NDArray[np.bool_]) -> None:
        """Put the vehicles of some lanes to rest."""
        self._batch.lanes.state[lanes] = 0.0

    def reset(
        self,
        delays: FloatArray,
        track_inputs: FloatArray | None = None,
        track_of_lane: NDArray[np.int64] | None = None,
        initial_state: FloatArray | None = None,
        longest_jitter: float = 0.0,
    ) -> None:
        """Put every lane back to time zero with an empty delay line.

        Args:
            delays: Delay of every lane and channel, shape (lanes, channels) [s].
            track_inputs: Tracks as `excitation.wheelset_inputs` gives them, shape (tracks, steps +
                1, 8); None for a straight level track of any length.
            track_of_lane: Track of each lane, shape (lanes,); None for the first one everywhere.
            initial_state: Vehicle states at the start, shape (lanes, states) or (states,); None for
                rest. Lagged actuators start without force.
            longest_jitter: What a command may be late beyond its delay [s]; see `advance`.

        Raises:
            ArgumentError: An array has the wrong shape, a delay is negative or not finite, or the
                actuator is too fast for delays that vary.
        """
        m, n = self.system.num_actuators, self.system.A.shape[0]
        longest, num_lanes = checked_delays(delays, m, longest_jitter), delays.shape[0]
        # Refused while the lanes are still what they were.
        self._batch.refuse_jitter_if_stiff(longest_jitter)
        self._start(num_lanes, longest)
        self._longest_jitter = longest_jitter
        state = np.zeros((num_lanes, self._table.num_states))
        if initial_state is not None:
            if initial_state.shape not in ((n,), (num_lanes, n)):
                raise ArgumentError(
                    f"initial_state has shape {initial_state.shape}; it must be ({n},) or "
                    f"({num_lanes}, {n})"
                )
            state[:, :n] = initial_state
        if track_inputs is not None:
            if track_inputs.ndim != 3 or track_inputs.shape[2] != NUM_TRACK:
                raise ArgumentError(
                    f"track_inputs has shape {track_inputs.shape}; "
                    f"it must be (tracks, steps + 1, {NUM_TRACK})"
                )
            self._track = np.ascontiguousarray(track_inputs)
        if track_of_lane is not None:
            tracks = 1 if self._track is None else len(self._track)
            self._track_of_lane = np.asarray(track_of_lane, dtype=np.int64)
            if self._track_of_lane.shape != (num_lanes,) or np.any(
                (self._track_of_lane < 0) | (self._track_of_lane >= tracks)
            ):
                raise ArgumentError("track_of_lane must hold one existing track number per lane")
        if self._track is not None:
            self._batch.track[:, -1] = self._track[self._track_of_lane, 0]
        everyone = np.arange(num_lanes, dtype=np.int64)
        self._batch.start(everyone, np.zeros_like(everyone), delays, state)

    def end_track(self) -> None:
        """Go on on straight level track, whatever lies ahead."""
        self._batch.end_track()
        self._track = None

    def measure(self) -> FloatArray:
        """Return the outputs at the start of a run, shape (lanes, outputs).

        Only right after a reset, before the first force; later the last column of what `advance`
        returns is the present.
        """
        return self._batch.sampled.copy()

    def advance(
        self,
        commands: FloatArray,
        later: FloatArray | None = None,
        lost: NDArray[np.bool_] | None = None,
    ) -> FloatArray:
        """Advance every lane by one control period.

        Args:
            commands: Wanted forces, before the limits, shape (lanes, channels) [N].
            later: What each command is late beyond its delay, at most the reset's `longest_jitter`,
                shape (lanes, channels) [s]; None for nothing.
            lost: Commands that get lost, so that the actuator holds its last one, shape (lanes,
                channels); None for none.

        Returns:
            The outputs at the end of each physics step, shape (lanes, steps, outputs), a new array.

        Raises:
            ArgumentError: An array has the wrong shape, a value is out of its range, or the track
                ends.
        """
        batch = self._batch
        send(batch, commands, later, lost, self._longest_jitter)
        first, end = self.step_count, self.step_count + self.steps_per_command
        if self._track is not None:
            if end >= self._track.shape[1]:
                last = (self._track.shape[1] - 1) * self.time_step
                raise ArgumentError(f"the track ends after {last:g} s; give a longer one")
            batch.track[:] = self._track[self._track_of_lane, first : end + 1]
        batch.advance(0, self.num_lanes)
        self.step_count = end
        return batch.recorded.copy()


def check_time_step(time_step: float) -> float:
    """Return a physics step.

    Raises:
        ArgumentError: It is not above zero, or shorter than `SHORTEST_STEP`.
    """
    step = check_positive("time_step", time_step, "seconds")
    if step < SHORTEST_STEP:
        raise ArgumentError(
            f"time_step = {step:g} s is too short; give {SHORTEST_STEP:g} s or more"
        )
    return step


# More periods than this are no run but a mistake.
_MOST_PERIODS = 1e8


def whole_multiple(longer_name: str, longer: float, shorter_name: str, shorter: float) -> int:
    """Return how many times one period holds another.

    Raises:
        ArgumentError: The ratio is not a whole number (to a relative 1e-9, far above rounding and
            far below any step that is meant to differ).
    """
    ratio = longer / shorter
    if ratio > _MOST_PERIODS:
        raise ArgumentError(
            f"{longer_name} = {longer:g} s is too long for {shorter_name} = {shorter:g} s; "
            f"give {_MOST_PERIODS * shorter:g} s or less"
        )
    number = round(ratio)
    if number < 1 or abs(ratio - number) > 1e-9 * ratio:
        raise ArgumentError(
            f"{longer_name} = {longer:g} s must be a whole multiple of "
            f"{shorter_name} = {shorter:g} s; change one of them"
        )
    return number
