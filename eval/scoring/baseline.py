"""Passive and reference: what gains are measured by, on one vehicle and one track.

Where a run of one of them was lost to a limit or a crash, nothing is known: that is a fault of the
records, which is said, and no property of the vehicle.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from eval.packages import PASSIVE, REFERENCE
from eval.scenarios.channel import number_text
from eval.store.schema import LOST
from railenv.units import Dimensionless

LEAST_GAIN: Dimensionless = 0.1
"""Ride index by which the reference must be better than passive for a run to be scored."""

WORST = -1.0
"""What a run counts that diverged or came to no end."""

Row = Mapping[str, Any]
Condition = tuple[str, ...]


@dataclass(frozen=True)
class Baseline:
    """Passive and reference, on one vehicle and one track.

    Attributes:
        passive: Ride index of the worse floor end; None if the vehicle diverged [1].
        reference: The same of the reference [1].
        lost: Why the run of one of them came to no end, which says nothing of the vehicle; "" if
            both did.
    """

    passive: float | None
    reference: float | None
    lost: str = ""

    @property
    def scored(self) -> bool:
        """Whether runs here are scored."""
        if self.passive is None or self.reference is None:
            return False
        return self.passive - self.reference >= LEAST_GAIN

    def gain(self, row: Row) -> float:
        """Return the comfort gain of a run, where runs are scored."""
        assert self.passive is not None
        assert self.reference is not None
        worse = worse_end(row)
        if worse is None:
            return WORST
        share = (self.passive - worse) / (self.passive - self.reference)
        return float(np.clip(share, WORST, 1.0))


def worse_end(row: Row) -> float | None:
    """Return the ride index of the worse floor end; None if the run diverged or has no end."""
    if row["status"] != "ok":
        return None
    return max(row["ride_index_front"], row["ride_index_rear"])


def baselines_of(passive: Sequence[Row], reference: Sequence[Row]) -> dict[Condition, Baseline]:
    """Return passive and reference by vehicle, track and seed.

    Args:
        passive: Rows of passive, without delay.
        reference: Rows of the reference on the same scenarios.
    """
    by_place = {track_of(row): row for row in reference}
    found: dict[Condition, Baseline] = {}
    for row in passive:
        other = by_place.get(track_of(row))
        reasons = [
            f"{spec}: {run['status']}" + (f", {run['message']}" if run["message"] else "")
            for spec, run in ((PASSIVE, row), (REFERENCE, other))
            if run is not None and run["status"] in LOST
        ]
        index = None if other is None else worse_end(other)
        found[track_of(row)] = Baseline(worse_end(row), index, "; ".join(reasons))
    return found


def lost_baselines(baselines: Mapping[Condition, Baseline]) -> Counter[str]:
    """Return why runs of passive or reference were lost, with the number of tracks of each."""
    return Counter(baseline.lost for baseline in baselines.values() if baseline.lost)


def place_of(row: Row) -> Condition:
    """Return model, vehicle, layout and speed of a run."""
    return row["model"], row["vehicle"], row["layout"], number_text(row["speed_kmh"])


def track_of(row: Row) -> Condition:
    """Return what passive and reference are known by: place, spectrum and seed of a run."""
    return (*place_of(row), row["track"], str(row["seed"]))
