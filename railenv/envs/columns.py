"""Columns of the observation: readings now and before, past actions, told delays."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from railenv.envs.episodes import Episodes
from railenv.envs.kernels import ObservationArrays
from railenv.envs.noise import MeasurementNoise
from railenv.units import FloatArray


@dataclass(frozen=True, eq=False)
class Columns:
    """What the observation is made of.

    Attributes:
        names: Name of every column.
        bounds: Largest value of every column, shape (columns,).
        scales: What every column is in units of, shape (columns,) [its SI unit].
        told_factor: What a told delay is multiplied by [1/s, or 1].
        noise: Noise of the measured columns.
        arrays: What every lane remembers.
    """

    names: tuple[str, ...]
    bounds: NDArray[np.float32]
    scales: FloatArray
    told_factor: float
    noise: MeasurementNoise
    arrays: ObservationArrays


def columns_of(episodes: Episodes, num_lanes: int, num_actions: int) -> Columns:
    """Return the columns of an environment's observation.

    Args:
        episodes: Gives settings, measured columns and delays.
        num_lanes: Number of lanes.
        num_actions: Entries of an action.
    """
    s, n, measured = episodes.settings, num_lanes, episodes.measured
    limits = [episodes.limits_of(name) for name in measured]
    scaled = s.observation_scale == "controlled"
    scale = np.array([scale if scaled else 1.0 for _, _, scale in limits])
    depth, length = s.observation_history + 1, s.num_past_actions()
    told = () if not s.delay_observed else ("told_delay",)
    if told and episodes.draw.channels_differ:
        told = tuple(f"told_delay_{c}" for c in range(1, episodes.num_channels + 1))
    # A told delay in units of the longest one; zero stays zero where no delay is allowed.
    told_factor = 1.0 / s.max_delay if scaled and s.max_delay > 0.0 else 1.0
    usual = np.array([response for _, _, response in limits])
    noise = MeasurementNoise(s.sensor_noise * usual / scale, n)
    arrays = ObservationArrays(
        factor=1.0 / scale,
        bound=np.array([limit for limit, _, _ in limits]) / scale,
        frames=np.zeros((n, 2 * depth * len(measured)), dtype=np.float32),
        frame=np.zeros(n, dtype=np.int64),
        actions=np.zeros((n, 2 * length * num_actions), dtype=np.float32),
        action=np.zeros(n, dtype=np.int64),
        told=np.zeros((n, len(told)), dtype=np.float32),
        noise=noise.ahead,
        noise_row=noise.row,
        lost=np.zeros(n, dtype=bool),
        clipped=np.zeros(n, dtype=bool),
        action_clipped=np.zeros(n, dtype=bool),
    )
    names = (
        *measured,
        *(f"{name}_ago_{age}" for age in range(1, depth) for name in measured),
        *(
            f"action_{age}_ago_{a}"
            for age in range(1, length + 1)
            for a in range(1, num_actions + 1)
        ),
        *told,
    )
    actions = np.ones(length * num_actions)
    longest_told = np.full(len(told), (s.max_delay + s.told_error) * told_factor)
    told_scale = np.full(len(told), 1.0 / told_factor)
    bounds = np.concatenate([np.tile(arrays.bound, depth), actions, longest_told])
    scales = np.concatenate([np.tile(scale, depth), actions, told_scale])
    return Columns(names, bounds.astype(np.float32), scales, told_factor, noise, arrays)
