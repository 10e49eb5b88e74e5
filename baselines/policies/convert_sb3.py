"""Policies out of the zip files of stable-baselines3, of which nothing is executed.

`PPO.save` writes a zip: `data`, a JSON text in which Python objects are pickled, `policy.pth`,
the weights, and what only training needs. stable-baselines3 itself unpickles `data`, which runs
whatever code a stranger put there. Here `data` is looked at as text and no object in it is made;
`policy.pth` is read by `torch.load(weights_only=True)`, which makes tensors and nothing else.

What the file does not say has to be said: the environment it was trained on (`[environment]` of a
TOML file, fields of `railenv.envs.settings.EnvSettings`). Only feed-forward actors with tanh
between the layers and no squashing are held by `NetworkPolicy`: `MlpPolicy` of PPO and A2C as they
come. A constant action at rest is taken off, see `baselines.policies.network`.
"""

import io
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from baselines.policies.history import History
from baselines.policies.network import NetworkPolicy
from baselines.policies.policy import TOLD_UNIT
from baselines.policies.tensor_file import LARGEST_FILE, parse_json
from railenv.config import from_mapping, load_toml
from railenv.envs.observation import bound, measured_names
from railenv.envs.settings import EnvSettings
from railenv.errors import ArgumentError, InputFileError
from railenv.units import FloatArray
from railenv.vehicle import lateral17
from railenv.vehicle.coordinates import parse_layout

_WEIGHTS = "policy.pth"
_DATA = "data"
_ACTOR = "mlp_extractor.policy_net."
_HARMLESS = (
    "net_arch",
    "log_std_init",
    "ortho_init",
    "full_std",
    "optimizer_class",
    "optimizer_kwargs",
    "share_features_extractor",
    "normalize_images",
)
# Entries of policy_kwargs that do not change what the mean action is.
_MOST_LAYERS = 16


@dataclass(frozen=True, eq=False)
class Converted:
    """What came out of a zip.

    Attributes:
        policy: The policy.
        at_rest: Action of the network at rest, taken off, shape (actions,) [1]; for a told policy
            as told no delay.
        never_run: Entries of the file that hold pickled objects and were not touched.
    """

    policy: NetworkPolicy
    at_rest: FloatArray
    never_run: tuple[str, ...]


def convert_sb3(path: str | Path, config: str | Path) -> Converted:
    """Read the actor of a zip that stable-baselines3 wrote.

    Args:
        path: The zip.
        config: TOML file with a table [environment]; other tables are not looked at.

    Returns:
        The policy and what was left out.

    Raises:
        ArgumentError: The environment is of a kind that a policy cannot hold.
        InputFileError: The file cannot be read, or holds another kind of actor.
    """
    place = Path(path)
    table = load_toml(Path(config)).get("environment")
    if not isinstance(table, dict):
        raise ArgumentError(f"{config} has no table [environment]; say what it was trained on")
    settings = from_mapping(EnvSettings, table, f"{config}: [environment]")
    history, factor = _history(settings)
    data, weights, others = _members(place)
    pickled = tuple(
        f"data: {key!s:.60}"
        for key, value in data.items()
        if isinstance(value, dict) and ":serialized:" in value
    )
    _check_kind(place, data)
    layers = _layers(place, _tensors(place, weights), history)
    if history.is_told:
        # The environment tells the delay in its own unit.
        first = layers[0][0].copy()
        first[:, -1] *= factor * TOLD_UNIT
        layers[0] = first, layers[0][1]
    linear = np.zeros((history.num_knots, history.num_actions, history.num_features))
    try:
        policy = NetworkPolicy(history, linear, layers)
    except ArgumentError as error:
        raise InputFileError(f"{place}: {error}") from None
    rest = policy._network(np.zeros((1, history.num_features)), np.zeros(1))[0]
    return Converted(policy, rest, (*pickled, *others))


def _check_kind(path: Path, data: dict[str, Any]) -> None:
    """Refuse what the zip itself says is another kind of actor.

    `data` tells beside each pickled entry, in plain text, what is in it. A zip that lies about
    itself is not found out: the actor is taken as one with tanh.

    Raises:
        InputFileError: Another activation function, squashed actions, state-dependent exploration,
            or something in policy_kwargs that may change the actor.
    """
    if data.get("use_sde"):
        raise InputFileError(f"{path} has use_sde = true; only actors without it are converted")
    told = data.get("policy_kwargs")
    for key, value in (told if isinstance(told, dict) else {}).items():
        if key in _HARMLESS or key.startswith(":"):
            continue
        if key == "activation_fn" and str(value).rstrip("'>").endswith(".Tanh"):
            continue
        if key in ("squash_output", "use_expln", "use_sde") and value in (False, "False"):
            continue
        raise InputFileError(
            f"{path} says policy_kwargs {key!s:.40} = {value!s:.60}; an actor of Linear layers "
            "with tanh between them is converted, and nothing else"
        )


