"""One control period of the linear environment as one matrix, for the differentiable twin.

With constant delays everything between two actions is linear: the exact steps of the vehicle, the
switch of every channel inside one of them, the ride filter and the sensors. Its matrix is found by
superposition: each column is the response to one unit input.

The steps are written over the physical states with matrix exponentials of the whole vehicle
(`railenv.actuation.hold`), not over the modes as those of `railenv.simulation`, so that the
equality of the two is a check of both. Signs and units are those of `railenv.vehicle.statespace`.
The module knows nothing of tracks, limits or torch.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import sosfilt

from railenv.actuation import ActuatorSpec, held_input, ramped_input
from railenv.envs.reward import RECORDED
from railenv.envs.settings import EnvSettings
from railenv.errors import ArgumentError
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle, state_space
from railenv.vehicle.suspension import NUM_TRACK

FLOOR_ENDS = 2


@dataclass(frozen=True)
class Rows:
    """Where the results of a period stand.

    Attributes:
        state: Vehicle's states, actuator lags included, and the ride filter's memory.
        recorded: What the reward sees of every physics step, step by step.
        weighted: Ride-filtered floor accelerations of every physics step [m/s^2].
        sampled: Measured columns at the end of the period, in units of their scales.
    """

    state: slice
    recorded: slice
    weighted: slice
    sampled: slice


class PeriodMatrices:
    """Matrices of one control period for some vehicles of one layout.

    Args:
        vehicles: The vehicles.
        measured: Names of the measured columns.
        factor: What these are multiplied by, shape (measured,).
        actuator: Lag of the actuators; the limits are not linear and stand elsewhere.
        time_step: Physics step h [s].
        steps: Physics steps in one control period, S.
        ride_sections: Second-order sections of the ride filter, shape (sections, 6).

    Attributes:
        rows: Where the results stand.
        num_states: States n of a vehicle, actuator lags included.
        num_channels: Actuator channels m.
        lagged: Whether the forces are the last of these states.
        own: Results of states and filter memory, shape (vehicles, results, n + memory).
        track: Results of the track inputs at every step's start and the last one's end, one after
            the other, shape (vehicles, results, 8 (S + 1)).
        held: Results of forces held all through, shape (vehicles, results, m).
        start: Measured columns of (states, track inputs), shape (vehicles, measured, n + 8).
    """

    def __init__(
        self,
        vehicles: Sequence[LateralVehicle],
        measured: tuple[str, ...],
        factor: FloatArray,
        actuator: ActuatorSpec,
        time_step: float,
        steps: int,
        ride_sections: FloatArray,
    ) -> None:
        self._time_step, self._steps = time_step, steps
        parts = [_Exact(vehicle, actuator, time_step, measured, factor) for vehicle in vehicles]
        self._parts = parts
        self._ride = _ride_matrix(ride_sections)
        self.num_states, self.num_channels = parts[0].B.shape
        self.lagged = self.num_states > parts[0].num_vehicle_states
        memory = FLOOR_ENDS * (len(self._ride) - 1)
        ends = np.cumsum(
            [
                self.num_states + memory,
                steps * len(RECORDED),
                steps * FLOOR_ENDS,
                len(measured),
            ]
        ).tolist()
        self.rows = Rows(*(slice(a, b) for a, b in zip([0, *ends[:-1]], ends, strict=True)))
        known, inputs = ends[0], NUM_TRACK * (steps + 1)
        unit, everyone = np.eye(known + inputs), np.arange(len(parts))
        no_push = np.zeros((1, len(unit), steps, self.num_states))
        no_force = np.zeros((1, len(unit), steps, self.num_channels))
        track = unit[:, known:].reshape(len(unit), steps + 1, NUM_TRACK)
        whole = self._respond(everyone, unit[:, :known], track, no_push, no_force)
        self.own, self.track = whole[:, :, :known], whole[:, :, known:]
        self.held = self._respond_to_forces(everyone, *self._held_pushes(everyone))
        self.start = np.array([np.hstack([part.sample, part.sample_track]) for part in parts])

    def switched(
        self, vehicle: NDArray[np.int64], step: NDArray[np.int64], rest: FloatArray
    ) -> FloatArray:
        """Return the results of forces of one that begin inside the period.

        Args:
            vehicle: Vehicle of each lane, shape (lanes,).
            step: Physics step, counted from 0, in which each channel switches, (lanes, m).
            rest: Instant inside that step, shape (lanes, m) [s].

        Returns:
            Shape (lanes, results, m).
        """
        pushed, forces = self._held_pushes(vehicle)
        known: dict[tuple[int, float], FloatArray] = {}
        for lane, channel in np.ndindex(*rest.shape):
            which, late_by = int(vehicle[lane]), float(rest[lane, channel])
            part, at = self._parts[which], int(step[lane, channel])
            if (which, late_by) not in known:
                _, effect = held_input(part.A, part.B, self._time_step - late_by)
                known[which, late_by] = effect
            pushed[lane, channel, :at] = 0.0
            forces[lane, channel, :at] = 0.0
            pushed[lane, channel, at] = known[which, late_by][:, channel]
        return self._respond_to_forces(vehicle, pushed, forces)

    def _held_pushes(self, vehicle: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
        """What unit forces held all through add to the state in every step, and these forces."""
        effect = np.array([part.held.T for part in self._parts])[vehicle]
        pushed = np.repeat(effect[:, :, None], self._steps, axis=2)
        unit = np.eye(self.num_channels)[None, :, None]
        return pushed, np.broadcast_to(unit, (*pushed.shape[:3], self.num_channels)).copy()

    def _respond_to_forces(
        self, vehicle: NDArray[np.int64], pushed: FloatArray, forces: FloatArray
    ) -> FloatArray:
        """As `_respond`, from rest on straight level track."""
        m = self.num_channels
        at_rest = np.zeros((m, self.rows.state.stop))
        straight = np.zeros((m, self._steps + 1, NUM_TRACK))
        return self._respond(vehicle, at_rest, straight, pushed, forces)

    def _respond(
        self,
        vehicle: NDArray[np.int64],
        known: FloatArray,
        track: FloatArray,
        pushed: FloatArray,
        forces: FloatArray,
    ) -> FloatArray:
        """Run one period once per case, and return its results as columns.

        Args:
            vehicle: Vehicle numbers, shape (k,).
            known: States and filter memory at the start, shape (cases, n + memory).
            track: Track inputs, shape (cases, S + 1, 8).
            pushed: What forces add to the state in each step, shape (k or 1, cases, S, n).
            forces: Forces at the end of each step, shape (k or 1, cases, S, m) [N].

        Returns:
            Shape (k, results, cases).
        """

        def of(name: str) -> FloatArray:
            return np.array([getattr(part, name).T for part in self._parts])[vehicle]

        shape, n, size = (len(vehicle), len(known)), self.num_states, len(self._ride) - 1
        state = np.broadcast_to(known[:, :n], (*shape, n))
        memory = np.broadcast_to(known[:, n:], (*shape, FLOOR_ENDS * size))
        memory = memory.reshape(*shape, FLOOR_ENDS, size)
        Phi, W_0, W_1 = of("Phi"), of("W_0"), of("W_1")
        record, by_track, by_force = of("record"), of("record_track"), of("record_force")
        recorded: list[FloatArray] = []
        weighted: list[FloatArray] = []
        for step in range(self._steps):
            state = state @ Phi + track[:, step] @ W_0 + track[:, step + 1] @ W_1
            state = state + pushed[:, :, step]
            values = state @ record + track[:, step + 1] @ by_track
            values = values + forces[:, :, step] @ by_force
            recorded.append(values)
            both = np.concatenate([memory, values[..., :FLOOR_ENDS, None]], axis=-1) @ self._ride
            memory = both[..., :size]
            weighted.append(both[..., size])
        sampled = state @ of("sample") + track[:, -1] @ of("sample_track")
        sampled = sampled + forces[:, :, -1] @ of("sample_force")
        results = [state, memory.reshape(*shape, -1), *recorded, *weighted, sampled]
        return np.concatenate(results, axis=-1).swapaxes(1, 2).copy()


class _Exact:
    """One vehicle's exact step of length h over its physical states, and its outputs."""

    def __init__(
        self,
        vehicle: LateralVehicle,
        actuator: ActuatorSpec,
        time_step: float,
        measured: tuple[str, ...],
        factor: FloatArray,
    ) -> None:
        system = state_space(vehicle)
        m = system.num_actuators
        self.num_vehicle_states = len(system.A)
        self.A, self.B = actuator.with_lag(system.A, system.actuator_input)
        # The track does not act on the actuators' lags.
        E = np.zeros((len(self.A), 2 * NUM_TRACK))
        E[: len(system.A)] = system.B[:, m:]
        self.Phi, self.held = held_input(self.A, self.B, time_step)
        self.W_0, self.W_1 = ramped_input(self.A, E[:, :NUM_TRACK], E[:, NUM_TRACK:], time_step)
        rows = []
        for names in (RECORDED, measured):
            C, D = system.output_rows(names)
            by_force, by_track = D[:, :m], D[:, m : m + NUM_TRACK]
            if len(self.A) > len(system.A):
                C, by_force = np.hstack([C, by_force]), np.zeros_like(by_force)
            rows.append((C, by_force, by_track))
        self.record, self.record_force, self.record_track = rows[0]
        self.sample, self.sample_force, self.sample_track = (
            factor[:, None] * part for part in rows[1]
        )


def _ride_matrix(sections: FloatArray) -> FloatArray:
    """Return one step of the ride filter as a matrix.

    Args:
        sections: Second-order sections, shape (sections, 6).

    Returns:
        (memory, sample) @ matrix = (memory, filtered sample), shape (2 sections + 1,) squared.
    """
    size = 2 * len(sections)
    responses = []
    for unit in np.eye(size + 1):
        memory = unit[:size].reshape(len(sections), 2)
        filtered, after = sosfilt(sections, unit[size:], zi=memory)
        responses.append([*after.ravel(), *filtered])
    return np.array(responses)


def refuse_varying_delays(settings: EnvSettings) -> None:
    """Refuse settings whose delays vary within an episode.

    Raises:
        ArgumentError: There is jitter or a dropout.
    """
    varying = settings.delays().varying
    for name in ("jitter", "dropout", "sensor_dropout"):
        if getattr(varying, name) > 0.0:
            raise ArgumentError(
                f"{name} = {getattr(varying, name):g} is not supported by the twin, whose delays "
                "are constant over an episode; draw the delay from a range, delay=(low, high), or "
                "train in the environment itself"
            )
