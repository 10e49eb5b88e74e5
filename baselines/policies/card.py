"""What a policy's file says of it: how it acts, how it was trained, what it scored, its limits.

The card and the arrays together hold every number that turns an observation into an action. Keys:

- `format`, `version`, `class` ("linear", "network", "recurrent" or "gated") and, of a network, its
  `activation`;
- `history`: the fields of `baselines.policies.history.History`;
- `base`: null, or the kind, sensors, layout, action scale (and control period) of the classical law
  underneath, whose matrices are among the arrays;
- `description`: one line;
- `training`: `command`, `config` (all settings, resolved), `seed`, `steps` [lane-steps], `seconds`,
  `versions` (of packages), `revision` (of the source);
- `score`: what `railenv score` found; `limits`: where the policy is not to be trusted.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from baselines.controller import LinearFeedback
from baselines.linear_dynamic import LinearDynamic
from baselines.policies.base_law import ClassicalLaw
from baselines.policies.gated import GatedPolicy
from baselines.policies.history import History
from baselines.policies.linear import LinearPolicy
from baselines.policies.network import NetworkPolicy
from baselines.policies.policy import HistoryPolicy
from baselines.policies.recurrent import RecurrentPolicy
from railenv.config import to_dict
from railenv.errors import ArgumentError, InputFileError, unknown_name
from railenv.units import FloatArray

FORMAT = "railenv trained policy"
VERSION = 1

LARGEST_CARD = 500_000
"""Most bytes of a card."""

_CLASSES: dict[str, type[HistoryPolicy]] = {
    "linear": LinearPolicy,
    "network": NetworkPolicy,
    "recurrent": RecurrentPolicy,
    "gated": GatedPolicy,
}
_HOW_IT_ACTS = ("format", "version", "class", "activation", "history", "base")
_ABOUT: dict[str, type | tuple[type, ...]] = {
    "description": str,
    "training": dict,
    "score": dict,
    "limits": (list, dict, str),
}
_TRAINING = ("command", "config", "seed", "steps", "seconds", "versions", "revision")
_BASE = {
    "linear_feedback": (("gain",), ("layout", "sensors", "action_scale")),
    "linear_dynamic": (
        ("A", "B", "C", "D"),
        ("layout", "sensors", "action_scale", "control_period"),
    ),
    "sampled_linear_dynamic": (
        ("A", "B", "C", "D"),
        ("layout", "sensors", "action_scale", "control_period"),
    ),
}


def card_of(
    policy: HistoryPolicy, about: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, FloatArray]]:
    """Return a policy's card and arrays.

    Args:
        policy: The policy.
        about: `description`, `training`, `score`, `limits`, each of which may be left out. What
            says how it acts is written anew; a card that was loaded can be given as it is.

    Raises:
        ArgumentError: The policy is of another class, a key is unknown, or a value is not plain.
    """
    kinds = [name for name, kind in _CLASSES.items() if type(policy) is kind]
    if not kinds:
        raise ArgumentError(
            f"policy {type(policy).__name__} is of no class that a file holds; known: "
            f"{', '.join(kind.__name__ for kind in _CLASSES.values())}"
        )
    arrays: dict[str, FloatArray] = {"weights": policy.weights}
    card: dict[str, Any] = {"format": FORMAT, "version": VERSION, "class": kinds[0]}
    if isinstance(policy, NetworkPolicy):
        card["activation"] = policy.activation
        for k, (weight, bias) in enumerate(policy.layers):
            arrays |= {f"layer{k}.weight": weight, f"layer{k}.bias": bias}
    if isinstance(policy, RecurrentPolicy | GatedPolicy):
        arrays |= {name: getattr(policy, name) for name in policy.arrays}
    card["history"] = to_dict(policy.history)
    card["base"] = None if policy.base is None else _described(policy.base, arrays)
    kept = {k: v for k, v in about.items() if k not in (*_HOW_IT_ACTS, "sha256")}
    try:
        check_about(kept)
        # Through JSON, so that what is compared with a file is what a file gives.
        plain = json.loads(json.dumps({**card, **kept}, allow_nan=False))
    except (TypeError, ValueError, RecursionError) as error:
        raise ArgumentError(f"card: {error}") from None
    return plain, arrays


def check_about(about: Mapping[str, Any]) -> None:
    """Raise `ArgumentError` unless a card's keys beside how it acts are known and of their type."""
    for key, value in about.items():
        if key not in _ABOUT:
            raise unknown_name("key of a card", str(key), _ABOUT)
        if not isinstance(value, _ABOUT[key]):
            raise ArgumentError(f"{key} of type {type(value).__name__} does not belong in a card")
    for key in about.get("training", {}):
        if key not in _TRAINING:
            raise unknown_name("key of training", str(key), _TRAINING)


