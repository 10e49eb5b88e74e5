"""The score of policies: comfort on tracks never trained on, stability, and what stands beside.

One answer of plain values. Comfort is Sperling's ride index of the worse floor end, a mean over
tracks; of several policies from one recipe (the same training settings, different seeds) also over
the policies. Each number has an interval (`eval.policy_score_intervals`), each margin is paired.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from baselines.controller import Controller
from eval.policy_score_intervals import Bootstrap, Estimate
from eval.policy_score_oracle import (
    LONGEST,
    LONGEST_NONLINEAR,
    growth_rates,
    has_oracle,
    is_told,
    stable_windows,
    time_domain,
)
from eval.policy_score_references import (
    References,
    error_words,
    layout_beside,
    passive_and_skyhook,
    with_designs,
)
from eval.policy_score_runs import SCORING_SEEDS, Comfort, Trial, comfort_of
from railenv.errors import ArgumentError, check_finite
from railenv.units import FloatArray

TOLD_ERRORS = (0.0, -0.02, 0.02)
"""Errors of the told delay at which policies are run and judged [s]."""

HIDDEN, PLAIN = "delay hidden", "as it is"
"""Rows of a policy that is not told the delay, and of any other law."""

QUICK = Trial(tracks=4, seconds=30.0, delays=(0.0, 0.1, 0.2, 0.3))
"""What `--quick` runs."""


@dataclass(frozen=True)
class Depth:
    """How much is asked beyond the runs.

    Attributes:
        trial: What is run.
        growth_delays: Delays at which the growth rate is worked out [s].
        windows: Whether stable windows are looked for.
        simulated: Models on which the critical delay is found by simulation.
        fully: Names of the policies for which that is done on the nonlinear vehicle, which takes
            minutes each; None for all.
        mistaken: Errors of the delay that the LQG is designed for, further references [s].
    """

    trial: Trial = field(default_factory=Trial)
    growth_delays: tuple[float, ...] = tuple(round(0.0025 * k, 4) for k in range(121))
    windows: bool = True
    simulated: tuple[str, ...] = ("lateral17",)
    mistaken: tuple[float, ...] = ()
    fully: tuple[str, ...] | None = None

    def of(self, name: str) -> "Depth":
        """Return what is asked of one policy."""
        if self.fully is None or name in self.fully:
            return self
        return replace(self, simulated=tuple(m for m in self.simulated if m == "lateral17"))


@dataclass(frozen=True, eq=False)
class Scored:
    """A policy and its runs.

    Attributes:
        name: How it was given.
        controller: The policy.
        recipe: Equal for policies that differ in the training seed only; None if unknown.
        runs: Comfort by row.
    """

    name: str
    controller: Controller
    recipe: str | None
    runs: dict[str, Comfort]

    @property
    def first(self) -> Comfort:
        """The runs without an error of the told delay."""
        return next(iter(self.runs.values()))


def row_name(controller: Controller, told_error: float) -> str:
    """Return how a row of a policy is called, for an error of the told delay [s]."""
    if not is_told(controller):
        return HIDDEN if hasattr(controller, "history") else PLAIN
    return error_words(check_finite("told_error", told_error, "seconds"))


def run_policy(
    name: str,
    controller: Controller,
    trial: Trial,
    recipe: str | None = None,
    progress: Callable[[str], None] | None = None,
    errors: Sequence[float] = TOLD_ERRORS,
) -> Scored:
    """Run a policy at every delay, told it with each error [s], or not at all if it is not told."""
    runs: dict[str, Comfort] = {}
    for error in errors if is_told(controller) else (0.0,):
        row = row_name(controller, error)
        if progress is not None:
            progress(f"{name}, {row}")
        runs[row] = comfort_of(controller, trial, told_error=error)
    return Scored(name, controller, recipe, runs)


def stability(
    controller: Controller, depth: Depth, progress: Callable[[str], None] | None = None
) -> dict[str, Any]:
    """Return growth rates, windows and critical delays of a policy, plain values.

    Returns:
        `growth`, by row: `delays_s`, `rates` [1/s] and the `worst`; `linear`, whether that is the
        policy itself and not its motion near rest; what `stable_windows` returns; all these absent
        if there is no oracle for the controller. `simulated`, by model: what `time_domain` returns.
    """
    layout = getattr(controller, "layout", "4")
    vehicle = depth.trial.lateral(layout)
    answer: dict[str, Any] = {}
    if has_oracle(controller):
        answer["linear"] = bool(getattr(controller, "is_linear", True))
        answer["growth"] = {}
        for error in TOLD_ERRORS if is_told(controller) else (0.0,):
            rates = growth_rates(controller, vehicle, depth.growth_delays, error, progress)
            answer["growth"][row_name(controller, error)] = {
                "delays_s": list(depth.growth_delays),
                "rates": rates,
                "worst": max(rates),
            }
        if depth.windows:
            answer |= stable_windows(controller, vehicle, progress=progress)
    answer["simulated"] = {}
    for model in depth.simulated:

        def tell(word: str, model: str = model) -> None:
            if progress is not None:
                progress(f"critical delay by simulation, {model}: {word}")

        place = Trial(
            parameters=depth.trial.parameters, speed_kmh=depth.trial.speed_kmh, model=model
        )
        longest = LONGEST if model == "lateral17" else LONGEST_NONLINEAR
        answer["simulated"][model] = time_domain(controller, place.vehicle(layout), longest, tell)
    return answer


def score(
    policies: Sequence[tuple[str, Controller, str | None]],
    depth: Depth,
    progress: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Score policies beside the references.

    Args:
        policies: Name, policy and recipe (see `Scored`) of each.
        depth: How much is asked.
        progress: Called with a word on every part that starts.

    Returns:
        `trial`; `layout` of the references, which is that of the policies; `policies` and
        `references`, see `comparison`; `gains` and `single_gain`, the sky-hook's [N s/m];
        `stability` by policy, see `stability`. Plain values.

    Raises:
        ArgumentError: The policies act on different layouts.
    """
    trial = depth.trial
    layout = layout_beside([(name, each) for name, each, _ in policies])
    scored = [run_policy(name, each, trial, recipe, progress) for name, each, recipe in policies]
    found = passive_and_skyhook(trial, progress, layout=layout)
    found = with_designs(found, trial, progress, depth.mistaken)
    rows, beside = comparison(scored, found, trial)
    return {
        "trial": plain_trial(trial),
        "layout": layout,
        "policies": rows,
        "references": beside,
        "gains": plain(found.gains),
        "single_gain": found.single_gain,
        "stability": {s.name: stability(s.controller, depth.of(s.name), progress) for s in scored},
    }


