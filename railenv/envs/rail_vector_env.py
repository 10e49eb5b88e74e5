"""The vectorised Gymnasium environment: thousands of vehicles in one process."""

from functools import cache
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from railenv.envs.checkpoint import restored, state_of
from railenv.envs.episode_lanes import BoolArray, EpisodeLanes, IntArray
from railenv.envs.lanes import Lanes
from railenv.envs.picture import RENDER_MODES, Pictures, check_render_mode
from railenv.envs.spaces import checked_settings, single_spaces
from railenv.errors import ArgumentError, check_count, unknown_name
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle

Observations = NDArray[np.float32]
Info = dict[str, Any]


class Lateral17VectorEnv(VectorEnv[Observations, Observations, NDArray[Any]]):
    """Many `Lateral17Env` at once, stepped by compiled code.

    Lane k with seed s equals the single environment with seed s + k, bit for bit, whatever the
    number of lanes and threads. Spaces, reward, info and settings are those of `Lateral17Env`, see
    there; every array has the lanes first. All returned arrays are new.

    Every key of info is paired with a mask `_key`, as Gymnasium has it; what an entry shows outside
    of its mask means nothing. With autoreset in the same step, `final_obs` and `final_info` hold
    the end of the episodes that have just ended.

    Args:
        num_envs: Number of lanes.
        autoreset_mode: "next_step" (Gymnasium's default: the step after the end resets, ignores
            the action and gives reward 0), "same_step" (the observation already begins the next
            episode) or "disabled" (reset by `options={"reset_mask": ...}`), or the enum's member.
        threads: Threads that share the lanes. One thread per core pays from some hundred lanes on.
        render_mode: As of the single environment; `render` gives one picture per lane.
        settings: Fields of `railenv.envs.settings.EnvSettings`.

    Raises:
        ArgumentError: A setting is unknown or out of its range.
    """

    def __init__(
        self,
        num_envs: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        threads: int = 1,
        render_mode: str | None = None,
        **settings: Any,
    ) -> None:
        self.num_envs = check_count("num_envs", num_envs)
        check_count("threads", threads)
        self.autoreset_mode = _autoreset_mode(autoreset_mode)
        self.render_mode = check_render_mode(render_mode)
        self._lanes = self._made(settings, min(threads, self.num_envs))
        self.settings = self._lanes.settings
        self.metadata = {
            "render_modes": list(RENDER_MODES),
            "render_fps": round(1.0 / self.settings.control_period),
            "autoreset_mode": self.autoreset_mode,
        }
        self.single_observation_space, self.single_action_space = single_spaces(self._lanes)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._actions = (self.num_envs, self._lanes.num_actions)
        self._done: BoolArray = np.ones(self.num_envs, dtype=bool)
        self._seeds: list[int | None] = [None] * self.num_envs
        self._started = False
        self._pictures = None if render_mode is None else Pictures(self._lanes)

    def _made(self, settings: dict[str, Any], threads: int) -> EpisodeLanes:
        """The lanes, of these settings."""
        return Lanes(checked_settings(settings), self.num_envs, threads)

    @property
    def observation_names(self) -> tuple[str, ...]:
        """Name of every column of the observation."""
        return self._lanes.observation_names

    @property
    def observation_scales(self) -> NDArray[np.float64]:
        """What each column is in units of, shape (columns,) [its SI unit]."""
        return self._lanes.scales.copy()

    @property
    def vehicles(self) -> tuple[LateralVehicle, ...]:
        """The pool of vehicles."""
        return self._lanes.episodes.vehicles

    @property
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """The random streams, one per lane."""
        return tuple(self._lanes.generator(lane) for lane in range(self.num_envs))

    @property
    def np_random_seed(self) -> tuple[int | None, ...]:  # type: ignore[override]
        """The seeds of the random streams, one per lane; None for one that was never seeded."""
        return tuple(self._seeds)

    def reset(
        self,
        *,
        seed: int | list[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observations, Info]:
        """Start new episodes.

        Args:
            seed: A number s seeds lane k with s + k; or one per lane; None goes on with the random
                streams as they are.
            options: "reset_mask", shape (lanes,), bool: only these lanes. "delay", "track_seed" and
                "vehicle" as of the single environment, one for all lanes or a sequence of one per
                lane; a sequence is always by lane, so a delay per channel that is the same for all
                lanes is given as a DelaySpec.

        Returns:
            Observations, shape (lanes, columns), and info.

        Raises:
            ArgumentError: An option or a seed is out of its range; nothing has changed then.
        """
        if options is not None and not isinstance(options, dict):  # pyright: ignore
            raise ArgumentError(f"options = {options!r} must be a dictionary")
        given = dict(options or {})
        mask = self._mask(given.pop("reset_mask", None))
        lanes: IntArray = np.nonzero(mask)[0].astype(np.int64)
        seeds = self._checked_seeds(seed)
        fixed = [self._of_lane(given, int(lane)) for lane in lanes] if given else None
        self._lanes.check_options(fixed)
        for lane in map(int, lanes):
            chosen = seeds[lane]
            if chosen is not None:
                self._lanes.generators[lane] = seeding.np_random(chosen)[0]
                self._seeds[lane] = chosen
        self._lanes.reset(lanes, fixed)
        self._done[lanes] = False
        self._started = self._started or not self._done.any()
        if self._pictures is not None:
            self._pictures.begin(lanes)
        return self._lanes.here.observation.copy(), self._shown(lanes)

    def step(
        self, actions: Observations
    ) -> tuple[Observations, FloatArray, BoolArray, BoolArray, Info]:
        """Send one action per lane on its way and advance by one control period.

        Args:
            actions: Shape (lanes, actions), in [-1, 1].

        Returns:
            Observations, rewards, terminations, truncations, info.

        Raises:
            ArgumentError: The actions have the wrong shape or are not finite, the environment has
                never been reset, or, without autoreset, an episode has ended and was not reset.
        """
        given = np.asarray(actions)
        if given.dtype.kind not in "fiu" or given.shape != self._actions:
            raise ArgumentError(
                f"actions of shape {given.shape} and type {given.dtype} must be "
                f"{self._actions} numbers in [-1, 1]"
            )
        lanes, here = self._lanes, self._lanes.here
        here.actions[...] = given
        if not np.isfinite(here.actions).all():
            raise ArgumentError("actions hold a value that is not finite; give numbers in [-1, 1]")
        if not self._started:
            raise ArgumentError("step before the first reset; call reset first")
        again = self._done.any()
        if again and self.autoreset_mode is AutoresetMode.DISABLED:
            raise ArgumentError(
                f"lane {int(np.argmax(self._done))} has ended; reset it first, by "
                'options={"reset_mask": ...}'
            )
        np.logical_not(self._done, out=here.active)
        lanes.step()
        if self._pictures is not None:
            self._pictures.note(here.active, here.reward)
        reward, terminated = here.reward.copy(), here.terminated.copy()
        truncated = here.truncated.copy()
        if again:
            self._restart(self._done)
        self._done = terminated | truncated
        final: Info = {}
        if self.autoreset_mode is AutoresetMode.SAME_STEP and self._done.any():
            final = self._final()
            self._restart(self._done)
            self._done = np.zeros(self.num_envs, dtype=bool)
        info = _masked(lanes.info(), self.num_envs)
        info.update(final)
        return here.observation.copy(), reward, terminated, truncated, info

    def _restart(self, which: BoolArray) -> None:
        chosen: IntArray = which.nonzero()[0]
        self._lanes.reset(chosen)
        if self._pictures is not None:
            self._pictures.begin(chosen)

    def _final(self) -> Info:
        """What the lanes that have just ended end with; the others are told apart by the mask."""
        done, observation = self._done, self._lanes.here.observation
        last = np.empty(self.num_envs, dtype=object)  # of None
        lanes: IntArray = done.nonzero()[0]
        for lane in lanes:
            last[lane] = observation[lane].copy()
        # The whole batch is copied faster than some lanes are picked and put in their places.
        info = _masked(self._lanes.info(), self.num_envs, lanes)
        return {
            "final_obs": last,
            "_final_obs": done.copy(),
            "final_info": info,
            "_final_info": done.copy(),
        }

    def _shown(self, lanes: IntArray) -> Info:
        """The info of some lanes among all; the others show zeros."""
        if len(lanes) == self.num_envs:
            return _masked(self._lanes.info(), self.num_envs)
        info: dict[str, NDArray[Any]] = {}
        for name, values in self._lanes.info(lanes).items():
            info[name] = np.zeros((self.num_envs, *values.shape[1:]), dtype=values.dtype)
            info[name][lanes] = values
        return _masked(info, self.num_envs, lanes)

    def checkpoint(self) -> dict[str, Any]:
        """Return everything that the coming steps depend on: plain arrays, numbers and texts.

        `restore` of an environment with the same settings and number of lanes goes on identically.
        """
        own = {"done": self._done.copy(), "observation": self._lanes.here.observation.copy()}
        return state_of(self._lanes, {**own, "seeds": list(self._seeds), "started": self._started})

    def restore(self, checkpoint: dict[str, Any]) -> None:
        """Go back to a checkpoint.

        Raises:
            ArgumentError: It is none of an environment with these settings and lanes.
        """
        own = restored(self._lanes, checkpoint, ("done", "observation", "seeds", "started"))
        self._done = own["done"].copy()
        self._lanes.here.observation[...] = own["observation"]
        self._seeds = list(own["seeds"])
        self._started = bool(own["started"])
        if self._pictures is not None:
            self._pictures.begin(np.arange(self.num_envs, dtype=np.int64))

    def render(self) -> tuple[Any, ...] | None:
        """Return one picture per lane: arrays, texts, or None where no mode was chosen."""
        if self._pictures is None:
            return None
        assert self.render_mode is not None
        return self._pictures.render(self.render_mode)

    def close_extras(self, **_: Any) -> None:
        """Close windows and stop threads."""
        if self._pictures is not None:
            self._pictures.close()
        self._lanes.close()

    def _mask(self, mask: Any) -> BoolArray:
        if mask is None:
            return np.ones(self.num_envs, dtype=bool)
        array = np.asarray(mask)
        if array.shape != (self.num_envs,) or array.dtype != np.bool_ or not array.any():
            raise ArgumentError(
                f"reset_mask of shape {array.shape} and type {array.dtype} must be "
                f"({self.num_envs},) of bool with one True at least"
            )
        if not self._started and not array.all():
            raise ArgumentError("the first reset must be of all lanes; leave reset_mask out")
        return array.copy()

    def _checked_seeds(self, seed: Any) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, list | tuple | np.ndarray):
            if len(seed) != self.num_envs:  # pyright: ignore[reportUnknownArgumentType]
                raise ArgumentError(
                    f"seed has {len(seed)} entries for {self.num_envs} lanes; "  # pyright: ignore
                    "give one number, or one per lane"
                )
            return [None if s is None else check_count("seed", s, minimum=0) for s in seed]  # pyright: ignore
        first = check_count("seed", seed, minimum=0)
        return [first + lane for lane in range(self.num_envs)]

    def _of_lane(self, given: dict[str, Any], lane: int) -> dict[str, Any]:
        """Options of one lane."""
        mine: dict[str, Any] = {}
        for name, value in given.items():
            single = isinstance(value, np.ndarray) and value.ndim == 0
            if single or not isinstance(value, list | tuple | np.ndarray):
                mine[name] = value
                continue
            each: list[Any] = list(value)  # pyright: ignore[reportUnknownArgumentType]
            if len(each) != self.num_envs:
                raise ArgumentError(
                    f"option {name} has {len(each)} entries for {self.num_envs} lanes; "
                    "give one value, or one per lane"
                )
            chosen = each[lane]
            mine[name] = tuple(chosen.tolist()) if isinstance(chosen, np.ndarray) else chosen
        return mine


def _autoreset_mode(mode: Any) -> AutoresetMode:
    if isinstance(mode, AutoresetMode):
        return mode
    known = {member.name.lower(): member for member in AutoresetMode}
    # Gymnasium's own texts are the members' values, "SameStep" and so on.
    texts = known | {str(member.value): member for member in AutoresetMode}
    if not isinstance(mode, str) or mode not in texts:
        raise unknown_name("autoreset_mode", str(mode), known)
    return texts[mode]


def _masked(info: dict[str, NDArray[Any]], num_lanes: int, lanes: IntArray | None = None) -> Info:
    """Pair every entry with its mask, which says for which lanes it was given (None: all)."""
    if lanes is None:
        masks = np.ones((len(info), num_lanes), dtype=bool)
    else:
        masks = np.empty((len(info), num_lanes), dtype=bool)
        mask = np.zeros(num_lanes, dtype=bool)
        mask[lanes] = True
        masks[:] = mask
    paired: Info = {}
    for (name, values), mask in zip(info.items(), masks, strict=True):
        paired[name] = values
        paired[_mask_name(name)] = mask
    return paired


@cache
def _mask_name(name: str) -> str:
    return f"_{name}"