def policy_from(path: Path, card: Mapping[str, Any], arrays: dict[str, FloatArray]) -> Any:
    """Return the policy of a card and its arrays.

    Args:
        path: Names the file in messages.
        card: The card; changed nowhere.
        arrays: The arrays, every one of which must have its use.

    Raises:
        InputFileError: A key or an array is missing, unknown or does not fit.
    """
    if card.get("format") != FORMAT:
        raise InputFileError(f"{path} is no trained policy; write one with save_trained")
    version, kind = card.get("version"), card.get("class")
    if type(version) is not int or version != VERSION:
        raise InputFileError(
            f"{path} has version {version!r:.40}; this railenv reads version {VERSION}"
        )
    if not isinstance(kind, str) or kind not in _CLASSES:
        raise InputFileError(f"{path} has class {kind!r:.40}; known: {', '.join(_CLASSES)}")
    wanted = {key for key in _HOW_IT_ACTS if key != "activation" or kind == "network"}
    missing = wanted - set(card)
    if missing:
        raise InputFileError(f"{path}: the card lacks {', '.join(sorted(missing))}")
    left = dict(arrays)
    try:
        check_about({key: value for key, value in card.items() if key not in wanted})
        history = _history(card["history"])
        base = None if card["base"] is None else _base(card["base"], left)
        policy = _policy(kind, history, base, card, left)
    except KeyError as error:
        raise InputFileError(f"{path}: there is no array {error.args[0]!r}") from None
    except ArgumentError as error:
        raise InputFileError(f"{path}: {error}") from None
    if left:
        raise InputFileError(
            f"{path}: arrays {', '.join(sorted(left))!s:.80} have no use in a {kind} policy"
        )
    return policy


def _policy(
    kind: str,
    history: History,
    base: ClassicalLaw | None,
    card: Mapping[str, Any],
    left: dict[str, FloatArray],
) -> HistoryPolicy:
    weights = left.pop("weights")
    if kind == "linear":
        return LinearPolicy(history, weights, base)
    if kind == "recurrent":
        arrays = {name: left.pop(name) for name in RecurrentPolicy.arrays}
        return RecurrentPolicy(history, weights, **arrays, base=base)
    if kind == "gated":
        arrays = {name: left.pop(name) for name in GatedPolicy.arrays}
        return GatedPolicy(history, weights, **arrays, base=base)
    number = sum(name.startswith("layer") and name.endswith(".weight") for name in left)
    layers = [(left.pop(f"layer{k}.weight"), left.pop(f"layer{k}.bias")) for k in range(number)]
    return NetworkPolicy(history, weights, layers, str(card["activation"]), base)


def _history(fields: Any) -> History:
    known = set(History.__dataclass_fields__)
    if not isinstance(fields, dict) or set(fields) != known:
        raise ArgumentError(f"history must have the keys {', '.join(sorted(known))}")
    return History(**fields)


def _described(law: ClassicalLaw, arrays: dict[str, FloatArray]) -> dict[str, Any]:
    """Return what the card says of a base; its matrices are added to the arrays."""
    if isinstance(law, LinearDynamic):
        kind = "sampled_linear_dynamic" if law.sampled else "linear_dynamic"
        arrays |= {f"base.{letter}": getattr(law.law, letter) for letter in "ABCD"}
    else:
        kind = "linear_feedback"
        arrays["base.gain"] = law.gain
    return {"kind": kind, **{key: getattr(law, key) for key in _BASE[kind][1]}}


def _base(fields: Any, left: dict[str, FloatArray]) -> ClassicalLaw:
    kind = fields.get("kind") if isinstance(fields, dict) else None
    if not isinstance(kind, str) or kind not in _BASE:
        raise ArgumentError(f"base has kind {kind!r:.40}; known: {', '.join(_BASE)}")
    names, keys = _BASE[kind]
    if set(fields) != {"kind", *keys}:
        raise ArgumentError(f"base of kind {kind} must have the keys kind, {', '.join(keys)}")
    values: dict[str, Any] = {key: fields[key] for key in keys}
    sensors = values.pop("sensors")
    if not isinstance(sensors, list) or not all(isinstance(name, str) for name in sensors):
        raise ArgumentError("sensors of base are no list of names")
    layout, matrices = values.pop("layout"), [left.pop(f"base.{name}") for name in names]
    if kind == "linear_feedback":
        return LinearFeedback(matrices[0], tuple(sensors), layout, **values)
    sampled = kind == "sampled_linear_dynamic"
    return LinearDynamic(tuple(matrices), tuple(sensors), layout, sampled=sampled, **values)
