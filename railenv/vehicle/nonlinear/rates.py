"""The compiled equations of motion of the nonlinear vehicle: what the state's rate of change is.

State of one vehicle: 50 coordinates, their 50 velocities, one node per damper with a spring in
series, then the force of every actuator behind its lag (none where there is no lag).

    M v' = load - K q - C v - dampers - stops + actuators + contact + gyroscopic moments

Contact of a wheel is worked out on the right-hand side; the left wheel is its mirror image (lateral
displacement, roll and yaw change sign). Normal forces are the gradient of the contact's potential
(`railenv.contact.table`), with damping N (1 + alpha p') that never pulls. With the wheelset's
rotation w = -V / r_0 + pitch', contact point (x_c, y_c, r_c) in the wheelset's axes and the tangent
t = (0, 1, h_u) / s, s = sqrt(1 + h_u^2), across the contact plane, the wheel slides on the rail by

    v_x = V + x' + w r_c - y_c yaw'                       forward
    v_y = y' - r_c roll' + w r_c yaw + x_t yaw',  x_t = x_c - y_c yaw
    v_z = z' - z_rail' + y_c roll' - w x_c
    v_t = (v_y + h_u v_z) / s                             across
    spin = (yaw' + w roll - h_u w) / s                    about the contact normal, down

(in a curve yaw' counts the turning of the track frame)

and creep forces act along the same rows, so that their power is force times sliding. The rail does
not move sideways: irregularity moves the place of contact, not the rail's material.
"""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from railenv.contact import creep_laws, creep_table, fastsim, table
from railenv.contact.creep_laws import creep_force
from railenv.contact.creep_table import CreepTable
from railenv.contact.table import ContactArrays, flange_is_free, patch, touch
from railenv.units import FloatArray
from railenv.vehicle.nonlinear.coordinates import FIRST_WHEELSET, NUM_COORDINATES

IntArray = NDArray[np.int64]

N = NUM_COORDINATES
FIRST = FIRST_WHEELSET
ZONES = 2
WHEEL_COLUMNS = ("vertical", "lateral", "tread_normal", "flange_normal", "shift")
"""What is told of every wheel: force on the rail down, force on the rail outwards, normal forces
[N], displacement of the wheelset towards this wheel's flange relative to the rail [m]."""

GIVEN = -1
"""Creep law: linear with coefficients that are given, not computed."""


class FullArrays(NamedTuple):
    """The vehicle as the compiled equations read it. Rows are sparse: columns and values.

    Attributes:
        mass: Shape (50,).
        load: Constant force on every coordinate, shape (50,) [N].
        start: Where each row of K and C begins, shape (51,).
        column: Shape (entries,).
        stiffness: Entries of K, shape (entries,).
        damping: Entries of C, shape (entries,).
        row_start: Where the row of each damper, stop and actuator begins, shape (elements + 1,).
        row_column: Shape (row entries,).
        row_value: Shape (row entries,).
        damper: Damping, break force, velocity at the break, damping beyond, series stiffness of
            every damper, those without spring first, shape (dampers, 5).
        stop: Displacement [m] and force [N], shape (points, 2).
        counts: Dampers without a spring, dampers with one, stops, actuators.
        scalars: Speed [m/s], wheel radius [m], wheelset's pitch inertia [kg m^2], contact damping
            alpha [s/m], friction coefficient, shear modulus [Pa], actuator lag [s], then given
            creep coefficients f_11, f_22 [N], f_23 [N m], f_33 [N m^2], and 1 where a wheelset's
            roll is felt by creepage, springs and gyroscopic moments, 0 where that is left out.
        law: Creep law.
    """

    mass: FloatArray
    load: FloatArray
    start: IntArray
    column: IntArray
    stiffness: FloatArray
    damping: FloatArray
    row_start: IntArray
    row_column: IntArray
    row_value: FloatArray
    damper: FloatArray
    stop: FloatArray
    counts: IntArray
    scalars: FloatArray
    law: int


class FrameArrays(NamedTuple):
    """What a curve does to the vehicle; rows without entries on straight track.

    Attributes:
        offset: Displacement of every body's own track frame against a common one, shape (50,) or
            (0,).
        rate: Its rate, shape (50,) or (0,).
        acceleration: Of the frames, less gravity in them, shape (50,) or (0,) [m/s^2, rad/s^2].
        turning: Yaw rate of the wheelsets' frames, shape (4,) or (0,) [rad/s].
    """

    offset: FloatArray
    rate: FloatArray
    acceleration: FloatArray
    turning: FloatArray


