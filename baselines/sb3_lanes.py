"""Access to single lanes in the way of stable-baselines3: attributes and methods by lane.

stable-baselines3 takes a `VecEnv` for a list of environments, each with attributes and methods of
its own. Here all lanes are one object; this is what it answers when one of them is asked.
"""

import copy
import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray

from railenv.envs.rail_vector_env import Lateral17VectorEnv
from railenv.envs.registration import LATERAL17
from railenv.errors import ArgumentError, check_count

try:
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import VecEnv
except ModuleNotFoundError as missing:
    missing.add_note('this needs stable-baselines3: pip install "railenv[train]"')
    raise

Indices = int | Iterable[int] | None

_BY_LANE = ("np_random", "np_random_seed")
"""Attributes of the vector environment with one entry per lane."""

_SINGLE = {
    "observation_space": "single_observation_space",
    "action_space": "single_action_space",
}
"""Names that mean one lane here and all lanes there."""

_NOT_FROM_HERE = ("reset", "step", "close", "close_extras", "restore")
"""Methods that must not be called behind the back of the counters of return and length."""


class LaneAccess(VecEnv):
    """The part of a `VecEnv` that asks single lanes; episodes are the business of subclasses.

    Args:
        env: The lanes.
        monitor: Whether episodes are counted as stable-baselines3's `Monitor` counts them.

    Attributes:
        vector_env: The environment given.
    """

    def __init__(self, env: Lateral17VectorEnv, monitor: bool) -> None:
        self.vector_env = env
        self._monitor = monitor
        self._attributes: dict[str, dict[int, Any]] = {}
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self.metadata = {**self.metadata, "render_fps": env.metadata["render_fps"]}

    @property
    def spec(self) -> EnvSpec:
        """Gymnasium's specification of one lane: `gym.make` of it is the single environment."""
        spec = copy.copy(gym.spec(LATERAL17))
        settings = self.vector_env.settings
        spec.kwargs = {f.name: getattr(settings, f.name) for f in dataclasses.fields(settings)}
        return spec

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """Return an attribute of some lanes.

        What all lanes have in common, `settings` or `observation_names` for instance, is returned
        once for each lane asked.

        Raises:
            AttributeError: It does not exist (`has_attr` relies on this type).
            ArgumentError: A lane does not exist.
        """
        lanes = self._chosen(indices)
        if attr_name in self._attributes:
            noted = self._attributes[attr_name]
            without = [lane for lane in lanes if lane not in noted]
            if without:
                raise AttributeError(f"lane {without[0]} has no attribute {attr_name!r}")
            return [noted[lane] for lane in lanes]
        if attr_name == "spec":
            return [self.spec for _ in lanes]
        value = self._looked_up(_SINGLE.get(attr_name, attr_name))
        return [value[lane] if attr_name in _BY_LANE else value for lane in lanes]

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Note an attribute of some lanes, for `get_attr`; the environment does not read it.

        Raises:
            ArgumentError: The environment has it already, or a lane does not exist.
        """
        lanes = self._chosen(indices)
        if attr_name == "spec" or hasattr(self.vector_env, attr_name):
            raise ArgumentError(
                f"attribute {attr_name} is fixed once the environment is made; make another one, "
                "or set_options delay, track_seed or vehicle before a reset"
            )
        self._attributes.setdefault(attr_name, {}).update(dict.fromkeys(lanes, value))

    def env_method(
        self, method_name: str, *method_args: Any, indices: Indices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of the vector environment, once, and return its answer for some lanes.

        `render` is answered by lane; an answer about all lanes together, as of `checkpoint`, is
        returned once for each lane asked.

        Raises:
            AttributeError: There is no such method.
            ArgumentError: It would end or change episodes behind the adapter's back, or a lane does
                not exist.
        """
        lanes = self._chosen(indices)
        if method_name in _NOT_FROM_HERE:
            raise ArgumentError(
                f"method {method_name} would pass by the adapter, which counts returns and "
                "lengths; use the adapter's reset, step and close"
            )
        if not callable(self._looked_up(method_name)):
            raise AttributeError(f"{method_name!r} is no method; read it by get_attr")
        answer = self._looked_up(method_name)(*method_args, **method_kwargs)
        if method_name != "render" or answer is None:
            return [answer for _ in lanes]
        return [answer[lane] for lane in lanes]

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper], indices: Indices = None
    ) -> list[bool]:
        """Return whether lanes have a wrapper: none has, but `Monitor`'s work is done here."""
        return [self._monitor and wrapper_class is Monitor for _ in self._chosen(indices)]

    def get_images(self) -> Sequence[NDArray[np.uint8]]:
        """Return one picture per lane, shape (height, width, 3).

        Raises:
            ArgumentError: The environment was not made with `render_mode="rgb_array"`.
        """
        if self.render_mode != "rgb_array":
            raise ArgumentError(
                f"render_mode = {self.render_mode!r} gives no pictures; make the environment with "
                'render_mode="rgb_array"'
            )
        return self.env_method("render")

    def close(self) -> None:
        """Close windows and stop threads."""
        self.vector_env.close()

    def _looked_up(self, name: str) -> Any:
        if name.startswith("_") or not hasattr(self.vector_env, name):
            raise AttributeError(f"the environment has no public attribute {name!r}")
        return getattr(self.vector_env, name)

    def _chosen(self, indices: Indices) -> list[int]:
        number = self.vector_env.num_envs
        if indices is None:
            return list(range(number))
        several = indices if isinstance(indices, Iterable) else [indices]
        lanes = [check_count("indices", lane, minimum=0) for lane in several]
        for lane in lanes:
            if lane >= number:
                raise ArgumentError(
                    f"lane {lane} does not exist; indices go from 0 to {number - 1}"
                )
        return lanes
