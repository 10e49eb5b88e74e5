"""SAC, TD3 and TQC: learning from a memory of transitions, by stable-baselines3 and sb3-contrib.

Haarnoja et al., ICML 2018 (arXiv:1801.01290); Fujimoto et al., ICML 2018 (arXiv:1802.09477);
Kuznetsov et al., ICML 2020 (arXiv:2005.04269). They need fewer steps of the environment than PPO,
and far more computing per step; here, where steps are cheap, that is the wrong trade, and they are
for comparison. The library's random first actions, uniform in the box, would throw the vehicle
about with 1.7 kN; exploration begins at `exploration` around the untrained policy instead.
"""

import math
from typing import Any

import numpy as np
import torch
from torch import nn

from baselines.policies.torch_modules import PolicyModule
from baselines.training.method import Arrays, Plain, episode_seed
from baselines.training.new_module import module_arrays, new_module, set_module
from baselines.training.sb3_on_policy import acting_of, known_metrics, learner_env
from baselines.training.sb3_optimiser import (
    network_arrays,
    optimiser_arrays,
    set_network,
    set_optimiser,
)
from baselines.training.sb3_policy import Actor, acting_settings, drawing, folded
from baselines.training.sb3_settings import OffPolicySettings
from baselines.training.sb3_squashed import SacPolicy, Td3Policy, TqcPolicy
from baselines.training.settings import TrainingSettings
from railenv.errors import ArgumentError

try:
    from sb3_contrib import TQC
    from stable_baselines3 import SAC, TD3
    from stable_baselines3.common.logger import Logger
    from stable_baselines3.common.noise import NormalActionNoise
    from stable_baselines3.common.type_aliases import TrainFreq, TrainFrequencyUnit
except ModuleNotFoundError as missing:
    missing.add_note('this needs stable-baselines3 and sb3-contrib: pip install "railenv[train]"')
    raise

_LEARNERS: dict[str, tuple[Any, Any]] = {
    "sac": (SAC, SacPolicy),
    "td3": (TD3, Td3Policy),
    "tqc": (TQC, TqcPolicy),
}
_MEMORY = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
_SMALLEST_DEVIATION = 0.01


