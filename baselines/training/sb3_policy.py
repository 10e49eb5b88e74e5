"""The project's policies inside stable-baselines3's: the actor is a module of `torch_modules`.

The learner sees whitened features z = M x (`baselines.training.sb3_columns`), so its module has
weights for z; `folded` gives the module for x, with M multiplied into every weight that reads
features, and is what is exported. A base, whose action is added to the module's, stays a fixed
matrix of the features throughout. The critic is a network of its own: sharing layers with it would
bind the policy to what the value needs.

Exploration is white Gaussian noise of a standard deviation that is learnt, per action, above
a floor. Below the floor the policy is all but deterministic and its updates, measured by the KL
divergence, shrink to nothing.
"""

import contextlib
import dataclasses
import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from baselines.policies.base_law import BaseLaw
from baselines.policies.torch_modules import PolicyModule
from baselines.training.method import Arrays
from baselines.training.new_module import new_module, set_module
from baselines.training.sb3_columns import TOLD_MIDDLE
from baselines.training.settings import TrainingSettings
from railenv.units import FloatArray

try:
    from stable_baselines3.common.distributions import DiagGaussianDistribution
    from stable_baselines3.common.policies import ActorCriticPolicy
except ModuleNotFoundError as missing:
    missing.add_note('this needs stable-baselines3: pip install "railenv[train]"')
    raise


def acting_settings(settings: TrainingSettings) -> TrainingSettings:
    """Return the settings without the base, whose matrix the actor holds itself."""
    return settings.replace(policy=dataclasses.replace(settings.policy, base=""))


def base_matrix(settings: TrainingSettings) -> FloatArray:
    """Return the base's actions per feature, shape (actions, F); zeros without a base.

    Raises:
        ArgumentError: The base is not static, or reads what is no sensor of the history.
    """
    module = new_module(settings, 0)
    history = module.history
    fixed = None if module.base is None else BaseLaw(module.base, history).static_weights()
    return np.zeros((history.num_actions, history.num_features)) if fixed is None else fixed


def folded(settings: TrainingSettings, values: Arrays, matrix: FloatArray) -> PolicyModule:
    """Return the module for features as they are, in double precision, base included.

    Args:
        settings: Of the run.
        values: Weights of the acting module, whose features are whitened, by name.
        matrix: The whitening M, shape (F, F).
    """
    features = len(matrix)
    changed = {name: np.asarray(value, dtype=np.float64) for name, value in values.items()}
    for name in ("weights", "layers.0.weight", "weight_ih"):
        if name in changed:
            whitened, rest = np.split(changed[name], [features], axis=-1)
            changed[name] = np.concatenate([whitened @ matrix, rest], axis=-1)
    module = new_module(settings, 0, torch.float64)
    set_module(module, changed)
    return module


@dataclass(frozen=True)
class Acting:
    """What a policy of stable-baselines3 is made with.

    Attributes:
        make: Makes the acting module.
        fixed: The base's actions per whitened feature, shape (actions, F).
        exploration: Standard deviation at the start [1].
        exploration_floor: Smallest standard deviation [1].
        critic_hidden: Widths of the critic's layers.
    """

    make: Callable[[], PolicyModule]
    fixed: FloatArray
    exploration: float
    exploration_floor: float
    critic_hidden: tuple[int, ...]


