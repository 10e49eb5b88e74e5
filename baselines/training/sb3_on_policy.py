"""Proximal policy optimisation (Schulman et al., arXiv:1707.06347) by stable-baselines3.

Model-free: it sees observations and rewards alone. `ppo` trains policies without a hidden state,
`recurrent_ppo` (sb3-contrib) those with one. What its defaults lack for a delayed plant of 1 Hz:

- Credit has to reach over the delay and a body period. GAE's weights fall by discount * trace per
  control period; 0.98 * 0.98 at 50 ms reaches 1.3 s, the library's 0.99 * 0.95 at 10 ms 0.2 s.
- A control period of some 50 ms; at 10 ms exploration is noise of 50 Hz that the vehicle hardly
  feels, and an unstable mode of 12 to 15 Hz can grow slowly, unseen by the comfort filter.
- Whitened features, returns of order one, and a critic with a rate of its own.
- The actor's rate is steered so that every update moves the policy by about the same
  KL divergence: up where it is less than two thirds of `kl`, down where it is more than 3/2 of it.
- An effort weight of about one. With 0.01 some policies drive a drift below 0.3 Hz by feeding back
  their own past actions; it grows by up to 0.6 per second and costs no comfort until actions
  saturate. A drift is a lasting force, which effort sees.
"""

from typing import Any

import numpy as np
import torch

from baselines.policies.torch_modules import PolicyModule
from baselines.sb3 import make_vec_env
from baselines.training.method import Arrays, Plain, episode_seed
from baselines.training.new_module import module_arrays, new_module, set_module
from baselines.training.sb3_columns import PolicyColumns, mild_drive
from baselines.training.sb3_optimiser import (
    network_arrays,
    optimiser_arrays,
    set_network,
    set_optimiser,
)
from baselines.training.sb3_policy import (
    Acting,
    Actor,
    HistoryActorCritic,
    acting_settings,
    base_matrix,
    drawing,
    folded,
)
from baselines.training.sb3_settings import LearnerSettings, OnPolicySettings
from baselines.training.settings import TrainingSettings
from railenv.errors import ArgumentError

try:
    from stable_baselines3 import PPO
    from stable_baselines3.common.logger import Logger
except ModuleNotFoundError as missing:
    missing.add_note('this needs stable-baselines3: pip install "railenv[train]"')
    raise

_METRICS = {
    "train/value_loss": "value_loss",
    "train/explained_variance": "explained_variance",
    "train/approx_kl": "kl",
    "train/clip_fraction": "clip_fraction",
}


