"""The environment of the linear vehicle, for any number of lanes: one compiled pass over all."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from numpy.typing import NDArray

from railenv.envs.bundle import Limits, bundle_of
from railenv.envs.episode_lanes import EpisodeLanes, IntArray
from railenv.envs.episodes import Episodes
from railenv.envs.reward import RECORDED
from railenv.envs.settings import EnvSettings
from railenv.envs.whole_step import begin_lanes, step
from railenv.envs.workers import Workers
from railenv.simulation import VehicleBatch
from railenv.units import FloatArray
from railenv.vehicle.coordinates import NUM_COORDINATES


class Lanes(EpisodeLanes):
    """A batch of environments of the linear vehicle that step together.

    Args:
        settings: What they all share.
        num_lanes: How many.
        threads: Threads that share the lanes.
    """

    def __init__(self, settings: EnvSettings, num_lanes: int, threads: int = 1) -> None:
        s, episodes = settings, Episodes(settings, num_lanes, RECORDED)
        steps = round(s.control_period / s.time_step)
        self._batch = VehicleBatch(episodes.table, num_lanes, steps, s.max_delay, s.actuator())
        self._batch.refuse_jitter_if_stiff(episodes.draw.varying.jitter)
        super().__init__(s, num_lanes, threads, episodes, self._batch)
        # What is made of the arrays above when it is needed.
        self._bundle: Any = None
        self._tracks_in_bundle: Any = None
        self._workers: Workers | None = None

    def _bound(self) -> Any:
        """Return the bundle of all arrays; a new one after the table of tracks has changed."""
        here, batch, s = self.episodes, self._batch, self.settings
        if self._bundle is None or self._tracks_in_bundle is not here.track_table:
            self.close()
            self._tracks_in_bundle = here.track_table
            limits = Limits(
                action_scale=float(s.action_scale),
                force=batch.line.force_limit,
                force_step=batch.line.force_step,
                periods=s.num_periods(),
                told_factor=self._told_factor,
            )
            self._bundle = bundle_of(
                batch.plant,
                batch.lanes,
                batch.line.arrays,
                here.track_table,
                here.places,
                here.wheels,
                self._constants,
                self.reward,
                self._arrays,
                here.arrays,
                self.here,
                limits,
            )
        return self._bundle

    def reset(self, lanes: IntArray, options: Sequence[dict[str, Any]] | None = None) -> None:
        """Start a new episode in some lanes.

        Args:
            lanes: Lane numbers, rising, shape (k,).
            options: What is fixed instead of drawn, one dictionary per lane; see
                `Episodes.start`.

        Raises:
            ArgumentError: An option is unknown or out of its range.
        """
        self.check_options(options)
        generators = [self.generator(lane) for lane in lanes.tolist()]
        states = self.episodes.start(lanes, generators, options)
        if self.noise:
            self.noise.draw(lanes.tolist(), self.generator)
        modes = self._batch.modes(self.episodes.vehicle[lanes], states)
        begin_lanes(self._bound(), lanes, modes)
        self._batch.prepare_late(lanes)

    def step(self) -> None:
        """Send the actions on their way and advance by one control period; see `here`."""
        bundle = self._bound()
        self._draw()
        if self.threads == 1:
            step(bundle, 0, self.num_lanes)
            return
        if self._workers is None:
            self._workers = Workers(bundle, self.threads)
        self._workers.step()

    def state(self, lane: int) -> FloatArray:
        """Return the state x of one lane, shape (n,)."""
        here = self._batch.lanes
        return self.episodes.table.from_modes(
            int(here.vehicle[lane]), here.state[lane], here.track[lane, -1]
        )

    def pictured(self, lane: int) -> dict[str, FloatArray]:
        """Return where the bodies of one lane are, as `railenv.rendering.View` wants it."""
        return {"coordinates": self.state(lane)[:NUM_COORDINATES]}

    def _physics_arrays(self) -> dict[str, NDArray[Any]]:
        """Every array of the vehicles that changes from step to step, by name; not copies."""
        return self._batch.lanes._asdict()

    def _force(self) -> FloatArray:
        """Forces that act now, behind any lag, shape (lanes, channels) [N]; not a copy."""
        if self.episodes.table.lagged:
            return self._batch.sampled[:, len(self._arrays.factor) :]
        return self._batch.lanes.force

    def __getstate__(self) -> dict[str, Any]:
        made = ("_bundle", "_tracks_in_bundle", "_shown", "_workers")
        return {**self.__dict__, **dict.fromkeys(made)}

    def close(self) -> None:
        """Stop the threads."""
        if self._workers is not None:
            self._workers.close()
            self._workers = None
