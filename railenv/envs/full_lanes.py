"""The environment of the nonlinear vehicle, for any number of lanes.

Episodes, delays, observation and reward are those of the linear vehicle's lanes; the physics is
`railenv.simulation.full`, and beside the reward every period is judged by its safety. A period of
one lane takes some ten times as long as the hand-over of all arrays, so the parts of a step are
called one after the other, and every thread has its share of the lanes.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from railenv.envs.bundle import Exchange
from railenv.envs.episode_lanes import BoolArray, EpisodeLanes, IntArray
from railenv.envs.full_episodes import FullEpisodes
from railenv.envs.full_kernels import SafetyArrays, judge
from railenv.envs.full_settings import FullSettings
from railenv.envs.kernels import assess, begin_episodes, command, end_period, observe
from railenv.envs.reward import RECORDED
from railenv.errors import ArgumentError
from railenv.simulation.full import FullBatch
from railenv.simulation.full_stepping import RUNNING
from railenv.units import FloatArray
from railenv.vehicle.coordinates import COORDINATES, WHEELSETS
from railenv.vehicle.nonlinear.coordinates import coordinate_index

_PICTURED = np.array([coordinate_index(name) for name in COORDINATES])
_ROLL = np.array([coordinate_index(f"wheelset{i}_roll") for i in WHEELSETS])
_HEIGHT = np.array([coordinate_index(f"wheelset{i}_vertical") for i in WHEELSETS])
_FARTHEST = 10.0  # of what a picture shows [m, rad]; a diverged state may be beyond all numbers


class FullLanes(EpisodeLanes):
    """A batch of environments of the nonlinear vehicle that step together.

    Args:
        settings: What they all share.
        num_lanes: How many.
        threads: Threads that share the lanes.

    Attributes:
        vehicles: The pool of vehicles.
        safety: How safe every lane's last period was.
    """

    def __init__(self, settings: FullSettings, num_lanes: int, threads: int = 1) -> None:
        s, episodes = settings, FullEpisodes(settings, num_lanes)
        self.vehicles = episodes.full
        self._batch = FullBatch(
            self.vehicles,
            num_lanes,
            episodes.tracks,
            recorded=RECORDED,
            sampled=() if s.observation == "state" else episodes.measured,
            actuator=s.actuator(),
            longest_delay=s.max_delay,
            control_period=s.control_period,
            record_step=s.record_step,
            time_step=s.time_step,
            curves=s.line(),
        )
        self._batch.places = episodes.places
        super().__init__(s, num_lanes, threads, episodes, self._batch)
        self._num_periods = s.num_periods()
        self._every = round(s.record_step / s.time_step)
        self._records: IntArray = np.zeros(num_lanes, dtype=np.int64)
        self.safety = SafetyArrays(*(np.zeros(num_lanes) for _ in SafetyArrays._fields))
        self._static_load = np.array([0.5 * c.parameters.lateral.axle_load for c in self.vehicles])
        self._threads: ThreadPoolExecutor | None = None

    def _exchange(self) -> Exchange:
        """What goes into a step and comes out of it."""
        found = super()._exchange()
        if self.settings.observation == "state":
            return found._replace(sampled=self._batch.lanes.state)
        return found

    def reset(self, lanes: IntArray, options: Sequence[dict[str, Any]] | None = None) -> None:
        """Start a new episode in some lanes, from steady rolling.

        Args:
            lanes: Lane numbers, rising, shape (k,).
            options: What is fixed instead of drawn, one dictionary per lane; see
                `railenv.envs.episodes.Episodes.start`.

        Raises:
            ArgumentError: An option is unknown or out of its range.
        """
        self.check_options(options)
        generators = [self.generator(lane) for lane in lanes.tolist()]
        episodes, batch, here, memory = self.episodes, self._batch, self.here, self._arrays
        episodes.start(lanes, generators, options)
        if self.noise:
            self.noise.draw(lanes.tolist(), self.generator)
        batch.run_on(episodes.track_table)
        batch.start(lanes, episodes.vehicle[lanes], episodes.delay[lanes])
        begin_episodes(self.reward, memory, lanes)
        here.periods[lanes] = 0
        here.commands[lanes] = 0.0
        here.true_delay[lanes] = episodes.delay[lanes]
        memory.told[lanes] = episodes.told[lanes, : memory.told.shape[1]] * self._told_factor
        chosen = np.zeros(self.num_lanes, dtype=bool)
        chosen[lanes] = True
        first, end = int(lanes[0]), int(lanes[-1]) + 1
        self._judge(chosen, first, end)
        observe(memory, chosen, first, end, here.sampled, here.observation)

    def step(self) -> None:
        """Send the actions on their way and advance by one control period; see `here`.

        Raises:
            ArgumentError: The vehicle of a lane that takes part derailed or diverged before.
        """
        over = self.here.active & (self._batch.lanes.ended != RUNNING)
        if over.any():
            raise ArgumentError(
                f"the vehicle of lane {int(over.argmax())} has derailed or diverged and cannot go "
                "on; reset it first"
            )
        # A checkpoint that was restored may have brought other tracks.
        self._batch.run_on(self.episodes.track_table)
        self._draw()
        if self.threads == 1:
            self._advance(0, self.num_lanes)
            return
        if self._threads is None:
            self._threads = ThreadPoolExecutor(self.threads - 1, "railenv-lanes")
        edges = [self.num_lanes * t // self.threads for t in range(self.threads + 1)]
        others = [self._threads.submit(self._advance, a, b) for a, b in pairwise(edges[1:])]
        self._advance(0, edges[1])
        for other in others:
            other.result()

    def _advance(self, first: int, end: int) -> None:
        """Advance the lanes from `first` to before `end`."""
        batch, here, memory, reward = self._batch, self.here, self._arrays, self.reward
        constants, active = self._constants, here.active
        command(
            memory,
            reward.effort,
            constants.effort_weight,
            active,
            first,
            end,
            here.actions,
            self.settings.action_scale,
            here.commands,
        )
        batch.advance(first, end)
        self._records[first:end] = batch.step[first:end] // self._every
        assess(constants, reward, active, first, end, here.recorded, self._records, here.reward)
        self._judge(active, first, end)
        observe(memory, active, first, end, here.sampled, here.observation)
        end_period(
            active,
            first,
            end,
            reward.ended,
            self._num_periods,
            here.periods,
            here.reward,
            here.terminated,
            here.truncated,
        )

    def _judge(self, active: BoolArray, first: int, end: int) -> None:
        """Say how safe the last period was, and end the episodes of derailed vehicles."""
        lanes = self._batch.lanes
        judge(
            lanes.wheels,
            lanes.ended,
            lanes.vehicle,
            self._static_load,
            self._constants.penalty,
            active,
            first,
            end,
            self.safety,
            self.reward,
            self.here.reward,
        )

    def _shown_arrays(self) -> dict[str, NDArray[Any]]:
        """What info copies."""
        return {**super()._shown_arrays(), **self.safety._asdict()}

    def state(self, lane: int) -> FloatArray:
        """Return the state of one lane, shape (n,); see `FullVehicle.states`."""
        return self._batch.lanes.state[lane].copy()

    def pictured(self, lane: int) -> dict[str, FloatArray]:
        """Return where the bodies of one lane are, as `railenv.rendering.View` wants it."""
        state = np.nan_to_num(self._batch.lanes.state[lane]).clip(-_FARTHEST, _FARTHEST)
        rails = self._batch.rails(lane)
        return {
            "coordinates": state[_PICTURED],
            "wheelset_roll": state[_ROLL],
            "wheelset_lift": rails[:, 1].reshape(-1, 2).mean(axis=1) - state[_HEIGHT],
        }

    def _physics_arrays(self) -> dict[str, NDArray[Any]]:
        """Every array of the vehicles that changes from step to step, by name; not copies."""
        return {**self._batch.lanes._asdict(), **self.safety._asdict()}

    def _force(self) -> FloatArray:
        """Forces that act now, behind any lag, shape (lanes, channels) [N]; not a copy."""
        lanes = self._batch.lanes
        if self.settings.actuator_lag > 0.0:
            return lanes.state[:, -lanes.force.shape[1] :]
        return lanes.force

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_shown": None, "_threads": None}

    def close(self) -> None:
        """Stop the threads."""
        if self._threads is not None:
            self._threads.shutdown()
            self._threads = None