def families(scored: Sequence[Scored]) -> list[tuple[str, list[Scored]]]:
    """Return policies of one recipe together: name and members, two at least."""
    by_recipe: dict[str, list[Scored]] = {}
    for one in scored:
        members = by_recipe.setdefault(one.recipe or "", [])
        # A copy of a policy is no further seed.
        copied = any(np.array_equal(_weights(one), _weights(member)) for member in members)
        if one.recipe is not None and not copied:
            members.append(one)
    return [
        (f"{members[0].name} and {len(members) - 1} more seeds", members)
        for members in by_recipe.values()
        if len(members) > 1
    ]


def _weights(one: Scored) -> FloatArray:
    """Return the weights of the linear path, by which a copy is known."""
    weights = getattr(one.controller, "weights", None)
    return np.full(1, float(id(one))) if weights is None else np.asarray(weights)


def comparison(
    scored: Sequence[Scored], references: References, trial: Trial
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return rows and margins of policies, of families of policies, and rows of references.

    Returns:
        Of policies and of references: rows by name, each with `worse`, `low`, `high`, `front`,
        `rear`, `force_rms`, `weighted`, `diverged`, one number per delay; a policy's rows have
        `margins` by name of the reference, each `value`, `low`, `high`: by how much it is better.
    """
    alone = Bootstrap(trial.tracks)
    beside = {
        name: _row([comfort], alone.index([comfort])) for name, comfort in references.rows.items()
    }
    rows: dict[str, Any] = {}
    for one in scored:
        rows[one.name] = {
            word: _compared([comfort], alone, references) for word, comfort in one.runs.items()
        }
    for name, members in families(scored):
        draws = Bootstrap(trial.tracks, len(members))
        common = [word for word in members[0].runs if all(word in m.runs for m in members)]
        rows[name] = {
            word: _compared([m.runs[word] for m in members], draws, references) for word in common
        }
    return rows, beside


def _compared(runs: list[Comfort], draws: Bootstrap, references: References) -> dict[str, Any]:
    row = _row(runs, draws.index(runs))
    row["margins"] = {
        name: _plain_estimate(draws.margin(reference, runs))
        for name, reference in references.rows.items()
    }
    return row


def _row(runs: list[Comfort], estimate: Estimate) -> dict[str, Any]:
    found = _plain_estimate(estimate)
    row: dict[str, Any] = {"worse": found.pop("value"), **found}
    for key, get in _MEANS.items():
        row[key] = plain(np.mean([get(run) for run in runs], axis=0))
    row["diverged"] = np.any([run.lost for run in runs], axis=0).tolist()
    return row


_MEANS: dict[str, Callable[[Comfort], FloatArray]] = {
    "front": lambda run: run.front.mean(axis=1),
    "rear": lambda run: run.rear.mean(axis=1),
    "force_rms": lambda run: np.sqrt(np.mean(run.force**2, axis=1)),
    "weighted": lambda run: np.sqrt(np.mean(run.weighted**2, axis=1)),
}


def _plain_estimate(estimate: Estimate) -> dict[str, Any]:
    return {
        "value": plain(estimate.value),
        "low": plain(estimate.low),
        "high": plain(estimate.high),
    }


def plain(values: FloatArray) -> list[float | None]:
    """Return numbers for JSON, None for what is not finite."""
    return [float(v) if np.isfinite(v) else None for v in values]


def plain_trial(trial: Trial) -> dict[str, Any]:
    """Return a trial for JSON, with the seed of its first track.

    Raises:
        ArgumentError: Its vehicle has no name.
    """
    if not isinstance(trial.parameters, str):
        raise ArgumentError("a score is of a catalogued vehicle; give the vehicle's name")
    values = asdict(trial)
    values["delays"] = list(trial.delays)
    return {**values, "first_track_seed": SCORING_SEEDS}
