"""What lanes of environments share, whatever the vehicle: episodes, readings, actions, info.

A lane is one vehicle on one track with its own delays, clock and random stream. Everything a lane
draws comes from its own generator, in an order that does not depend on other lanes; everything it
computes has a fixed order of operations. So lane k of any batch is the single environment bit for
bit. Randomly varying delay is drawn in blocks of `BLOCK` periods, noise of the sensors in blocks of
`railenv.envs.noise.AHEAD` measurements.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from railenv.actuation import DelayLine
from railenv.envs.bundle import Exchange
from railenv.envs.columns import columns_of
from railenv.envs.episodes import Episodes
from railenv.envs.reward import reward_arrays, reward_constants
from railenv.envs.settings import EnvSettings
from railenv.units import FloatArray

BLOCK = 64
"""Periods for which jitter and dropouts are drawn at a time."""

ENDINGS = np.array(["", "gauge", "divergence", "derailment"])
_TEXT = ENDINGS.dtype

IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


class Batch(Protocol):
    """What lanes need of a batch of vehicles: see `railenv.simulation.batch.VehicleBatch`."""

    commands: FloatArray
    later: FloatArray
    lost: BoolArray
    active: BoolArray
    recorded: FloatArray
    sampled: FloatArray
    line: DelayLine

    @property
    def step(self) -> IntArray:
        """Physics steps since each lane's start, shape (lanes,)."""
        ...


