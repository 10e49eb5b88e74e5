"""Spaces and settings that the single and the vectorised environment share."""

import dataclasses
from typing import Any, TypeVar

import gymnasium as gym
import numpy as np

from railenv.envs.episode_lanes import EpisodeLanes
from railenv.envs.settings import EnvSettings
from railenv.errors import unknown_name

Settings = TypeVar("Settings", bound=EnvSettings)


def checked_settings(settings: dict[str, Any]) -> EnvSettings:
    """Return the linear vehicle's settings of keyword arguments.

    Raises:
        ArgumentError: A setting is unknown or out of its range.
    """
    return settings_of(EnvSettings, settings)


def settings_of(kind: type[Settings], settings: dict[str, Any]) -> Settings:
    """Return the settings of keyword arguments.

    Args:
        kind: Which settings.
        settings: Their fields by name.

    Raises:
        ArgumentError: A setting is unknown or out of its range.
    """
    names = [field.name for field in dataclasses.fields(kind)]
    for name in settings:
        if name not in names:
            raise unknown_name("environment setting", name, names)
    return kind(**settings)


def single_spaces(lanes: EpisodeLanes) -> tuple[gym.spaces.Box, gym.spaces.Box]:
    """Return observation and action space of one lane."""
    observation = gym.spaces.Box(-lanes.bounds, lanes.bounds, dtype=np.float32)
    return observation, gym.spaces.Box(-1.0, 1.0, (lanes.num_actions,), dtype=np.float32)
