"""The score in a policy's card: written once, and reproduced by running it again.

The card holds what was run and what came out. Reproducing runs the policy alone: no reference
depends on it. Ride indices, forces and growth rates are computed in double precision and a stable
loop forgets rounding, so that a machine with other numeric libraries agrees to far better than
`TOLERANCE`; a run that diverged depends on every rounding, and only that it diverged is compared.
"""

import json
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from baselines.controller import Controller
from eval.policy_score import Depth, comparison, run_policy
from eval.policy_score_oracle import growth_rates, has_oracle
from eval.policy_score_references import References
from eval.policy_score_runs import SCORING_SEEDS, Trial
from railenv.config import from_mapping
from railenv.errors import ArgumentError, InputFileError

TOLERANCE = 1e-6
"""Largest relative difference of a ride index or a force, and largest difference of a growth rate
[1/s], at which a score counts as reproduced."""

MEASURED = "measured"
"""Key of a card's `score` under which the result of `railenv score` stands."""

_COMPARED = ("front", "rear", "force_rms")
_KEPT = ("worse", "low", "high", *_COMPARED, "diverged")
_EXACT = 0.0


def card_score(answer: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return what a card says of a score.

    Args:
        answer: What `eval.policy_score.score` returned.
        name: The policy's name in it.

    Returns:
        `trial`, `rows` of the policy and `references` without what can be derived, and `stability`
        with the worst growth rates.
    """
    found = answer["stability"][name]
    stability = {key: value for key, value in found.items() if key != "growth"}
    stability["worst_growth"] = {w: g["worst"] for w, g in found.get("growth", {}).items()}
    stability["growth_delays_s"] = next(
        (list(g["delays_s"]) for g in found.get("growth", {}).values()), []
    )
    return {
        "trial": dict(answer["trial"]),
        "rows": {w: {k: row[k] for k in _KEPT} for w, row in answer["policies"][name].items()},
        "references": {n: {"worse": row["worse"]} for n, row in answer["references"].items()},
        "stability": stability,
    }


def reproduced(
    name: str,
    controller: Controller,
    kept: Mapping[str, Any],
    progress: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Run what a card's score says was run, and compare.

    Args:
        name: Names the policy in messages.
        controller: The policy.
        kept: What the card's score holds under `MEASURED`; empty if it has none.
        progress: Called with a word on every part that starts.

    Returns:
        `reproduced`, `largest_difference` (of what is compared, relative or in 1/s), `where`,
        and the `tolerance`. Plain values.

    Raises:
        InputFileError: The card holds no score, or one that cannot be read.
    """
    depth, rows = _read(name, kept)
    scored = run_policy(name, controller, depth.trial, progress=progress)
    nothing = References({}, np.full(len(depth.trial.delays), np.nan), None)
    own = comparison([scored], nothing, depth.trial)[0][name]
    if set(own) != set(rows):
        raise InputFileError(
            f"{name}: the card's score has the rows {', '.join(rows)}, and the policy gives "
            f"{', '.join(own)}; the card is another policy's, score this one with --save"
        )
    differences: dict[str, float] = {}
    for word, row in own.items():
        for key in _COMPARED:
            differences[f"{word}, {key}"] = _difference(rows[word], row, key)
    worst = kept["stability"]["worst_growth"]
    if has_oracle(controller) and depth.growth_delays:
        vehicle = depth.trial.lateral(getattr(controller, "layout", "4"))
        rates = growth_rates(controller, vehicle, depth.growth_delays, _EXACT, progress)
        first = next(iter(own))
        if first in worst:
            differences[f"{first}, growth rate"] = abs(max(rates) - float(worst[first]))
    where = max(differences, key=lambda key: differences[key])
    largest = differences[where]
    return {
        "reproduced": bool(largest <= TOLERANCE),
        "largest_difference": largest if np.isfinite(largest) else None,
        "where": where,
        "tolerance": TOLERANCE,
    }


def _difference(old: Mapping[str, Any], new: Mapping[str, Any], key: str) -> float:
    """Return the largest relative difference over the delays, infinite if one has diverged."""
    largest = 0.0
    for k, value in enumerate(new[key]):
        if new["diverged"][k] or old["diverged"][k]:
            if new["diverged"][k] != old["diverged"][k]:
                return float("inf")
            continue
        before = float(old[key][k])
        scale = max(abs(before), abs(value))
        largest = max(largest, abs(value - before) / scale if scale > 0.0 else 0.0)
    return largest


def _read(name: str, kept: Mapping[str, Any]) -> tuple[Depth, Mapping[str, Any]]:
    """Return what was run and the rows of a card's score."""
    if not kept:
        raise InputFileError(
            f"{name}: the card holds no score; write one with railenv score --save"
        )
    try:
        fields = dict(kept["trial"])
        first = fields.pop("first_track_seed")
        if first != SCORING_SEEDS:
            raise ArgumentError(f"first_track_seed is {first!r}, here it is {SCORING_SEEDS}")
        trial = from_mapping(Trial, fields, "trial")
        rows, stability = kept["rows"], kept["stability"]
        delays = tuple(float(d) for d in stability["growth_delays_s"])
        dict(stability["worst_growth"])
        for row in rows.values():
            for key in (*_COMPARED, "diverged"):
                if len(row[key]) != len(trial.delays):
                    raise ArgumentError(f"{key} has not one number per delay")
                np.array([np.nan if v is None else v for v in row[key]], dtype=float)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputFileError(
            f"{name}: the card's score cannot be read ({type(error).__name__}: {error}); "
            "write it anew with railenv score --save"
        ) from None
    return Depth(trial, growth_delays=delays, windows=False, simulated=()), rows


def scored_card(card: Mapping[str, Any], answer: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return a card with the score of its policy in it, beside what the judge said."""
    return {**card, "score": {**card.get("score", {}), MEASURED: card_score(answer, name)}}


def recipe_of(card: Mapping[str, Any]) -> str | None:
    """Return what tells whether two policies differ in the training seed only; None if unknown."""
    config = card.get("training", {}).get("config")
    if not isinstance(config, dict):
        return None
    rest = {key: value for key, value in config.items() if key != "seed"}
    return json.dumps([card.get("class"), rest], sort_keys=True)
