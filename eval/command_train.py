"""`railenv train` and `railenv search`: policies and hyper-parameters by a configuration file."""

import argparse
import shlex
import sys
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eval.arguments import parse_whole, print_json, progress_bar
from eval.records import provenance
from railenv.config import config_path
from railenv.errors import ArgumentError, check_count

if TYPE_CHECKING:
    from baselines.training.outcome import Outcome
    from baselines.training.settings import TrainingSettings

_TRAINING_PACKAGES = ("torch", "stable-baselines3", "sb3-contrib", "optuna")


def command_train(options: argparse.Namespace) -> None:
    """Train a policy and say where it is, what the judge says of it, and what comes next."""
    from baselines.training.trainer import Trainer

    path, settings = _settings(options)
    steps = _whole_or_none("steps", options.steps, 1)
    if steps is not None:
        settings = settings.replace(steps=steps)
    folder = _run_folder(options, path, settings.seed)
    with progress_bar(options, settings.steps, "step") as bar:
        bar.unit_scale = True

        def watch(done: int, word: str) -> None:
            bar.set_postfix_str(word, refresh=False)
            # The last update may go beyond the budget.
            bar.update(min(done, settings.steps) - bar.n)

        trainer = Trainer(
            settings,
            folder,
            command=_repeating_command(options),
            origin=_origin(),
            watch=watch,
            warn=partial(_warn, options),
        )
        try:
            outcome = trainer.run(options.resume)
        except KeyboardInterrupt:
            bar.close()
            out = shlex.quote(str(folder))
            _say(options, f"go on with: {_repeating_command(options)} --out {out} --resume")
            raise
    if options.json:
        print_json(_plain(outcome))
    else:
        _show(outcome)


def command_search(options: argparse.Namespace) -> None:
    """Search for hyper-parameters and say which were best."""
    from baselines.training.search import Search

    path, settings = _settings(options)
    trials = _whole_or_none("trials", options.trials, 1)
    folder = _run_folder(options, path, settings.seed, "search-")
    search = Search(settings, folder, trials=trials, origin=_origin(), warn=partial(_warn, options))
    with progress_bar(options, search.trials, "trial") as bar:

        def watch(done: int, word: str) -> None:
            bar.set_postfix_str(word, refresh=False)
            bar.update(done - bar.n)

        found = search.run(options.resume, watch)
    best = folder / "best.toml"
    if options.json:
        print_json({"best": str(best), **found})
        return
    print(f"trials     {found['trials']}, {found['stable']} of them stable")
    print(f"best       cost {found['cost']:.4f} in trial {found['number']}")
    for name, value in found["values"].items():
        print(f"           {name} = {value}")
    print(f"next       railenv train {shlex.quote(str(best))}")


def _settings(options: argparse.Namespace) -> "tuple[Path, TrainingSettings]":
    from baselines.training.settings import load_settings

    path = _config_file(options.config)
    settings = load_settings(path)
    seed = _whole_or_none("seed", options.seed, 0)
    return path, settings if seed is None else settings.replace(seed=seed)


def _plain(outcome: "Outcome") -> dict[str, Any]:
    return {
        "policy": str(outcome.folder),
        "steps": outcome.steps,
        "seconds": round(outcome.seconds, 2),
        "best_steps": outcome.best_steps,
        "judge": outcome.best.to_plain(),
        "worst_growth": outcome.best.worst_growth,
        "stable": outcome.best.stable,
        "references": outcome.references,
        "was_done": outcome.was_done,
        "put_back": outcome.put_back,
    }


def _show(outcome: "Outcome") -> None:
    if outcome.put_back:
        print(
            f"done       {outcome.folder} was done before; its policy was missing and is written "
            f"again from the best checkpoint, that after {outcome.best_steps:,} lane-steps"
        )
    elif outcome.was_done:
        print(f"done       {outcome.folder} was done before; nothing was left to do")
    print(f"policy     {outcome.folder}")
    print(f"judge      {outcome.best.line()}")
    for name in ("best sky-hook", "lqg-delay"):
        if name in outcome.references:
            indices = ", ".join(f"{i:.2f}" for i in outcome.references[name]["ride_index"])
            print(f"{name.removeprefix('best '):<10} {indices}")
    print(
        f"training   {outcome.steps:,} lane-steps in {outcome.seconds:.0f} s; "
        f"the best after {outcome.best_steps:,}"
    )
    print(f"next       railenv score {shlex.quote(str(outcome.folder))}")


def _warn(options: argparse.Namespace, text: str) -> None:
    _say(options, f"warning: {text}")


def _say(options: argparse.Namespace, text: str) -> None:
    print(f"railenv {options.command}: {text}", file=sys.stderr)


def _config_file(text: str) -> Path:
    """Return the file of a configuration: a path, or the name of one that is shipped."""
    path = Path(text)
    if path.suffix == ".toml" or path.exists():
        return path
    return config_path("train", text)


def _whole_or_none(name: str, text: str | None, minimum: int) -> int | None:
    """Return a whole number that was given, or None."""
    return None if text is None else check_count(name, parse_whole(name, text), minimum)


def _run_folder(options: argparse.Namespace, path: Path, seed: int, kind: str = "") -> Path:
    """Return the folder of a run: as given, or named after configuration and seed."""
    if options.out is None:
        return Path("runs") / f"{kind}{path.stem}-seed{seed}"
    if not options.out:
        raise ArgumentError("out = '' is no folder; give one")
    return Path(options.out)


def _repeating_command(options: argparse.Namespace) -> str:
    """Return the command that repeats a run, without where it is written."""
    words = ["railenv", options.command, options.config]
    for name in ("seed", "steps", "trials"):
        value = getattr(options, name, None)
        if value is not None:
            words += [f"--{name}", value]
    return shlex.join(words)


def _origin() -> dict[str, Any]:
    """Return versions of what computes, and the code's revision."""
    about = provenance("", 0.0)
    versions = {"python": about["python"], **about["packages"]}
    for name in _TRAINING_PACKAGES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return {"versions": versions, "revision": about["revision"]}
