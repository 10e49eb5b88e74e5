"""Steady rolling of many vehicles that differ in their numbers only: a pool for episodes.

The vehicles of a pool are alike: their contact is the same and their suspensions differ by some ten
per cent. So the first one's equilibrium is a good guess for the others, and its derivative, with
the suspension's part exchanged, a good one for theirs: the iteration needs no differences, one
evaluation a time, and ends at the same residual as `railenv.vehicle.nonlinear.equilibrium`.
"""

from collections.abc import Sequence

import numpy as np

from railenv.units import FloatArray
from railenv.vehicle.nonlinear.coordinates import NUM_COORDINATES, coordinate_index
from railenv.vehicle.nonlinear.equilibrium import equilibrium, linearised, rate_of_change
from railenv.vehicle.nonlinear.model import FullVehicle

_N = NUM_COORDINATES
_ROTATIONS = np.array([coordinate_index(f"wheelset{i}_pitch") for i in range(1, 5)])
_PLACES = np.setdiff1d(np.arange(_N), _ROTATIONS)
_UNKNOWN = np.concatenate([_PLACES, _N + _ROTATIONS])
_TOLERANCE = 1e-10  # of an axle load, as of a single equilibrium
_ITERATIONS = 40


def steady_rolling(vehicles: Sequence[FullVehicle]) -> FloatArray:
    """Return the state of steady rolling on straight track of every vehicle.

    Args:
        vehicles: Of one layout and contact.

    Returns:
        States, shape (vehicles, states).

    Raises:
        NoEquilibriumError: There is none.
    """
    first = vehicles[0]
    here = equilibrium(first)
    if len(vehicles) == 1:
        return here.state[None]
    # Forces of the contact per unknown; the suspension's are each vehicle's own.
    forces = linearised(first, here)[_N : 2 * _N] * first.arrays.mass[:, None]
    places = _with_settled_nodes(first, forces) + first.stiffness
    contact = np.concatenate([places[:, _PLACES], forces[:, _N + _ROTATIONS]], axis=1)
    states = [here.state]
    for vehicle in vehicles[1:]:
        slope = contact.copy()
        slope[:, : len(_PLACES)] -= vehicle.stiffness[:, _PLACES]
        found = _iterated(vehicle, here.state, slope)
        states.append(equilibrium(vehicle).state if found is None else found)
    return np.array(states)


def _with_settled_nodes(vehicle: FullVehicle, forces: FloatArray) -> FloatArray:
    """Derivative by the coordinates where every node follows its damper without force."""
    places = forces[:, :_N].copy()
    for k, damper in enumerate(vehicle.nodes):
        places += np.outer(forces[:, 2 * _N + k], damper.row)
    return places


def _iterated(vehicle: FullVehicle, start: FloatArray, slope: FloatArray) -> FloatArray | None:
    """Return the state that is left without forces; None if the guess was not good enough."""
    mass, load = vehicle.arrays.mass, vehicle.parameters.lateral.axle_load
    size = np.array([1e-6] * len(_PLACES) + [1e-3] * len(_ROTATIONS))
    inverse = np.linalg.pinv(slope * size, rcond=1e-14)
    state, before = start.copy(), np.inf
    for _ in range(_ITERATIONS):
        left = rate_of_change(vehicle, state)[0][_N : 2 * _N] * mass
        now = float(np.abs(left).max()) / load
        if now < _TOLERANCE:
            return state
        if not now < before:
            return None
        before = now
        state[_UNKNOWN] -= size * (inverse @ left)
        for k, damper in enumerate(vehicle.nodes):
            state[2 * _N + k] = damper.row @ state[:_N]
    return None
