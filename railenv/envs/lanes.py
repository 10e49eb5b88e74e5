"""The environment itself, for any number of lanes: what the single and the vector one share.

A lane is one vehicle on one track with its own delays, clock and random stream. Everything a lane
draws comes from its own generator, in an order that does not depend on other lanes; everything it
computes has a fixed order of operations. So lane k of any batch is the single environment bit for
bit. Randomly varying delay is drawn in blocks of `BLOCK` periods.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from railenv.envs.episodes import Episodes
from railenv.envs.kernels import (
    DIVERGENCE,
    GAUGE,
    ObservationArrays,
    begin_episodes,
    observe,
)
from railenv.envs.observation import bound
from railenv.envs.reward import RECORDED, reward_arrays, reward_constants
from railenv.envs.settings import EnvSettings
from railenv.envs.whole_step import whole_step
from railenv.envs.workers import Workers
from railenv.simulation import VehicleBatch
from railenv.simulation.excitation import excite_start
from railenv.units import FloatArray

BLOCK = 64
"""Periods for which jitter and dropouts are drawn at a time."""

ENDINGS = np.array(["", "gauge", "divergence"])

IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
Float32Array = NDArray[np.float32]


class Lanes:
    """A batch of environments that step together.

    Args:
        settings: What they all share.
        num_lanes: How many.
        threads: Threads that share the lanes.

    Attributes:
        episodes: What was drawn for every lane.
        observation_names: Columns of the observation.
        bounds: Largest value of every column, shape (columns,).
        num_actions: Entries of an action.
        true_delay: Time from the measurement to the force of the newest action, infinite for a
            lost one, shape (lanes, channels) [s].
        generators: One per lane; None before its first seed.
        periods: Control periods since each lane's start, shape (lanes,).
    """

    def __init__(self, settings: EnvSettings, num_lanes: int, threads: int = 1) -> None:
        self.settings = s = settings
        self.num_lanes = num_lanes
        self.threads = threads
        self.episodes = Episodes(s, num_lanes, RECORDED)
        table = self.episodes.table
        channels = table.num_channels
        self.num_actions = channels if s.action == "each" else 2
        self.generators: list[np.random.Generator | None] = [None] * num_lanes
        self.periods: IntArray = np.zeros(num_lanes, dtype=np.int64)
        self.true_delay: FloatArray = np.zeros((num_lanes, channels))
        self._num_periods = s.num_periods()
        self._scale = float(s.action_scale)
        self._steps = round(s.control_period / s.time_step)
        self._batch = VehicleBatch(table, num_lanes, self._steps, s.max_delay, s.actuator())
        varying = self.episodes.draw.varying
        self._batch.refuse_jitter_if_stiff(varying.jitter)
        self._varies = bool(varying.jitter or varying.dropout or varying.sensor_dropout)
        self._uniform: FloatArray = np.zeros(
            (num_lanes, BLOCK, 2 * channels + 1) if self._varies else (0, 0, 0)
        )
        self._observation_arrays(self.episodes.measured, channels)
        self._constants, self.reward = reward_constants(s), reward_arrays(s, num_lanes)
        self._workers: Workers | None = None

    def _observation_arrays(self, measured: tuple[str, ...], channels: int) -> None:
        s, n = self.settings, self.num_lanes
        limits = [bound(name) for name in measured]
        scaled = s.observation_scale == "controlled"
        scale = np.array([scale if scaled else 1.0 for _, _, scale in limits])
        depth, length = s.observation_history + 1, s.num_past_actions()
        told = () if not s.delay_observed else ("told_delay",)
        if told and self.episodes.draw.channels_differ:
            told = tuple(f"told_delay_{c}" for c in range(1, channels + 1))
        # A told delay in units of the longest one; zero stays zero where no delay is allowed.
        self._told_factor = 1.0 / s.max_delay if scaled and s.max_delay > 0.0 else 1.0
        self._arrays = ObservationArrays(
            factor=1.0 / scale,
            bound=np.array([limit for limit, _, _ in limits]) / scale,
            frames=np.zeros((n, 2 * depth * len(measured)), dtype=np.float32),
            frame=np.zeros(n, dtype=np.int64),
            actions=np.zeros((n, 2 * length * self.num_actions), dtype=np.float32),
            action=np.zeros(n, dtype=np.int64),
            told=np.zeros((n, len(told)), dtype=np.float32),
            lost=np.zeros(n, dtype=bool),
            clipped=np.zeros(n, dtype=bool),
            action_clipped=np.zeros(n, dtype=bool),
        )
        self.observation_names: tuple[str, ...] = (
            *measured,
            *(f"{name}_ago_{age}" for age in range(1, depth) for name in measured),
            *(
                f"action_{age}_ago_{a}"
                for age in range(1, length + 1)
                for a in range(1, self.num_actions + 1)
            ),
            *told,
        )
        longest_told = (s.max_delay + s.told_error) * self._told_factor
        self.bounds: Float32Array = np.concatenate(
            [
                np.tile(self._arrays.bound, depth),
                np.ones(length * self.num_actions),
                np.full(len(told), longest_told),
            ]
        ).astype(np.float32)
        self.scales: FloatArray = np.concatenate(
            [
                np.tile(scale, depth),
                np.ones(length * self.num_actions),
                np.full(len(told), 1.0 / self._told_factor),
            ]
        )

    def reset(
        self, lanes: IntArray, out: Float32Array, options: Sequence[dict[str, Any]] | None = None
    ) -> None:
        """Start a new episode in some lanes.

        Args:
            lanes: Lane numbers, rising, shape (k,).
            out: Observations of all lanes; rows of these lanes are overwritten.
            options: What is fixed instead of drawn, one dictionary per lane; see
                `Episodes.start`.

        Raises:
            ArgumentError: An option is unknown or out of its range.
        """
        self.check_options(options)
        generators = [self.generator(int(lane)) for lane in lanes]
        states = self.episodes.start(lanes, generators, options)
        here, batch = self.episodes, self._batch
        self.periods[lanes] = 0
        excite_start(
            here.track_table,
            here.places,
            here.wheels,
            here.vehicle,
            lanes,
            batch.track,
        )
        batch.start(lanes, here.vehicle[lanes], here.delay[lanes], states)
        batch.commands[lanes] = 0.0
        self.true_delay[lanes] = here.delay[lanes]
        arrays = self._arrays
        if arrays.told.shape[1]:
            arrays.told[lanes] = here.told[lanes, : arrays.told.shape[1]] * self._told_factor
        begin_episodes(self.reward, arrays, lanes)
        chosen = np.zeros(self.num_lanes, dtype=bool)
        chosen[lanes] = True
        observe(arrays, chosen, int(lanes[0]), int(lanes[-1]) + 1, batch.sampled, out)

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

    def step(
        self, actions: FloatArray, active: BoolArray, reward: FloatArray, out: Float32Array
    ) -> None:
        """Send actions on their way and advance by one control period.

        Args:
            actions: Shape (lanes, actions), finite.
            active: Lanes that take part, shape (lanes,); the others stay as they are.
            reward: Overwritten for active lanes, shape (lanes,).
            out: Observations, overwritten for active lanes, shape (lanes, columns).
        """
        self._batch.active[:] = active
        if self._varies:
            self._vary(active)
        if self.threads == 1:
            self._part(0, self.num_lanes, actions, reward, out)
        else:
            self._in_parts(actions, reward, out)
        self.periods += active

    def _in_parts(self, actions: FloatArray, reward: FloatArray, out: Float32Array) -> None:
        if self._workers is None:
            self._workers = Workers(self.threads)
        edges = [self.num_lanes * t // self.threads for t in range(self.threads + 1)]
        self._workers.run(
            [
                partial(self._part, first, end, actions, reward, out)
                for first, end in pairwise(edges)
            ]
        )

    def _part(
        self, first: int, end: int, actions: FloatArray, reward: FloatArray, out: Float32Array
    ) -> None:
        batch, here = self._batch, self.episodes
        whole_step(
            here.table.arrays,
            batch.lanes,
            batch.line.arrays,
            here.track_table,
            here.places,
            here.wheels,
            self._constants,
            self.reward,
            self._arrays,
            batch.active,
            first,
            end,
            actions,
            self._scale,
            batch.commands,
            batch.later,
            batch.lost,
            batch.line.force_limit,
            batch.line.force_step,
            batch.recorded,
            batch.sampled,
            reward,
            out,
        )

    def _vary(self, active: BoolArray) -> None:
        """Draw what the coming commands are late and which of them and of the readings get lost."""
        batch, varying = self._batch, self.episodes.draw.varying
        channels = batch.commands.shape[1]
        place = self.periods % BLOCK
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
        np.copyto(self.true_delay, true, where=active[:, None])

    @property
    def ended(self) -> BoolArray:
        """Lanes that left the gauge or diverged in their last period, shape (lanes,)."""
        return (self.reward.ended == GAUGE) | (self.reward.ended == DIVERGENCE)

    @property
    def out_of_time(self) -> BoolArray:
        """Lanes whose episode has reached its length, shape (lanes,)."""
        return self.periods >= self._num_periods

    def info(self, lanes: IntArray | None = None) -> dict[str, NDArray[Any]]:
        """Return what there is to know about lanes, new arrays, lanes first.

        Args:
            lanes: Lane numbers, shape (k,); None for all.
        """
        batch, terms, here = self._batch, self.reward, self.episodes

        def of(values: NDArray[Any]) -> NDArray[Any]:
            return values.copy() if lanes is None else values.take(lanes, axis=0)

        vehicle, track = of(here.vehicle), of(here.places.track)
        told = {"told_delay": of(here.told)} if self.settings.delay_observed else {}
        return {
            "time": self.settings.time_step * of(batch.step),
            "delay": of(self.true_delay),
            "sensor_delay": of(here.sensor_delay),
            **told,
            "command": of(batch.commands),
            "force": of(self._force()),
            "vehicle": vehicle,
            "speed": here.wheels.speed.take(vehicle),
            "track": np.where(track < len(here.tracks), track, -1),
            "weighted_acceleration": of(terms.weighted),
            "ride_index": of(terms.ride_index),
            "reward_comfort": of(terms.comfort),
            "reward_effort": of(terms.effort),
            "reward_stroke": of(terms.stroke),
            "reward_divergence": of(terms.divergence),
            "action_clipped": of(self._arrays.action_clipped),
            "observation_clipped": of(self._arrays.clipped),
            "ended_by": ENDINGS.take(of(terms.ended)),
        }

    def last_period(self) -> tuple[FloatArray, FloatArray]:
        """Return what was recorded in the last period, and the commands sent in it; not copies."""
        return self._batch.recorded, self._batch.commands

    def state(self, lane: int) -> FloatArray:
        """Return the state x of one lane, shape (n,)."""
        here = self._batch.lanes
        return self.episodes.table.from_modes(
            int(here.vehicle[lane]), here.state[lane], here.track[lane, -1]
        )

    def track_around(self, lane: int, distance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return alignment and cross level at distances from the carbody's centre [m]."""
        return self.episodes.track_around(
            lane, self.settings.time_step * int(self._batch.step[lane]), distance
        )

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return every array that changes from step to step, by name; not copies."""
        here, batch = self.episodes, self._batch
        groups: dict[str, dict[str, Any]] = {
            "lanes": batch.lanes._asdict(),
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
            "periods": self.periods,
            "true_delay": self.true_delay,
            "uniform": self._uniform,
            "commands": batch.commands,
            "later": batch.later,
            "lost": batch.lost,
            "recorded": batch.recorded,
            "sampled": batch.sampled,
        }

    def _force(self) -> FloatArray:
        """Forces that act now, behind any lag, shape (lanes, channels) [N]; not a copy."""
        if self.episodes.table.lagged:
            return self._batch.sampled[:, len(self._arrays.factor) :]
        return self._batch.lanes.force

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_workers": None}

    def close(self) -> None:
        """Stop the threads."""
        if self._workers is not None:
            self._workers.close()
            self._workers = None
