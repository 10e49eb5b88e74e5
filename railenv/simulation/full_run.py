"""Simulation of one nonlinear vehicle in many lanes: what `LateralSimulation` is to the linear one.

All lanes share the vehicle, the actuator and the step sizes; each lane has its own delays, track,
level of irregularity and start. One call of `advance` takes one command per lane and channel and
moves every lane by one control period.
"""

from bisect import bisect_left
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from railenv.actuation import ActuatorSpec
from railenv.errors import ArgumentError, check_count
from railenv.simulation.full import DEFAULT_FULL_STEP, FullBatch
from railenv.simulation.full_stepping import DERAILED, RUNNING
from railenv.simulation.late_commands import checked_delays, send
from railenv.simulation.lateral import DEFAULT_CONTROL_PERIOD, DEFAULT_TIME_STEP
from railenv.track import Track
from railenv.track.table import FULL_CHANNELS, single_track
from railenv.units import FloatArray
from railenv.vehicle.nonlinear import FullVehicle
from railenv.vehicle.nonlinear.curve import CurveArrays


class FullSimulation:
    """A batch of nonlinear vehicles on recorded tracks.

    Args:
        vehicle: The vehicle, shared by all lanes.
        outputs: Names of the outputs recorded at every record step; see
            `railenv.simulation.full_outputs`.
        actuator: Force and rate limit; its lag must be the vehicle's.
        control_period: Time between commands [s], a whole multiple of `record_step`.
        record_step: Time between records [s], a whole multiple of `time_step`.
        time_step: Physics step [s].
        specific_force: Accelerometers measure y'' - g roll.
        curves: The line; None for straight track.
        threads: Threads that share the lanes; results do not depend on it.

    Attributes:
        vehicle: The vehicle.
        outputs: Names of the outputs.
        time_step: Time between records [s].
        steps_per_command: Records in a control period.

    Raises:
        ArgumentError: A step size does not divide the next one, or an output is unknown.
    """

    def __init__(
        self,
        vehicle: FullVehicle,
        outputs: Sequence[str],
        *,
        actuator: ActuatorSpec | None = None,
        control_period: float = DEFAULT_CONTROL_PERIOD,
        record_step: float = DEFAULT_TIME_STEP,
        time_step: float = DEFAULT_FULL_STEP,
        specific_force: bool = False,
        curves: CurveArrays | None = None,
        threads: int = 1,
    ) -> None:
        self.vehicle, self.outputs, self.time_step = vehicle, tuple(outputs), record_step
        self._threads = check_count("threads", threads)
        self._pool: ThreadPoolExecutor | None = None
        self._control_period = control_period
        self._settings: dict[str, Any] = {
            "actuator": actuator,
            "control_period": control_period,
            "record_step": record_step,
            "time_step": time_step,
            "specific_force": specific_force,
            "curves": curves,
        }
        self._made_for: tuple[int, float, tuple[Track, ...]] | None = None
        self._batch = self._made(1, 0.0, ())
        self.steps_per_command = self._batch.recorded.shape[1]
        self._tracks: tuple[Track, ...] = ()
        self._longest_jitter = 0.0

    def _made(self, num_lanes: int, longest_delay: float, tracks: tuple[Track, ...]) -> FullBatch:
        """Return lanes for these tracks: those at hand if they fit, as making them takes long."""
        wanted = num_lanes, longest_delay, tracks
        if self._made_for != wanted:
            self._batch = FullBatch(
                (self.vehicle,),
                num_lanes,
                tuple(single_track(track, FULL_CHANNELS) for track in tracks),
                recorded=self.outputs,
                longest_delay=longest_delay,
                **self._settings,
            )
            self._made_for = wanted
        return self._batch

    @property
    def num_lanes(self) -> int:
        """Number of lanes."""
        return self._batch.num_lanes

    @property
    def state(self) -> FloatArray:
        """States of all lanes, shape (lanes, states), a new array."""
        return self._batch.lanes.state.copy()

    @property
    def wheels(self) -> FloatArray:
        """What is told of every wheel, shape (lanes, 8, 5), a new array.

        See `railenv.vehicle.nonlinear.rates.WHEEL_COLUMNS`.
        """
        return self._batch.lanes.wheels.copy()

    @property
    def ended(self) -> NDArray[np.bool_]:
        """Lanes whose vehicle has derailed or whose numbers left all bounds, shape (lanes,)."""
        return self._batch.lanes.ended != RUNNING

    @property
    def derailed(self) -> NDArray[np.bool_]:
        """Lanes whose vehicle has derailed, shape (lanes,)."""
        return self._batch.lanes.ended == DERAILED

    def reset(
        self,
        delays: FloatArray,
        tracks: Sequence[Track] = (),
        track_of_lane: NDArray[np.int64] | None = None,
        initial_state: FloatArray | None = None,
        level: FloatArray | None = None,
        longest_jitter: float = 0.0,
    ) -> None:
        """Put every lane back to time zero with an empty delay line.

        Args:
            delays: Delay of every lane and channel, shape (lanes, channels) [s].
            tracks: Irregularity; none for straight, level track of any length.
            track_of_lane: Track of each lane, shape (lanes,); None for the first one everywhere.
            initial_state: States at the start, shape (lanes, states) or (states,); None for steady
                rolling.
            level: Factor on the irregularity of each lane, shape (lanes,); None for one.
            longest_jitter: What a command may be late beyond its delay [s]; see `advance`.

        Raises:
            ArgumentError: An array has the wrong shape, or a delay is negative or not finite.
        """
        longest = checked_delays(delays, self.vehicle.num_actuators, longest_jitter)
        lanes = delays.shape[0]
        self._tracks = tuple(tracks)
        batch = self._made(lanes, longest, self._tracks)
        self._longest_jitter = longest_jitter  # there is room for it now
        batch.places.track[:] = 0
        batch.places.amplitude[:] = 1.0
        if track_of_lane is not None:
            chosen = np.asarray(track_of_lane, dtype=np.int64)
            if chosen.shape != (lanes,) or np.any((chosen < 0) | (chosen >= max(1, len(tracks)))):
                raise ArgumentError("track_of_lane must hold one existing track number per lane")
            batch.places.track[:] = chosen
        if level is not None:
            if level.shape != (lanes,) or not np.all(np.isfinite(level)):
                raise ArgumentError(f"level must hold {lanes} finite factors, one per lane")
            batch.places.amplitude[:] = level
        state = None
        if initial_state is not None:
            n = self.vehicle.num_states
            if initial_state.shape not in ((n,), (lanes, n)):
                raise ArgumentError(
                    f"initial_state has shape {initial_state.shape}; it must be ({n},) or "
                    f"({lanes}, {n})"
                )
            state = np.broadcast_to(initial_state, (lanes, n))
        everyone = np.arange(lanes, dtype=np.int64)
        batch.start(everyone, np.zeros_like(everyone), delays, state)

    def stop(self, lanes: NDArray[np.bool_]) -> None:
        """End the runs of some lanes: their vehicles stand where they are."""
        ended = self._batch.lanes.ended
        ended[lanes & (ended == RUNNING)] = DERAILED + 1

    def end_track(self) -> None:
        """Go on on straight level track, whatever lies ahead."""
        self._batch.places.amplitude[:] = 0.0
        self._tracks = ()

    def measure(self) -> FloatArray:
        """Return the outputs at the start of a run, shape (lanes, outputs).

        Only right after a reset, before the first force; later the last column of what `advance`
        returns is the present.
        """
        return self._batch.recorded[:, -1].copy()

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
            The outputs at every record step, shape (lanes, records, outputs), a new array; those of
            a lane that has ended stay as they were when it did.

        Raises:
            ArgumentError: An array has the wrong shape, a value is out of its range, or the track
                ends.
        """
        batch = self._batch
        send(batch, commands, later, lost, self._longest_jitter)
        time = int(batch.step.max()) * batch.time_step + self._control_period
        reach = self.vehicle.speed * time
        for track in self._tracks:
            if reach > track.length + 1e-6:
                raise ArgumentError(
                    f"the track ends after {track.length / self.vehicle.speed:g} s; "
                    "give a longer one"
                )
        self._advance(batch)
        return batch.recorded.copy()

    def _advance(self, batch: FullBatch) -> None:
        """Advance all lanes, those that still run in equal shares over the threads."""
        lanes = self.num_lanes
        running = np.cumsum(~self.ended)
        parts = min(self._threads, int(running[-1]))
        if parts <= 1:
            batch.advance(0, lanes)
            return
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self._threads - 1, "railenv-lanes")
        counted: list[int] = (running * parts).tolist()
        inner = (bisect_left(counted, int(running[-1]) * k) + 1 for k in range(1, parts))
        bounds = [0, *inner, lanes]
        others = [self._pool.submit(batch.advance, *bounds[k : k + 2]) for k in range(1, parts)]
        try:
            batch.advance(*bounds[:2])
        finally:
            for other in others:
                other.result()
