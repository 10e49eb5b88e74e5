"""Drives on development tracks: what a controller makes of the ride at every delay.

The environment of the training on other tracks, all controllers over the same ones with the same
noise. The cost of a lane is the mean square of the ride-filtered acceleration at the worse floor
end; tracks of one delay are averaged before the worse end is taken.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.controller import Controller
from baselines.training.judge_settings import CheckpointSettings
from railenv.envs.rail_vector_env import Lateral17VectorEnv
from railenv.envs.settings import EnvSettings
from railenv.errors import ArgumentError
from railenv.metrics.ride_filter import ride_index_from_mean_square
from railenv.units import FloatArray, Second

DEV_POOL = 950_000
"""Seed of the development tracks; see `railenv.track.seed_domains`."""


class DevDrive:
    """The same drives for every controller.

    Args:
        environment: Settings of the training environment; what its episodes are like.
        chosen: Delays, number of tracks, and how long each drive is.

    Attributes:
        delays: Delays, shape (delays,) [s].
    """

    def __init__(self, environment: EnvSettings, chosen: CheckpointSettings) -> None:
        self.delays: FloatArray = np.array(chosen.delays)
        self._tracks = chosen.dev_tracks
        period = environment.control_period
        self._skip, self._last = (
            round(seconds / period) for seconds in (chosen.skip_seconds, chosen.dev_seconds)
        )
        if not 0 <= self._skip < self._last:
            raise ArgumentError(
                f"dev_seconds = {chosen.dev_seconds:g} s is shorter than a control period after "
                f"skip_seconds = {chosen.skip_seconds:g} s; give more"
            )
        varying = environment.delays().varying
        self._environment = dataclasses.replace(
            environment,
            pool_seed=DEV_POOL,
            track_pool=self._tracks,
            max_delay=max(environment.max_delay, float(self.delays.max()) + varying.jitter),
            delay=0.0,
            sensor_delay=0.0,
            jitter=varying.jitter,
            common_jitter=varying.common_jitter,
            dropout=varying.dropout,
            sensor_dropout=varying.sensor_dropout,
            delay_per_channel=False,
            delay_observed=False,
            told_error=0.0,
            observation="sensors",
            observation_scale="si",
            observation_history=0,
            action_history=0,
            action="each",
            action_scale=environment.force_limit,
            # One period more: the last one that counts is none of an ended episode.
            episode_seconds=(self._last + 1) * period,
        )

    def powers(
        self,
        controller: Controller,
        told_error: Second = 0.0,
        watch: Callable[[], None] = lambda: None,
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Drive a controller over all tracks at all delays.

        Args:
            controller: Standard sensors in, told the delay if it can be.
            told_error: Error of the told delay, which is never negative [s].
            watch: Called after the controller has acted in a period that counts; lanes are then all
                tracks of the first delay, all of the second, and so on.

        Returns:
            Mean square of the ride-filtered acceleration at the worse floor end, shape (delays,)
            [(m/s^2)^2], and which delays had a lane that diverged. Such a lane counts with the
            acceleration at which a run has diverged.
        """
        settings = {
            field.name: getattr(self._environment, field.name)
            for field in dataclasses.fields(self._environment)
        }
        delay = np.repeat(self.delays, self._tracks)
        lanes, of_lane = len(delay), np.tile(np.arange(self._tracks), len(self.delays))
        env = Lateral17VectorEnv(lanes, **settings)
        try:
            observation, _ = env.reset(
                seed=[DEV_POOL + int(track) for track in of_lane], options={"delay": delay}
            )
            # Seed zero: what a law draws for itself is the same in every judgement.
            controller.reset(lanes, 0)
            tell: Any = getattr(controller, "tell", None)
            if tell is not None:
                tell(np.maximum(delay + told_error, 0.0))
            scale = getattr(controller, "action_scale", 0.0) / env.settings.action_scale
            before = np.zeros((lanes, 2))
            diverged: NDArray[np.bool_] = np.zeros(lanes, dtype=bool)
            info: dict[str, Any] = {}
            for period in range(self._last):
                action = scale * controller.act(observation.astype(np.float64))
                if period >= self._skip:
                    watch()
                # A lane that has ended drives on from a new start and no longer counts; what a law
                # in a limit cycle commands beyond the force limit is cut there by the box.
                action = np.clip(action, -1.0, 1.0)
                observation, _, ended, _, info = env.step(action.astype(np.float32))
                diverged |= ended
                if period + 1 == self._skip:
                    before = _sum_of_squares(info["ride_index"], self._skip)
            after = _sum_of_squares(info["ride_index"], self._last)
        finally:
            env.close()
        power = (after - before) / (self._last - self._skip)
        power[diverged] = env.settings.acceleration_limit**2
        by_delay = power.reshape(len(self.delays), self._tracks, 2).mean(axis=1)
        gone = np.array([lanes.any() for lanes in diverged.reshape(len(self.delays), -1)])
        return by_delay.max(axis=1), gone


def _sum_of_squares(index: FloatArray, periods: int) -> FloatArray:
    """Undo the running ride index: its mean square times the number of periods."""
    unit, tenfold = (float(ride_index_from_mean_square(p)) for p in (1.0, 10.0))
    return periods * (np.asarray(index) / unit) ** (1.0 / np.log10(tenfold / unit))
