"""How a training run ended."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from baselines.training.judge import Judgement
from railenv.errors import InputFileError


@dataclass(frozen=True)
class Outcome:
    """How a run ended.

    Attributes:
        folder: The run's folder; the best policy lies in it.
        steps: Lane-steps taken.
        seconds: Time spent, all resumes together [s].
        best_steps: Lane-steps of the best checkpoint.
        best: What the judge said of it.
        references: What classical laws reach on the same drives; empty if they were not driven.
        was_done: Whether the run had been done before.
        put_back: Whether its policy was missing then, and was taken from the best checkpoint.
    """

    folder: Path
    steps: int
    seconds: float
    best_steps: int
    best: Judgement
    references: dict[str, Any]
    was_done: bool
    put_back: bool = False

    @staticmethod
    def of_run(
        folder: Path, about: dict[str, Any], references: dict[str, Any], *, was_done: bool
    ) -> "Outcome":
        """Return what run.json says of a run that is done.

        Args:
            folder: The run's folder.
            about: The content of run.json.
            references: That of references.json.
            was_done: See `Outcome`.

        Raises:
            InputFileError: An entry is missing or of another kind.
        """
        try:
            return Outcome(
                folder,
                int(about["steps"]),
                float(about["seconds"]),
                int(about["best_steps"]),
                Judgement.of_plain(about["best"]),
                references,
                was_done,
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise InputFileError(
                f"{folder / 'run.json'} says that the run is done, and not how it ended "
                f"({type(error).__name__}: {error}): damaged; train anew with another --out"
            ) from None
