"""`railenv score`: a policy's card, several policies in one table, and a run's learning curve."""

import argparse
import json
import shlex
import sys
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from baselines import make_controller
from baselines.controller import Controller
from baselines.policies import LinearPolicy
from baselines.policies.folder import is_policy, load_card, save_trained
from baselines.policies.policy import HistoryPolicy
from baselines.policies.shipped import shipped_folder, shipped_names
from eval.arguments import (
    folder_name,
    layout_of,
    parse_output,
    parse_whole,
    print_json,
    progress_bar,
)
from eval.loops import is_typed
from eval.policy_score import QUICK, Depth, score
from eval.policy_score_card import MEASURED, recipe_of, reproduced, scored_card
from eval.policy_score_runs import Trial
from eval.policy_score_text import screen
from eval.records import provenance, write_text
from railenv.errors import ArgumentError, check_count
from railenv.files import make_folder

_NOT_REPRODUCED = 1


def command_score(options: argparse.Namespace) -> int:
    """Score policies and print a table or one JSON object.

    Returns:
        1 if `--check` was given and a score was not reproduced, 0 otherwise.
    """
    specs = list(dict.fromkeys(options.policy))
    if options.learning_curve is not None:
        return _learning_curve(options, specs)
    policies = [(spec, make_controller(spec, options.layout)) for spec in specs]
    for spec, each in policies:
        layout_of(spec, each, options.layout)
    if options.check:
        return _check(options, policies)
    start = time.perf_counter()
    if options.out is not None:
        make_folder(Path(options.out))
    depth = _depth(options)
    cards = {spec: policy_card(spec) for spec in specs}
    names = short_names(specs)
    kept: list[tuple[str, HistoryPolicy, Path]] = []
    if options.save:
        kept = [(spec, *_kept(spec, each)) for spec, each in policies]
    with _words(options) as tell:
        listed = [(names[spec], each, recipe_of(cards[spec])) for spec, each in policies]
        answer = score(listed, depth, tell)
    command = shlex.join(["railenv", *sys.argv[1:]])
    answer["provenance"] = provenance(command, time.perf_counter() - start)
    if options.save:
        for spec, policy, folder in kept:
            save_trained(policy, folder, scored_card(cards[spec], answer, names[spec]))
    text = screen(answer, _next(options, specs))
    if options.out is not None:
        folder = Path(options.out)
        write_text(folder / "score.json", json.dumps(answer, indent=1, allow_nan=False) + "\n")
        write_text(folder / "score.md", f"```\n{text}\n```\n")
    if options.json:
        print_json(answer)
    else:
        print(text)
    return 0


def _depth(options: argparse.Namespace) -> Depth:
    """Return how much is asked."""
    depth = Depth()
    if options.quick:
        depth = Depth(trial=QUICK, growth_delays=QUICK.delays, windows=False, simulated=())
    if options.tracks is not None:
        tracks = check_count("tracks", parse_whole("tracks", options.tracks))
        depth = replace(depth, trial=replace(depth.trial, tracks=tracks))
    if options.full50:
        depth = replace(depth, simulated=("lateral17", "full50"))
    return depth


def _check(options: argparse.Namespace, policies: Sequence[tuple[str, Controller]]) -> int:
    """Reproduce the scores in the cards."""
    answer: dict[str, Any] = {}
    with _words(options) as tell:
        for spec, policy in policies:
            answer[spec] = reproduced(
                spec, policy, policy_card(spec).get("score", {}).get(MEASURED, {}), tell
            )
    failed = [spec for spec, found in answer.items() if not found["reproduced"]]
    if options.json:
        print_json(answer)
    else:
        for spec, found in answer.items():
            word = "reproduced" if found["reproduced"] else "NOT reproduced"
            largest = found["largest_difference"]
            shown = (
                "a run diverges in one and not the other" if largest is None else f"{largest:.1e}"
            )
            print(
                f"{spec}: score {word}; largest difference {shown} ({found['where']}), "
                f"tolerance {found['tolerance']:g}"
            )
    return _NOT_REPRODUCED if failed else 0


def _learning_curve(options: argparse.Namespace, specs: Sequence[str]) -> int:
    from eval.chart_plot import check_drawing
    from eval.policy_score_curve import learning_curve
    from eval.policy_score_figure import draw_curve

    path = parse_output(options.learning_curve, (".png", ".svg", ".pdf"))
    check_drawing()
    if path is None:
        raise ArgumentError("--learning-curve has no file; give one that ends in .png")
    trial = replace(Trial(), tracks=8) if not options.quick else QUICK
    if options.tracks is not None:
        trial = replace(trial, tracks=check_count("tracks", parse_whole("tracks", options.tracks)))
    with _words(options) as tell:
        curve = learning_curve([Path(spec) for spec in specs], trial, tell)
    draw_curve(curve, path)
    if options.json:
        print_json(curve)
    else:
        print(f"learning curve: {path}")
    return 0


@contextmanager
def _words(options: argparse.Namespace) -> Generator[Callable[[str], None], None, None]:
    with progress_bar(options, None, "part") as bar:

        def tell(word: str) -> None:
            bar.set_postfix_str(word, refresh=False)
            bar.update()

        yield tell


def short_names(specs: Sequence[str]) -> dict[str, str]:
    """Return what the table calls each SPEC: a folder's own name where no other is called so."""
    short = {spec: spec if policy_place(spec) is None else folder_name(spec) for spec in specs}
    often = [*short.values()]
    return {spec: name if often.count(name) == 1 else spec for spec, name in short.items()}


def policy_place(spec: str) -> Path | None:
    """Return where a policy lies, shipped or not; None for any other controller."""
    if spec in shipped_names():
        return shipped_folder() / spec
    return Path(spec) if is_policy(spec) else None


def policy_card(spec: str) -> dict[str, Any]:
    """Return a policy's card; empty for a controller that has none."""
    place = policy_place(spec)
    return {} if place is None else load_card(place)


def _kept(spec: str, policy: Controller) -> tuple[HistoryPolicy, Path]:
    """Return a policy and its folder, whose card can be written.

    Raises:
        ArgumentError: It is no folder.
    """
    place = policy_place(spec)
    if place is None or not place.is_dir() or not isinstance(policy, HistoryPolicy):
        raise ArgumentError(f"--save writes into a policy's folder, and {spec!r} is none")
    return policy, place


def _next(options: argparse.Namespace, specs: Sequence[str]) -> str:
    """Return the command to try next."""
    spec = shlex.quote(specs[0])
    layout = f" --layout {options.layout}" if is_typed(options, "layout") else ""
    if options.quick:
        return f"railenv score {' '.join(map(shlex.quote, specs))}{layout}"
    policy = make_controller(specs[0])
    if not isinstance(policy, LinearPolicy):
        return f"railenv simulate --controller {spec}{layout} --delay 0.1 --track german_low"
    error = " --told-error 0.02" if policy.history.is_told else ""
    return (
        f"railenv certify --controller {spec} --control-period {policy.control_period:g} "
        f"--delay 0:0.3{error}"
    )
