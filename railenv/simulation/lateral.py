"""Batch simulation of linear lateral vehicles with delayed actuators: the one physics loop.

All lanes share the vehicle, the actuator and the step sizes; each lane has its own delays, track
and start. One call of `advance` takes one command per lane and channel and moves every lane by one
control period. Time is computed from the step count.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from railenv.actuation import ActuatorSpec, DelayLine, held_input, ramped_input
from railenv.errors import ArgumentError, check_positive
from railenv.simulation.stepping import advance
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle, StateSpace, state_space
from railenv.vehicle.suspension import NUM_TRACK

DEFAULT_CONTROL_PERIOD = 0.01
"""Control period [s]."""

DEFAULT_TIME_STEP = 0.005
"""Physics step [s]; the effect of the track's hold at this step is in docs/model.md."""

SHORTEST_STEP = 1e-5
"""Shortest physics step [s]; steps are exact, so nothing is gained below."""

LONGEST_DELAY = 1000.0
"""Longest delay that is simulated [s]; its commands must be stored."""


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
        self.outputs = tuple(outputs)
        self.actuator = ActuatorSpec() if actuator is None else actuator
        self.control_period = check_positive("control_period", control_period, "seconds")
        self.time_step = check_positive("time_step", time_step, "seconds")
        if self.time_step < SHORTEST_STEP:
            raise ArgumentError(
                f"time_step = {time_step:g} s is too short; give {SHORTEST_STEP:g} s or more"
            )
        self.steps_per_command = whole_multiple(
            "control_period", self.control_period, "time_step", self.time_step
        )
        self.system: StateSpace = state_space(vehicle, specific_force=specific_force)
        self._track_of_lane: NDArray[np.int64]
        self._discretise()
        self._start(1)

    def _discretise(self) -> None:
        system, h = self.system, self.time_step
        m = system.num_actuators
        A, B = self.actuator.with_lag(system.A, system.actuator_input)
        num_lags = A.shape[0] - system.A.shape[0]
        track = np.vstack([system.B[:, m:], np.zeros((num_lags, 2 * NUM_TRACK))])
        transition, held = held_input(A, B, h)
        start, end = ramped_input(A, track[:, :NUM_TRACK], track[:, NUM_TRACK:], h)
        self._A, self._B = A, B
        self._transition = np.ascontiguousarray(transition.T)
        self._held = np.ascontiguousarray(held.T)
        self._ramp_start = np.ascontiguousarray(start.T)
        self._ramp_end = np.ascontiguousarray(end.T)

        C, D = system.output_rows(self.outputs)
        through = D[:, :m]
        # With a lag the force is a state of its own, no longer the arriving command.
        by_state = np.hstack([C, through]) if num_lags else C
        through = np.zeros_like(through) if num_lags else through
        self._output_state = np.ascontiguousarray(by_state.T)
        self._output_force = np.ascontiguousarray(through.T)
        # No output reads the track's rates: they reach the bogie frames' roll acceleration only.
        self._output_track = np.ascontiguousarray(D[:, m : m + NUM_TRACK].T)

    def _start(self, num_lanes: int) -> None:
        m = self.system.num_actuators
        self.step_count = 0
        self.state = np.zeros((num_lanes, self._A.shape[0]))
        self.line = DelayLine(num_lanes, m, self.time_step, self.steps_per_command)
        self._late = np.zeros((num_lanes, m, self._A.shape[0]))
        self._last_command = np.zeros((num_lanes, m))
        self.end_track()

    @property
    def num_lanes(self) -> int:
        """Number of lanes, fixed by the last reset."""
        return self.state.shape[0]

    @property
    def time(self) -> float:
        """Time since the reset [s]."""
        return self.step_count * self.time_step

    def reset(
        self,
        delays: FloatArray,
        track_inputs: FloatArray | None = None,
        track_of_lane: NDArray[np.int64] | None = None,
        initial_state: FloatArray | None = None,
    ) -> None:
        """Put every lane back to time zero with an empty delay line.

        Args:
            delays: Delay of every lane and channel, shape (lanes, channels) [s].
            track_inputs: Tracks as `excitation.wheelset_inputs` gives them, shape (tracks, steps +
                1, 8); None for a straight level track of any length.
            track_of_lane: Track of each lane, shape (lanes,); None for the first one everywhere.
            initial_state: Vehicle states at the start, shape (lanes, states) or (states,); None for
                rest. Lagged actuators start without force.

        Raises:
            ArgumentError: An array has the wrong shape, or a delay is negative or not finite.
        """
        m, n = self.system.num_actuators, self.system.A.shape[0]
        if delays.ndim != 2 or delays.shape[1] != m or delays.shape[0] == 0:
            raise ArgumentError(f"delays has shape {delays.shape}; it must be (lanes, {m})")
        if not np.all((delays >= 0.0) & (delays <= LONGEST_DELAY)):
            raise ArgumentError(
                "delays holds a value that is negative, not finite or above "
                f"{LONGEST_DELAY:g} s; give seconds"
            )
        self._start(delays.shape[0])
        self.line.reset(delays)
        for r in np.unique(self.line.remainder):
            _, effect = held_input(self._A, self._B, self.time_step - float(r))
            lanes, channels = np.nonzero(self.line.remainder == r)
            self._late[lanes, channels] = effect.T[channels]
        if initial_state is not None:
            if initial_state.shape not in ((n,), (self.num_lanes, n)):
                raise ArgumentError(
                    f"initial_state has shape {initial_state.shape}; it must be ({n},) or "
                    f"({self.num_lanes}, {n})"
                )
            self.state[:, :n] = initial_state
        if track_inputs is not None:
            if track_inputs.ndim != 3 or track_inputs.shape[2] != NUM_TRACK:
                raise ArgumentError(
                    f"track_inputs has shape {track_inputs.shape}; "
                    f"it must be (tracks, steps + 1, {NUM_TRACK})"
                )
            self._flat, self._track = False, np.ascontiguousarray(track_inputs)
        if track_of_lane is not None:
            self._track_of_lane = np.asarray(track_of_lane, dtype=np.int64)
            if self._track_of_lane.shape != (self.num_lanes,) or np.any(
                (self._track_of_lane < 0) | (self._track_of_lane >= self._track.shape[0])
            ):
                raise ArgumentError("track_of_lane must hold one existing track number per lane")

    def end_track(self) -> None:
        """Go on on straight level track, whatever lies ahead."""
        self._flat = True
        self._track = np.zeros((1, self.steps_per_command + 1, NUM_TRACK))
        self._track_of_lane = np.zeros(self.num_lanes, dtype=np.int64)

    def measure(self) -> FloatArray:
        """Return the outputs at the start of a run, shape (lanes, outputs).

        Only right after a reset, before the first force; later the last column of what `advance`
        returns is the present.
        """
        return self.state @ self._output_state + (
            self._track[self._track_of_lane, 0] @ self._output_track
        )

    def advance(self, commands: FloatArray) -> FloatArray:
        """Advance every lane by one control period.

        Args:
            commands: Wanted forces, before the limits, shape (lanes, channels) [N].

        Returns:
            The outputs at the end of each physics step, shape (lanes, steps, outputs), a new array.

        Raises:
            ArgumentError: The commands have the wrong shape or are not finite, or the track ends.
        """
        if commands.shape != self._last_command.shape:
            raise ArgumentError(
                f"commands has shape {commands.shape}; it must be {self._last_command.shape}"
            )
        if not np.all(np.isfinite(commands)):
            raise ArgumentError("commands holds a value that is not finite; give newtons")
        end = self.step_count + self.steps_per_command
        first = self.step_count
        if not self._flat and end >= self._track.shape[1]:
            last = (self._track.shape[1] - 1) * self.time_step
            raise ArgumentError(f"the track ends after {last:g} s; give a longer one")
        limited = self.actuator.limited(commands, self._last_command, self.control_period)
        self._last_command = limited
        self.line.issue(limited)
        recorded = np.empty((self.num_lanes, self.steps_per_command, len(self.outputs)))
        advance(
            self.state,
            self.line.commands,
            self.line.whole_steps,
            first,
            0 if self._flat else first,
            self.steps_per_command,
            self._transition,
            self._held,
            self._late,
            self._ramp_start,
            self._ramp_end,
            self._track,
            self._track_of_lane,
            self._output_state,
            self._output_force,
            self._output_track,
            recorded,
        )
        self.step_count = end
        return recorded


# More periods than this are no run but a mistake.
_MOST_PERIODS = 1e8


def whole_multiple(longer_name: str, longer: float, shorter_name: str, shorter: float) -> int:
    """Return how many times one period holds another.

    Raises:
        ArgumentError: The ratio is not a whole number (to a relative 1e-9, far above rounding and
            far below any step that is meant to differ).
    """
    ratio = longer / shorter
    number = round(ratio) if ratio < _MOST_PERIODS else 0
    if number < 1 or abs(ratio - number) > 1e-9 * ratio:
        raise ArgumentError(
            f"{longer_name} = {longer:g} s must be a whole multiple of "
            f"{shorter_name} = {shorter:g} s; change one of them"
        )
    return number
