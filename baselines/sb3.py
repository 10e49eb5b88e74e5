"""The environment as stable-baselines3 wants it: its own `VecEnv`, in place of a Gymnasium one.

    from baselines.sb3 import make_vec_env

    env = make_vec_env(64, delay=(0.0, 0.3))
    PPO("MlpPolicy", env).learn(1_000_000)

stable-baselines3 refuses Gymnasium's `VectorEnv`: its own interface is older. Here the lanes stay
one compiled batch, and only what a step returns is put into the other form. Rewards are neither
scaled nor clipped: a divergence costs its whole penalty (some -10 000 by default), so wrap the
environment in `VecNormalize` where an algorithm wants rewards of order one.
"""

import time
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from baselines.sb3_lanes import LaneAccess
from railenv.envs.rail_vector_env import Lateral17VectorEnv
from railenv.errors import ArgumentError, check_count
from railenv.units import FloatArray

Observations = NDArray[np.float32]


class StableBaselinesEnv(LaneAccess):
    """`Lateral17VectorEnv` as a `VecEnv` of stable-baselines3.

    Lane k is a sub-environment. `reset` returns observations alone and leaves the infos in
    `reset_infos`; `step` returns observations, rewards (float32), dones and one dictionary per
    lane, and every array and dictionary is new. A lane that ends starts its next episode within the
    same step, and its dictionary holds the end of the last one: all keys of the environment's info,
    `terminal_observation`, and `episode` with the return `r` (summed in double precision), the
    length `l` [steps] and the time `t` since the adapter was made [s]. `TimeLimit.truncated` stands
    in every dictionary: True where an episode ended by its length alone.

    `seed` and `set_options` count for the next `reset` only, as stable-baselines3 has it: episodes
    that follow draw anew. An option is one dictionary for all lanes or one per lane.

    Args:
        env: Made with `autoreset_mode="same_step"`.
        lane_infos: Whether lanes that go on have the keys of the environment's info as well; costs
            some microseconds per lane and step.
        monitor: Whether `episode` is there. It is what stable-baselines3's `Monitor` adds, so
            `env_is_wrapped(Monitor)` is answered accordingly. Choose False below a `VecMonitor`
            (which can write a file): it warns of two monitors otherwise.

    Attributes:
        vector_env: The environment given.

    Raises:
        ArgumentError: The environment is of another kind or another autoreset mode.
    """

    def __init__(
        self, env: Lateral17VectorEnv, lane_infos: bool = False, monitor: bool = True
    ) -> None:
        if not isinstance(env, Lateral17VectorEnv):
            raise ArgumentError(
                f"env of type {type(env).__name__} is not a Lateral17VectorEnv; make one, or call "
                "make_vec_env; wrappers of stable-baselines3 go around the adapter"
            )
        if env.autoreset_mode is not AutoresetMode.SAME_STEP:
            raise ArgumentError(
                f'env has autoreset_mode = "{env.autoreset_mode.name.lower()}", and '
                "stable-baselines3 expects the first observation of the next episode in the very "
                'step that ends one; make it with autoreset_mode="same_step"'
            )
        super().__init__(env, monitor)
        self._lane_infos = lane_infos
        self._actions: Any = None
        self._ready = False
        self._returns: FloatArray = np.zeros(env.num_envs)
        self._lengths: NDArray[np.int64] = np.zeros(env.num_envs, dtype=np.int64)
        self._began = time.time()

    def set_options(self, options: list[dict] | dict | None = None) -> None:
        """Fix what the next reset would draw: "delay", "track_seed" or "vehicle".

        Args:
            options: For all lanes, or one dictionary per lane, each with the same names.

        Raises:
            ArgumentError: Number or names of the dictionaries do not fit. Values are checked by
                `reset`.
        """
        given = [options or {}] * self.num_envs if not isinstance(options, list) else options
        if len(given) != self.num_envs:
            raise ArgumentError(
                f"options has {len(given)} dictionaries for {self.num_envs} lanes; give one for "
                "all, or one per lane"
            )
        for lane, mine in enumerate(given):
            if not isinstance(mine, dict):
                raise ArgumentError(f"options of lane {lane} = {mine!r} must be a dictionary")
            if set(mine) != set(given[0]):
                raise ArgumentError(
                    f"options of lane {lane} name {sorted(mine)} and those of lane 0 "
                    f"{sorted(given[0])}; name the same in every lane"
                )
        if "reset_mask" in given[0]:
            raise ArgumentError(
                "reset_mask is no option here, stable-baselines3 resets all lanes together; "
                "leave it out"
            )
        super().set_options(list(given))

    def reset(self) -> Observations:
        """Start new episodes in all lanes, with the seeds and options that were set.

        Returns:
            Observations, shape (lanes, columns); the infos are in `reset_infos`.

        Raises:
            ArgumentError: A seed or an option is out of its range; nothing has changed then but
                that it is forgotten.
        """
        seeds, options = self._seeds, self._options
        self._reset_seeds()
        self._reset_options()
        fixed: dict[str, NDArray[Any]] = {}
        for name in options[0]:
            # An array of objects: the value of a lane may itself be one number per channel.
            values = np.empty(self.num_envs, dtype=object)
            for lane, mine in enumerate(options):
                values[lane] = mine[name]
            fixed[name] = values
        observations, info = self.vector_env.reset(seed=seeds, options=fixed)
        self.reset_infos = _all_lanes(info)
        self._returns[:] = 0.0
        self._lengths[:] = 0
        self._actions = None
        self._ready = True
        return observations

    def step_async(self, actions: NDArray[Any]) -> None:
        """Take the actions of the coming step, shape (lanes, actions), in [-1, 1]."""
        self._actions = actions

    def step_wait(
        self,
    ) -> tuple[Observations, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Advance by one control period.

        Returns:
            Observations, rewards, dones, and one dictionary per lane.

        Raises:
            ArgumentError: There are no actions, they do not fit, or there was no reset.
        """
        actions, self._actions = self._actions, None
        if not self._ready:
            raise ArgumentError("step before the adapter's first reset; call reset first")
        if actions is None:
            raise ArgumentError("step_wait without actions; call step_async first, or step")
        observations, rewards, terminated, truncated, info = self.vector_env.step(actions)
        dones = terminated | truncated
        self._returns += rewards
        self._lengths += 1
        infos: list[dict[str, Any]] = [{"TimeLimit.truncated": False} for _ in dones]
        if self._lane_infos:
            for mine, known in zip(infos, _all_lanes(info), strict=True):
                mine.update(known)
        for lane in np.nonzero(dones)[0].tolist():
            infos[lane] = self._ended(lane, info)
            infos[lane]["TimeLimit.truncated"] = bool(truncated[lane] and not terminated[lane])
            self.reset_infos[lane] = _one_lane(info, lane)
        return observations, rewards.astype(np.float32), dones, infos

    def _ended(self, lane: int, info: dict[str, Any]) -> dict[str, Any]:
        """Return what the episode of a lane ends with, and count from zero again."""
        last = _one_lane(info["final_info"], lane)
        last["terminal_observation"] = info["final_obs"][lane]
        if self._monitor:
            last["episode"] = {
                "r": float(self._returns[lane]),
                "l": int(self._lengths[lane]),
                "t": round(time.time() - self._began, 6),
            }
        self._returns[lane] = 0.0
        self._lengths[lane] = 0
        return last


def make_vec_env(
    num_envs: int = 64,
    *,
    seed: int | None = None,
    threads: int = 1,
    render_mode: str | None = None,
    lane_infos: bool = False,
    monitor: bool = True,
    **settings: Any,
) -> StableBaselinesEnv:
    """Return an environment that stable-baselines3 trains on.

    Args:
        num_envs: Number of lanes.
        seed: Lane k is seeded with seed + k at the first reset; None leaves it to the algorithm.
        threads: Threads that share the lanes.
        render_mode: "rgb_array", "human" or "ansi".
        lane_infos: See `StableBaselinesEnv`.
        monitor: See `StableBaselinesEnv`.
        settings: Fields of `railenv.envs.settings.EnvSettings`, `delay=(0.0, 0.3)` for instance.

    Raises:
        ArgumentError: A setting is unknown or out of its range.
    """
    made = {"autoreset_mode": "same_step", **settings}
    env = Lateral17VectorEnv(num_envs, threads=threads, render_mode=render_mode, **made)
    adapter = StableBaselinesEnv(env, lane_infos, monitor)
    if seed is not None:
        adapter.seed(check_count("seed", seed, minimum=0))
    return adapter


def _names(info: dict[str, Any]) -> list[str]:
    """Return the keys of a vector environment's info that are neither masks nor of the end."""
    return [name for name in info if not name.startswith(("_", "final_"))]


def _all_lanes(info: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the dictionaries of all lanes: numbers, texts, and arrays that nobody else holds."""
    names = _names(info)
    columns = [info[name].tolist() if info[name].ndim == 1 else list(info[name]) for name in names]
    return [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]


def _one_lane(info: dict[str, Any], lane: int) -> dict[str, Any]:
    """Return the dictionary of one lane: numbers, texts and new arrays."""
    return {
        name: info[name][lane].item() if info[name].ndim == 1 else info[name][lane].copy()
        for name in _names(info)
    }
