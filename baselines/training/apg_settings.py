"""Hyper-parameters of the analytic policy gradient."""

import math
from dataclasses import dataclass

from baselines.training.quiet_lanes import QuietLanes
from baselines.training.told_draws import DelayLaw
from railenv.errors import ArgumentError, check_count, check_not_negative, check_positive
from railenv.units import Dimensionless, MetrePerSecondSquared, PerSecond, Second


@dataclass(frozen=True)
class ApgSettings:
    """Hyper-parameters of the analytic policy gradient.

    Attributes:
        lanes: Vehicles side by side.
        window: Control periods that are back-propagated through at a time.
        windows_per_episode: Windows that follow each other before new episodes begin.
        learning_rate: Of Adam at the start [1].
        final_learning_rate: At the end of the budget; in between half a cosine [1].
        gradient_norm: Longest gradient; a longer one is shortened to it [1].
        effort_weight: Cost of a mean square action of one [1].
        soft: Ride-filtered acceleration below which it pays little to be smoother [m/s^2].
        worse_end_weight: Share of the worse floor end in the cost, the rest is both ends' mean [1].
        averaging: Share of the old weights in the running mean of weights that is the result, per
            window; 0 for the weights themselves [1].
        exact_share: Share of the lanes that are told the exact delay [1].
        shortest_share: Share of the lanes at the shortest delay [1].
        longest_share: Share of the lanes at the longest delay [1].
        edge_share: Share of the lanes right beside a whole control period, told at an extreme; see
            `baselines.training.told_draws` [1].
        gate_error: Of a gated policy the guard watches the gains at rest, and those of the gates
            that are right for a delay to within this error [s].
        gate_weight: Weight of the cross entropy between the gates of a gated policy and those of
            the true delay, see `baselines.training.gate_loss`; the first half window of an episode
            does not count [1].
        quiet_share: Share of the lanes on a quieter track, see `baselines.training.quiet_lanes`;
            of no use to a linear policy, to which all amplitudes are alike [1].
        quietest: Smallest amplitude of a quiet lane [1].
        unit_rate: Learning rate of all that is no gain of a feature (networks, recurrent units,
            readouts), as a share of the gains' own [1].
        imitation_rounds: Rounds of `baselines.training.imitation` that give the linear path its
            first weights; their lane-steps count; 0 to begin at zero.
        imitation_effort: Effort of the expert in these rounds [(m/s^2)^2].
        growth_weight: Weight of what growth rates exceed -growth_margin by, see
            `baselines.training.stability_guard`; not for recurrent policies; 0 for no guard [s].
        growth_margin: Growth rates up to minus this are left alone [1/s].
        growth_looks: New pairs of true and told delay looked at in every window.

    Raises:
        ArgumentError: A value is out of its range.
    """

    lanes: int = 128
    window: int = 300
    windows_per_episode: int = 6
    learning_rate: Dimensionless = 4e-3
    final_learning_rate: Dimensionless = 1e-5
    gradient_norm: Dimensionless = 1.0
    effort_weight: Dimensionless = 1e-3
    soft: MetrePerSecondSquared = 0.0067
    worse_end_weight: Dimensionless = 0.0
    averaging: Dimensionless = 0.0
    exact_share: Dimensionless = 0.0
    shortest_share: Dimensionless = 0.0
    longest_share: Dimensionless = 0.0
    edge_share: Dimensionless = 0.0
    growth_weight: Second = 0.0
    growth_margin: PerSecond = 0.05
    growth_looks: int = 4
    gate_error: Second = 0.005
    gate_weight: Dimensionless = 0.0
    quiet_share: Dimensionless = 0.0
    quietest: Dimensionless = 0.1
    unit_rate: Dimensionless = 1.0
    imitation_rounds: int = 0
    imitation_effort: Dimensionless = 1e-2

    def __post_init__(self) -> None:
        for name in ("lanes", "window", "windows_per_episode"):
            check_count(name, getattr(self, name))
        check_count("imitation_rounds", self.imitation_rounds, minimum=0)
        for name in ("learning_rate", "gradient_norm", "soft", "unit_rate", "imitation_effort"):
            check_positive(name, getattr(self, name))
        for name in ("final_learning_rate", "effort_weight", "worse_end_weight", "averaging"):
            check_not_negative(name, getattr(self, name))
        check_not_negative("gate_weight", self.gate_weight)
        check_not_negative("gate_error", self.gate_error, "seconds")
        check_not_negative("growth_weight", self.growth_weight)
        check_positive("growth_margin", self.growth_margin)
        check_count("growth_looks", self.growth_looks)
        if self.worse_end_weight > 1.0:
            raise ArgumentError(
                f"worse_end_weight = {self.worse_end_weight:g} is a share; give 0 to 1"
            )
        if self.averaging >= 1.0:
            raise ArgumentError(
                f"averaging = {self.averaging:g} keeps the first weights for ever; give less than 1"
            )
        # Their checks are ours.
        QuietLanes(self.quiet_share, self.quietest)
        DelayLaw(
            0.0,
            0.0,
            0.0,
            self.exact_share,
            self.shortest_share,
            self.longest_share,
            self.edge_share,
        )

    def rate(self, done: float) -> float:
        """Return the learning rate after a share of the budget, from 0 to 1."""
        fall = 0.5 * (1.0 + math.cos(math.pi * min(1.0, done)))
        return self.final_learning_rate + (self.learning_rate - self.final_learning_rate) * fall