def _history(s: EnvSettings) -> tuple[History, float]:
    """Return what the environment's observation is, and what a told delay is multiplied by."""
    if s.delay_observed and s.delays().channels_differ:
        raise ArgumentError(
            "delay_per_channel with delay_observed tells one delay per channel, and a policy is "
            "told one; such a policy cannot be converted"
        )
    layout = parse_layout(s.layout)
    sensors = measured_names(lateral17(s.vehicle, layout, s.speed_kmh), s.observation)
    controlled = s.observation_scale == "controlled"
    history = History(
        layout,
        sensors,
        tuple(bound(name)[2] if controlled else 1.0 for name in sensors),
        tuple(range(s.observation_history + 1)),
        tuple(range(1, s.num_past_actions() + 1)),
        s.action,
        s.control_period,
        s.action_scale,
        (0.0,) if s.delay_observed else (),
    )
    return history, 1.0 / s.max_delay if controlled else 1.0


def _members(path: Path) -> tuple[dict[str, Any], bytes, tuple[str, ...]]:
    """Return `data` as plain JSON, the bytes of the weights, and the names of what is left."""
    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
            missing = {_DATA, _WEIGHTS} - set(names)
            if missing or len(names) != len(set(names)):
                raise InputFileError(
                    f"{path} is no zip of stable-baselines3: "
                    + (f"it has no {sorted(missing)[0]}" if missing else "a name stands twice")
                )
            data, weights = (_limited(path, archive, name) for name in (_DATA, _WEIGHTS))
    except InputFileError:
        raise
    except FileNotFoundError:
        raise InputFileError(f"{path} does not exist; give a zip of stable-baselines3") from None
    except Exception as error:
        # Whatever a parser makes of a hostile file, it is the file that is at fault.
        raise InputFileError(
            f"{path} cannot be read as a zip of stable-baselines3 ({type(error).__name__}: {error})"
        ) from None
    others = tuple(f"{n!s:.60}" for n in names if n.endswith((".pth", ".pkl")) and n != _WEIGHTS)
    return parse_json(path, _DATA, data), weights, others


def _limited(path: Path, archive: zipfile.ZipFile, name: str) -> bytes:
    with archive.open(name) as stream:
        content = stream.read(LARGEST_FILE + 1)
    if len(content) > LARGEST_FILE:
        raise InputFileError(f"{path}: {name} has more than {LARGEST_FILE:,} bytes")
    return content


def _tensors(path: Path, content: bytes) -> dict[str, FloatArray]:
    """Return the weights by name, in double precision."""
    import torch

    try:
        found = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
        if not isinstance(found, dict):
            raise TypeError(f"a {type(found).__name__} is no set of weights")
        return {
            str(name): tensor.detach().double().numpy().copy()
            for name, tensor in found.items()
            if isinstance(tensor, torch.Tensor)
        }
    except Exception as error:
        # torch raises many kinds for what is no file of tensors; none of them has run anything.
        line = str(error).strip().split("\n")[0]
        raise InputFileError(
            f"{path}: {_WEIGHTS} holds more than weights, or is damaged, and was not loaded "
            f"({type(error).__name__}: {line:.120})"
        ) from None


def _layers(
    path: Path, tensors: dict[str, FloatArray], history: History
) -> list[tuple[FloatArray, FloatArray]]:
    """Return weight and bias of every layer of the actor."""
    places = {
        int(name.removeprefix(_ACTOR).split(".")[0])
        for name in tensors
        if name.startswith(_ACTOR) and name.removeprefix(_ACTOR).split(".")[0].isdecimal()
    }
    names = [f"{_ACTOR}{k}" for k in sorted(places)[:_MOST_LAYERS]] + ["action_net"]
    layers: list[tuple[FloatArray, FloatArray]] = []
    columns = history.num_features + int(history.is_told)
    for name in names:
        weight, bias = tensors.get(f"{name}.weight"), tensors.get(f"{name}.bias")
        if weight is None or bias is None:
            raise InputFileError(
                f"{path} has no {name}: its actor is none of PPO's or A2C's MlpPolicy; those of "
                "SAC, TD3, TQC and recurrent ones are trained and saved by railenv train"
            )
        if weight.ndim != 2 or weight.shape[1] != columns:
            raise InputFileError(
                f"{path}: {name} has shape {weight.shape} and is given {columns} inputs; say in "
                "[environment] what it was trained on, history and told delay included"
            )
        layers.append((weight, bias))
        columns = weight.shape[0]
    return layers
