"""Runs a controller on a batch of vehicles and records what the metrics need."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.controller import Controller, measured_by, users_own_code
from eval.sensor_noise import NoisyReadings
from eval.simulations import LinearRuns, Vehicle, simulation_of
from eval.told_delay import told_delays
from eval.varying_delay import ChannelDraws, VaryingDelay
from railenv.actuation import ActuatorSpec
from railenv.envs.observation import (
    DEFAULT_ACTION_SCALE,
    DEFAULT_MAX_DELAY,
    Observer,
    pipe_length,
)
from railenv.errors import ArgumentError, ControllerError, check_positive
from railenv.simulation import (
    DEFAULT_CONTROL_PERIOD,
    DEFAULT_TIME_STEP,
    Trajectory,
    whole_multiple,
)
from railenv.track import Track
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle
from railenv.vehicle.coordinates import actuator_positions

ACCELERATIONS = (
    "floor_front_lateral_acceleration",
    "floor_rear_lateral_acceleration",
    "bogie1_lateral_acceleration",
    "bogie2_lateral_acceleration",
)


@dataclass(frozen=True)
class Stepping:
    """How a run is stepped and what its actuators can do.

    Attributes:
        control_period: Time between commands [s].
        time_step: Time between records [s]; the linear vehicle's physics step, while the nonlinear
            one divides it.
        actuator: Limits and lag.
        max_delay: Longest delay whose past actions are observed [s].
        sensor_noise: Standard deviation of the white Gaussian noise of what the controller
            measures, in units of the controlled response; see `eval.sensor_noise` [1].
        told_error: What a controller that is told the delay is told too much; negative for too
            little [s].
    """

    control_period: float = DEFAULT_CONTROL_PERIOD
    time_step: float = DEFAULT_TIME_STEP
    actuator: ActuatorSpec = field(default_factory=ActuatorSpec)
    max_delay: float = DEFAULT_MAX_DELAY
    sensor_noise: float = 0.0
    told_error: float = 0.0


class ControlledBatch:
    """A controller in closed loop with a batch of vehicles.

    Args:
        controller: The controller.
        vehicle: The vehicle.
        record: Outputs or states to record at every time step.
        stepping: Steps, limits and lag.

    Raises:
        ArgumentError: The controller has a control period of its own and it is another one.
        ControllerError: What the controller says of itself cannot be used.

    Attributes:
        blown_up: Lanes whose state left every bound or whose vehicle derailed; they stand still and
            record NaN from there.
        silent: Lanes whose controller is not listened to, shape (lanes,); None for none.
    """

    def __init__(
        self,
        controller: Controller,
        vehicle: Vehicle,
        record: tuple[str, ...],
        stepping: Stepping,
    ) -> None:
        self.controller = controller
        self.vehicle = vehicle
        self.record = record
        self.stepping = stepping
        self._check_period()
        measured = self._call("measures", lambda: measured_by(controller, vehicle.layout))
        outputs = tuple(dict.fromkeys((*measured, *record)))
        try:
            self.simulation = simulation_of(
                vehicle,
                outputs,
                actuator=stepping.actuator,
                control_period=stepping.control_period,
                time_step=stepping.time_step,
                damper=getattr(controller, "damper", None),
            )
        except ArgumentError as error:
            told = [name for name in measured if f"unknown output {name!r}" in str(error)]
            if told and not isinstance(vehicle, LateralVehicle):
                raise ArgumentError(
                    f"the controller measures {told[0]!r}, a state of the linear vehicle that the "
                    "nonlinear one does not have; use --model lateral17"
                ) from None
            raise
        length = pipe_length(stepping.max_delay, stepping.control_period)
        self._observer = Observer(measured, vehicle.num_actuators, length)
        self._measured = [outputs.index(name) for name in measured]
        self._recorded = [outputs.index(name) for name in record]
        scale = getattr(controller, "action_scale", DEFAULT_ACTION_SCALE)
        unit = "N" if getattr(controller, "damper", None) is None else "N s/m"
        self._scale: float = self._call(
            "action_scale", lambda: check_positive("action_scale", scale, unit)
        )
        self.blown_up: NDArray[np.bool_] = np.zeros(1, dtype=bool)
        self.silent: NDArray[np.bool_] | None = None
        self.commands: FloatArray = np.zeros((1, vehicle.num_actuators))

    def reset(
        self,
        delays: FloatArray,
        tracks: Sequence[Track] = (),
        track_of_lane: NDArray[np.int64] | None = None,
        seed: int = 0,
        initial_state: FloatArray | None = None,
        level: FloatArray | None = None,
        track_inputs: FloatArray | None = None,
        channel: VaryingDelay | None = None,
        noise_seeds: Sequence[int] | None = None,
    ) -> None:
        """Start every lane, at rest if nothing else is said.

        Args:
            delays: See `eval.simulations.Simulation.begin`, as for the others.
            tracks: Irregularity.
            track_of_lane: Track of each lane.
            seed: Given to the controller, and the sensors' noise is drawn from it.
            initial_state: States at the start.
            level: Factor on the irregularity of each lane.
            track_inputs: Tracks that have been sampled for the linear vehicle, instead of `tracks`;
                see `railenv.simulation.wheelset_inputs`.
            channel: What varies in the channels beside these delays; None for nothing. A controller
                is told the delays without it.
            noise_seeds: Seed of each lane's noise; equal seeds are equal noise; None for seeds that
                follow from `seed` and the lane's number.
        """
        lanes = delays.shape[0]
        self._draws = ChannelDraws(channel, lanes, self.vehicle.num_actuators)
        late = self._draws.longest_jitter
        if track_inputs is None:
            self.simulation.begin(delays, tracks, track_of_lane, level, initial_state, late)
        elif isinstance(self.simulation, LinearRuns):
            self.simulation.reset(delays, track_inputs, track_of_lane, initial_state, late)
        else:
            raise ArgumentError("track_inputs is for the linear vehicle; give tracks")
        self._observer.reset(lanes)
        noise = self.stepping.sensor_noise
        streams = [(seed, lane) for lane in range(lanes)]
        if noise_seeds is not None:
            streams = [(own,) for own in noise_seeds]
        self._readings = NoisyReadings(self._observer.names, noise, streams)
        self.blown_up = np.zeros(lanes, dtype=bool)
        self._call("reset", lambda: self.controller.reset(lanes, seed))
        tell: Callable[[FloatArray], None] | None = getattr(self.controller, "tell", None)
        if tell is not None and delays.shape[1]:
            told = told_delays(delays, self.stepping.told_error)
            self._call("tell", lambda: tell(told))
        self._now = self.simulation.measure()[:, self._measured]

    def advance(self) -> FloatArray:
        """Decide and advance by one control period.

        Returns:
            Recorded outputs, shape (lanes, steps, record).

        Raises:
            ControllerError: The controller raised, or returned a wrong shape or no finite number.
        """
        readings = self._draws.seen(self._readings.of(self._now))
        observations = self._observer.observe(readings)
        shape = (observations.shape[0], self.vehicle.num_actuators)
        actions = self._call("act", lambda: _real(self.controller.act(observations)))
        if actions.shape != shape:
            raise ControllerError(
                f"act returned shape {actions.shape}; it must be {shape}: (lanes, channels)"
            )
        if not np.all(np.isfinite(actions)):
            raise ControllerError("act returned a value that is not finite")
        if self.silent is not None:
            actions[self.silent] = 0.0
        self._observer.push(actions)
        self.commands = self._scale * actions
        self._draws.renew()
        outputs = self.simulation.advance(self.commands, self._draws.later, self._draws.lost)
        new = self.simulation.lost
        if np.any(new):
            self.blown_up |= new
            self.simulation.stop(self.blown_up)
        self._now = outputs[:, -1, self._measured]
        if np.any(self.blown_up):
            self._now[self.blown_up] = 0.0
            outputs[self.blown_up] = np.nan
        return outputs[:, :, self._recorded]

    def _check_period(self) -> None:
        """Raise `ArgumentError` if the controller is made for another control period."""
        said, run = getattr(self.controller, "control_period", None), self.stepping.control_period
        if said is None:
            return
        own: float = self._call(
            "control_period", lambda: check_positive("control_period", said, "seconds")
        )
        if not math.isclose(own, run, rel_tol=1e-9):
            raise ArgumentError(
                f"control_period = {run:g} s, but the controller is made for control_period = "
                f"{own:g} s; run it with that one, or make it with control_period = {run:g}"
            )

    def _call(self, what: str, function: Callable[[], Any]) -> Any:
        with users_own_code(f"the controller's {what}"):
            return function()


def _real(actions: Any) -> FloatArray:
    """Return actions as floats; a complex number is an error and loses nothing silently."""
    array = np.asarray(actions)
    if array.dtype.kind not in "fiu":
        raise TypeError(f"actions of type {array.dtype} are no real numbers")
    return array.astype(float)


def force_names(vehicle: Vehicle) -> tuple[str, ...]:
    """Return the names of the actuator forces."""
    return tuple(f"actuator_force_{k}" for k in actuator_positions(vehicle.layout))


def rollout(
    controller: Controller,
    vehicle: Vehicle,
    delays: FloatArray,
    duration: float,
    *,
    tracks: Sequence[Track] = (),
    track_inputs: FloatArray | None = None,
    track_of_lane: NDArray[np.int64] | None = None,
    record: tuple[str, ...] | None = None,
    stepping: Stepping | None = None,
    seed: int = 0,
    progress: Callable[[int], None] | None = None,
    watch: Callable[[ControlledBatch, FloatArray], None] | None = None,
    channel: VaryingDelay | None = None,
    noise_seeds: Sequence[int] | None = None,
) -> Trajectory:
    """Run a controller for a while.

    Args:
        controller: The controller.
        vehicle: The vehicle.
        delays: Delay of every lane and channel, shape (lanes, channels) [s].
        duration: Length of the run [s], a whole number of control periods.
        tracks: Irregularity; none for straight, level track.
        track_inputs: The same as sampled for the linear vehicle, instead of `tracks`; see
            `railenv.simulation.wheelset_inputs`.
        track_of_lane: Track of each lane.
        record: Outputs or states to record; accelerations and forces by default.
        stepping: Steps, limits and lag.
        seed: Given to the controller, and the sensors' noise is drawn from it.
        progress: Called with the number of control periods just done.
        watch: Called after every control period with the batch and what was recorded in it, shape
            (lanes, steps, record).
        channel: What varies in the channels beside these delays; None for nothing.
        noise_seeds: Seed of each lane's noise, see `ControlledBatch.reset`.

    Returns:
        Recorded signals at every physics step; lanes that blew up end in NaN.

    Raises:
        ArgumentError: A setting is out of range.
        ControllerError: The controller broke the protocol.
    """
    steps = Stepping() if stepping is None else stepping
    names = (*ACCELERATIONS, *force_names(vehicle)) if record is None else record
    batch = ControlledBatch(controller, vehicle, names, steps)
    batch.reset(
        delays,
        tracks,
        track_of_lane,
        seed,
        track_inputs=track_inputs,
        channel=channel,
        noise_seeds=noise_seeds,
    )
    periods = whole_multiple("duration", duration, "control_period", steps.control_period)
    per_period = batch.simulation.steps_per_command
    values = np.empty((delays.shape[0], periods * per_period, len(names)))
    for k in range(periods):
        recorded = batch.advance()
        values[:, k * per_period : (k + 1) * per_period] = recorded
        if watch is not None:
            watch(batch, recorded)
        if progress is not None:
            progress(1)
    time = steps.time_step * np.arange(1, periods * per_period + 1, dtype=np.float64)
    return Trajectory(time, names, values)
