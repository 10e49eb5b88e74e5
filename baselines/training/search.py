"""A search of hyper-parameters: many short runs, each proposed by those before.

Tree-structured Parzen estimator (Bergstra et al., NeurIPS 2011) by Optuna. The objective is the
judge's cost of a trial's best policy, and plus infinity where that is not stable.

    search.json            settings of the search
    study.sqlite3          proposals and results
    trials/000/            one training run each, see `baselines.training.run_folder`
    best.toml              a complete training configuration with the best values

The k-th trial's proposal depends on the results of those before it and on a seed of its own. So a
search that was killed proposes again what it was trying, finds the run half done in its folder and
goes on with it.
"""

import copy
import json
import math
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, cast

from baselines.training.method import episode_seed
from baselines.training.other_settings import words_of_difference
from baselines.training.run_folder import RunFolder, read_json
from baselines.training.run_lock import LOCK_FILE, held
from baselines.training.search_settings import SearchRange, SearchSettings
from baselines.training.settings import TrainingSettings, settings_from
from baselines.training.toml_text import toml_text
from baselines.training.trainer import Trainer
from railenv.errors import ArgumentError, InputFileError, RailenvError
from railenv.files import make_folder, replacing

_ABOUT = "search.json"


class Search:
    """One search in one folder.

    Args:
        settings: Of the training, with a table [search].
        path: The search's folder.
        trials: How many settings are tried; as the table says unless given.
        origin: Versions and code revision, for the records.
        warn: Called with a sentence about what went wrong and was put right.

    Attributes:
        trials: How many settings are tried.

    Raises:
        ArgumentError: There is no table [search], or it names an entry that does not exist.
    """

    def __init__(
        self,
        settings: TrainingSettings,
        path: Path,
        *,
        trials: int | None = None,
        origin: dict[str, Any] | None = None,
        warn: Callable[[str], None] = lambda _: None,
    ) -> None:
        if settings.search is None:
            raise ArgumentError(
                "the configuration has no table [search]; add one with trials, steps and ranges"
            )
        self._chosen: SearchSettings = settings.search
        self.trials = settings.search.trials if trials is None else trials
        self._plain = settings.replace(search=None).to_plain()
        self._seed, self._path = settings.seed, path
        self._origin, self._warn = dict(origin or {}), warn
        for name, entry in self._chosen.ranges:
            self._with({name: entry.choices[0] if entry.choices else entry.low}, 1)

    def run(
        self, resume: bool = False, watch: Callable[[int, str], None] = lambda _done, _word: None
    ) -> dict[str, Any]:
        """Run the trials and write best.toml.

        Args:
            resume: Go on with the search in the folder, if there is one.
            watch: Called after every trial with their number and a word about the best.

        Returns:
            "trials" and how many were "stable", and "number", "cost" and "values" of the best.

        Raises:
            ArgumentError: The folder is not empty and `resume` is not set, its search has other
                settings, another process is at it, or Optuna is not installed.
            InputFileError: search.json is damaged.
            OutputError: The folder cannot be written to.
            RailenvError: No trial gave a stable policy.
        """
        optuna = _optuna()
        if not (self._path / _ABOUT).is_file():
            self._refuse_used()  # before a lock is left in a folder of somebody else's
        make_folder(self._path)
        with held(self._path):
            self._open(resume)
            return self._searched(optuna, watch)

    def _searched(self, optuna: Any, watch: Callable[[int, str], None]) -> dict[str, Any]:
        """Run the trials that are left, and finish."""
        study = optuna.create_study(
            study_name="search",
            storage=f"sqlite:///{self._path.resolve() / 'study.sqlite3'}",
            load_if_exists=True,
        )
        known = optuna.trial.TrialState
        for trial in study.get_trials(states=(known.RUNNING,)):
            study.tell(trial.number, state=known.FAIL)
        done = study.get_trials(states=(known.COMPLETE,))
        while len(done) < self.trials:
            number = len(done)
            watch(number, _best_word(done))
            study.sampler = optuna.samplers.TPESampler(
                seed=episode_seed(self._seed, "search", number)
            )
            trial = study.ask()
            values = {name: _suggested(trial, name, e) for name, e in self._chosen.ranges}
            study.tell(trial, self._tried(number, values))
            done = study.get_trials(states=(known.COMPLETE,))
        return self._finish(done, watch)

    def _finish(self, done: list[Any], watch: Callable[[int, str], None]) -> dict[str, Any]:
        """Write best.toml and return what the search found."""
        costs = [float(trial.value) for trial in done]
        number = min(range(len(costs)), key=costs.__getitem__)
        watch(len(done), _best_word(done))
        if not math.isfinite(costs[number]):
            raise RailenvError(
                f"none of {len(done)} trials gave a policy that is stable at every judged delay; "
                "give more steps per trial, or other ranges"
            )
        given = done[number].params
        values = {name: _meant(entry, given[name]) for name, entry in self._chosen.ranges}
        best = self._with(values, self._plain["steps"])
        comment = (
            f"The best of {len(done)} trials: cost {costs[number]:.4f} in trial {number},\n"
            + "\n".join(f"{name} = {value}" for name, value in values.items())
        )
        with replacing(self._path / "best.toml") as stream:
            stream.write(toml_text(best.to_plain(), comment).encode("ascii"))
        return {
            "trials": len(done),
            "stable": sum(math.isfinite(cost) for cost in costs),
            "number": number,
            "cost": costs[number],
            "values": values,
        }

    def _open(self, resume: bool) -> None:
        """Make the folder, or check that the search in it is this one."""
        about = {"config": self._plain, "search": {**self._chosen.to_plain(), "trials": None}}
        about = json.loads(json.dumps(about))
        path = self._path / _ABOUT
        if resume and path.is_file():
            known = read_json(path)
            if known != about:
                raise ArgumentError(
                    f"the search in {self._path} has other settings "
                    f"({words_of_difference(known, about)}); resume it with its own, or start a "
                    "new one with another --out"
                )
            return
        self._refuse_used()
        with replacing(path) as stream:
            stream.write(json.dumps(about, indent=1).encode("ascii"))

    def _refuse_used(self) -> None:
        """Raise `ArgumentError` if more is there than a search killed at once leaves."""
        left = list(self._path.iterdir()) if self._path.is_dir() else []
        if any(not e.name.startswith(".search.") and e.name != LOCK_FILE for e in left):
            raise ArgumentError(
                f"{self._path} is not empty; go on with the search in it by --resume, or give "
                "another folder by --out"
            )

    def _tried(self, number: int, values: Mapping[str, Any]) -> float:
        """Return the cost of one trial; infinite if it diverged or is not stable."""
        folder = self._path / "trials" / f"{number:03d}"
        try:
            settings = self._with(values, self._chosen.steps)
            trainer = Trainer(
                settings, folder, origin=self._origin, with_references=False, warn=self._warn
            )
            self._clear(folder, settings)
            outcome = trainer.run(resume=True)
        except (ArgumentError, InputFileError):
            raise
        except RailenvError as error:
            if isinstance(error, OSError):
                raise
            self._warn(f"trial {number}: {error}")
            return math.inf
        return outcome.best.cost if outcome.best.stable else math.inf

    def _clear(self, folder: Path, settings: TrainingSettings) -> None:
        """Remove a half-done run with other values, of a killed search with other versions."""
        run = RunFolder(folder)
        if run.exists() and run.about()["config"] != json.loads(json.dumps(settings.to_plain())):
            self._warn(f"{folder} holds a run with other values; removed")
            shutil.rmtree(folder)

    def _with(self, values: Mapping[str, Any], steps: int) -> TrainingSettings:
        """Return the settings with some entries replaced."""
        plain = copy.deepcopy(self._plain)
        for path, value in values.items():
            table, _, entry = path.partition(".")
            plain[table][entry] = value
        plain["steps"] = steps
        return settings_from(plain, "search")


def _suggested(trial: Any, name: str, entry: SearchRange) -> Any:
    if entry.choices:
        # As text: a choice may be a list, which the study cannot store.
        texts = [json.dumps(choice) for choice in entry.choices]
        return _meant(entry, trial.suggest_categorical(name, texts))
    if entry.whole:
        return trial.suggest_int(name, entry.low, entry.high, log=entry.log)
    low, high = float(cast("float", entry.low)), float(cast("float", entry.high))
    return trial.suggest_float(name, low, high, log=entry.log)


def _meant(entry: SearchRange, stored: Any) -> Any:
    """Return the value that the study has stored."""
    return json.loads(stored) if entry.choices else stored


def _best_word(done: list[Any]) -> str:
    costs = [float(trial.value) for trial in done]
    return f"best cost {min(costs):.4f}" if costs else ""


def _optuna() -> Any:
    try:
        import optuna
    except ModuleNotFoundError as missing:
        raise ArgumentError(
            f'a search needs {missing.name}, which is not installed: pip install "railenv[train]"'
        ) from None
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return optuna
