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
        """Return what `to_plain` wrote."""
        return Progress(
            float(plain["seconds"]),
            plain["best_steps"],
            None if plain["best"] is None else Judgement.of_plain(plain["best"]),
            list(plain["rows"]),
            {int(steps): best for steps, best in plain["best_of"].items()},
            list(plain["interruptions"]),
        )