class Actor(nn.Module):
    """The acting module, its base and its exploration; actions before the cut.

    Args:
        acting: What it is made with.

    Attributes:
        module: The module, of whitened features.
        log_std: Logarithm of the standard deviation, per action.
    """

    def __init__(self, acting: Acting) -> None:
        super().__init__()
        self.module = acting.make()
        self._features = self.module.history.num_features
        fixed = torch.tensor(acting.fixed, dtype=self.module.weights.dtype)
        self._fixed: Tensor | None
        self.register_buffer("_fixed", fixed if bool(fixed.any()) else None, persistent=False)
        start = math.log(acting.exploration)
        self._floor = math.log(acting.exploration_floor)
        self.log_std = nn.Parameter(torch.full((self.module.history.num_actions,), start))

    def mean(self, seen: Tensor, hidden: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Return the mean actions, shape (lanes, actions), and the next hidden state.

        Args:
            seen: Whitened features and the told delay, shape (lanes, F + 1).
            hidden: Hidden state, shape (lanes, units); at rest unless given.
        """
        seen = aligned(seen)
        features = seen[:, : self._features]
        told = (seen[:, self._features] + 1.0) * TOLD_MIDDLE
        actions, after = self.module(features, told, hidden)
        if self._fixed is not None:
            actions = actions + features @ self._fixed.T
        return actions, after

    def deviation(self) -> Tensor:
        """Return the logarithm of the standard deviation, above its floor, shape (actions,)."""
        return self.log_std.clamp(min=self._floor)


class Critic(nn.Module):
    """A network from what the learner sees to one value.

    Args:
        columns: Columns seen, the told delay last.
        widths: Widths of the layers.
    """

    def __init__(self, columns: int, widths: tuple[int, ...]) -> None:
        super().__init__()
        sizes = [columns, *widths]
        layers: list[nn.Module] = []
        for inputs, outputs in itertools.pairwise(sizes):
            layers += [nn.Linear(inputs, outputs), nn.Tanh()]
        self.layers = nn.Sequential(*layers, nn.Linear(sizes[-1], 1))

    def forward(self, seen: Tensor) -> Tensor:
        """Return values, shape (lanes, 1)."""
        seen = aligned(seen)
        # A diverging lane must not spoil the value of all others through the weights.
        features = seen[:, :-1].clamp(-8.0, 8.0)
        return self.layers(torch.cat([features, seen[:, -1:]], dim=1))


class HistoryActorCritic(ActorCriticPolicy):
    """A policy without memory but its history, and its critic; for PPO.

    Args:
        args: As stable-baselines3 gives them: spaces and the schedule of the learning rate.
        acting: What the actor is made with.
        kwargs: Further settings of `ActorCriticPolicy`.

    Attributes:
        actor: Acts.
        critic: Values.
    """

    def __init__(self, *args: Any, acting: Acting, **kwargs: Any) -> None:
        self._acting = acting
        super().__init__(*args, **kwargs)

    def _build(self, lr_schedule: Any) -> None:
        self.actor = Actor(self._acting)
        columns = int(np.prod(self.observation_space.shape or (0,)))
        self.critic = Critic(columns, self._acting.critic_hidden)
        self.optimizer = two_rates(self.actor, self.critic, lr_schedule(1))

    def _distribution(self, seen: Any) -> DiagGaussianDistribution:
        mean, _ = self.actor.mean(seen)
        return DiagGaussianDistribution(mean.shape[1]).proba_distribution(
            mean, self.actor.deviation()
        )

    def forward(self, obs: Tensor, deterministic: bool = False) -> tuple[Tensor, Tensor, Tensor]:
        """Return actions, values and log probabilities."""
        distribution = self._distribution(obs)
        actions = distribution.get_actions(deterministic=deterministic)
        return actions, self.critic(obs), distribution.log_prob(actions)

    def evaluate_actions(self, obs: Any, actions: Tensor) -> tuple[Tensor, Tensor, Tensor | None]:
        """Return values, log probabilities and entropies of actions taken."""
        distribution = self._distribution(obs)
        return self.critic(obs), distribution.log_prob(actions), distribution.entropy()

    def get_distribution(self, obs: Any) -> DiagGaussianDistribution:
        """Return the distribution of the actions."""
        return self._distribution(obs)

    def predict_values(self, obs: Any) -> Tensor:
        """Return values, shape (lanes, 1)."""
        return self.critic(obs)


def aligned(seen: Tensor) -> Tensor:
    """Return a tensor whose memory begins at a multiple of 64 bytes, as torch's own does.

    A product of few rows is rounded by where its operands begin, and numpy's arrays, which the
    library hands over as they are, begin anywhere: one run would not equal the next.
    """
    return seen if seen.data_ptr() % 64 == 0 else seen.clone()


def two_rates(actor: nn.Module, critic: nn.Module, rate: float) -> torch.optim.Adam:
    """Return an optimiser with a group of its own for actor and critic, in this order.

    The actor's rate is steered by how far its actions move; the critic's has no reason to follow.
    """
    groups = [{"params": list(part.parameters())} for part in (actor, critic)]
    return torch.optim.Adam(groups, lr=rate, eps=1e-5)


@contextlib.contextmanager
def drawing(*entropy: int) -> Iterator[None]:
    """Seed the global generators for a while, and put them back afterwards.

    stable-baselines3 draws batches from numpy's global generator and actions from torch's.

    Args:
        entropy: Numbers that decide the seeds.
    """
    first, second = np.random.SeedSequence(entropy).generate_state(2, np.uint32)
    before = np.random.get_state()  # noqa: NPY002
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(int(first))
        np.random.seed(int(second))  # noqa: NPY002
        try:
            yield
        finally:
            np.random.set_state(before)  # noqa: NPY002
