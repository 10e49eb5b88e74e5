"""Writes docs/policies-table.md: trained policies beside classical laws, and where they transfer.

`python -m eval.policy_evidence` scores every shipped policy and those of `--policy`; `--smoke` runs
a small part of it. Policies that differ in the training seed only get a row for all of them. One
numeric thread per process: OMP_NUM_THREADS=1.
"""

import argparse
import shlex
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from tqdm import tqdm

from baselines import make_controller
from baselines.policies.shipped import shipped_names
from eval.command_score import policy_card, short_names
from eval.policy_score import TOLD_ERRORS, Depth, score
from eval.policy_score_card import recipe_of
from eval.policy_score_oracle import LONGEST
from eval.policy_score_references import LQG, PASSIVE, PREVIEW, SINGLE, SKYHOOK
from eval.policy_score_runs import Trial
from eval.policy_score_text import (
    critical_word,
    delay_columns,
    index_cell,
    margin_cell,
    markdown,
)
from eval.policy_score_transfer import cases, transfer_text, transferred
from eval.records import provenance, write_text
from railenv.files import make_folder

_DELAYS = (0.0, 0.1, 0.2, 0.3)
_FULL = Depth(simulated=("lateral17", "full50"), mistaken=TOLD_ERRORS)
_ELSEWHERE = Trial(tracks=8, delays=_DELAYS)
_NONLINEAR = Trial(tracks=4, seconds=20.0, delays=_DELAYS)

_SHORT = Trial(tracks=2, seconds=5.0, skip=2.0, delays=(0.0, 0.2))
_SMOKE = Depth(trial=_SHORT, growth_delays=(0.0, 0.2), windows=False, simulated=())


def main(arguments: Sequence[str] | None = None) -> None:
    """Run and write."""
    parser = argparse.ArgumentParser(prog="python -m eval.policy_evidence", description=__doc__)
    parser.add_argument("--out", default="docs/policies-table.md", help="where to write")
    parser.add_argument("--policy", action="append", default=[], help="one more policy; repeat")
    parser.add_argument("--smoke", action="store_true", help="short runs")
    parser.add_argument(
        "--linear-delays",
        action="store_true",
        help="critical delays by simulation on the linear vehicle alone: minutes less per policy",
    )
    options = parser.parse_args(arguments)
    specs = list(dict.fromkeys([*shipped_names(), *options.policy]))
    if not specs:
        parser.error("no policy is shipped and none is given; give one by --policy")
    start = time.perf_counter()
    names = short_names(specs)
    policies = [
        (names[spec], make_controller(spec), recipe_of(policy_card(spec))) for spec in specs
    ]
    depth, elsewhere, nonlinear = (
        (_SMOKE, _SHORT, _SHORT) if options.smoke else (_FULL, _ELSEWHERE, _NONLINEAR)
    )
    shipped = () if options.linear_delays else tuple(names[spec] for spec in shipped_names())
    depth = replace(depth, fully=shipped)
    with tqdm(file=sys.stderr, unit="part") as bar:

        def tell(word: str) -> None:
            bar.set_postfix_str(word, refresh=False)
            bar.update()

        answer = score(policies, depth, tell)
        pairs = [(name, controller) for name, controller, _ in policies]
        moved = [transferred(case, pairs, tell) for case in cases(elsewhere, nonlinear)]
    given = sys.argv[1:] if arguments is None else list(arguments)
    command = shlex.join(["python", "-m", "eval.policy_evidence", *given])
    about = provenance(command, time.perf_counter() - start)
    path = Path(options.out)
    make_folder(path.parent)
    write_text(path, evidence_text(answer, moved, about))


