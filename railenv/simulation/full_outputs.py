"""What can be measured on the nonlinear vehicle, by name: the linear model's outputs and more.

An output is a row on the vector (q, v, a, forces, rails): 50 coordinates, their velocities and
accelerations, the actuators' forces [N], then lateral and downward places of the eight rails under
the wheels [m]. Names and meanings are those of `railenv.vehicle.statespace`, so that a controller
that reads one vehicle reads the other.
"""

from collections.abc import Sequence

import numpy as np

from railenv.errors import unknown_name
from railenv.simulation.full_stepping import OutputRows
from railenv.units import STANDARD_GRAVITY, FloatArray
from railenv.vehicle.coordinates import (
    BOGIES,
    DAMPER_POSITIONS,
    WHEELSETS,
    actuator_positions,
    bogie_of_position,
    bogie_sign,
    end_sign,
)
from railenv.vehicle.nonlinear.coordinates import (
    COORDINATES,
    NUM_COORDINATES,
    point_row,
    unit_row,
)
from railenv.vehicle.nonlinear.elements import damper_row
from railenv.vehicle.nonlinear.model import FullVehicle

_N = NUM_COORDINATES
FLOOR_OFFSET = 1.0
"""Where vertical comfort is measured, to the right of the centre line [m]."""


def output_names(vehicle: FullVehicle) -> tuple[str, ...]:
    """Return the name of everything that can be measured."""
    return tuple(_rows(vehicle, specific_force=False))


def output_rows(
    vehicles: Sequence[FullVehicle],
    recorded: Sequence[str],
    sampled: Sequence[str],
    *,
    every: int,
    time_step: float,
    specific_force: bool = False,
) -> OutputRows:
    """Return outputs as the compiled loop reads them.

    Args:
        vehicles: All of one layout.
        recorded: Names of outputs that are recorded inside a control period.
        sampled: Names of outputs at its end.
        every: Physics steps between two records.
        time_step: Physics step [s].
        specific_force: Accelerometers measure y'' - g roll instead of y''.

    Raises:
        ArgumentError: An output does not exist.
    """
    stacks: list[FloatArray] = []
    for vehicle in vehicles:
        known = _rows(vehicle, specific_force)
        for name in (*recorded, *sampled):
            if name not in known:
                raise unknown_name("output", name, known)
        chosen = [known[name] for name in (*recorded, *sampled)]
        stacks.append(np.array(chosen).reshape(len(chosen), len(known[COORDINATES[0]])))
    rows = np.array(stacks)
    used = np.any(rows != 0.0, axis=0)
    return OutputRows(
        start=np.concatenate([[0], np.cumsum(used.sum(axis=1))]).astype(np.int64),
        column=np.nonzero(used)[1].astype(np.int64),
        value=np.ascontiguousarray(rows[:, used]),
        recorded=len(recorded),
        every=every,
        time_step=time_step,
    )


def _rows(vehicle: FullVehicle, specific_force: bool) -> dict[str, FloatArray]:
    """Rows by name."""
    full, p = vehicle.parameters, vehicle.parameters.lateral
    m = vehicle.num_actuators
    width = 3 * _N + m + 4 * len(WHEELSETS)

    def place(row: FloatArray) -> FloatArray:
        return np.concatenate([row, np.zeros(width - _N)])

    def velocity(row: FloatArray) -> FloatArray:
        return np.concatenate([np.zeros(_N), row, np.zeros(width - 2 * _N)])

    def acceleration(row: FloatArray, body: str) -> FloatArray:
        found = np.concatenate([np.zeros(2 * _N), row, np.zeros(width - 3 * _N)])
        if specific_force:
            found[:_N] -= STANDARD_GRAVITY * unit_row(f"{body}_roll")
        return found

    rows: dict[str, FloatArray] = {}
    on_carbody: dict[int, FloatArray] = {}
    for k in DAMPER_POSITIONS:
        x = bogie_sign(bogie_of_position(k)) * p.half_bogie_spacing + end_sign(k) * p.damper_offset
        on_carbody[k] = point_row("carbody", "lateral", x, 0.0, p.carbody_to_damper_height)
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
        rows[f"suspension_stroke_{k}"] = place(damper_row(full, k))
    for k in DAMPER_POSITIONS:
        rows[f"suspension_stroke_rate_{k}"] = velocity(damper_row(full, k))
    for name, sign in (("front", 1), ("rear", -1)):
        x, height = sign * p.half_bogie_spacing, p.carbody_to_floor_height
        row = point_row("carbody", "lateral", x, 0.0, height)
        rows[f"floor_{name}_lateral_acceleration"] = acceleration(row, "carbody")
        rows[f"floor_{name}_lateral_displacement"] = place(row)
        up = point_row("carbody", "vertical", x, FLOOR_OFFSET, height)
        rows[f"floor_{name}_vertical_acceleration"] = velocity(np.zeros(_N))
        rows[f"floor_{name}_vertical_acceleration"][2 * _N : 3 * _N] = up
    for motion in ("lateral", "yaw", "roll", "vertical", "pitch"):
        found = np.zeros(width)
        found[2 * _N : 3 * _N] = unit_row(f"carbody_{motion}")
        rows[f"carbody_{motion}_acceleration"] = found
    for k, position in enumerate(actuator_positions(vehicle.layout)):
        found = np.zeros(width)
        found[3 * _N + k] = 1.0
        rows[f"actuator_force_{position}"] = found
    for i in WHEELSETS:
        found = place(unit_row(f"wheelset{i}_lateral"))
        # The track's alignment is the mean of its two rails.
        first = 3 * _N + m + 2 * (i - 1)
        found[first : first + 2] = -0.5
        rows[f"wheelset{i}_rail_offset"] = found
    for index, name in enumerate(COORDINATES):
        rows[name] = np.zeros(width)
        rows[name][index] = 1.0
        rows[f"{name}_velocity"] = np.zeros(width)
        rows[f"{name}_velocity"][_N + index] = 1.0
    return rows
