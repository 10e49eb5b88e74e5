"""Small motion of the nonlinear vehicle about steady rolling, for the stability oracle."""

import numpy as np

from baselines.controller import LinearFeedback
from railenv.errors import ArgumentError
from railenv.simulation.full_outputs import output_rows
from railenv.stability import DelaySystem
from railenv.stability.loops import LinearSystem
from railenv.units import FloatArray
from railenv.vehicle.coordinates import COORDINATES, WHEELSETS, actuator_positions
from railenv.vehicle.nonlinear import FullVehicle, equilibrium, linearised
from railenv.vehicle.nonlinear.coordinates import NUM_COORDINATES, coordinate_index
from railenv.vehicle.nonlinear.equilibrium import actuator_matrix

_N = NUM_COORDINATES
# Nothing depends on how far a wheelset has turned; kept, these states are roots at zero.
_TURNED = {coordinate_index(f"wheelset{i}_pitch") for i in WHEELSETS}
_LATERAL = [coordinate_index(name) for name in COORDINATES]


def linear_plant(vehicle: FullVehicle, sensors: tuple[str, ...]) -> LinearSystem:
    """Return commands in, sensors out, for small motion about steady rolling on straight track.

    Args:
        vehicle: The vehicle. Its states come in the order of the 17-coordinate model, so that its
            modes have their names: lateral coordinates, their velocities, nodes of dampers; then
            the others, less the wheelsets' angles of rotation.
        sensors: Names of outputs, see `railenv.simulation.full_outputs`.

    Raises:
        ArgumentError: An output does not exist.
        NoEquilibriumError: The vehicle does not roll steadily.
    """
    A, B = linearised(vehicle, equilibrium(vehicle)), actuator_matrix(vehicle)
    n, m = B.shape
    rows = output_rows((vehicle,), sensors, (), every=1, time_step=1.0)
    C, D = np.zeros((len(sensors), n)), np.zeros((len(sensors), m))
    for k, (first, end) in enumerate(zip(rows.start, rows.start[1:], strict=False)):
        dense: FloatArray = np.zeros(3 * _N + m + 4 * len(WHEELSETS))
        dense[rows.column[first:end]] = rows.value[0, first:end]
        places, accelerations = dense[: 2 * _N], dense[2 * _N : 3 * _N]
        C[k] = accelerations @ A[_N : 2 * _N]
        C[k, : 2 * _N] += places
        D[k] = accelerations @ B[_N : 2 * _N]
        forces = dense[3 * _N : 3 * _N + m]
        if vehicle.actuator_lag > 0.0:
            C[k, n - m :] += forces
        else:
            D[k] += forces
    nodes = range(2 * _N, 2 * _N + len(vehicle.nodes))
    leading = [*_LATERAL, *(_N + index for index in _LATERAL), *nodes]
    kept = [*leading, *sorted(set(range(n)) - _TURNED - set(leading))]
    names = tuple(f"actuator_force_{k}" for k in actuator_positions(vehicle.layout))
    return LinearSystem(A[np.ix_(kept, kept)], B[kept], C[:, kept], D, names, sensors)


def linear_loop(controller: object, vehicle: FullVehicle) -> DelaySystem:
    """Return the loop of a static linear feedback around small motion of the vehicle.

    Raises:
        ArgumentError: The controller is no `LinearFeedback`, or of another layout.
    """
    if not isinstance(controller, LinearFeedback):
        raise ArgumentError(
            f"controller {type(controller).__name__} is not a static linear feedback, and only "
            "that is closed around the linearised vehicle; use --method simulation"
        )
    if controller.layout != vehicle.layout:
        raise ArgumentError(
            f"the controller is for layout {controller.layout}, the vehicle has layout "
            f"{vehicle.layout}; use the same for both"
        )
    return DelaySystem.from_loop(linear_plant(vehicle, controller.sensors), controller.gain)
