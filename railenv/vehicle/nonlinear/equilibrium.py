"""Static equilibrium of the nonlinear vehicle and its linearisation.

On straight track the vehicle rolls steadily: every acceleration is zero while the wheelsets'
rotation is whatever rolls without slipping. The unknowns are the 50 coordinates less the
wheelsets' pitch angles, which nothing depends on, plus the wheelsets' pitch rates; the equations
are the 50 accelerations.
"""

from dataclasses import dataclass

import numpy as np

from railenv.errors import RailenvError
from railenv.units import FloatArray
from railenv.vehicle.nonlinear.coordinates import NUM_COORDINATES, coordinate_index
from railenv.vehicle.nonlinear.model import FullVehicle, straight
from railenv.vehicle.nonlinear.rates import WHEEL_COLUMNS, FrameArrays, rates

_N = NUM_COORDINATES
_ROTATIONS = np.array([coordinate_index(f"wheelset{i}_pitch") for i in range(1, 5)])
_PLACES = np.setdiff1d(np.arange(_N), _ROTATIONS)
_UNKNOWN = np.concatenate([_PLACES, _N + _ROTATIONS])
# Smaller than any tolerance asked of the balance (1e-6 of the weight), above rounding.
_TOLERANCE = 1e-10
_CONVERGED = 1e-7  # where rounding keeps it from the tolerance
_ITERATIONS = 60
_PARTS = 8
# Steps of the central differences: contact approaches are 1e-4 m, creepages of interest 1e-4, and
# the tables are smooth over 1e-5 m. Two steps and Richardson's extrapolation leave an error of
# fourth order.
_PLACE_STEP = 2e-6
_RATE_STEP = 1e-4


class NoEquilibriumError(RailenvError):
    """No static equilibrium was found."""


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """Steady rolling.

    Attributes:
        state: Shape (states,).
        wheels: What is told of every wheel, shape (8, 5), see `WHEEL_COLUMNS`.
        residual: Largest force left over, per weight of an axle [1].
    """

    state: FloatArray
    wheels: FloatArray
    residual: float


