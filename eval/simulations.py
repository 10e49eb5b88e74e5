"""One face for the two simulations, so that a controller runs on either vehicle.

`simulation_of` takes a vehicle and returns what steps it. A run's excitation is the same for both:
tracks, which of them each lane runs on, and a factor on the irregularity of each lane. The linear
vehicle may have semi-active dampers in the place of actuators: commands are then coefficients.
"""

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numba.core import config as numba_config
from numpy.typing import NDArray

from railenv.actuation import ActuatorSpec, SemiActiveDamper
from railenv.errors import ArgumentError
from railenv.simulation import LateralSimulation, SemiActiveSimulation, wheelset_inputs
from railenv.simulation.full import DEFAULT_FULL_STEP, longest_step
from railenv.simulation.full_run import FullSimulation
from railenv.track import Track
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle
from railenv.vehicle.coordinates import COORDINATES
from railenv.vehicle.nonlinear import FullVehicle
from railenv.vehicle.nonlinear.coordinates import coordinate_index

IntArray = NDArray[np.int64]

Vehicle = LateralVehicle | FullVehicle
"""A vehicle that can be run: linear with 17 coordinates, or nonlinear with 50."""

BLOW_UP = 1e4
"""A mode of the linear vehicle beyond this amplitude is stopped: the vehicle is unstable."""


class Simulation(Protocol):
    """Lanes of one vehicle, stepped by control periods.

    Attributes:
        outputs: Names of what is recorded.
        time_step: Time between records [s].
        steps_per_command: Records in a control period.
    """

    outputs: tuple[str, ...]
    time_step: float
    steps_per_command: int

    @property
    def num_lanes(self) -> int:
        """Number of lanes, fixed by the last start."""
        ...

    @property
    def state(self) -> FloatArray:
        """States of all lanes, shape (lanes, states), a new array."""
        ...

    @property
    def lateral(self) -> FloatArray:
        """The 17 lateral coordinates of all lanes, shape (lanes, 17)."""
        ...

    @property
    def lost(self) -> NDArray[np.bool_]:
        """Lanes whose vehicle left every bound or derailed, shape (lanes,)."""
        ...

    def begin(
        self,
        delays: FloatArray,
        tracks: Sequence[Track] = (),
        track_of_lane: IntArray | None = None,
        level: FloatArray | None = None,
        initial_state: FloatArray | None = None,
        longest_jitter: float = 0.0,
    ) -> None:
        """Put every lane back to time zero with an empty delay line.

        Args:
            delays: Delay of every lane and channel, shape (lanes, channels) [s].
            tracks: Irregularity; none for straight, level track of any length.
            track_of_lane: Track of each lane, shape (lanes,); None for the first one everywhere.
            level: Factor on the irregularity of each lane, shape (lanes,); None for one.
            initial_state: States at the start, shape (lanes, states) or (states,); None for rest,
                which on wheels and rails is steady rolling.
            longest_jitter: What a command may be late beyond its delay [s]; see `advance`.
        """
        ...

    def measure(self) -> FloatArray:
        """Return the outputs at the start of a run, shape (lanes, outputs)."""
        ...

    def advance(
        self,
        commands: FloatArray,
        later: FloatArray | None = None,
        lost: NDArray[np.bool_] | None = None,
    ) -> FloatArray:
        """Advance a control period; return the outputs, shape (lanes, steps, outputs).

        Args:
            commands: Forces [N], or coefficients of semi-active dampers [N s/m], (lanes, channels).
            later: What each is late beyond its delay, (lanes, channels) [s]; None for nothing.
            lost: Which of them get lost, (lanes, channels); None for none.
        """
        ...

    def stop(self, lanes: NDArray[np.bool_]) -> None:
        """End the motion of some lanes."""
        ...

    def end_track(self) -> None:
        """Go on on straight level track, whatever lies ahead."""
        ...


class LinearRuns(LateralSimulation):
    """The linear vehicle, started on tracks."""

    _sampled: tuple[tuple[Track, ...], FloatArray] | None = None

    @property
    def lateral(self) -> FloatArray:
        """The 17 lateral coordinates of all lanes, shape (lanes, 17)."""
        return self.state[:, : len(COORDINATES)]

    @property
    def lost(self) -> NDArray[np.bool_]:
        """Lanes with a mode beyond `BLOW_UP`, shape (lanes,)."""
        return ~(self.amplitude <= BLOW_UP)

    def begin(
        self,
        delays: FloatArray,
        tracks: Sequence[Track] = (),
        track_of_lane: IntArray | None = None,
        level: FloatArray | None = None,
        initial_state: FloatArray | None = None,
        longest_jitter: float = 0.0,
    ) -> None:
        """Put every lane back to time zero; see `Simulation.begin`."""
        inputs = self._inputs(tuple(tracks)) if tracks else None
        if inputs is not None and level is not None:
            chosen = (
                np.zeros(len(level), dtype=np.int64) if track_of_lane is None else track_of_lane
            )
            inputs = level[:, None, None] * inputs[chosen]
            track_of_lane = np.arange(len(level), dtype=np.int64)
        self.reset(delays, inputs, track_of_lane, initial_state, longest_jitter)

    def _inputs(self, tracks: tuple[Track, ...]) -> FloatArray:
        """Sample tracks over the whole steps that the shortest of them has room for."""
        if self._sampled is None or self._sampled[0] != tracks:
            advance = self.vehicle.speed * self.time_step
            # A track that ends at a step is one step longer than rounding may make it.
            steps = math.floor(min(track.length for track in tracks) / advance + 1e-9)
            sampled = [wheelset_inputs(self.vehicle, t, self.time_step, steps) for t in tracks]
            self._sampled = tracks, np.stack(sampled)
        return self._sampled[1]


