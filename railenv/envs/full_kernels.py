"""The compiled part of the nonlinear vehicle's environment: safety of a period, and derailment."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from railenv.envs.kernels import DIVERGENCE, NOT_ENDED, RewardArrays
from railenv.simulation.full_stepping import DERAILED, DIVERGED
from railenv.units import FloatArray

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

DERAILMENT = 3
"""An episode's ending, beside those of `railenv.envs.kernels`."""


class SafetyArrays(NamedTuple):
    """How safe the last period of every lane was; forces are means over the period.

    Attributes:
        derailment_quotient: Largest quotient Y / Q of a wheel that bears on its rail, guiding force
            outwards over wheel load, shape (lanes,) [1].
        wheel_unloading: Largest 1 - Q / Q_0 of a wheel, Q_0 its static load, shape (lanes,) [1].
        wheelset_shift: Largest displacement of a wheelset on a rail at the end of the period, in
            either direction, shape (lanes,) [m].
        guiding_force: Largest sum of the guiding forces of a wheelset's two wheels, in either
            direction, shape (lanes,) [N].
    """

    derailment_quotient: FloatArray
    wheel_unloading: FloatArray
    wheelset_shift: FloatArray
    guiding_force: FloatArray


@njit(cache=True, nogil=True, error_model="numpy")
def judge(
    wheels: FloatArray,
    vehicle_ended: IntArray,
    vehicle: IntArray,
    static_load: FloatArray,
    penalty: float,
    active: BoolArray,
    first: int,
    end: int,
    safety: SafetyArrays,
    terms: RewardArrays,
    reward: FloatArray,
) -> None:
    """Say how safe the last period of the lanes from `first` to before `end` was.

    A vehicle that has derailed or diverged ends the episode, whatever else has: the reason becomes
    its own, and the penalty is paid once.

    Args:
        wheels: What is told of the wheels, left before right, shape (lanes, 8, 5); see
            `railenv.vehicle.nonlinear.rates.WHEEL_COLUMNS`.
        vehicle_ended: What the vehicle has come to, shape (lanes,); see
            `railenv.simulation.full_stepping`.
        vehicle: Vehicle of each lane, shape (lanes,).
        static_load: Static load of a wheel of every vehicle, shape (vehicles,) [N].
        penalty: Cost of an ending.
        active: Lanes that take part, shape (lanes,).
        first: First lane.
        end: One past the last lane.
        safety: Overwritten.
        terms: Reward; its ending and divergence term are changed.
        reward: Shape (lanes,); changed.
    """
    quotient, unloading = safety.derailment_quotient, safety.wheel_unloading
    shift, guiding = safety.wheelset_shift, safety.guiding_force
    comfort, effort, stroke, divergence = (
        terms.comfort,
        terms.effort,
        terms.stroke,
        terms.divergence,
    )
    ended = terms.ended
    for lane in range(first, end):
        if not active[lane]:
            continue
        largest_quotient, largest_shift, largest_sum = -np.inf, 0.0, 0.0
        least_load = np.inf
        for wheel in range(8):
            load, outwards = wheels[lane, wheel, 0], wheels[lane, wheel, 1]
            least_load = min(least_load, load)
            # Loads are never negative; a wheel in the air all the time has no quotient.
            if load > 0.0:
                largest_quotient = max(largest_quotient, outwards / load)
            largest_shift = max(largest_shift, abs(wheels[lane, wheel, 4]))
            if wheel % 2 == 1:
                # Outwards is to the right for the right wheel, to the left for the left one.
                largest_sum = max(largest_sum, abs(outwards - wheels[lane, wheel - 1, 1]))
        quotient[lane] = largest_quotient if largest_quotient > -np.inf else 0.0
        unloading[lane] = 1.0 - least_load / static_load[vehicle[lane]]
        shift[lane] = largest_shift
        guiding[lane] = largest_sum
        state = vehicle_ended[lane]
        if state in (DERAILED, DIVERGED):
            if ended[lane] == NOT_ENDED:
                divergence[lane] = -penalty
                reward[lane] = comfort[lane] + effort[lane] + stroke[lane] + divergence[lane]
            ended[lane] = DERAILMENT if state == DERAILED else DIVERGENCE
