"""When a run writes checkpoints and by what they are judged; the table [checkpoints]."""

from dataclasses import dataclass

from railenv.errors import (
    ArgumentError,
    check_count,
    check_finite,
    check_not_negative,
    check_positive,
)
from railenv.units import Second


@dataclass(frozen=True)
class CheckpointSettings:
    """When checkpoints are written and by what they are judged.

    Attributes:
        every: Lane-steps from one checkpoint to the next.
        keep: How many of the newest checkpoints stay, beside the best.
        delays: Delays judged, rising [s].
        growth_step: Growth rates are looked at this far apart, from the first of `delays` to the
            last, and on both sides of every whole control period, where the loop jumps [s].
        told_errors: Errors of the told delay judged [s]; for a hidden delay 0 alone counts.
        dev_tracks: Tracks driven at every delay; they are none of the training pool.
        dev_seconds: Length of each drive [s].
        skip_seconds: Time at the start of each that does not count [s].
    """

    every: int = 1_000_000
    keep: int = 2
    delays: tuple[Second, ...] = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3)
    growth_step: Second = 0.01
    told_errors: tuple[Second, ...] = (-0.02, 0.0, 0.02)
    dev_tracks: int = 4
    dev_seconds: Second = 15.0
    skip_seconds: Second = 5.0

    def __post_init__(self) -> None:
        check_count("every", self.every)
        check_count("keep", self.keep)
        check_count("dev_tracks", self.dev_tracks)
        check_positive("dev_seconds", self.dev_seconds, "seconds")
        check_positive("growth_step", self.growth_step, "seconds")
        check_not_negative("skip_seconds", self.skip_seconds, "seconds")
        if self.skip_seconds >= self.dev_seconds:
            raise ArgumentError(
                f"skip_seconds = {self.skip_seconds:g} s leaves nothing of dev_seconds = "
                f"{self.dev_seconds:g} s; give less"
            )
        for delay in self.delays:
            check_not_negative("delays", delay, "seconds")
        for error in self.told_errors:
            check_finite("told_errors", error, "seconds")
        if not self.delays or list(self.delays) != sorted(set(self.delays)):
            raise ArgumentError(f"delays = {list(self.delays)} must be a rising list")
        if 0.0 not in self.told_errors:
            raise ArgumentError(
                f"told_errors = {list(self.told_errors)} must have 0 among them; the cost is "
                "measured with the true delay"
            )
