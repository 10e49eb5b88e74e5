"""The nonlinear vehicle as a hunting system, on straight and perfect track.

A state here is what the vehicle's state differs by from steady rolling at the lane's speed, so that
zero is the straight run at every speed, and a state that is carried from one speed to the next
keeps its motion while the wheelsets' rotation follows the speed. The wheelsets' angles of rotation,
on which nothing depends and which a limit cycle does not repeat, are left out.
"""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from railenv.actuation import ActuatorSpec
from railenv.errors import ArgumentError, check_count, check_positive, unknown_name
from railenv.simulation.full import DEFAULT_FULL_STEP, FullBatch
from railenv.simulation.full_outputs import output_names
from railenv.simulation.full_stepping import RUNNING
from railenv.units import FloatArray
from railenv.vehicle.nonlinear import FullVehicle, equilibrium, linearised
from railenv.vehicle.nonlinear.coordinates import coordinate_index

_ROTATIONS = np.array([coordinate_index(f"wheelset{i}_pitch") for i in range(1, 5)])
# Nothing in these depends on the speed, and they take long to make.
_SHARED = ("contact_arrays", "creep_arrays", "stiffness", "damping", "dampers")
IntArray = NDArray[np.int64]


class FullHunting:
    """One nonlinear vehicle at many speeds; follows `railenv.simulation.bifurcation.HuntingSystem`.

    A lane whose vehicle derails, or whose numbers leave all bounds, gets a state and outputs that
    are not a number, from then on.

    Args:
        vehicle: The vehicle; its speed does not matter. Actuators, if it has any, carry no force.
        output: Name of the output by which hunting is judged; see
            `railenv.simulation.full_outputs`.
        time_step: Longest physics step [s]; it is shortened where samples do not fit.
        threads: Threads that share the lanes; results do not depend on it.

    Attributes:
        vehicle: The vehicle.
        names: Name of every entry of a state.

    Raises:
        ArgumentError: The output does not exist.
    """

    def __init__(
        self,
        vehicle: FullVehicle,
        *,
        output: str = "wheelset1_lateral",
        time_step: float = DEFAULT_FULL_STEP,
        threads: int = 1,
    ) -> None:
        known = output_names(vehicle)
        if output not in known:
            raise unknown_name("output", output, known)
        self.vehicle, self._output = vehicle, output
        self._time_step = check_positive("time_step", time_step, "s")
        self._threads = check_count("threads", threads)
        self._kept = np.delete(np.arange(vehicle.num_states), _ROTATIONS)
        self.names = tuple(vehicle.states[k] for k in self._kept)
        self._rest: dict[float, tuple[FullVehicle, FloatArray]] = {}
        self._made: tuple[tuple[tuple[float, ...], float, int], FullBatch] | None = None

    @property
    def state_size(self) -> int:
        """Length of a state."""
        return len(self._kept)

    def shifted(self, displacements: dict[str, float]) -> FloatArray:
        """Return a state with some coordinates displaced, shape (n,).

        Args:
            displacements: By name of the state, see `names` [m, rad, m/s, rad/s].

        Raises:
            ArgumentError: A name is unknown.
        """
        state = np.zeros(self.state_size)
        for name, value in displacements.items():
            if name not in self.names:
                raise unknown_name("state", name, self.names)
            state[self.names.index(name)] = value
        return state

    def aside(self, shift: float) -> FloatArray:
        """Return a state in which the wheelsets of each bogie are moved sideways, shape (n,).

        The rear bogie's by half, so that the start has no symmetry that hunting might lack.

        Args:
            shift: Of the leading two [m].
        """
        halves = {1: 1.0, 2: 1.0, 3: 0.5, 4: 0.5}
        return self.shifted({f"wheelset{i}_lateral": shift * h for i, h in halves.items()})

    def at(self, speed: float) -> FullVehicle:
        """Return the vehicle at a speed [m/s]."""
        return self._at(speed)[0]

    def linearisation(self, speed: float) -> FloatArray:
        """Return the system matrix of small motions about steady rolling, shape (n, n).

        Args:
            speed: Running speed [m/s].
        """
        vehicle = _at_speed(self.vehicle, check_positive("speed", speed, "m/s"))
        return linearised(vehicle)[np.ix_(self._kept, self._kept)]

    def advance(
        self, states: FloatArray, speeds: FloatArray, durations: FloatArray, samples: int
    ) -> tuple[FloatArray, FloatArray]:
        """Move every lane on by its duration.

        Args:
            states: Shape (lanes, n); not changed.
            speeds: Shape (lanes,) [m/s].
            durations: Shape (lanes,) [s].
            samples: How many outputs to record, equally spaced, the last one at the end.

        Returns:
            The states at the end, shape (lanes, n), and the outputs, shape (lanes, samples).

        Raises:
            ArgumentError: Shapes do not fit, or a speed or duration is not above zero.
        """
        states = np.array(states, dtype=np.float64)
        speeds, durations = np.asarray(speeds, np.float64), np.asarray(durations, np.float64)
        if states.ndim != 2 or states.shape[1] != self.state_size:
            raise ArgumentError(
                f"states has the shape {states.shape}; give (lanes, {self.state_size})"
            )
        for name, values, unit in (("speeds", speeds, "m/s"), ("durations", durations, "s")):
            if values.shape != (len(states),) or not np.all(values > 0.0):
                raise ArgumentError(
                    f"{name} = {values!r} does not fit; give one above zero [{unit}] per lane"
                )
        samples = check_count("samples", samples)
        outputs = np.full((len(states), samples), np.nan)
        finite = np.all(np.isfinite(states), axis=1)
        states[~finite] = np.nan
        for duration in np.unique(durations[finite]):
            chosen = np.flatnonzero(finite & (durations == duration))
            self._advance(chosen, states, speeds, float(duration), outputs)
        return states, outputs

    def _advance(
        self,
        chosen: IntArray,
        states: FloatArray,
        speeds: FloatArray,
        duration: float,
        outputs: FloatArray,
    ) -> None:
        """Move some lanes on by one duration; `states` and `outputs` are overwritten."""
        batch = self._batch(tuple(speeds[chosen].tolist()), duration, outputs.shape[1])
        everyone = np.arange(len(chosen), dtype=np.int64)
        rest = np.array([self._at(float(speed))[1] for speed in speeds[chosen]])
        begin = rest.copy()
        begin[:, self._kept] += states[chosen]
        none = np.zeros((len(chosen), self.vehicle.num_actuators))
        batch.start(everyone, batch.lanes.vehicle.copy(), none, begin)
        self._in_shares(batch)
        moved = (batch.lanes.state - rest)[:, self._kept]
        running = batch.lanes.ended == RUNNING
        states[chosen] = np.where(running[:, None], moved, np.nan)
        outputs[chosen] = np.where(running[:, None], batch.recorded[:, :, 0], np.nan)

    def _batch(self, speeds: tuple[float, ...], duration: float, samples: int) -> FullBatch:
        """Return lanes at these speeds: those at hand if they fit."""
        wanted = speeds, duration, samples
        if self._made is not None and self._made[0] == wanted:
            return self._made[1]
        record = duration / samples
        step = record / max(1, int(np.ceil(record / self._time_step - 1e-9)))
        different = sorted(set(speeds))
        batch = FullBatch(
            tuple(self._at(speed)[0] for speed in different),
            len(speeds),
            recorded=(self._output,),
            actuator=ActuatorSpec(lag=self.vehicle.actuator_lag),
            control_period=duration,
            record_step=record,
            time_step=step,
        )
        batch.lanes.vehicle[:] = [different.index(speed) for speed in speeds]
        self._made = wanted, batch
        return batch

    def _at(self, speed: float) -> tuple[FullVehicle, FloatArray]:
        """Vehicle at a speed and its state of steady rolling."""
        if speed not in self._rest:
            vehicle = _at_speed(self.vehicle, speed)
            self._rest[speed] = vehicle, equilibrium(vehicle).state
        return self._rest[speed]

    def _in_shares(self, batch: FullBatch) -> None:
        """Advance all lanes in equal shares, one for each thread."""
        parts = min(self._threads, batch.num_lanes)
        bounds = [round(batch.num_lanes * k / parts) for k in range(parts + 1)]
        if parts == 1:
            batch.advance(0, batch.num_lanes)
            return
        with ThreadPoolExecutor(parts) as pool:
            for done in [pool.submit(batch.advance, *bounds[k : k + 2]) for k in range(parts)]:
                done.result()


def _at_speed(vehicle: FullVehicle, speed: float) -> FullVehicle:
    """Return the vehicle at another speed, with the tables that it has already."""
    other = vehicle.replace(speed=speed)
    vars(other).update({name: getattr(vehicle, name) for name in _SHARED})
    return other
