"""The same policies where they were not trained: speeds, load, worn wheels, track, the other model.

Nothing is trained or designed again. Beside the policies stand the passive vehicle and the sky-hook
with its best gain at each delay, both on the vehicle and the track of the case. Where the vehicle
with its lateral dampers is unstable by itself, or no gain of the grid is stable, it is said.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from baselines.controller import Controller
from eval.policy_score import plain, run_policy
from eval.policy_score_references import (
    PASSIVE,
    SKYHOOK,
    layout_beside,
    passive_and_skyhook,
)
from eval.policy_score_runs import Comfort, Trial
from eval.policy_score_text import delay_columns, markdown
from railenv.vehicle import VehicleParameters, get_vehicle, state_space

LOAD = 1.25
"""Factor on the carbody's mass and inertias: 10 t of passengers on 40 t, the full load of the
vehicle ranges "wide" (`railenv.vehicle.randomisation`)."""

WORN = 0.3
"""Equivalent conicity of worn wheels [1]; the vehicle's own is 0.17."""

NOMINAL = "paper_fit"


@dataclass(frozen=True)
class Case:
    """One place where policies are tried.

    Attributes:
        title: In words.
        trial: What is run.
    """

    title: str
    trial: Trial

    @property
    def hunts(self) -> bool:
        """Whether the linear vehicle with its lateral dampers is unstable without any control."""
        roots = np.linalg.eigvals(state_space(self.trial.lateral("passive")).A)
        return bool(np.max(roots.real) > 0.0)


def laden(parameters: VehicleParameters) -> VehicleParameters:
    """Return a vehicle full of people, who do not change the radii of gyration."""
    names = ("carbody_mass", "carbody_yaw_inertia", "carbody_roll_inertia")
    return parameters.replace(**{name: LOAD * getattr(parameters, name) for name in names})


def cases(trial: Trial, full: Trial) -> tuple[Case, ...]:
    """Return the cases.

    Args:
        trial: What is run on the linear vehicle; each case changes one thing of it.
        full: What is run on the nonlinear vehicle, which takes much more time.
    """
    parameters = get_vehicle(NOMINAL).parameters
    speeds = tuple(
        Case(f"{speed:g} km/h", replace(trial, speed_kmh=speed))
        for speed in (200.0, 250.0, 300.0, 350.0)
    )
    return (
        *speeds,
        Case(
            f"300 km/h, laden (carbody {LOAD:g} times as heavy)",
            replace(trial, parameters=laden(parameters)),
        ),
        Case(
            f"300 km/h, worn wheels (conicity {WORN:g})",
            replace(trial, parameters=parameters.replace(conicity=WORN)),
        ),
        Case("300 km/h, track TB/T 3352", replace(trial, track="tb3352")),
        Case(
            f"300 km/h, nonlinear vehicle (full50), {full.tracks} tracks of {full.seconds:g} s",
            replace(full, model="full50"),
        ),
    )


def transferred(
    case: Case,
    policies: Sequence[tuple[str, Controller]],
    progress: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Run policies, told the delay where they are told one, and the references of a case.

    Returns:
        `title`, `hunts`, `tracks`, `delays_s`, `gains` [N s/m], and `rows` by name: `worse`,
        `force_rms` and `diverged`, one number per delay. Plain values.

    Raises:
        ArgumentError: The policies act on different layouts.
    """

    def tell(word: str) -> None:
        if progress is not None:
            progress(f"{case.title}: {word}")

    linear = case.trial.model == "lateral17"
    layout = layout_beside(policies)
    found = passive_and_skyhook(case.trial, tell, by_eigenvalues=linear, layout=layout)
    rows = {name: _row(found.rows[name]) for name in (PASSIVE, SKYHOOK)}
    for name, controller in policies:
        only_exact = run_policy(name, controller, case.trial, progress=tell, errors=(0.0,))
        rows[name] = _row(only_exact.first)
    return {
        "title": case.title,
        "hunts": case.hunts,
        "tracks": case.trial.tracks,
        "delays_s": list(case.trial.delays),
        "gains": plain(found.gains),
        "rows": rows,
    }


def _row(runs: Comfort) -> dict[str, Any]:
    return {
        "worse": plain(runs.worse),
        "force_rms": plain(np.sqrt(np.mean(runs.force**2, axis=1))),
        "diverged": runs.lost.tolist(),
    }


def transfer_text(answer: dict[str, Any]) -> str:
    """Return a case as a title, a table in Markdown and what failed in words."""
    rows: list[list[str]] = []
    for name, row in answer["rows"].items():
        values = zip(row["worse"], row["diverged"], row["force_rms"], strict=True)
        rows.append([name, *(_cell(*value) for value in values)])
    gains = ", ".join("none" if g is None else f"{g / 1e3:g}" for g in answer["gains"])
    notes = [f"Best sky-hook gains: {gains} kN s/m."]
    if answer["hunts"]:
        notes.append(
            "The linear vehicle with its lateral dampers is unstable here by itself (hunting)."
        )
    if None in answer["gains"]:
        notes.append('"none": no gain of the grid is stable; the row shows the lowest one.')
    table = markdown(["controller", *delay_columns(answer["delays_s"])], rows)
    return "\n\n".join([f"### {answer['title']}", table, " ".join(notes)])


def _cell(worse: float | None, diverged: bool, force: float | None) -> str:
    if worse is None:
        return "diverges"
    star = " *" if diverged else ""
    return f"{worse:.2f}{star}" + (f" ({force / 1e3:.2f})" if force else "")
