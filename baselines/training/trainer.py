"""A training run: updates, checkpoints, the judge, and going on after a kill.

The run is a sequence of stretches, each from one checkpoint to the next. A stretch depends on
nothing but the settings, the seed and the checkpoint that it begins with; so a run that was killed
at any moment and resumed gives the policy of an undisturbed one, bit for bit, on the same machine
with the same versions. The exception is an interruption on demand (Ctrl-C): it writes a checkpoint
where none would be, loses nothing, and the episodes after it are others; run.json says so.
"""

import json
import math
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from baselines.policies.folder import save_trained
from baselines.training.checkpoint import Checkpoint, write_checkpoint
from baselines.training.interruption import Interruption
from baselines.training.judge import Judge, Judgement, better
from baselines.training.learning_curve import curve_row, means, reference_curves
from baselines.training.method import Method, method_class
from baselines.training.monitor import Monitor
from baselines.training.one_thread import one_thread
from baselines.training.other_settings import words_of_difference
from baselines.training.outcome import Outcome
from baselines.training.progress import Progress
from baselines.training.run_card import training_card
from baselines.training.run_folder import RunFolder
from baselines.training.settings import TrainingSettings
from railenv.errors import ArgumentError, InputFileError, RailenvError


class Trainer:
    """One run in one folder.

    Args:
        settings: Of the run.
        path: The run's folder.
        command: The command that repeats the run, for the policy's card.
        origin: Versions and code revision, for run.json and the card.
        with_references: Whether classical laws are driven for comparison.
        watch: Called after every update with the lane-steps taken and a word about the policy.
        warn: Called with a sentence about what went wrong and was put right.
    """

    def __init__(
        self,
        settings: TrainingSettings,
        path: Path,
        *,
        command: str = "",
        origin: dict[str, Any] | None = None,
        with_references: bool = True,
        watch: Callable[[int, str], None] = lambda _steps, _word: None,
        warn: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.settings = settings.replace(search=None)
        self._folder = RunFolder(path)
        self._command, self._origin = command, dict(origin or {})
        self._with_references, self._watch, self._warn = with_references, watch, warn
        self._progress = Progress()

    def run(self, resume: bool = False) -> Outcome:
        """Train until the budget of lane-steps is spent.

        Args:
            resume: Go on with the run in the folder, if there is one.

        Raises:
            ArgumentError: The folder is not empty and `resume` is not set, or its run has other
                settings.
            InputFileError: A file of the run is damaged, and there is nothing to go back to.
            KeyboardInterrupt: The run was interrupted on demand; a checkpoint is written.
            RailenvError: The training diverged.
        """
        self._started = time.perf_counter()
        with self._folder.held():
            about = self._opened(resume)
            if about["done"]:
                return self._was_done(about)
            with one_thread(), Interruption() as interruption:
                kind = method_class(self.settings.method)
                method = kind(self.settings, self.settings.seed)
                newest = self._went_on(method) if resume else None
                self._judge = Judge(self.settings.environment, self.settings.checkpoints)
                references = self._references()
                monitor = Monitor(self._folder.tensorboard, method.steps)
                try:
                    self._train(method, newest, monitor, interruption, references)
                finally:
                    monitor.close()
            return self._finished(method.steps, references)

    def _opened(self, resume: bool) -> dict[str, Any]:
        """Begin a new run, or check the one that is there; return the content of run.json."""
        config = json.loads(json.dumps(self.settings.to_plain()))
        if resume and self._folder.exists():
            about = self._folder.about()
            if about["config"] != config:
                raise ArgumentError(
                    f"the run in {self._folder.path} has other settings "
                    f"({words_of_difference(about['config'], config)}); resume it with its own, or "
                    "start a new one with another --out"
                )
            for name in ("versions", "revision"):
                if about.get(name) != self._origin.get(name):
                    self._warn(
                        f"{name} of the run's beginning are others than now; what follows may "
                        "differ from an undisturbed run"
                    )
            return about
        about = {"config": config, "command": self._command, **self._origin, "done": False}
        self._folder.begin(about)
        return about

    def _went_on(self, method: Method) -> Checkpoint | None:
        """Put the method back to the newest whole checkpoint, if there is one."""
        newest, complaints = self._folder.newest()
        for complaint in complaints:
            self._warn(complaint)
        if newest is not None:
            self._restore(method, newest)
        return newest

    def _restore(self, method: Method, newest: Checkpoint) -> None:
        try:
            method.restore(newest.arrays, newest.plain["method"])
            self._progress = Progress.of_plain(newest.plain["progress"])
            if method.steps != newest.steps:
                raise ValueError(f"steps are {method.steps} and {newest.steps}")
        except (KeyError, TypeError, ValueError, AttributeError, RuntimeError) as error:
            # Nothing is removed: another version of the program may have written it.
            place = self._folder.policy_at(newest.steps).parent
            raise InputFileError(
                f"{place / 'checkpoint.json'} does not hold what is needed to go on "
                f"({type(error).__name__}: {error}): damaged, or of another version; go on with "
                f"that version, or remove {place}, and the run goes on from the one before"
            ) from error

    def _references(self) -> dict[str, Any]:
        """Return what classical laws reach; driven once per run."""
        if not self._with_references:
            return {}
        known = self._folder.references()
        if known is None:
            known = self._judge.references()
            self._folder.write_references(known)
        return known

    def _train(
        self,
        method: Method,
        newest: Checkpoint | None,
        monitor: Monitor,
        interruption: Interruption,
        references: dict[str, Any],
    ) -> None:
        """Update and write checkpoints until the budget is spent."""
        every, budget = self.settings.checkpoints.every, self.settings.steps
        before = self._progress.seconds
        last = 0 if newest is None else newest.steps
        word, seen = "", list[dict[str, float]]()
        if method.steps < budget:
            method.begin()
        while method.steps < budget:
            metrics = method.update()
            self._check(metrics, method.steps)
            seen.append(metrics)
            monitor.add(method.steps, "training", metrics)
            spent = method.steps >= budget
            self._progress.seconds = before + time.perf_counter() - self._started
            if spent or method.steps // every > last // every:
                judgement = self._keep(method, means(seen))
                monitor.add(method.steps, "judge", self._progress.rows[-1])
                monitor.add(method.steps, "reference", reference_curves(references))
                monitor.flush()
                last, seen, word = method.steps, [], _word(judgement)
                if not spent:
                    method.begin()
            elif interruption.asked:
                self._progress.interruptions.append(method.steps)
                self._write(method, None)
            self._watch(method.steps, word)
            if interruption.asked and not spent:
                raise KeyboardInterrupt

    def _keep(self, method: Method, metrics: dict[str, float]) -> Judgement:
        """Judge the policy and write a checkpoint."""
        from baselines.policies.torch_modules import policy_of

        progress = self._progress
        policy = policy_of(method.module())
        judgement = self._judge.judge(policy)
        if better(judgement, progress.best):
            progress.best, progress.best_steps = judgement, method.steps
        progress.rows.append(curve_row(method.steps, progress.seconds, metrics, judgement))
        card = training_card(
            self.settings,
            self._command,
            self._origin,
            method.steps,
            judgement,
            progress.interruptions,
        )
        self._write(method, lambda path: save_trained(policy, path, card))
        self._folder.write_curve(progress.rows)
        return judgement

    def _write(self, method: Method, write_policy: Callable[[Path], None] | None) -> None:
        """Write a checkpoint, with the policy if it was judged, and remove old ones."""
        arrays, plain = method.state()
        progress = self._progress
        progress.best_of[method.steps] = progress.best_steps
        whole = {"method": plain, "progress": progress.to_plain()}
        write_checkpoint(self._folder.checkpoints, method.steps, arrays, whole, write_policy)
        self._folder.prune(self.settings.checkpoints.keep, progress.best_of)

    def _check(self, metrics: dict[str, float], steps: int) -> None:
        """Raise `RailenvError` if the numbers of an update are not finite."""
        wrong = [name for name, value in metrics.items() if not math.isfinite(value)]
        if wrong:
            best = self._progress.best_steps
            where = (
                "no checkpoint was written"
                if best is None
                else f"the best policy so far is in {self._folder.policy_at(best)}"
            )
            raise RailenvError(
                f"training diverged after {steps} lane-steps: {wrong[0]} is not finite; {where}; "
                "give a smaller learning rate"
            )

    def _finished(self, steps: int, references: dict[str, Any]) -> Outcome:
        """Put the best policy in its place and note that the run is done."""
        progress = self._progress
        assert progress.best is not None
        assert progress.best_steps is not None
        self._folder.put_policy(progress.best_steps)
        self._folder.write_curve(progress.rows)
        about = self._folder.about()
        about |= {
            "done": True,
            "steps": steps,
            "seconds": progress.seconds,
            "best_steps": progress.best_steps,
            "best": progress.best.to_plain(),
            "interruptions": progress.interruptions,
        }
        self._folder.write_about(about)
        return Outcome.of_run(self._folder.path, about, references, was_done=False)

    def _was_done(self, about: dict[str, Any]) -> Outcome:
        known = self._folder.references() or {}
        outcome = Outcome.of_run(self._folder.path, about, known, was_done=True)
        if self._folder.has_policy():
            return outcome
        self._folder.put_policy(outcome.best_steps)
        return replace(outcome, put_back=True)


def _word(judgement: Judgement) -> str:
    worst = max(judgement.ride_index)
    return f"growth {judgement.worst_growth:.2g} 1/s, ride index up to {worst:.2f}"
