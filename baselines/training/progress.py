"""How far a training run has come."""

from dataclasses import dataclass, field
from typing import Any

from baselines.training.judge import Judgement


@dataclass
class Progress:
    """What a run knows of itself beside its method; kept in every checkpoint.

    Attributes:
        seconds: Time spent, all resumes together [s].
        best_steps: Lane-steps of the best checkpoint; None before the first.
        best: What the judge said of it.
        rows: Rows of learning.csv, one per judged checkpoint.
        best_of: For every checkpoint by its steps, the steps of the best one then.
        interruptions: Lane-steps after which the run was interrupted on demand.
    """

    seconds: float = 0.0
    best_steps: int | None = None
    best: Judgement | None = None
    rows: list[dict[str, float]] = field(default_factory=list[dict[str, float]])
    best_of: dict[int, int | None] = field(default_factory=dict[int, int | None])
    interruptions: list[int] = field(default_factory=list[int])

    def to_plain(self) -> dict[str, Any]:
        """Return it for JSON."""
        return {
            "seconds": self.seconds,
            "best_steps": self.best_steps,
            "best": None if self.best is None else self.best.to_plain(),
            "rows": self.rows,
            "best_of": {str(steps): best for steps, best in self.best_of.items()},
            "interruptions": self.interruptions,
        }

    @staticmethod
    def of_plain(plain: dict[str, Any]) -> "Progress":
        """Return what `to_plain` wrote.

        Raises:
            KeyError: An entry is missing.
            TypeError: An entry is of another kind.
            ValueError: Entries contradict each other.
        """
        best, best_steps = plain["best"], _steps_or_none(plain["best_steps"])
        if (best is None) != (best_steps is None):
            raise ValueError("there is a best checkpoint without its judgement, or the reverse")
        return Progress(
            float(plain["seconds"]),
            best_steps,
            None if best is None else Judgement.of_plain(best),
            [_row(row) for row in plain["rows"]],
            {int(steps): _steps_or_none(at) for steps, at in dict(plain["best_of"]).items()},
            [_steps(at) for at in plain["interruptions"]],
        )


def _row(row: Any) -> dict[str, float]:
    """Return a row of learning.csv as it stands: a number that is whole stays so."""
    for name, value in dict(row).items():
        if not isinstance(value, int | float):
            raise TypeError(f"{name} of a row of learning.csv is no number")
    return dict(row)


def _steps(value: Any) -> int:
    if type(value) is not int:
        raise TypeError(f"a number of lane-steps is {value!r:.40}")
    return value


def _steps_or_none(value: Any) -> int | None:
    return None if value is None else _steps(value)