class OffPolicy:
    """The method; see `baselines.training.method.Method`.

    Args:
        settings: Of the run; its hyper-parameters are `OffPolicySettings`.
        seed: Of weights, episodes and exploration.

    Attributes:
        name: "sac", "td3" or "tqc".
        steps: Lane-steps taken so far.
        env: What the learner sees.

    Raises:
        ArgumentError: The policy is recurrent, or the base is not static.
    """

    def __init__(self, settings: TrainingSettings, seed: int) -> None:
        hyper = settings.hyper
        self._hyper: OffPolicySettings = hyper
        self._settings, self._seed = settings, seed
        self.name = settings.method
        if settings.policy.kind == "recurrent":
            raise ArgumentError(
                f"method {self.name!r} does not train class = 'recurrent', as its memory holds no "
                "hidden states; use recurrent_ppo, or a network with a longer history"
            )
        self.env = learner_env(settings, hyper, seed)
        acting = acting_of(settings, hyper, self.env, seed, _SMALLEST_DEVIATION)
        learner, policy = _LEARNERS[self.name]
        with drawing(seed, 0):
            self._model: Any = learner(
                policy,
                self.env,
                learning_rate=hyper.critic_learning_rate,
                buffer_size=hyper.replay,
                learning_starts=0,
                batch_size=hyper.minibatch,
                tau=hyper.target_share,
                gamma=hyper.discount,
                n_steps=hyper.returns,
                policy_kwargs={
                    "acting": acting,
                    "net_arch": {"pi": [], "qf": list(hyper.critic_hidden)},
                    "activation_fn": nn.Tanh,
                },
                device="cpu",
                **self._own(settings.history().num_actions),
            )
        self._model.set_logger(Logger(None, []))
        self._model._update_learning_rate = self._set_rates
        _, self._callback = self._model._setup_learn(settings.steps)
        self._average = new_module(acting_settings(settings), seed)
        set_module(self._average, module_arrays(self._actor.module))
        self._updates = 0

    @classmethod
    def hyper_parameters(cls, name: str) -> type[OffPolicySettings]:  # noqa: ARG003
        """Return the dataclass of the table [method]."""
        return OffPolicySettings

    @property
    def steps(self) -> int:
        """Lane-steps taken so far."""
        return int(self._model.num_timesteps)

    @property
    def _actor(self) -> Actor:
        return self._model.policy.actor.actor

    def begin(self) -> None:
        """Start new episodes in all lanes; the memory stays, cut where the old ones stopped."""
        memory = self._model.replay_buffer
        if memory.pos or memory.full:
            memory.dones[memory.pos - 1] = memory.timeouts[memory.pos - 1] = 1.0
        self.env.seed(episode_seed(self._seed, self.name, self.steps))
        self._model._last_obs = self.env.reset()

    def update(self) -> dict[str, float]:
        """Drive all lanes for some periods, with gradient steps after each.

        Returns:
            "reward" (mean of a control period, in the environment's units), "actor_loss",
            "critic_loss", "deviation" (of the exploration [1]), and "entropy_coefficient" for SAC
            and TQC. Losses are zero before the first gradient step.
        """
        model, hyper = self._model, self._hyper
        once = TrainFreq(1, TrainFrequencyUnit.STEP)
        with drawing(self._seed, 1, self._updates):
            for _ in range(hyper.periods):
                model.collect_rollouts(
                    self.env,
                    self._callback,
                    once,
                    model.replay_buffer,
                    model.action_noise,
                    log_interval=None,
                )
                if self.steps > hyper.warm_up:
                    model.train(hyper.gradient_steps, hyper.minibatch)
        self._updates += 1
        self._follow()
        names = {"train/actor_loss": "actor_loss", "train/critic_loss": "critic_loss"}
        if self.name != "td3":
            names["train/ent_coef"] = "entropy_coefficient"
        deviation = float(self._actor.deviation().detach().exp().mean())
        known = known_metrics(model.logger, names)
        return {"reward": self.env.mean_reward(), **known, "deviation": deviation}

    def module(self) -> PolicyModule:
        """Return a copy of the policy, with the running mean of the weights."""
        return folded(self._settings, module_arrays(self._average), self.env.matrix)

    def state(self) -> tuple[Arrays, Plain]:
        """Return networks, Adam's moments, the memory, the whitening and the counters."""
        model, memory = self._model, self._model.replay_buffer
        filled = memory.buffer_size if memory.full else memory.pos
        arrays = {
            **network_arrays("policy.", model.policy),
            **network_arrays("average.", self._average),
            "matrix": self.env.matrix.copy(),
        }
        for name, optimiser in self._optimisers().items():
            arrays.update(optimiser_arrays(f"{name}.", optimiser))
        if self.name != "td3":
            arrays["log_entropy"] = model.log_ent_coef.detach().numpy().copy()
        for name in _MEMORY:
            arrays[f"memory.{name}"] = getattr(memory, name)[:filled].copy()
        plain = {"steps": self.steps, "updates": self._updates}
        plain |= {"library_updates": int(model._n_updates), "place": int(memory.pos)}
        return arrays, {**plain, "full": bool(memory.full)}

    def restore(self, arrays: Arrays, plain: Plain) -> None:
        """Go back to what `state` returned."""
        model, memory = self._model, self._model.replay_buffer
        set_network("policy.", model.policy, arrays)
        set_network("average.", self._average, arrays)
        self.env.matrix = np.array(arrays["matrix"], dtype=np.float64)
        for name, optimiser in self._optimisers().items():
            set_optimiser(f"{name}.", optimiser, arrays)
        if self.name != "td3":
            with torch.no_grad():
                model.log_ent_coef.copy_(torch.tensor(arrays["log_entropy"]))
        for name in _MEMORY:
            kept = arrays[f"memory.{name}"]
            getattr(memory, name)[: len(kept)] = kept
        memory.pos, memory.full = int(plain["place"]), bool(plain["full"])
        model.num_timesteps = int(plain["steps"])
        model._n_updates = int(plain["library_updates"])
        self._updates = int(plain["updates"])

    def _own(self, num_actions: int) -> dict[str, Any]:
        """Return what only this algorithm is told."""
        hyper = self._hyper
        if self.name == "td3":
            return {
                "action_noise": NormalActionNoise(
                    np.zeros(num_actions), np.full(num_actions, hyper.exploration)
                ),
                "target_policy_noise": hyper.exploration,
                "target_noise_clip": 2.0 * hyper.exploration,
            }
        # Entropy of a Gaussian; the squash changes it little where actions are small.
        each = 0.5 * math.log(2.0 * math.pi * math.e * hyper.target_deviation**2)
        return {"ent_coef": f"auto_{hyper.entropy!r}", "target_entropy": num_actions * each}

    def _set_rates(self, optimisers: list[torch.optim.Adam]) -> None:
        """Give the actor, which is first, a rate of its own, zero while it waits."""
        hyper = self._hyper
        own = hyper.learning_rate if self.steps > hyper.actor_after else 0.0
        for place, optimiser in enumerate(optimisers):
            rate = hyper.critic_learning_rate if place else own
            for group in optimiser.param_groups:
                group["lr"] = rate

    def _optimisers(self) -> dict[str, torch.optim.Adam]:
        policy = self._model.policy
        found = {"actor": policy.actor.optimizer, "critic": policy.critic.optimizer}
        if self.name != "td3":
            found["entropy"] = self._model.ent_coef_optimizer
        return found

    def _follow(self) -> None:
        """Bring the running mean of the weights up to date."""
        newest = dict(self._actor.module.named_parameters())
        with torch.no_grad():
            for name, mean in self._average.named_parameters():
                mean.lerp_(newest[name], 1.0 - self._hyper.averaging)
