"""Vehicles made ready for exact stepping: discrete matrices in modal coordinates.

The state x of a vehicle is written x = T xi, with T real, so that the transition falls into blocks
of two: a rotation for a pair of complex modes, two numbers for two real ones. Where the modes of a
vehicle do not span the state well (a double root without two modes, as of a free wheelset pair
without conicity), the whole table keeps the full matrix, with T the identity: slower, never less
exact.

The track input w is linear over a step (first-order hold). Instead of xi the stepping carries

    z = xi - W_1 w      so that      z <- Phi z + (Phi W_1 + W_0) w + G(h) f

needs the input at one instant only; outputs take W_1 w back in.

A command that arrives at r inside a step acts through G(h - r). Over a step that is a smooth
function, here a Chebyshev series whose terms are added until they vanish in double precision. A
plant too stiff for that (an actuator lag far below the step) has none; see `PlantTable.late`.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from railenv.actuation import ActuatorSpec, held_input, ramped_input
from railenv.errors import ArgumentError
from railenv.simulation.stepping import PlantArrays
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle, StateSpace, state_space
from railenv.vehicle.suspension import NUM_TRACK

_WORST_MODES = 1e6
"""Condition number of T above which the modes are not used: ten digits of sixteen stay."""

_MOST_TERMS = 96
"""Terms of the Chebyshev series that are tried; 24 do for a step of 5 ms at any running speed."""

_VANISHED = 1e-15
"""A series has ended when its last terms are below this share of the largest one."""


class PlantTable:
    """Discrete matrices of one or more vehicles of one layout.

    Args:
        vehicles: The vehicles.
        outputs: Names of the outputs or states recorded at every physics step.
        sampled: Names of those taken once per control period.
        actuator: Limits and lag, the same for all.
        time_step: Physics step [s].
        specific_force: Accelerometers measure y'' - g roll.

    Attributes:
        systems: State space of each vehicle.
        arrays: What the compiled stepping reads.
        num_channels: Actuator channels m.
        num_states: States n, those of actuator lags included.
        num_modes: Entries of xi: the states, filled up to a whole number of fours.
        lagged: Whether the forces are the last states, behind an actuator lag.

    Raises:
        ArgumentError: No vehicle is given, layouts differ, or an output's name is unknown.
    """

    def __init__(
        self,
        vehicles: Sequence[LateralVehicle],
        outputs: Sequence[str],
        sampled: Sequence[str],
        actuator: ActuatorSpec,
        time_step: float,
        specific_force: bool = False,
    ) -> None:
        if not vehicles:
            raise ArgumentError("vehicles is empty; give one or more")
        if len({vehicle.layout for vehicle in vehicles}) > 1:
            raise ArgumentError("vehicles have different layouts; give vehicles of one layout")
        self.vehicles = tuple(vehicles)
        self.outputs, self.sampled = tuple(outputs), tuple(sampled)
        self.time_step = time_step
        self.systems: tuple[StateSpace, ...] = tuple(
            state_space(vehicle, specific_force=specific_force) for vehicle in vehicles
        )
        self.num_channels = self.systems[0].num_actuators
        modes = [_modes(actuator.with_lag(s.A, s.actuator_input)[0]) for s in self.systems]
        separate = all(found is not None for found in modes)
        parts = [
            _Discrete(system, actuator, time_step, found if separate else None)
            for system, found in zip(self.systems, modes, strict=True)
        ]
        self.num_states, self.num_modes = parts[0].T.shape
        self.lagged = self.num_states > self.systems[0].A.shape[0]
        self._modes = np.array([part.T for part in parts])
        self._inverse = np.array([part.inverse for part in parts])
        self._parts = parts
        terms = max(part.late.shape[0] for part in parts)
        if any(part.late.shape[0] == 0 for part in parts):
            terms = 0
        self.arrays = PlantArrays(
            pairs=np.array([part.pairs for part in parts]),
            full=np.array([part.transition for part in parts])[: 0 if separate else None],
            inputs=np.array([part.inputs for part in parts]),
            ramp_end=np.array([np.ascontiguousarray(part.ramp_end.T) for part in parts]),
            late=np.array([_padded(part.late, terms) for part in parts]),
            record=np.array([part.rows(self.outputs) for part in parts]),
            final=np.array([part.rows((*self.outputs, *self.sampled)) for part in parts]),
            time_step=time_step,
        )

    @property
    def smooth(self) -> bool:
        """Whether the compiled stepping can find the effect of a late command by itself."""
        return self.arrays.late.shape[1] > 0

    def late_effect(self, vehicle: int, rest: float) -> FloatArray:
        """Return G(h - rest) over the modes of a vehicle transposed, by a matrix exponential."""
        part = self._parts[vehicle]
        _, effect = held_input(part.A, part.B, self.time_step - rest)
        return effect.T

    def to_modes(self, vehicle: int, state: FloatArray) -> FloatArray:
        """Return the modes xi of a state x, shape (states,)."""
        return self._inverse[vehicle] @ state

    def from_modes(self, vehicle: int, z: FloatArray, track: FloatArray) -> FloatArray:
        """Return the state x of z, shape (modes,), while the track input is `track`, shape (k,)."""
        return self._modes[vehicle] @ (z + track @ self.arrays.ramp_end[vehicle])


class _Modes(NamedTuple):
    """x = T xi and xi = inverse x, with xi filled up to a whole number of fours.

    Attributes:
        T: Shape (states, n).
        inverse: Shape (n, states).
        form: T^-1 A T, shape (n, n).
    """

    T: FloatArray
    inverse: FloatArray
    form: FloatArray


class _Discrete:
    """One vehicle's matrices over its modes."""

    def __init__(
        self, system: StateSpace, actuator: ActuatorSpec, time_step: float, modes: _Modes | None
    ) -> None:
        m = system.num_actuators
        A, B = actuator.with_lag(system.A, system.actuator_input)
        self.T, self.inverse, self.A = _no_modes(A) if modes is None else modes
        states, n = self.T.shape
        track = np.vstack([system.B[:, m:], np.zeros((states - len(system.A), 2 * NUM_TRACK))])
        self.B = self.inverse @ B
        E = self.inverse @ track
        self.transition, held = held_input(self.A, self.B, time_step)
        here: NDArray[np.int64] = np.arange(n // 2, dtype=np.int64)
        there = here + n // 2
        rows, columns = np.array([here, here, there, there]), np.array([here, there, here, there])
        self.pairs = self.transition[rows, columns]
        if modes is not None:
            # Rounding may have left something between modes that have nothing in common.
            self.transition = np.zeros((n, n))
            self.transition[rows, columns] = self.pairs
        start, self.ramp_end = ramped_input(self.A, E[:, :NUM_TRACK], E[:, NUM_TRACK:], time_step)
        gamma = self.transition @ self.ramp_end + start
        self.inputs = _in_fours(np.hstack([gamma, held]).T)
        self.late = _late_series(self.A, self.B, time_step)
        self._system = system

    def rows(self, names: tuple[str, ...]) -> FloatArray:
        """Rows of the named outputs over v = (z, w, f), transposed, shape (n + k + m, names)."""
        C, D = self._system.output_rows(names)
        m = self._system.num_actuators
        by_state, through = C, D[:, :m]
        if len(self.T) > len(self._system.A):
            # With a lag the force is a state of its own, no longer the arriving command.
            by_state, through = np.hstack([C, through]), np.zeros_like(through)
        by_modes = by_state @ self.T
        # No output reads the track's rates: they reach the bogie frames' roll acceleration only.
        by_track = D[:, m : m + NUM_TRACK] + by_modes @ self.ramp_end
        return _in_fours(np.hstack([by_modes, by_track, through]).T)


def _in_fours(rows: FloatArray) -> FloatArray:
    """Fill up with zero rows to a whole number of fours."""
    return np.pad(rows, ((0, -len(rows) % 4), (0, 0)))


def _no_modes(A: FloatArray) -> _Modes:
    n = len(A) + -len(A) % 4
    T = np.eye(len(A), n)
    form = np.zeros((n, n))
    form[: len(A), : len(A)] = A
    return _Modes(T, np.ascontiguousarray(T.T), form)


def _modes(A: FloatArray) -> _Modes | None:
    """Return the modes of x' = A x, two by two; None if they do not span the state well."""
    roots, vectors = linalg.eig(A)
    if np.linalg.matrix_rank(vectors) < len(A):
        return None
    states, half = len(A), (len(A) + -len(A) % 4) // 2
    T, form = np.zeros((states, 2 * half)), np.zeros((2 * half, 2 * half))
    complex_modes = [k for k in range(states) if roots[k].imag > 0.0]
    real_modes = [k for k in range(states) if roots[k].imag == 0.0]
    for i, k in enumerate(complex_modes):
        T[:, i], T[:, half + i] = vectors[:, k].real, vectors[:, k].imag
        re, im = roots[k].real, roots[k].imag
        form[i, i], form[i, half + i], form[half + i, i], form[half + i, half + i] = re, im, -im, re
    places = [i + side for i in range(len(complex_modes), half) for side in (0, half)]
    used = [i + side for i in range(len(complex_modes)) for side in (0, half)]
    for place, k in zip(places, real_modes, strict=False):
        T[:, place] = vectors[:, k].real / np.linalg.norm(vectors[:, k].real)
        form[place, place] = roots[k].real
        used.append(place)
    if not np.linalg.cond(T[:, used]) < _WORST_MODES:
        return None
    inverse = np.zeros((2 * half, states))
    inverse[used] = np.linalg.inv(T[:, used])
    return _Modes(T, inverse, form)


def _late_series(A: FloatArray, B: FloatArray, time_step: float) -> FloatArray:
    """Return the Chebyshev series of G(s), s in [0, h], shape (terms, m, n); no terms if stiff."""
    terms = 12
    while terms <= _MOST_TERMS:
        angle = np.pi * (np.arange(terms) + 0.5) / terms
        places = 0.5 * time_step * (np.cos(angle) + 1.0)
        values = np.array([held_input(A, B, float(s))[1].T for s in places])
        cosines = np.cos(np.outer(np.arange(terms), angle))
        series = 2.0 / terms * np.einsum("kj,jmn->kmn", cosines, values)
        series[0] *= 0.5
        scale = np.abs(values).max(axis=0)
        # Rounding of the exponentials leaves a floor of some 1e-16 under every term.
        if np.all(
            np.abs(series[-2:]) <= np.maximum(_VANISHED * scale.max(initial=0.0), 1e-13 * scale)
        ):
            return series
        terms *= 2
    return np.zeros((0, *B.T.shape))


def _padded(series: FloatArray, terms: int) -> FloatArray:
    """Fill up with zero terms, which change nothing."""
    return np.pad(series[:terms], ((0, max(0, terms - len(series))), (0, 0), (0, 0)))
