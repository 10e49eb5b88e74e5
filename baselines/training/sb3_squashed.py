"""The project's policies as actors of SAC, TQC and TD3.

Those algorithms act by tanh of a Gaussian (or of a network), and the policies cut at one. For SAC
and TQC the actor here gives the Gaussian the mean atanh(a), a the policy's action cut at
`LARGEST_MEAN`; so tanh of the mean is the policy's action, and what is exported acts as what was
trained. TD3's actor is the policy's action cut at one. The squash remains for the exploration.
"""

from typing import Any

import torch
from torch import Tensor

from baselines.training.sb3_policy import Acting, Actor

try:
    from sb3_contrib.tqc import policies as tqc
    from stable_baselines3.sac import policies as sac
    from stable_baselines3.td3 import policies as td3
except ModuleNotFoundError as missing:
    missing.add_note('this needs stable-baselines3 and sb3-contrib: pip install "railenv[train]"')
    raise

LARGEST_MEAN = 0.98
"""Beyond it a mean action is cut in training: atanh would grow without bound [1]."""


class _Squashed:
    """What the actors of SAC and TQC have in common."""

    def get_action_dist_params(self, obs: Any) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
        """Return mean and logarithm of the standard deviation before the squash."""
        own: Actor = self.actor  # pyright: ignore[reportAttributeAccessIssue]
        mean, _ = own.mean(obs)
        inside = torch.atanh(mean.clamp(-LARGEST_MEAN, LARGEST_MEAN))
        return inside, own.deviation().expand_as(inside), {}


class SacActor(_Squashed, sac.Actor):
    """Actor of SAC around a policy.

    Args:
        acting: What it is made with.
        kwargs: As the library gives them.
    """

    def __init__(self, acting: Acting, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        del self.latent_pi, self.mu, self.log_std
        self.actor = Actor(acting)


class TqcActor(_Squashed, tqc.Actor):
    """Actor of TQC around a policy.

    Args:
        acting: What it is made with.
        kwargs: As the library gives them.
    """

    def __init__(self, acting: Acting, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        del self.latent_pi, self.mu, self.log_std
        self.actor = Actor(acting)


class Td3Actor(td3.Actor):
    """Actor of TD3 around a policy.

    Args:
        acting: What it is made with.
        kwargs: As the library gives them.
    """

    def __init__(self, acting: Acting, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        del self.mu
        self.actor = Actor(acting)

    def forward(self, obs: Tensor) -> Tensor:
        """Return the actions, shape (lanes, actions)."""
        return self.actor.mean(obs)[0].clamp(-1.0, 1.0)


class SacPolicy(sac.SACPolicy):
    """SAC's policy with the actor above; critics are the library's.

    Args:
        args: As the library gives them.
        acting: What the actor is made with.
        kwargs: As the library gives them.
    """

    def __init__(self, *args: Any, acting: Acting, **kwargs: Any) -> None:
        self._acting = acting
        super().__init__(*args, **kwargs)

    def make_actor(self, features_extractor: Any = None) -> SacActor:
        """Return a new actor."""
        given = self._update_features_extractor(self.actor_kwargs, features_extractor)
        return SacActor(self._acting, **given)


class TqcPolicy(tqc.TQCPolicy):
    """TQC's policy with the actor above; critics are the library's.

    Args:
        args: As the library gives them.
        acting: What the actor is made with.
        kwargs: As the library gives them.
    """

    def __init__(self, *args: Any, acting: Acting, **kwargs: Any) -> None:
        self._acting = acting
        super().__init__(*args, **kwargs)

    def make_actor(self, features_extractor: Any = None) -> TqcActor:
        """Return a new actor."""
        given = self._update_features_extractor(self.actor_kwargs, features_extractor)
        return TqcActor(self._acting, **given)


class Td3Policy(td3.TD3Policy):
    """TD3's policy with the actor above; critics are the library's.

    Args:
        args: As the library gives them.
        acting: What the actor is made with.
        kwargs: As the library gives them.
    """

    def __init__(self, *args: Any, acting: Acting, **kwargs: Any) -> None:
        self._acting = acting
        super().__init__(*args, **kwargs)

    def make_actor(self, features_extractor: Any = None) -> Td3Actor:
        """Return a new actor."""
        given = self._update_features_extractor(self.actor_kwargs, features_extractor)
        return Td3Actor(self._acting, **given)
