"""State space of the linear lateral vehicle, with named states, inputs and outputs.

    x' = A x + B u,   y = C x + D u

x: 17 coordinates, their 17 velocities, then the Maxwell nodes. u: actuator forces, then alignment
at the four wheelsets [m], track roll there [rad], and the rates of both (the rates enter through
the primary dampers; a hold that knows the slope supplies them exactly). y: sensors, forces and
floor accelerations, see `_outputs`.

Accelerometers give kinematic acceleration; with `specific_force=True` they give what a real one
on the tilting body measures, y'' - g roll.
"""

from dataclasses import dataclass

import numpy as np

from railenv.errors import unknown_name
from railenv.units import STANDARD_GRAVITY, FloatArray
from railenv.vehicle.coordinates import (
    BOGIES,
    COORDINATES,
    DAMPER_POSITIONS,
    NUM_COORDINATES,
    WHEELSETS,
    actuator_positions,
    lateral_of_point,
    unit_row,
)
from railenv.vehicle.linear import LateralVehicle
from railenv.vehicle.suspension import NUM_TRACK, damper_place, damper_row

FLOORS = ("front", "rear")


@dataclass(frozen=True, eq=False)
class StateSpace:
    """Linear time-invariant system x' = A x + B u, y = C x + D u with names.

    Attributes:
        A: Shape (states, states).
        B: Shape (states, inputs).
        C: Shape (outputs, states).
        D: Shape (outputs, inputs).
        states: Names of the states.
        inputs: Names of the inputs; the actuator forces come first.
        outputs: Names of the outputs.
        num_actuators: Number of leading inputs that are actuator forces [N].
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    num_actuators: int

    def output_rows(self, names: tuple[str, ...]) -> tuple[FloatArray, FloatArray]:
        """Return the rows of C and D for the named outputs or states.

        Args:
            names: Output names; a state's name selects that state itself.

        Returns:
            C rows, shape (len(names), states), and D rows, shape (len(names), inputs).

        Raises:
            ArgumentError: A name is neither an output nor a state.
        """
        C = np.zeros((len(names), len(self.states)))
        D = np.zeros((len(names), len(self.inputs)))
        for k, name in enumerate(names):
            if name in self.outputs:
                index = self.outputs.index(name)
                C[k], D[k] = self.C[index], self.D[index]
            elif name in self.states:
                C[k, self.states.index(name)] = 1.0
            else:
                raise unknown_name("output", name, (*self.outputs, *self.states))
        return C, D

    @property
    def actuator_input(self) -> FloatArray:
        """Columns of B that belong to the actuators, shape (states, channels)."""
        return self.B[:, : self.num_actuators]


def state_space(vehicle: LateralVehicle, *, specific_force: bool = False) -> StateSpace:
    """Build the state space of the vehicle at its speed.

    Args:
        vehicle: The linear vehicle.
        specific_force: Accelerometers measure y'' - g roll instead of y''.

    Returns:
        The system; 42 states for the passive layout, 40 with two and 38 with four actuators.
    """
    n, nodes = NUM_COORDINATES, vehicle.dampers
    num_states = 2 * n + len(nodes)
    m = vehicle.num_actuators
    inverse_mass = 1.0 / np.diag(vehicle.mass)[:, None]

    stiffness = vehicle.suspension_stiffness + vehicle.contact_stiffness
    C_damping = vehicle.suspension_damping + vehicle.creep_damping / vehicle.speed
    A = np.zeros((num_states, num_states))
    A[:n, n : 2 * n] = np.eye(n)
    A[n : 2 * n, n : 2 * n] = -inverse_mass * C_damping
    for index, damper in enumerate(nodes):
        stiffness += damper.stiffness * np.outer(damper.row, damper.row)
        node = 2 * n + index
        A[n : 2 * n, node] = inverse_mass[:, 0] * damper.stiffness * damper.row
        A[node, :n] = damper.stiffness / damper.damping * damper.row
        A[node, node] = -damper.stiffness / damper.damping
    A[n : 2 * n, :n] = -inverse_mass * stiffness

    B = np.zeros((num_states, m + 2 * NUM_TRACK))
    B[n : 2 * n, :m] = inverse_mass * vehicle.actuator_rows.T
    B[n : 2 * n, m : m + NUM_TRACK] = inverse_mass * vehicle.track_stiffness
    B[n : 2 * n, m + NUM_TRACK :] = inverse_mass * vehicle.track_damping

    states = (
        *COORDINATES,
        *(f"{name}_velocity" for name in COORDINATES),
        *(damper.name for damper in nodes),
    )
    track = tuple(f"{kind}_{w}" for kind in ("alignment", "track_roll") for w in WHEELSETS)
    inputs = (
        *(f"actuator_force_{p}" for p in actuator_positions(vehicle.layout)),
        *track,
        *(f"{name}_rate" for name in track),
    )
    rows = _outputs(vehicle, A, B, specific_force)
    outputs = tuple(rows)
    C = np.array([rows[name][0] for name in outputs])
    D = np.array([rows[name][1] for name in outputs])
    return StateSpace(A, B, C, D, states, inputs, outputs, m)


def _outputs(
    vehicle: LateralVehicle, A: FloatArray, B: FloatArray, specific_force: bool
) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Rows of C and D by name; the order here is the order of the outputs."""
    p = vehicle.parameters
    n = NUM_COORDINATES
    num_states, num_inputs = int(B.shape[0]), int(B.shape[1])

    def position(row: FloatArray) -> tuple[FloatArray, FloatArray]:
        c: FloatArray = np.zeros(num_states)
        c[:n] = row
        return c, np.zeros(num_inputs)

    def velocity(row: FloatArray) -> tuple[FloatArray, FloatArray]:
        c: FloatArray = np.zeros(num_states)
        c[n : 2 * n] = row
        return c, np.zeros(num_inputs)

    def acceleration(row: FloatArray, body: str) -> tuple[FloatArray, FloatArray]:
        c, d = row @ A[n : 2 * n], row @ B[n : 2 * n]
        if specific_force:
            c = c.copy()
            c[:n] -= STANDARD_GRAVITY * unit_row(f"{body}_roll")
        return c, d

    rows: dict[str, tuple[FloatArray, FloatArray]] = {}
    on_carbody = {
        k: lateral_of_point("carbody", damper_place(p, k), p.carbody_to_damper_height)
        for k in DAMPER_POSITIONS
    }
    for k in DAMPER_POSITIONS:
        rows[f"carbody_lateral_velocity_{k}"] = velocity(on_carbody[k])
    for k in DAMPER_POSITIONS:
        rows[f"carbody_lateral_acceleration_{k}"] = acceleration(on_carbody[k], "carbody")
    for j in BOGIES:
        row = unit_row(f"bogie{j}_lateral")
        rows[f"bogie{j}_lateral_acceleration"] = acceleration(row, f"bogie{j}")
    for body in ("carbody", "bogie1", "bogie2"):
        for motion in ("roll", "yaw"):
            rows[f"{body}_{motion}_rate"] = velocity(unit_row(f"{body}_{motion}"))
    for k in DAMPER_POSITIONS:
        rows[f"suspension_stroke_{k}"] = position(damper_row(p, k))
    for k in DAMPER_POSITIONS:
        rows[f"suspension_stroke_rate_{k}"] = velocity(damper_row(p, k))
    for name, sign in zip(FLOORS, (1, -1), strict=True):
        row = lateral_of_point("carbody", sign * p.half_bogie_spacing, p.carbody_to_floor_height)
        rows[f"floor_{name}_lateral_acceleration"] = acceleration(row, "carbody")
        rows[f"floor_{name}_lateral_displacement"] = position(row)
    for motion in ("lateral", "yaw", "roll"):
        c, d = velocity(unit_row(f"carbody_{motion}"))
        rows[f"carbody_{motion}_acceleration"] = (c @ A, c @ B + d)
    for k, position_number in enumerate(actuator_positions(vehicle.layout)):
        d = np.zeros(num_inputs)
        d[k] = 1.0
        rows[f"actuator_force_{position_number}"] = (np.zeros(num_states), d)
    for index, damper in enumerate(vehicle.dampers):
        c = np.zeros(num_states)
        c[:n] = damper.stiffness * damper.row
        c[2 * n + index] = -damper.stiffness
        rows[damper.name.replace("_node", "_force")] = (c, np.zeros(num_inputs))
    for column, wheelset in enumerate(WHEELSETS):
        c, d = position(unit_row(f"wheelset{wheelset}_lateral"))
        d[vehicle.num_actuators + column] = -1.0
        rows[f"wheelset{wheelset}_rail_offset"] = (c, d)
    # What the wheelsets meet, for laws that are told it.
    for column in range(NUM_TRACK):
        name = f"{('alignment', 'track_roll')[column // 4]}_{WHEELSETS[column % 4]}"
        d = np.zeros(num_inputs)
        d[vehicle.num_actuators + column] = 1.0
        rows[name] = (np.zeros(num_states), d)
    return rows
