"""Rows of the learning curve: what is written down at every checkpoint."""

from typing import Any

from baselines.training.judge import Judgement


def means(seen: list[dict[str, float]]) -> dict[str, float]:
    """Return the mean of every number over the updates of a stretch."""
    return {name: sum(row[name] for row in seen) / len(seen) for name in seen[0]}


def curve_row(
    steps: int, seconds: float, metrics: dict[str, float], judgement: Judgement
) -> dict[str, float]:
    """Return one row of learning.csv.

    Args:
        steps: Lane-steps taken.
        seconds: Time spent, all resumes together [s].
        metrics: Means of the method's numbers since the checkpoint before.
        judgement: What the judge says of the policy.
    """
    row = {"steps": float(steps), "seconds": round(seconds, 2), **metrics}
    row |= {
        "cost": judgement.cost,
        "worst_growth": judgement.worst_growth,
        "stable": float(judgement.stable),
    }
    growth = [max(column) for column in zip(*judgement.growth, strict=True)]
    for name, values in (("ride_index", judgement.ride_index), ("growth", growth)):
        row |= {
            f"{name}_{1e3 * delay:g}ms": value
            for delay, value in zip(judgement.delays, values, strict=True)
        }
    return row


def reference_curves(references: dict[str, Any]) -> dict[str, float]:
    """Return the lines that the curve is set beside: ride index of classical laws by delay."""
    lines: dict[str, float] = {}
    if not references:
        return lines
    for law in ("best sky-hook", "lqg-delay"):
        for delay, index in zip(references["delays"], references[law]["ride_index"], strict=True):
            lines[f"{law.replace(' ', '_')}_{1e3 * delay:g}ms"] = float(index)
    return lines