class EpisodeLanes(ABC):
    """A batch of environments that step together.

    Args:
        settings: What they all share.
        num_lanes: How many.
        threads: Threads that share the lanes.
        episodes: What is drawn for them.
        batch: Their vehicles.

    Attributes:
        episodes: What was drawn for every lane.
        observation_names: Columns of the observation.
        bounds: Largest value of every column, shape (columns,).
        scales: What every column is in units of, shape (columns,) [its SI unit].
        num_actions: Entries of an action.
        noise: Noise of the coming measurements.
        generators: One per lane; None before its first seed.
        here: What goes into a step and comes out of it: `here.actions` and `here.active` are set
            before `step`, which overwrites all else.
    """

    def __init__(
        self,
        settings: EnvSettings,
        num_lanes: int,
        threads: int,
        episodes: Episodes,
        batch: Batch,
    ) -> None:
        self.settings = s = settings
        self.num_lanes = num_lanes
        self.threads = threads
        self.episodes = episodes
        channels = batch.commands.shape[1]
        self.num_actions = channels if s.action == "each" else 2
        self.generators: list[np.random.Generator | None] = [None] * num_lanes
        self._physics = batch
        varying = episodes.draw.varying
        self._varies = bool(varying.jitter or varying.dropout or varying.sensor_dropout)
        self._uniform: FloatArray = np.zeros(
            (num_lanes, BLOCK, 2 * channels + 1) if self._varies else (0, 0, 0)
        )
        columns = columns_of(episodes, num_lanes, self.num_actions)
        self.observation_names, self.bounds, self.scales = (
            columns.names,
            columns.bounds,
            columns.scales,
        )
        self._told_factor, self._arrays = columns.told_factor, columns.arrays
        self.noise = columns.noise
        self._constants, self.reward = reward_constants(s), reward_arrays(s, num_lanes)
        self.here = self._exchange()
        # What info copies; found when it is first asked for.
        self._shown: dict[str, NDArray[Any]] | None = None

    @abstractmethod
    def reset(self, lanes: IntArray, options: Sequence[dict[str, Any]] | None = None) -> None:
        """Start a new episode in some lanes.

        Args:
            lanes: Lane numbers, rising, shape (k,).
            options: What is fixed instead of drawn, one dictionary per lane; see
                `railenv.envs.episodes.Episodes.start`.

        Raises:
            ArgumentError: An option is unknown or out of its range.
        """

    @abstractmethod
    def step(self) -> None:
        """Send the actions on their way and advance by one control period; see `here`."""

    @abstractmethod
    def state(self, lane: int) -> FloatArray:
        """Return the state x of one lane, shape (n,)."""

    @abstractmethod
    def pictured(self, lane: int) -> dict[str, FloatArray]:
        """Return where the bodies of one lane are, as `railenv.rendering.View` wants it."""

    @abstractmethod
    def _physics_arrays(self) -> dict[str, NDArray[Any]]:
        """Every array of the vehicles that changes from step to step, by name; not copies."""

    @abstractmethod
    def _force(self) -> FloatArray:
        """Forces that act now, behind any lag, shape (lanes, channels) [N]; not a copy."""

    @abstractmethod
    def close(self) -> None:
        """Stop the threads."""

    def _exchange(self) -> Exchange:
        batch, n = self._physics, self.num_lanes
        return Exchange(
            active=batch.active,
            actions=np.zeros((n, self.num_actions)),
            commands=batch.commands,
            later=batch.later,
            lost=batch.lost,
            true_delay=np.zeros_like(batch.commands),
            recorded=batch.recorded,
            sampled=batch.sampled,
            periods=np.zeros(n, dtype=np.int64),
            reward=np.zeros(n),
            terminated=np.zeros(n, dtype=bool),
            truncated=np.zeros(n, dtype=bool),
            observation=np.zeros((n, len(self.bounds)), dtype=np.float32),
        )

    def check_options(self, options: Sequence[dict[str, Any]] | None) -> None:
        """Check what is to be fixed in a reset; see `Episodes.start`.

        Raises:
            ArgumentError: An option is unknown or out of its range.
        """
        for given in options or ():
            self.episodes.check(given)

    def generator(self, lane: int) -> np.random.Generator:
        """Return a lane's generator; one that was never seeded starts from the system's entropy."""
        generator = self.generators[lane]
        if generator is None:
            generator = np.random.Generator(np.random.PCG64())
            self.generators[lane] = generator
        return generator

    def _vary(self) -> None:
        """Draw what the coming commands are late and which of them and of the readings get lost."""
        batch, varying = self.here, self.episodes.draw.varying
        active, channels = batch.active, batch.commands.shape[1]
        place = batch.periods % BLOCK
        for lane in np.nonzero(active & (place == 0))[0]:
            block = self._uniform[lane]
            block[:] = self.generator(int(lane)).random(block.shape)
        here = self._uniform[np.arange(self.num_lanes), place]
        late = here[:, :1] if varying.common_jitter else here[:, :channels]
        lost = here[:, channels:-1] < varying.dropout
        np.copyto(batch.later, varying.jitter * late, where=active[:, None])
        np.copyto(batch.lost, lost, where=active[:, None])
        np.copyto(self._arrays.lost, here[:, -1] < varying.sensor_dropout, where=active)
        true = np.where(lost, np.inf, self.episodes.delay + batch.later)
        np.copyto(batch.true_delay, true, where=active[:, None])

    def _draw(self) -> None:
        """Draw what the coming period needs: varying delay first, then noise."""
        if self._varies:
            self._vary()
        if self.noise:
            self.noise.renew(self.generator, self.here.active)

    def info(self, lanes: IntArray | None = None) -> dict[str, NDArray[Any]]:
        """Return what there is to know about lanes, new arrays, lanes first.

        Args:
            lanes: Lane numbers, shape (k,); None for all.
        """
        if self._shown is None:
            self._shown = self._shown_arrays()
        if lanes is None:
            info = {name: values.copy() for name, values in self._shown.items()}
        else:
            info = {name: values.take(lanes, axis=0) for name, values in self._shown.items()}
        here = self.episodes
        info["time"] = self.settings.time_step * info["time"]
        info["speed"] = here.wheels.speed.take(info["vehicle"])
        if here.given_seeds:
            track = info["track"]
            track[track >= len(here.tracks)] = -1
        ended = info["ended_by"]
        # Texts are slow to pick, and hardly ever does a lane end but by the length of its episode.
        info["ended_by"] = ENDINGS.take(ended) if ended.any() else np.zeros_like(ended, _TEXT)
        return info

    def _shown_arrays(self) -> dict[str, NDArray[Any]]:
        """What info copies; time in steps, speed and ending as numbers that stand for them."""
        batch, terms, here = self._physics, self.reward, self.episodes
        told = {"told_delay": here.told} if self.settings.delay_observed else {}
        return {
            "time": batch.step,
            "delay": self.here.true_delay,
            "sensor_delay": here.sensor_delay,
            **told,
            "command": batch.commands,
            "force": self._force(),
            "vehicle": here.vehicle,
            "speed": here.vehicle,
            "track": here.places.track,
            "weighted_acceleration": terms.weighted,
            "ride_index": terms.ride_index,
            "reward_comfort": terms.comfort,
            "reward_effort": terms.effort,
            "reward_stroke": terms.stroke,
            "reward_divergence": terms.divergence,
            "action_clipped": self._arrays.action_clipped,
            "observation_clipped": self._arrays.clipped,
            "ended_by": terms.ended,
        }

    def last_period(self) -> tuple[FloatArray, FloatArray]:
        """Return what was recorded in the last period, and the commands sent in it; not copies."""
        return self._physics.recorded, self._physics.commands

    def track_around(self, lane: int, distance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return alignment and cross level at distances from the carbody's centre [m]."""
        return self.episodes.track_around(
            lane, self.settings.time_step * int(self._physics.step[lane]), distance
        )

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return every array that changes from step to step, by name; not copies."""
        here, batch = self.episodes, self._physics
        groups: dict[str, dict[str, Any]] = {
            "lanes": self._physics_arrays(),
            "queue": batch.line.arrays._asdict(),
            "observation": self._arrays._asdict(),
            "reward": self.reward._asdict(),
            "places": here.places._asdict(),
        }
        named = {
            f"{g}.{name}": array for g, group in groups.items() for name, array in group.items()
        }
        return {
            **named,
            "vehicle": here.vehicle,
            "delay": here.delay,
            "sensor_delay": here.sensor_delay,
            "told": here.told,
            "periods": self.here.periods,
            "true_delay": self.here.true_delay,
            "uniform": self._uniform,
            "commands": batch.commands,
            "later": batch.later,
            "lost": batch.lost,
            "recorded": batch.recorded,
            "sampled": batch.sampled,
        }