class SemiActiveRuns(LinearRuns, SemiActiveSimulation):
    """The linear vehicle on semi-active dampers, started on tracks."""


class FullRuns(FullSimulation):
    """The nonlinear vehicle, started on tracks."""

    @property
    def lateral(self) -> FloatArray:
        """The 17 lateral coordinates of all lanes, shape (lanes, 17)."""
        return self.state[:, [coordinate_index(name) for name in COORDINATES]]

    @property
    def lost(self) -> NDArray[np.bool_]:
        """Lanes whose vehicle has derailed or whose numbers left all bounds, shape (lanes,)."""
        return self.ended

    def begin(
        self,
        delays: FloatArray,
        tracks: Sequence[Track] = (),
        track_of_lane: IntArray | None = None,
        level: FloatArray | None = None,
        initial_state: FloatArray | None = None,
        longest_jitter: float = 0.0,
    ) -> None:
        """Put every lane back to time zero; see `Simulation.begin`."""
        self.reset(delays, tracks, track_of_lane, initial_state, level, longest_jitter)


def physics_step(vehicle: LateralVehicle | FullVehicle, time_step: float) -> float:
    """Return the step at which a vehicle's motion is worked out between two records [s]."""
    if isinstance(vehicle, LateralVehicle):
        return time_step
    longest = min(DEFAULT_FULL_STEP, longest_step(vehicle))
    return time_step / max(1, math.ceil(time_step / longest - 1e-9))


def simulation_of(
    vehicle: Vehicle,
    outputs: Sequence[str],
    *,
    actuator: ActuatorSpec,
    control_period: float,
    time_step: float,
    damper: SemiActiveDamper | None = None,
) -> LinearRuns | FullRuns:
    """Return what steps a vehicle.

    Args:
        vehicle: The vehicle.
        outputs: What is recorded at every time step.
        actuator: Limits and lag; a nonlinear vehicle takes this lag over.
        control_period: Time between commands [s].
        time_step: Time between records [s]: the linear vehicle's physics step; the nonlinear one
            divides it into equal physics steps of 0.5 ms, or less at low speed.
        damper: What stands in the place of every actuator; None for the actuators.

    Raises:
        ArgumentError: A step does not divide the next one, or an output does not exist, or the
            damper is none, is on a nonlinear vehicle, or is given what only actuators have.
    """
    if damper is not None:
        return _on_dampers(vehicle, outputs, damper, actuator, control_period, time_step)
    if isinstance(vehicle, LateralVehicle):
        return LinearRuns(
            vehicle, outputs, actuator=actuator, control_period=control_period, time_step=time_step
        )
    if vehicle.actuator_lag != actuator.lag:
        vehicle = vehicle.replace(actuator_lag=actuator.lag)
    return FullRuns(
        vehicle,
        outputs,
        actuator=actuator,
        control_period=control_period,
        record_step=time_step,
        time_step=physics_step(vehicle, time_step),
        # As many as the compiled code may have: all cores, but one in a benchmark's workers, which
        # share the cores among themselves.
        threads=int(vars(numba_config)["NUMBA_NUM_THREADS"]),
    )


def _on_dampers(
    vehicle: Vehicle,
    outputs: Sequence[str],
    damper: SemiActiveDamper,
    actuator: ActuatorSpec,
    control_period: float,
    time_step: float,
) -> SemiActiveRuns:
    """Return what steps a linear vehicle on semi-active dampers, see `simulation_of`."""
    # It comes from a user's controller: anything may stand there.
    if not isinstance(damper, SemiActiveDamper):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise ArgumentError(
            f"the controller's damper = {damper!r:.80} is no SemiActiveDamper; give one, or None "
            "for actuators"
        )
    if not isinstance(vehicle, LateralVehicle):
        raise ArgumentError(
            "the controller commands semi-active dampers, which only the linear vehicle has; use "
            "--model lateral17"
        )
    if actuator.lag > 0.0 or actuator.rate_limit is not None:
        raise ArgumentError(
            f"actuator has lag = {actuator.lag:g} s and rate_limit = {actuator.rate_limit}, and "
            "the controller commands semi-active dampers; give neither, and set the damper's "
            "response_time"
        )
    return SemiActiveRuns(
        vehicle,
        outputs,
        damper=damper,
        force_limit=actuator.force_limit,
        control_period=control_period,
        time_step=time_step,
    )


def lateral_twin(vehicle: Vehicle) -> LateralVehicle:
    """Return the linear vehicle with the same lateral numbers, which names modes and is drawn."""
    if isinstance(vehicle, LateralVehicle):
        return vehicle
    return LateralVehicle(vehicle.parameters.lateral, vehicle.layout, vehicle.speed)
