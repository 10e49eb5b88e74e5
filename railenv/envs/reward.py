"""The environment's reward, term by term.

    reward = comfort + effort + stroke + divergence

- comfort = -min(a / comfort_reference, comfort_cap) with a the root mean square, over the physics
  steps of the control period and both floor ends, of the lateral acceleration behind the ride
  filter (`railenv.metrics.ride_filter`), whose running mean square follows Sperling's ride index.
  The root, not the square: returns are not dominated by a few bad moments.
- effort = -effort_weight times the mean square of the actions as applied.
- stroke = -stroke_weight times the mean square stroke of the secondary suspension in units of
  stroke_reference, at most stroke_weight: a soft ride must not use up the way to the bump stops.
- divergence = -penalty on the step that leaves the gauge or diverges. Rewards are negative, so
  ending early must cost more than going on. By default it costs the worst of every step of a whole
  episode: no episode without it, however bad, has a lower return than one with it, and at the
  moment it happens it costs more than the worst way to go on, at any discount.

Every reward lies in [-(comfort_cap + effort_weight + stroke_weight + penalty), 0].
"""

import numpy as np
from numpy.typing import NDArray

from railenv.envs.kernels import RewardArrays, RewardConstants, assess
from railenv.envs.settings import EnvSettings
from railenv.errors import ArgumentError
from railenv.metrics.ride_filter import ride_filter, ride_index_from_mean_square
from railenv.units import FloatArray

FLOORS = ("front", "rear")
RECORDED = (
    *(f"floor_{end}_lateral_acceleration" for end in FLOORS),
    *(f"floor_{end}_lateral_displacement" for end in FLOORS),
    *(f"suspension_stroke_{k}" for k in (1, 2, 3, 4)),
)
"""What the reward sees of every physics step."""


def reward_constants(settings: EnvSettings) -> RewardConstants:
    """Return the numbers of the reward."""
    s = settings
    # The estimate of the ride index is a pure power of the mean square.
    factor, tenfold = (float(ride_index_from_mean_square(p)) for p in (1.0, 10.0))
    return RewardConstants(
        comfort_reference=float(s.comfort_reference),
        comfort_cap=float(s.comfort_cap),
        effort_weight=float(s.effort_weight),
        stroke_weight=float(s.stroke_weight),
        stroke_reference=float(s.stroke_reference),
        penalty=s.penalty(),
        gauge_limit=float(s.gauge_limit),
        acceleration_limit=float(s.acceleration_limit),
        index_factor=factor,
        index_exponent=float(np.log10(tenfold / factor)),
    )


def reward_arrays(settings: EnvSettings, num_lanes: int) -> RewardArrays:
    """Return what the reward of every lane remembers, before anything has happened."""
    n, sections = num_lanes, ride_filter(1.0 / settings.record_period())
    return RewardArrays(
        sections=sections,
        memory=np.zeros((n, 2, len(sections), 2)),
        energy=np.zeros((n, 2)),
        comfort=np.zeros(n),
        effort=np.zeros(n),
        stroke=np.zeros(n),
        divergence=np.zeros(n),
        weighted=np.zeros(n),
        ride_index=np.zeros((n, 2)),
        ended=np.zeros(n, dtype=np.int64),
    )


def rewards_of_record(
    settings: EnvSettings, recorded: FloatArray, actions: FloatArray | None = None
) -> FloatArray:
    """Return what a recorded run would have earned, period by period.

    Serves to compare the environment's return with that of a vehicle that is no environment, such
    as the passive one. A run that ends early earns nothing more.

    Args:
        settings: Gives the constants, the control period and the time between records.
        recorded: The signals `RECORDED` after every record step, shape (lanes, steps, 8).
        actions: Actions as applied, shape (lanes, periods, actions); None for no effort.

    Returns:
        Rewards, shape (lanes, periods).

    Raises:
        ArgumentError: The record has the wrong shape or holds no whole number of periods.
    """
    per_period = round(settings.control_period / settings.record_period())
    if recorded.ndim != 3 or recorded.shape[2] != len(RECORDED) or recorded.shape[1] % per_period:
        raise ArgumentError(
            f"recorded has shape {recorded.shape}; it must be (lanes, steps, {len(RECORDED)}) with "
            f"a multiple of {per_period} steps"
        )
    lanes, periods = recorded.shape[0], recorded.shape[1] // per_period
    constants, arrays = reward_constants(settings), reward_arrays(settings, lanes)
    step: NDArray[np.int64] = np.zeros((lanes,), dtype=np.int64)
    active = np.ones(lanes, dtype=bool)
    rewards = np.zeros((lanes, periods))
    for k in range(periods):
        part = np.ascontiguousarray(recorded[:, k * per_period : (k + 1) * per_period])
        if actions is not None:
            arrays.effort[:] = -settings.effort_weight * np.mean(actions[:, k] ** 2, axis=1)
        step = step + per_period
        now = np.zeros(lanes)
        assess(constants, arrays, active, 0, lanes, part, step, now)
        rewards[:, k] = now
        active &= arrays.ended == 0
    return rewards
