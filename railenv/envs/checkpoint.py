"""Checkpoints of a batch of environments in mid-episode: plain arrays, numbers and texts."""

import copy
import dataclasses
import json
from typing import Any, cast

import numpy as np

from railenv.envs.episode_lanes import EpisodeLanes
from railenv.errors import ArgumentError

_VERSION = 1


def state_of(lanes: EpisodeLanes, own: dict[str, Any]) -> dict[str, Any]:
    """Return everything that the coming steps of the lanes depend on.

    Args:
        lanes: The lanes.
        own: What the environment around them adds.
    """
    return {
        "version": _VERSION,
        "settings": _fingerprint(lanes),
        "num_lanes": lanes.num_lanes,
        "arrays": {name: array.copy() for name, array in lanes.arrays().items()},
        "given_tracks": lanes.episodes.given_seeds,
        "generators": [
            None if generator is None else copy.deepcopy(generator.bit_generator.state)
            for generator in lanes.generators
        ],
        "own": own,
    }


def restored(lanes: EpisodeLanes, checkpoint: Any, own: tuple[str, ...]) -> dict[str, Any]:
    """Put lanes back to a checkpoint and return what the environment around them had added.

    Args:
        lanes: The lanes.
        checkpoint: What `state_of` gave.
        own: Names of what the environment around them adds.

    Raises:
        ArgumentError: The checkpoint is of another kind of environment, of other settings or of
            another number of lanes; nothing has changed then.
    """
    _check(lanes, checkpoint, own)
    lanes.episodes.give_tracks(checkpoint["given_tracks"])
    for name, array in lanes.arrays().items():
        array[...] = checkpoint["arrays"][name]
    for lane, state in enumerate(checkpoint["generators"]):
        if state is None:
            lanes.generators[lane] = None
            continue
        generator = np.random.Generator(np.random.PCG64())
        generator.bit_generator.state = copy.deepcopy(state)
        lanes.generators[lane] = generator
    return checkpoint["own"]


def _check(lanes: EpisodeLanes, given: Any, own: tuple[str, ...]) -> None:
    parts = ("version", "settings", "num_lanes", "arrays", "given_tracks", "generators", "own")
    checkpoint = cast("dict[str, Any]", given if isinstance(given, dict) else {})
    whole = all(part in checkpoint for part in parts)
    if not whole or checkpoint["version"] != _VERSION or set(checkpoint["own"]) != set(own):
        raise ArgumentError(
            "checkpoint is none of this kind of environment; make one with its checkpoint()"
        )
    if checkpoint["num_lanes"] != lanes.num_lanes:
        raise ArgumentError(
            f"checkpoint has {checkpoint['num_lanes']} lanes and this environment "
            f"{lanes.num_lanes}; make one with as many"
        )
    if checkpoint["settings"] != _fingerprint(lanes):
        raise ArgumentError(
            "checkpoint comes from an environment with other settings; make one with the same"
        )
    stored: dict[str, Any] = checkpoint["arrays"]
    for name, array in lanes.arrays().items():
        if name not in stored or np.shape(stored[name]) != array.shape:
            raise ArgumentError(f"checkpoint has no array {name!r} of shape {array.shape}")
    if len(checkpoint["generators"]) != lanes.num_lanes:
        raise ArgumentError("checkpoint does not have one random stream per lane")


def _fingerprint(lanes: EpisodeLanes) -> str:
    """The settings as text; numbers that are equal are written alike, whatever their type."""

    def plain(value: Any) -> Any:
        if isinstance(value, dict):
            return {name: plain(entry) for name, entry in cast("dict[str, Any]", value).items()}
        if isinstance(value, list | tuple):
            return [plain(entry) for entry in cast("list[Any]", value)]
        if isinstance(value, np.generic):
            return cast("Any", value.item())
        return value

    return json.dumps(plain(dataclasses.asdict(lanes.settings)))
