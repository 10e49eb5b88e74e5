"""Hyper-parameters of imitation."""

from dataclasses import dataclass

from baselines.training.told_draws import DelayLaw
from railenv.errors import ArgumentError, check_count, check_not_negative, check_positive
from railenv.units import Dimensionless


@dataclass(frozen=True)
class ImitationSettings:
    """Hyper-parameters of imitation.

    Attributes:
        lanes: Vehicles side by side.
        periods: Control periods of a round.
        run_in: Control periods at the start of a round that nothing is learned from.
        effort: Cost of the expert's mean square command in units of (3 kN)^2 [(m/s^2)^2].
        preview: Whether the expert knows that trailing wheelsets meet the leading one's track.
        expert_share: Share of the lanes that the expert drives, to the power of the round [1].
        exploration: Standard deviation of the random actions [1].
        ridge: Cost of a squared gain, in units of the features' mean square [1].
        replay: Samples kept for a network; new ones take the place of random old ones.
        batches: Steps of Adam in a round, for a network.
        batch: Samples of a step.
        learning_rate: Of Adam [1].
        exact_share: Share of the lanes that are told the exact delay [1].
        shortest_share: Share of the lanes at the shortest delay [1].
        longest_share: Share of the lanes at the longest delay [1].

    Raises:
        ArgumentError: A value is out of its range.
    """

    lanes: int = 64
    periods: int = 1500
    run_in: int = 100
    effort: Dimensionless = 1e-2
    preview: bool = True
    expert_share: Dimensionless = 0.5
    exploration: Dimensionless = 0.1
    ridge: Dimensionless = 1e-6
    replay: int = 32768
    batches: int = 200
    batch: int = 1024
    learning_rate: Dimensionless = 1e-3
    exact_share: Dimensionless = 0.0
    shortest_share: Dimensionless = 0.0
    longest_share: Dimensionless = 0.0

    def __post_init__(self) -> None:
        for name in ("lanes", "periods", "replay", "batch"):
            check_count(name, getattr(self, name))
        for name in ("run_in", "batches"):
            check_count(name, getattr(self, name), minimum=0)
        for name in ("effort", "ridge", "learning_rate"):
            check_positive(name, getattr(self, name))
        for name in ("expert_share", "exploration"):
            check_not_negative(name, getattr(self, name))
        if self.expert_share > 1.0:
            raise ArgumentError(f"expert_share = {self.expert_share:g} is a share; give 0 to 1")
        DelayLaw(0.0, 0.0, 0.0, self.exact_share, self.shortest_share, self.longest_share)
