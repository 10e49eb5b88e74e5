"""The compiled equations of motion of Cooperrider's bogie, and their Runge-Kutta steps.

Equations and signs: `railenv.vehicle.cooperrider`. Compiled functions that call each other stand in
one file, because the compiler's cache watches only the file of the function that is called.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from railenv.units import FloatArray


class BogieNumbers(NamedTuple):
    """What the equations need, springs and dampers summed over their pairs; SI units.

    Attributes:
        wheelset_mass: m_w.
        wheelset_yaw_inertia: I_wy.
        frame_mass: m_f.
        frame_yaw_inertia: I_fy.
        frame_roll_inertia: I_fr.
        primary_lateral: 2 k_1, a wheelset against the frame.
        primary_yaw: 2 k_2 d_1^2, likewise.
        secondary_lateral: 2 k_4.
        secondary_lateral_damping: 2 D_2.
        secondary_yaw: k_6.
        roll: 2 k_5 d_2^2 + 4 k_3 d_1^2, frame against the carbody and the wheelsets.
        roll_damping: 2 D_1 d_2^2.
        half_contact_spacing: a.
        half_wheelbase: b.
        primary_height: h_1.
        secondary_height: h_2.
        steer: lambda / r_0, longitudinal creepage by lateral shift.
        creep_stiffness: G pi a_e b_e, per wheel.
        divisor_longitudinal: phi.
        divisor_lateral: chi.
        friction_limit: mu N, per wheel.
        flange_stiffness: k_0.
        flange_clearance: delta.
    """

    wheelset_mass: float
    wheelset_yaw_inertia: float
    frame_mass: float
    frame_yaw_inertia: float
    frame_roll_inertia: float
    primary_lateral: float
    primary_yaw: float
    secondary_lateral: float
    secondary_lateral_damping: float
    secondary_yaw: float
    roll: float
    roll_damping: float
    half_contact_spacing: float
    half_wheelbase: float
    primary_height: float
    secondary_height: float
    steer: float
    creep_stiffness: float
    divisor_longitudinal: float
    divisor_lateral: float
    friction_limit: float
    flange_stiffness: float
    flange_clearance: float


@njit(cache=True, nogil=True, error_model="numpy")
def flange_force(p: BogieNumbers, shift: float) -> float:
    """Force of the rails against the shift of a wheelset [N]."""
    if shift > p.flange_clearance:
        return p.flange_stiffness * (shift - p.flange_clearance)
    if shift < -p.flange_clearance:
        return p.flange_stiffness * (shift + p.flange_clearance)
    return 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def creep_forces(p: BogieNumbers, along: float, across: float) -> tuple[float, float]:
    """Forces F_x and F_y of one wheel from its creepages, after Vermeulen and Johnson [N]."""
    x = along / p.divisor_longitudinal
    y = across / p.divisor_lateral
    u = p.creep_stiffness * np.sqrt(x * x + y * y) / p.friction_limit
    # The force over its linear value: so written, rest needs no case of its own.
    ratio = 1.0 - u / 3.0 + u * u / 27.0 if u < 3.0 else 1.0 / u
    return ratio * p.creep_stiffness * x, ratio * p.creep_stiffness * y


@njit(cache=True, nogil=True, error_model="numpy")
def bogie_rate(p: BogieNumbers, s: FloatArray, speed: float, rate: FloatArray) -> None:
    """Write the rate of change of one state, shape (14,)."""
    a, b, h1, h2 = p.half_contact_spacing, p.half_wheelbase, p.primary_height, p.secondary_height
    front = p.primary_lateral * (s[0] - s[4] - b * s[5] - h1 * s[6])
    rear = p.primary_lateral * (s[2] - s[4] + b * s[5] - h1 * s[6])
    front_yaw = p.primary_yaw * (s[1] - s[5])
    rear_yaw = p.primary_yaw * (s[3] - s[5])
    lateral = p.secondary_lateral * (s[4] - h2 * s[6])
    lateral += p.secondary_lateral_damping * (s[11] - h2 * s[13])
    x1, y1 = creep_forces(p, a * s[8] / speed + p.steer * s[0], s[7] / speed - s[1])
    x2, y2 = creep_forces(p, a * s[10] / speed + p.steer * s[2], s[9] / speed - s[3])
    for i in range(7):
        rate[i] = s[7 + i]
    rate[7] = (-front - 2.0 * y1 - flange_force(p, s[0])) / p.wheelset_mass
    rate[8] = (-front_yaw - 2.0 * a * x1) / p.wheelset_yaw_inertia
    rate[9] = (-rear - 2.0 * y2 - flange_force(p, s[2])) / p.wheelset_mass
    rate[10] = (-rear_yaw - 2.0 * a * x2) / p.wheelset_yaw_inertia
    rate[11] = (front + rear - lateral) / p.frame_mass
    yaw = b * (front - rear) + front_yaw + rear_yaw - p.secondary_yaw * s[5]
    rate[12] = yaw / p.frame_yaw_inertia
    roll = h1 * (front + rear) + h2 * lateral - p.roll * s[6] - p.roll_damping * s[13]
    rate[13] = roll / p.frame_roll_inertia


@njit(cache=True, nogil=True, error_model="numpy")
def advance_bogies(
    p: BogieNumbers,
    states: FloatArray,
    speeds: FloatArray,
    durations: FloatArray,
    longest: float,
    output: int,
    outputs: FloatArray,
) -> None:
    """Move states on in place, Runge-Kutta of fourth order.

    Args:
        p: Numbers of the bogie.
        states: Shape (lanes, 14); overwritten.
        speeds: Shape (lanes,) [m/s].
        durations: Shape (lanes,) [s].
        longest: Longest step [s].
        output: Which coordinate to record.
        outputs: Filled with its values, equally spaced in time, shape (lanes, samples).
    """
    lanes, n = states.shape
    samples = outputs.shape[1]
    k1, k2, k3, k4 = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    middle = np.empty(n)
    for lane in range(lanes):
        state = states[lane]
        speed = speeds[lane]
        interval = durations[lane] / samples
        # The margin keeps a duration that is a whole number of steps up to rounding at that number.
        steps = max(1, int(np.ceil(interval / longest - 1e-9)))
        h = interval / steps
        for sample in range(samples):
            for _ in range(steps):
                bogie_rate(p, state, speed, k1)
                for i in range(n):
                    middle[i] = state[i] + 0.5 * h * k1[i]
                bogie_rate(p, middle, speed, k2)
                for i in range(n):
                    middle[i] = state[i] + 0.5 * h * k2[i]
                bogie_rate(p, middle, speed, k3)
                for i in range(n):
                    middle[i] = state[i] + h * k3[i]
                bogie_rate(p, middle, speed, k4)
                for i in range(n):
                    state[i] += h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])
            outputs[lane, sample] = state[output]