def rate_of_change(
    vehicle: FullVehicle,
    state: FloatArray,
    rails: FloatArray | None = None,
    command: FloatArray | None = None,
    frame: FrameArrays | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return the rate of change of a state, and what is told of the wheels.

    Args:
        vehicle: The vehicle.
        state: Shape (states,).
        rails: Places and rates of the rails under the wheels, shape (8, 4); None for straight.
        command: Force of every actuator, shape (channels,) [N]; None for none.
        frame: What a curve does; None for straight track.

    Returns:
        Rate, shape (states,), and wheels, shape (8, 5).
    """
    out, wheels = np.zeros_like(state), np.zeros((8, len(WHEEL_COLUMNS)))
    rates(
        vehicle.arrays,
        vehicle.contact_arrays,
        vehicle.creep_arrays,
        state,
        np.zeros((8, 4)) if rails is None else rails,
        np.zeros(vehicle.num_actuators) if command is None else command,
        straight() if frame is None else frame,
        out,
        wheels,
    )
    return out, wheels


def equilibrium(vehicle: FullVehicle, frame: FrameArrays | None = None) -> Equilibrium:
    """Solve for steady rolling, on straight track or in a curve.

    Newton's method with a step that is halved until the residual falls, from the design position
    with the wheels pressed into the rails. A curve from which that gets stuck is approached in
    parts of itself, each from the solution of the last.

    Raises:
        NoEquilibriumError: The iteration does not converge, as where a curve asks for more guiding
            force than the wheels can give.
    """
    straight_on = np.zeros(len(_UNKNOWN))
    for name in ("carbody", "bogie1", "bogie2", *(f"wheelset{i}" for i in range(1, 5))):
        straight_on[np.searchsorted(_UNKNOWN, coordinate_index(f"{name}_vertical"))] = 1e-4
    values, left = _rolled(vehicle, frame, straight_on)
    if not left < _CONVERGED and frame is not None:
        values = straight_on
        for share in np.linspace(0.0, 1.0, _PARTS + 1):
            part = FrameArrays(*(share * array for array in frame))
            values, left = _rolled(vehicle, part, values)
            if not left < _CONVERGED:
                break
    if not left < _CONVERGED:
        raise NoEquilibriumError(
            f"no static equilibrium at {vehicle.speed:.6g} m/s: forces of {left:.2g} of an axle "
            "load are left over; check curve, cant, profiles and friction"
        )
    state = _settled(vehicle, frame, values)
    return Equilibrium(state, rate_of_change(vehicle, state, frame=frame)[1], left)


def _settled(vehicle: FullVehicle, frame: FrameArrays | None, values: FloatArray) -> FloatArray:
    """Return the state with these unknowns: nodes carry no force, lagged forces are zero."""
    state = np.zeros(vehicle.num_states)
    state[_UNKNOWN] = values
    places = state[:_N] if frame is None or not len(frame.offset) else state[:_N] + frame.offset
    for k, damper in enumerate(vehicle.nodes):
        state[2 * _N + k] = damper.row @ places
    return state


def _rolled(
    vehicle: FullVehicle, frame: FrameArrays | None, values: FloatArray
) -> tuple[FloatArray, float]:
    """Iterate from some unknowns; return the last ones and the largest force left over."""
    mass = vehicle.arrays.mass
    load = vehicle.parameters.lateral.axle_load

    def residual(values: FloatArray) -> FloatArray:
        state = _settled(vehicle, frame, values)
        return rate_of_change(vehicle, state, frame=frame)[0][_N : 2 * _N] * mass / load

    # Micrometres and microradians; the rates in thousandths of a radian per second.
    scale = np.where(_UNKNOWN < _N, 1e-6, 1e-3)
    force = residual(values)
    for _ in range(_ITERATIONS):
        if np.abs(force).max() < _TOLERANCE:
            break
        columns = [
            (residual(values + step) - residual(values - step)) / 2.0 for step in np.diag(scale)
        ]
        move = np.linalg.lstsq(np.stack(columns, axis=1), -force, rcond=1e-14)[0] * scale
        share = 1.0
        while share > 1e-4:
            trial = residual(values + share * move)
            if np.linalg.norm(trial) < np.linalg.norm(force):
                break
            share *= 0.5
        else:
            break  # nothing gained along the step: at the rounding limit, or stuck
        values, force = values + share * move, trial
    return values, float(np.abs(force).max())


def linearised(vehicle: FullVehicle, at: Equilibrium | None = None) -> FloatArray:
    """Return the state matrix A of small motion about steady rolling, shape (states, states).

    Suspension, dampers below their break and gyroscopic moments are linear, so any difference step
    gives them exactly; the contact is differentiated by central differences with two steps and
    Richardson's extrapolation. Half the steps move roots by a relative 1e-4 at most: centred wheels
    stand on a knot of the contact table, where its third derivative jumps.

    Args:
        vehicle: The vehicle.
        at: Where; None for its equilibrium on straight track.
    """
    here = equilibrium(vehicle) if at is None else at
    n = vehicle.num_states
    steps = np.full(n, _PLACE_STEP)
    steps[_N : 2 * _N] = _RATE_STEP
    steps[2 * _N + len(vehicle.nodes) :] = 1.0
    A = np.zeros((n, n))
    for i in range(n):
        slopes: list[FloatArray] = []
        for factor in (1.0, 2.0):
            step = np.zeros(n)
            step[i] = factor * steps[i]
            up = rate_of_change(vehicle, here.state + step)[0]
            down = rate_of_change(vehicle, here.state - step)[0]
            slopes.append((up - down) / (2.0 * step[i]))
        A[:, i] = (4.0 * slopes[0] - slopes[1]) / 3.0
    return A


def actuator_matrix(vehicle: FullVehicle) -> FloatArray:
    """Return the columns of B that belong to the actuators, shape (states, channels)."""
    rest = np.zeros(vehicle.num_states)
    none = rate_of_change(vehicle, rest)[0]
    columns = [
        rate_of_change(vehicle, rest, command=unit)[0] for unit in np.eye(vehicle.num_actuators)
    ]
    # Forces enter linearly, so a difference over one newton is exact to rounding.
    return np.array([column - none for column in columns]).reshape(-1, vehicle.num_states).T