def _compiled(sources: str) -> Callable[..., None]:
    @njit(cache=True, nogil=True, error_model="numpy")
    def rates(
        vehicle: FullArrays,
        contact: ContactArrays,
        creep: CreepTable,
        state: FloatArray,
        rails: FloatArray,
        command: FloatArray,
        frame: FrameArrays,
        out: FloatArray,
        wheels: FloatArray,
    ) -> None:
        len(sources)  # makes it a part of this function
        load, start, column = vehicle.load, vehicle.start, vehicle.column
        stiffness, damping = vehicle.stiffness, vehicle.damping
        row_start, row_column, row_value = (
            vehicle.row_start,
            vehicle.row_column,
            vehicle.row_value,
        )
        damper, stop, scalars = vehicle.damper, vehicle.stop, vehicle.scalars
        kelvin, maxwell, stops, actuators = vehicle.counts
        speed, radius, spin_inertia = scalars[0], scalars[1], scalars[2]
        lever = scalars[11]
        still = (1.0 - lever) * radius
        curved = len(frame.offset) > 0
        for i in range(N):
            out[i] = state[N + i]
            total = load[i]
            for k in range(start[i], start[i + 1]):
                c = column[k]
                total -= stiffness[k] * state[c] + damping[k] * state[N + c]
            out[N + i] = total
        if curved:
            for i in range(N):
                total = -vehicle.mass[i] * frame.acceleration[i]
                for k in range(start[i], start[i + 1]):
                    c = column[k]
                    total -= stiffness[k] * frame.offset[c] + damping[k] * frame.rate[c]
                out[N + i] += total

        for e in range(kelvin + maxwell + stops + actuators):
            first, end = row_start[e], row_start[e + 1]
            place, rate = 0.0, 0.0
            for k in range(first, end):
                c = row_column[k]
                place += row_value[k] * state[c]
                rate += row_value[k] * state[N + c]
                if curved:
                    place += row_value[k] * frame.offset[c]
                    rate += row_value[k] * frame.rate[c]
            if e < kelvin:
                size = abs(rate)
                if size <= damper[e, 2]:
                    force = damper[e, 0] * rate
                else:
                    force = np.copysign(damper[e, 1] + damper[e, 3] * (size - damper[e, 2]), rate)
            elif e < kelvin + maxwell:
                node = 2 * N + e - kelvin
                force = damper[e, 4] * (place - state[node])
                size = abs(force)
                if size <= damper[e, 1]:
                    out[node] = force / damper[e, 0]
                else:
                    beyond = damper[e, 2] + (size - damper[e, 1]) / damper[e, 3]
                    out[node] = np.copysign(beyond, force)
            elif e < kelvin + maxwell + stops:
                force = 0.0
                size, last = abs(place), len(stop) - 1
                if size > stop[0, 0]:
                    j = 0
                    while j < last - 1 and size > stop[j + 1, 0]:
                        j += 1
                    slope = (stop[j + 1, 1] - stop[j, 1]) / (stop[j + 1, 0] - stop[j, 0])
                    force = np.copysign(stop[j, 1] + slope * (size - stop[j, 0]), place)
            else:
                channel = e - kelvin - maxwell - stops
                if scalars[6] > 0.0:
                    behind = 2 * N + maxwell + channel
                    force = -state[behind]
                    out[behind] = (command[channel] - state[behind]) / scalars[6]
                else:
                    force = -command[channel]
            for k in range(first, end):
                out[N + row_column[k]] -= row_value[k] * force

        for i in range(4):
            b = FIRST + 6 * i
            x_rate, y, z = state[N + b], state[b + 1], state[b + 2]
            y_rate, z_rate = state[N + b + 1], state[N + b + 2]
            roll, yaw = state[b + 3], state[b + 5]
            roll_rate, yaw_rate = state[N + b + 3], state[N + b + 5]
            rotation = state[N + b + 4] - speed / radius
            turn = yaw_rate + frame.turning[i] if curved else yaw_rate
            # Spin about the axle: it turns roll into yaw and back, and does no work.
            out[N + b + 3] += lever * spin_inertia * rotation * turn
            out[N + b + 5] -= lever * spin_inertia * rotation * roll_rate
            for side in range(2):
                sign = -1.0 if side == 0 else 1.0
                wheel = 2 * i + side
                u, phi, psi = sign * (y - rails[wheel, 0]), sign * roll, sign * yaw
                u_rate = sign * (y_rate - rails[wheel, 2])
                phi_rate, psi_rate, turned = sign * roll_rate, sign * yaw_rate, sign * turn
                above, above_rate = z - rails[wheel, 1], z_rate - rails[wheel, 3]
                sum_x, sum_y, sum_z = 0.0, 0.0, 0.0
                sum_roll, sum_pitch, sum_yaw = 0.0, 0.0, 0.0
                wheels[wheel, 2] = 0.0
                wheels[wheel, 3] = 0.0
                for zone in range(ZONES):
                    if zone == 1 and flange_is_free(contact, u + still * phi, phi, psi, above):
                        continue
                    h, h_u, h_phi, h_psi, k, k_u, k_phi, k_psi = touch(
                        contact, zone, u + still * phi, phi, psi
                    )
                    h_phi += still * h_u
                    k_phi += still * k_u
                    p = above - h
                    if p <= 0.0:
                        continue
                    root = p * np.sqrt(p)
                    growth = above_rate - h_u * u_rate - h_phi * phi_rate - h_psi * psi_rate
                    upward = k * root * max(0.0, 1.0 + scalars[3] * growth)
                    change = 0.4 * p * root
                    sum_z -= upward
                    sum_y += upward * h_u - change * k_u
                    sum_roll += upward * h_phi - change * k_phi
                    sum_yaw += upward * h_psi - change * k_psi
                    s = np.sqrt(1.0 + h_u * h_u)
                    normal = upward * s
                    wheels[wheel, 2 + zone] = normal
                    if normal <= 0.0:
                        continue
                    r_c, y_c, x_c, _, a1, b1, c11, c22, c23, c33 = patch(
                        contact, zone, u + still * phi, phi, psi
                    )
                    x_t = x_c - y_c * psi
                    v_x = speed + x_rate + rotation * r_c - y_c * turned
                    v_y = (
                        sign * y_rate - lever * r_c * phi_rate + rotation * r_c * psi + x_t * turned
                    )
                    v_z = above_rate + y_c * phi_rate - rotation * x_c
                    v_t = (v_y + h_u * v_z) / s
                    spin = (turned + rotation * phi - h_u * rotation) / s
                    xi_x, xi_y, spin = v_x / speed, v_t / speed, spin / speed
                    if vehicle.law == GIVEN:
                        f_x = -scalars[7] * xi_x
                        f_t = -scalars[8] * xi_y - scalars[9] * spin
                        m_n = scalars[9] * xi_y - scalars[10] * spin
                    else:
                        size = normal ** (1.0 / 3.0)
                        f_x, f_t, m_n = creep_force(
                            vehicle.law,
                            a1 * size,
                            b1 * size,
                            c11,
                            c22,
                            c23,
                            c33,
                            scalars[5],
                            normal,
                            scalars[4],
                            xi_x,
                            xi_y,
                            spin,
                            creep,
                        )
                    f_y, f_z = f_t / s, f_t * h_u / s
                    sum_x += f_x
                    sum_y += f_y
                    sum_z += f_z
                    sum_roll += y_c * f_z - lever * r_c * f_y
                    sum_pitch += r_c * f_x + r_c * psi * f_y - x_c * f_z + m_n * (phi - h_u) / s
                    sum_yaw += x_t * f_y - y_c * f_x + m_n / s
                out[N + b] += sum_x
                out[N + b + 1] += sign * sum_y
                out[N + b + 2] += sum_z
                out[N + b + 3] += sign * sum_roll
                out[N + b + 4] += sum_pitch
                out[N + b + 5] += sign * sum_yaw
                wheels[wheel, 0] = -sum_z
                wheels[wheel, 1] = -sum_y
                wheels[wheel, 4] = u
        for i in range(N):
            out[N + i] /= vehicle.mass[i]

    return rates


def _digest() -> str:
    parts = (creep_laws, creep_table, fastsim, table)
    texts = [Path(str(part.__file__)).read_bytes() for part in parts]
    return hashlib.sha256(b"".join(texts)).hexdigest()


rates = _compiled(_digest())
"""Write the rate of change of one vehicle's state.

Args:
    vehicle: Its numbers.
    contact: Wheel on rail.
    creep: Table of creep forces.
    state: Shape (states,).
    rails: Lateral place of each rail under its wheel, its place down, and their rates, wheelsets in
        order, left before right, shape (8, 4) [m, m/s].
    command: Force of every actuator, before its lag, shape (channels,) [N].
    frame: What a curve does.
    out: Shape (states,); overwritten.
    wheels: Shape (8, 5), see `WHEEL_COLUMNS`; overwritten.
"""
