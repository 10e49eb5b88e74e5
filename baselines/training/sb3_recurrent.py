"""The recurrent policy inside sb3-contrib's recurrent PPO.

That one expects a long short-term memory, its output, and layers on top. Here the memory is the
whole actor: it takes what the learner sees and gives the mean actions, and the layers on top do
nothing. Its state at rest is zero, which is what a state is set to at the start of an episode.
"""

from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from baselines.training.sb3_policy import Acting, Actor, Critic, two_rates

try:
    from sb3_contrib.common.recurrent.policies import RecurrentActorCriticPolicy
    from stable_baselines3.common.distributions import DiagGaussianDistribution
except ModuleNotFoundError as missing:
    missing.add_note('this needs sb3-contrib: pip install "railenv[train]"')
    raise

_States = tuple[Tensor, Tensor]


class UnitAsMemory(nn.Module):
    """A recurrent actor in the form of `torch.nn.LSTM`.

    Args:
        actor: The actor; its module has a hidden state.
        columns: Columns of what the learner sees.

    Attributes:
        actor: As given.
        input_size: Columns taken.
        hidden_size: Length of the hidden state.
        num_layers: 1.
    """

    num_layers = 1

    def __init__(self, actor: Actor, columns: int) -> None:
        super().__init__()
        self.actor = actor
        self.input_size = columns
        self.hidden_size = actor.module.num_hidden

    def forward(self, seen: Tensor, states: _States) -> tuple[Tensor, _States]:
        """Return the mean actions, shape (periods, lanes, actions), and the states after.

        Args:
            seen: Shape (periods, lanes, columns).
            states: Hidden states, shape (1, lanes, units), and a second one that is not used.
        """
        hidden, spare = states[0][0], states[1]
        actions: list[Tensor] = []
        for period in seen:
            action, hidden = self.actor.mean(period, hidden)
            actions.append(action)
        return torch.stack(actions), (hidden[None], spare)


class RecurrentActorCritic(RecurrentActorCriticPolicy):
    """A recurrent policy and its critic, which has no memory but the history.

    Args:
        args: As stable-baselines3 gives them: spaces and the schedule of the learning rate.
        acting: What the actor is made with.
        kwargs: Further settings of `RecurrentActorCriticPolicy`.

    Attributes:
        actor: Acts.
        critic: Values.
    """

    def __init__(self, *args: Any, acting: Acting, **kwargs: Any) -> None:
        super().__init__(
            *args,
            lstm_hidden_size=1,
            enable_critic_lstm=False,
            net_arch={"pi": [], "vf": []},
            **kwargs,
        )
        columns = int(np.prod(self.observation_space.shape or (0,)))
        memory = UnitAsMemory(Actor(acting), columns)
        self.lstm_actor: Any = memory
        self.lstm_hidden_state_shape = (1, 1, memory.hidden_size)
        self.critic: Any = Critic(columns, acting.critic_hidden)
        self.value_net: Any = nn.Identity()
        self.action_net: Any = nn.Identity()
        del self.log_std
        self.optimizer = two_rates(memory, self.critic, 1e-3)

    @property
    def actor(self) -> Actor:
        """The actor."""
        return self.lstm_actor.actor

    def _get_action_dist_from_latent(self, latent_pi: Tensor) -> DiagGaussianDistribution:
        return DiagGaussianDistribution(latent_pi.shape[1]).proba_distribution(
            latent_pi, self.actor.deviation()
        )
