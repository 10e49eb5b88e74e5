"""One compiled pass over lanes: command, track, physics, reward, observation.

Lanes are taken a few at a time, so that what a lane needs is still close to the processor when the
next part asks for it, and a thread enters compiled code once per step.

The compiler's cache watches only the file of the function that is called: a change in one of the
parts would go on running as it was. A digest of their source is therefore a part of the function,
as a variable of the scope around it, which the cache does look at.
"""

import hashlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

from railenv.actuation import delay_line
from railenv.actuation.delay_line import QueueArrays, issue
from railenv.envs import kernels
from railenv.envs.kernels import (
    ObservationArrays,
    RewardArrays,
    RewardConstants,
    assess,
    command,
    observe,
)
from railenv.simulation import excitation, stepping
from railenv.simulation.excitation import Places, Wheels, excite
from railenv.simulation.stepping import LaneArrays, PlantArrays, advance
from railenv.track.table import TrackArrays
from railenv.units import FloatArray

AT_ONCE = 64
"""Lanes that go through all parts before the next ones."""

_PARTS = (delay_line, kernels, excitation, stepping)


def _compiled(sources: str) -> Callable[..., None]:
    @njit(cache=True, nogil=True, error_model="numpy")
    def whole_step(
        plant: PlantArrays,
        lanes: LaneArrays,
        queue: QueueArrays,
        table: TrackArrays,
        places: Places,
        wheels: Wheels,
        constants: RewardConstants,
        reward: RewardArrays,
        observation: ObservationArrays,
        active: NDArray[np.bool_],
        first: int,
        end: int,
        actions: FloatArray,
        scale: float,
        commands: FloatArray,
        later: FloatArray,
        lost: NDArray[np.bool_],
        force_limit: float,
        force_step: float,
        recorded: FloatArray,
        sampled: FloatArray,
        rewards: FloatArray,
        out: NDArray[np.float32],
    ) -> None:
        len(sources)  # makes it a part of this function
        h = plant.time_step
        for a in range(first, end, AT_ONCE):
            b = min(a + AT_ONCE, end)
            command(
                observation,
                reward.effort,
                constants.effort_weight,
                active,
                a,
                b,
                actions,
                scale,
                commands,
            )
            excite(table, places, wheels, lanes.vehicle, lanes.step, h, active, a, b, lanes.track)
            issue(
                queue, lanes.step, active, a, b, commands, later, lost, force_limit, force_step, h
            )
            advance(plant, lanes, queue, active, a, b, recorded, sampled)
            assess(constants, reward, active, a, b, recorded, lanes.step, rewards)
            observe(observation, active, a, b, sampled, out)

    return whole_step


def _digest() -> str:
    texts = [Path(str(part.__file__)).read_bytes() for part in _PARTS]
    return hashlib.sha256(b"".join(texts)).hexdigest()


whole_step = _compiled(_digest())
"""Advance the lanes from `first` to before `end` by one control period; see its parts."""