def evidence_text(
    answer: Mapping[str, Any], moved: Sequence[dict[str, Any]], about: Mapping[str, Any]
) -> str:
    """Return the page.

    Args:
        answer: What `eval.policy_score.score` returned.
        moved: What `transferred` returned of every case.
        about: Command, revision and time.
    """
    trial = answer["trial"]
    columns = delay_columns(trial["delays"])
    gains = ", ".join("none" if g is None else f"{g / 1e3:g}" for g in answer["gains"])
    single = answer["single_gain"]
    head = _HEAD.format(
        command=about["command"],
        revision=about["revision"],
        minutes=about["seconds"] / 60.0,
        single="none" if single is None else f"{single / 1e3:g} kN s/m",
        gains=gains,
        longest=1000.0 * LONGEST,
        **trial,
    )
    parts = [
        head,
        "## Ride index",
        markdown(["controller", *columns], _index_rows(answer, len(columns))),
        "## Better by",
        "Ride index of the reference less that of the policy, told the delay where it is told one; "
        "paired, with 95 % intervals; negative: worse.",
        *(_margin_table(answer, columns, reference) for reference in _COMPARED),
        "## Force",
        "RMS over the actuators [kN].",
        markdown(["controller", *columns], _force_rows(answer, len(columns))),
        "## Stability",
        markdown(_STABILITY, _stability_rows(answer)),
        "## Elsewhere, without retraining",
        "Ride index of the worse floor end (in brackets RMS force [kN]), told the true delay where "
        f"a policy is told one; {moved[0]['tracks']} tracks. A star: a run diverged.",
        *(transfer_text(case) for case in moved),
    ]
    return "\n\n".join(parts) + "\n"


_COMPARED = (PASSIVE, SKYHOOK, SINGLE, LQG, PREVIEW)
_STABILITY = ["policy", "worst growth rate [1/s]", "critical delay, eigenvalues", "simulated"]

_HEAD = """# Trained policies beside classical laws

Written by `{command}` at revision {revision} in {minutes:.0f} min; do not edit. What the policies
are and how they were trained: [policies.md](policies.md).

Vehicle `{parameters}`, 4 actuators, {speed_kmh:g} km/h, {tracks} tracks {track} with seeds from
{first_track_seed}, never trained on, {seconds:g} s after {skip:g} s, readings with noise of
{sensor_noise:g} of the controlled response. **Ride index** Wz (Sperling, GB/T 5599) of the worse
floor end, mean over the tracks; lower is better. In brackets the 95 % interval by bootstrap over
tracks, and over training seeds where a row is of several. A star: a run diverged.

Sky-hook has its best gain at each delay of a grid from 3 to 60 kN s/m, chosen on these very tracks
({gains} kN s/m), or its best single gain from 50 ms up ({single}). The LQG is designed anew for
each delay, sharp, and breaks down if the delay it is told is wrong by 10 ms
([controllers-table.md](controllers-table.md)). "Full information with preview" reads the state
without noise: no law that measures can be expected below it at its force.

**Growth rates** and critical delays by eigenvalues are of the sampled loop, on a grid with both
sides of every jump, searched to {longest:g} ms, told the true delay unless it says otherwise, and
not proved (`railenv certify` proves). Of a policy that is not linear they hold near rest."""


def _index_rows(answer: Mapping[str, Any], number: int) -> list[list[str]]:
    rows = [
        [f"**{name}**, {word}", *(index_cell(row, k, interval=True) for k in range(number))]
        for name, own in answer["policies"].items()
        for word, row in own.items()
    ]
    return rows + [
        [name, *(index_cell(row, k, interval=True) for k in range(number))]
        for name, row in answer["references"].items()
    ]


def _margin_table(answer: Mapping[str, Any], columns: Sequence[str], reference: str) -> str:
    rows: list[list[str]] = []
    for name, own in answer["policies"].items():
        margin = next(iter(own.values()))["margins"].get(reference)
        if margin is not None:
            cells = [margin_cell(margin, k, interval=True) for k in range(len(columns))]
            rows.append([name, *cells])
    return markdown([f"than {reference}", *columns], rows)


def _force_rows(answer: Mapping[str, Any], number: int) -> list[list[str]]:
    def cells(row: Mapping[str, Any]) -> list[str]:
        values = [row["force_rms"][k] for k in range(number)]
        return ["-" if value is None else f"{value / 1e3:.2f}" for value in values]

    rows = [
        [f"**{name}**, {word}", *cells(row)]
        for name, own in answer["policies"].items()
        for word, row in own.items()
    ]
    return rows + [[name, *cells(row)] for name, row in answer["references"].items()]


def _stability_rows(answer: Mapping[str, Any]) -> list[list[str]]:
    rows: list[list[str]] = []
    for name, found in answer["stability"].items():
        growth = "; ".join(f"{w}: {g['worst']:+.3f}" for w, g in found.get("growth", {}).items())
        local = "" if found.get("linear", True) else ", near rest"
        exact = f"{critical_word(found)}{local}" if "critical_delay_s" in found else "-"
        simulated = "; ".join(f"{m}: {critical_word(s)}" for m, s in found["simulated"].items())
        rows.append([name, growth or "-", exact, simulated or "-"])
    return rows


if __name__ == "__main__":
    main()