class OnPolicy:
    """The method; see `baselines.training.method.Method`.

    Args:
        settings: Of the run; its hyper-parameters are `OnPolicySettings`.
        seed: Of weights, episodes and exploration.

    Attributes:
        name: "ppo" or "recurrent_ppo".
        steps: Lane-steps taken so far.
        env: What the learner sees.

    Raises:
        ArgumentError: The class of policy does not fit the method, or the base is not static.
    """

    def __init__(self, settings: TrainingSettings, seed: int) -> None:
        hyper = settings.hyper
        self._hyper: OnPolicySettings = hyper
        self._settings, self._seed = settings, seed
        self.name = settings.method
        recurrent = self.name == "recurrent_ppo"
        if recurrent != (settings.policy.kind == "recurrent"):
            raise ArgumentError(
                f"method {self.name!r} does not train class = {settings.policy.kind!r}; "
                "recurrent_ppo trains a recurrent policy, ppo a linear one or a network"
            )
        self.env = learner_env(settings, hyper, seed)
        acting = acting_of(settings, hyper, self.env, seed, hyper.exploration_floor)
        learner, policy = _learner(recurrent)
        with drawing(seed, 0):
            self._model = learner(
                policy,
                self.env,
                n_steps=hyper.rollout,
                batch_size=hyper.minibatch,
                n_epochs=hyper.epochs,
                gamma=hyper.discount,
                gae_lambda=hyper.trace,
                clip_range=hyper.clip,
                max_grad_norm=hyper.gradient_norm,
                policy_kwargs={"acting": acting},
                device="cpu",
            )
        self._model.set_logger(Logger(None, []))
        self._rate = min(hyper.learning_rate, hyper.largest_learning_rate)
        # The library would set one rate for actor and critic at the start of every update.
        self._model._update_learning_rate = self._set_rates  # pyright: ignore
        _, self._callback = self._model._setup_learn(settings.steps)
        self._fresh_states = getattr(self._model, "_last_lstm_states", None)
        self._average = new_module(acting_settings(settings), seed)
        set_module(self._average, module_arrays(self._actor.module))
        self._updates = 0

    @classmethod
    def hyper_parameters(cls, name: str) -> type[OnPolicySettings]:  # noqa: ARG003
        """Return the dataclass of the table [method]."""
        return OnPolicySettings

    @property
    def steps(self) -> int:
        """Lane-steps taken so far."""
        return int(self._model.num_timesteps)

    @property
    def _actor(self) -> Actor:
        policy: Any = self._model.policy
        return policy.actor

    def begin(self) -> None:
        """Start new episodes in all lanes, with hidden states at rest."""
        self.env.seed(episode_seed(self._seed, self.name, self.steps))
        self._model._last_obs = self.env.reset()
        self._model._last_episode_starts = np.ones(self._hyper.lanes, dtype=bool)
        if self._fresh_states is not None:
            self._model._last_lstm_states = self._fresh_states  # pyright: ignore

    def update(self) -> dict[str, float]:
        """Drive all lanes for some time and learn from it.

        Returns:
            "reward" (mean of a control period, in the environment's units), "value_loss",
            "explained_variance", "kl", "clip_fraction", "deviation" (of the actions [1]) and
            "learning_rate" (of the actor).
        """
        model, hyper = self._model, self._hyper
        buffer: Any = model.rollout_buffer
        with drawing(self._seed, 1, self._updates):
            model.collect_rollouts(self.env, self._callback, buffer, hyper.rollout)
            model.train()
        self._updates += 1
        numbers = known_metrics(model.logger, _METRICS)
        self._steer(numbers["kl"])
        self._follow()
        deviation = float(self._actor.deviation().detach().exp().mean())
        return {
            "reward": self.env.mean_reward(),
            **numbers,
            "deviation": deviation,
            "learning_rate": self._rate,
        }

    def module(self) -> PolicyModule:
        """Return a copy of the policy, with the running mean of the weights."""
        return folded(self._settings, module_arrays(self._average), self.env.matrix)

    def state(self) -> tuple[Arrays, Plain]:
        """Return networks, Adam's moments, the whitening and the counters."""
        policy: Any = self._model.policy
        arrays = {
            **network_arrays("policy.", policy),
            **optimiser_arrays("adam.", policy.optimizer),
            **network_arrays("average.", self._average),
            "matrix": self.env.matrix.copy(),
        }
        plain = {"steps": self.steps, "updates": self._updates, "rate": self._rate}
        plain["library_updates"] = int(self._model._n_updates)
        return arrays, plain

    def restore(self, arrays: Arrays, plain: Plain) -> None:
        """Go back to what `state` returned."""
        policy: Any = self._model.policy
        set_network("policy.", policy, arrays)
        set_optimiser("adam.", policy.optimizer, arrays)
        set_network("average.", self._average, arrays)
        self.env.matrix = np.array(arrays["matrix"], dtype=np.float64)
        self._model.num_timesteps = int(plain["steps"])
        self._model._n_updates = int(plain["library_updates"])
        self._updates, self._rate = int(plain["updates"]), float(plain["rate"])

    def _set_rates(self, optimiser: torch.optim.Adam) -> None:
        actor, critic = optimiser.param_groups
        actor["lr"], critic["lr"] = self._rate, self._hyper.critic_learning_rate

    def _steer(self, kl: float) -> None:
        """Set the actor's next learning rate by how far the last update moved it."""
        if kl > 1.5 * self._hyper.kl:
            self._rate /= 1.5
        elif kl < self._hyper.kl / 1.5:
            self._rate *= 1.5
        self._rate = min(self._rate, self._hyper.largest_learning_rate)

    def _follow(self) -> None:
        """Bring the running mean of the weights up to date."""
        newest = dict(self._actor.module.named_parameters())
        with torch.no_grad():
            for name, mean in self._average.named_parameters():
                mean.lerp_(newest[name], 1.0 - self._hyper.averaging)


def learner_env(settings: TrainingSettings, hyper: LearnerSettings, seed: int) -> PolicyColumns:
    """Return the environment of a learner, its features whitened by a first drive."""
    env = PolicyColumns(
        make_vec_env(hyper.lanes, **settings.environment_fields()),
        settings.history(),
        hyper.discount,
        hyper.reward_offset,
        hyper.reward_scale,
    )
    start = episode_seed(seed, "whitening", 0)
    record = mild_drive(
        env, hyper.whitening_seconds, hyper.whitening_gain, hyper.exploration, start
    )
    env.whiten(hyper.ridge, record)
    return env


def acting_of(
    settings: TrainingSettings, hyper: LearnerSettings, env: PolicyColumns, seed: int, floor: float
) -> Acting:
    """Return what a learner's actor is made with.

    Args:
        settings: Of the run.
        hyper: The method's.
        env: Gives the whitening.
        seed: Of the first weights.
        floor: Smallest standard deviation of the actions [1].
    """
    without = acting_settings(settings)
    # u = F x = (F M^-1) z; M is symmetric.
    fixed = np.asarray(np.linalg.solve(env.matrix, base_matrix(settings).T).T, dtype=np.float64)
    return Acting(
        lambda: new_module(without, seed), fixed, hyper.exploration, floor, hyper.critic_hidden
    )


def known_metrics(logger: Logger, names: dict[str, str]) -> dict[str, float]:
    """Return what the library noted, under our names, and forget it.

    An explained variance is undefined where all returns are equal; it then counts as zero.
    """
    values = {ours: float(logger.name_to_value[theirs]) for theirs, ours in names.items()}
    logger.name_to_value.clear()
    return {name: value if np.isfinite(value) else 0.0 for name, value in values.items()}


def _learner(recurrent: bool) -> tuple[Any, Any]:
    if not recurrent:
        return PPO, HistoryActorCritic
    try:
        from sb3_contrib import RecurrentPPO
    except ModuleNotFoundError as absent:
        absent.add_note('this needs sb3-contrib: pip install "railenv[train]"')
        raise
    from baselines.training.sb3_recurrent import RecurrentActorCritic

    return RecurrentPPO, RecurrentActorCritic
