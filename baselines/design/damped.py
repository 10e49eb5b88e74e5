"""The sampled design model on dampers: what their coefficients make of its motion.

Dashpots of the lowest coefficient c_0 are part of the plant, which leaves c - c_0 as the input's.
Over a control period T, exactly for a held force, with state X and stroke s,

    X_(k+1) = A X_k + B F_k,   F_k = -(c_k - c_0) (s_(k+1) - s_k) / T

c_k is the coefficient's mean over the period, exact for a first-order response. F_k stands on both
sides, (s_(k+1) - s_k) / T = R X_k + Q F_k: an implicit step, that takes energy out of the model for
any c_k T. Neglected: how coefficient and rate vary together within a period, and the force at which
a damper blows off.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit

from baselines.design.model import DesignModel
from railenv.units import FloatArray, NewtonSecondPerMetre
from railenv.vehicle import LateralVehicle, state_space
from railenv.vehicle.coordinates import actuator_positions


@dataclass(frozen=True, eq=False)
class DampedVehicle(LateralVehicle):
    """The vehicle with a dashpot beside every actuator.

    Attributes:
        coefficient: Of each dashpot [N s/m].
    """

    coefficient: NewtonSecondPerMetre = 0.0

    @cached_property
    def suspension_damping(self) -> FloatArray:
        """Sum of c r^T r over parallel elements and dashpots, shape (17, 17)."""
        rows = self.actuator_rows
        return super().suspension_damping + self.coefficient * rows.T @ rows


def stroke_rows(model: DesignModel, n: int) -> tuple[FloatArray, FloatArray]:
    """Return the rows of the dampers' strokes and of their rates over n states, shape (m, n)."""
    system, places = state_space(model.vehicle), actuator_positions(model.vehicle.layout)
    both: list[FloatArray] = []
    for quantity in ("suspension_stroke", "suspension_stroke_rate"):
        rows, _ = system.output_rows(tuple(f"{quantity}_{k}" for k in places))
        both.append(np.pad(rows, ((0, 0), (0, n - rows.shape[1]))))
    return both[0], both[1]


def coefficient_weights(response_time: float, rest: float, period: float) -> FloatArray:
    """Return how a period's mean coefficient and the one at its end are made up.

    A command arrives at r in the period T; before and after it the coefficient follows.

    Returns:
        Weights of the coefficient at the start, the command before and the one that arrives, of the
        mean (first row) and of the end (second row), shape (2, 3).
    """
    # What is left of the way to go: mean over a time, and at its end.
    left: list[tuple[float, float]] = []
    for time in (rest, period - rest):
        if time == 0.0:
            left.append((1.0, 1.0))
        elif response_time == 0.0:
            left.append((0.0, 0.0))
        else:
            gone = -np.expm1(-time / response_time)
            left.append((response_time / time * gone, 1.0 - gone))
    (mean_0, end_0), (mean_1, end_1) = left
    part = rest / period
    weights = np.zeros((2, 3))
    # Start and command before, at the instant of arrival: (end_0, 1 - end_0).
    weights[0, 0] = part * mean_0 + (1.0 - part) * mean_1 * end_0
    weights[0, 1] = part * (1.0 - mean_0) + (1.0 - part) * mean_1 * (1.0 - end_0)
    weights[0, 2] = (1.0 - part) * (1.0 - mean_1)
    weights[1] = end_1 * end_0, end_1 * (1.0 - end_0), 1.0 - end_1
    return weights


@njit(cache=True, nogil=True, error_model="numpy")
def give_forces(
    free: FloatArray,
    pipe: FloatArray,
    own: FloatArray,
    answer: FloatArray,
    weights: FloatArray,
    lowest: float,
    forces: FloatArray,
    end: FloatArray,
) -> None:
    """Work out the dampers' forces beside the lowest dashpots', period by period, lane by lane.

    Args:
        free: Mean stroke rates of a motion without these forces, m rows per period, shape
            (periods * m, lanes) [m/s].
        pipe: Coefficients in the order of arrival, the first in effect, shape
            (lanes, periods + 1, m) [N s/m].
        own: Q, the mean rate by a force held over the same period, shape (m, m) [m/s/N].
        answer: The mean rate by one of i + 1 periods ago, shape (periods, m, m) [m/s/N].
        weights: See `coefficient_weights`.
        lowest: c_0 [N s/m].
        forces: Shape (periods * m, lanes) [N]; overwritten.
        end: Coefficient at the start, shape (lanes, m) [N s/m]; overwritten by that at the end.
    """
    lanes, m = end.shape
    c, work = np.zeros(m), np.zeros((m, m))
    for lane in range(lanes):
        for j in range(pipe.shape[1] - 1):
            at = j * m
            for i in range(m):
                start, before, new = end[lane, i], pipe[lane, j, i], pipe[lane, j + 1, i]
                c[i] = weights[0, 0] * start + weights[0, 1] * before + weights[0, 2] * new
                c[i] -= lowest
                end[lane, i] = weights[1, 0] * start + weights[1, 1] * before
                end[lane, i] += weights[1, 2] * new
                rate = free[at + i, lane]
                for k in range(j):
                    for q in range(m):
                        rate += answer[j - 1 - k, i, q] * forces[k * m + q, lane]
                forces[at + i, lane] = -c[i] * rate
            # (1 + c own) F = -c rate. own is all but half a period over a mass matrix, symmetric
            # and positive: there is nothing to pivot for.
            for i in range(m):
                for q in range(m):
                    work[i, q] = c[i] * own[i, q]
                work[i, i] += 1.0
            for i in range(m):
                for row in range(i + 1, m):
                    factor = work[row, i] / work[i, i]
                    for q in range(i + 1, m):
                        work[row, q] -= factor * work[i, q]
                    forces[at + row, lane] -= factor * forces[at + i, lane]
            for i in range(m - 1, -1, -1):
                for q in range(i + 1, m):
                    forces[at + i, lane] -= work[i, q] * forces[at + q, lane]
                forces[at + i, lane] /= work[i, i]
