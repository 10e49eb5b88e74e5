"""Hyper-parameters of the methods from stable-baselines3; the table [method]."""

from dataclasses import dataclass

from railenv.errors import ArgumentError, check_count, check_not_negative, check_positive
from railenv.units import Dimensionless, NewtonSecondPerMetre, Second


@dataclass(frozen=True)
class LearnerSettings:
    """What all of them share: the environment as the learner sees it.

    Attributes:
        lanes: Vehicles side by side.
        discount: Of rewards per control period, gamma [1].
        exploration: Standard deviation of the actions at the start [1].
        reward_offset: Added to every reward, so that a usual one is about zero [1].
        reward_scale: Returns are of this order [1].
        ridge: Share of the mean variance of the features that every direction is given in the
            whitening [1].
        whitening_seconds: Length of the drive by which the features are whitened [s].
        whitening_gain: Gain of the sky-hook on that drive [N s/m].
        critic_hidden: Widths of the critic's layers.
        averaging: Share of the old weights in the running mean of weights that is the result, per
            update; 0 for the weights themselves [1].

    Raises:
        ArgumentError: A value is out of its range.
    """

    lanes: int = 256
    discount: Dimensionless = 0.98
    exploration: Dimensionless = 0.15
    reward_offset: Dimensionless = 1.0
    reward_scale: Dimensionless = 3.0
    ridge: Dimensionless = 1e-3
    whitening_seconds: Second = 10.0
    whitening_gain: NewtonSecondPerMetre = 7500.0
    critic_hidden: tuple[int, ...] = (128, 128)
    averaging: Dimensionless = 0.0

    def __post_init__(self) -> None:
        check_count("lanes", self.lanes)
        for name in ("exploration", "reward_scale", "ridge", "whitening_seconds"):
            check_positive(name, getattr(self, name))
        check_not_negative("whitening_gain", self.whitening_gain)
        share("discount", self.discount)
        share("averaging", self.averaging)
        for width in self.critic_hidden:
            check_count("critic_hidden", width)


@dataclass(frozen=True)
class OnPolicySettings(LearnerSettings):
    """Hyper-parameters of PPO, with and without recurrence.

    Attributes:
        rollout: Control periods of every lane between updates.
        minibatch: Samples of one gradient step; it divides lanes * rollout.
        epochs: Passes over the samples of an update.
        trace: Decay of the advantage's trace, GAE's lambda; with `discount` it decides over what
            time an action is credited with what follows [1].
        clip: Range of PPO's ratio [1].
        kl: KL divergence per update to which the actor's learning rate is steered [1].
        learning_rate: Of the actor at the start [1].
        largest_learning_rate: The actor's rate does not rise above [1].
        critic_learning_rate: Of the critic [1].
        gradient_norm: Longest gradient; a longer one is shortened to it [1].
        exploration_floor: Smallest standard deviation of the actions [1].

    Raises:
        ArgumentError: A value is out of its range.
    """

    rollout: int = 64
    minibatch: int = 4096
    epochs: int = 4
    trace: Dimensionless = 0.98
    clip: Dimensionless = 0.2
    kl: Dimensionless = 0.01
    learning_rate: Dimensionless = 1e-3
    largest_learning_rate: Dimensionless = 3e-3
    critic_learning_rate: Dimensionless = 1e-3
    gradient_norm: Dimensionless = 0.5
    exploration_floor: Dimensionless = 0.05

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("rollout", "minibatch", "epochs"):
            check_count(name, getattr(self, name))
        for name in ("clip", "kl", "learning_rate", "largest_learning_rate"):
            check_positive(name, getattr(self, name))
        for name in ("critic_learning_rate", "gradient_norm", "exploration_floor"):
            check_positive(name, getattr(self, name))
        check_not_negative("trace", self.trace)
        if self.trace > 1.0:
            raise ArgumentError(f"trace = {self.trace:g} is a decay; give 0 to 1")
        samples = self.lanes * self.rollout
        if samples % self.minibatch or samples < 2 * min(self.minibatch, 2):
            raise ArgumentError(
                f"minibatch = {self.minibatch} does not divide lanes * rollout = {samples}; give "
                "a divisor, so that no gradient step has fewer samples than the others"
            )


@dataclass(frozen=True)
class OffPolicySettings(LearnerSettings):
    """Hyper-parameters of SAC, TD3 and TQC.

    Attributes:
        replay: Transitions kept.
        warm_up: Lane-steps before the first gradient step.
        actor_after: Lane-steps before the actor moves; until then the critics learn alone. What
            critics that know nothing point to is far outside the stable policies.
        minibatch: Transitions of one gradient step.
        gradient_steps: Gradient steps per control period of all lanes.
        returns: Control periods of rewards in a critic's target before it relies on itself; an
            action shows in the reward no sooner than the delay.
        periods: Control periods of all lanes in one update of the run.
        learning_rate: Of the actor [1].
        critic_learning_rate: Of the critics, and of the entropy's coefficient [1].
        target_share: Share of the critics in their targets per gradient step, tau [1].
        entropy: Coefficient of the entropy at the start; it is learnt (SAC and TQC) [1].
        target_deviation: Standard deviation of the actions to which it is learnt (SAC and TQC) [1].

    Raises:
        ArgumentError: A value is out of its range.
    """

    lanes: int = 16
    discount: Dimensionless = 0.97
    critic_hidden: tuple[int, ...] = (128, 128)
    replay: int = 100_000
    warm_up: int = 5_000
    actor_after: int = 20_000
    minibatch: int = 256
    gradient_steps: int = 2
    returns: int = 8
    periods: int = 50
    learning_rate: Dimensionless = 5e-5
    critic_learning_rate: Dimensionless = 1e-3
    target_share: Dimensionless = 0.01
    entropy: Dimensionless = 1e-3
    target_deviation: Dimensionless = 0.1

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("replay", "minibatch", "gradient_steps", "periods", "returns"):
            check_count(name, getattr(self, name))
        for name in ("warm_up", "actor_after"):
            check_count(name, getattr(self, name), minimum=0)
        for name in ("learning_rate", "critic_learning_rate", "target_share", "entropy"):
            check_positive(name, getattr(self, name))
        check_positive("target_deviation", self.target_deviation)
        if self.target_share > 1.0:
            raise ArgumentError(f"target_share = {self.target_share:g} is a share; give 0 to 1")
        if self.replay < self.lanes:
            raise ArgumentError(
                f"replay = {self.replay} holds no transition of each of {self.lanes} lanes; give "
                "more"
            )


def share(name: str, value: float) -> None:
    """Raise `ArgumentError` unless a number lies in [0, 1)."""
    if check_not_negative(name, value) >= 1.0:
        raise ArgumentError(f"{name} = {value:g} must be from 0 to less than 1")
