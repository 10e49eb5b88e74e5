"""Imitation of an undelayed expert under delay (DIDA: Liotet, Maran, Bisi, Restelli, ICML 2022).

The expert (`baselines.training.expert`) knows the vehicle's state and acts on it at once. What a
delayed policy issues at t_k acts at t_k + tau; what the expert would want then is known afterwards,
and is the label: the policy learns by least squares to issue what will be wanted when it arrives.
The labels hold at the control samples at which commands arrive, so that delays are whole numbers of
control periods here and nothing is interpolated.

The best law in that sense is the conditional mean of the label. For a linear vehicle, Gaussian
track and noise it is the gain on the predicted state, that is the delay-aware LQG (`baselines.lqg`)
by the separation principle (Astrom 1970, chapter 8), as far as the history that the policy sees
holds what the Kalman filter knows. The labels come from the model: the method is not model-free.

Rounds follow DAgger (Ross, Gordon, Bagnell, AISTATS 2011): the policy as it stands drives, every
sample is added to all before, and the policy is fitted anew. At first the expert made causal drives
(`UndelayedExpert.command`), in every later round in a smaller share of the lanes. Small random
actions on top tell apart what the policy's own actions do.
"""

from dataclasses import replace
from functools import partial

import numpy as np
import torch

from baselines.policies.torch_modules import PolicyModule
from baselines.training.adam_state import adam_arrays, set_adam
from baselines.training.expert import UndelayedExpert
from baselines.training.imitation_round import Round
from baselines.training.imitation_settings import ImitationSettings
from baselines.training.least_squares import ScheduledLeastSquares
from baselines.training.method import Arrays, Plain, episode_seed
from baselines.training.new_module import module_arrays, new_module, set_module
from baselines.training.past import Past
from baselines.training.replay import Replay
from baselines.training.settings import TrainingSettings
from baselines.training.told_draws import DelayLaw
from baselines.training.training_twin import TrainingTwin
from railenv.errors import ArgumentError

_SUMS = ("same", "across", "answers")


def linear_part(settings: TrainingSettings, effort: float) -> TrainingSettings:
    """Return settings that imitate the expert with the linear path of a policy alone.

    Args:
        settings: Of a run by another method, whose law of delays is taken over.
        effort: Of the expert [(m/s^2)^2].

    Raises:
        ArgumentError: The policy has a base.
    """
    policy = settings.policy
    if policy.base:
        raise ArgumentError(
            f"base = {policy.base!r} and imitation_rounds do not go together: imitation finds the "
            "whole law; leave one out"
        )
    return settings.replace(
        method=Imitation.name,
        policy=replace(policy, kind="linear", hidden=()),
        hyper=ImitationSettings(
            effort=effort,
            exact_share=settings.hyper.exact_share,
            shortest_share=settings.hyper.shortest_share,
            longest_share=settings.hyper.longest_share,
        ),
    )


class Imitation:
    """The method; see `baselines.training.method.Method`.

    Attributes:
        name: "imitation".
        steps: Lane-steps taken so far.

    Raises:
        ArgumentError: The policy is recurrent or has a base, or the environment has what the expert
            does not know.
    """

    name = "imitation"

    def __init__(self, settings: TrainingSettings, seed: int) -> None:
        hyper = settings.hyper
        self._hyper: ImitationSettings = hyper
        self._seed, self._history = seed, settings.history()
        if settings.policy.kind == "recurrent" or settings.policy.base:
            raise ArgumentError(
                "imitation fits a linear or network policy without a base; train a recurrent or "
                'residual one with name = "apg"'
            )
        self._delays = DelayLaw.of(
            settings.environment, hyper.exact_share, hyper.shortest_share, hyper.longest_share
        )
        period = self._history.control_period
        if hyper.run_in + self._delays.high / period >= hyper.periods:
            raise ArgumentError(
                f"periods = {hyper.periods} leaves nothing to learn from after run_in and the "
                "longest delay; give more"
            )
        environment = replace(settings.environment, episode_seconds=hyper.periods * period)
        self._twin = TrainingTwin(hyper.lanes, environment, torch.float64)
        self._past = Past(self._history, self._twin.observation_names, hyper.lanes, torch.float64)
        self._expert = UndelayedExpert(
            self._twin.vehicle, environment, self._history, hyper.effort, hyper.preview
        )
        self._fresh = partial(new_module, settings, seed, torch.float64)
        self._module = self._fresh()
        h = self._history
        self._sums = ScheduledLeastSquares(h.num_knots, h.num_actions, h.num_features)
        self._network = {
            name: weight for name, weight in self._module.named_parameters() if name != "weights"
        }
        self._adam = torch.optim.Adam(
            self._network.values() or [self._module.weights], lr=hyper.learning_rate
        )
        self._replay = Replay(hyper.replay if self._network else 0, h.num_features, h.num_actions)
        self.steps = 0

    @classmethod
    def hyper_parameters(cls, name: str) -> type[ImitationSettings]:  # noqa: ARG003
        """Return the dataclass of the table [method]."""
        return ImitationSettings

    def begin(self) -> None:
        """Nothing to do: every round begins new episodes, seeded by `steps`."""

    def update(self) -> dict[str, float]:
        """Run one round and fit the policy anew.

        Returns:
            "mismatch" (root mean square of policy minus label over that of the label, on this
            round, before the fit; zero while the expert drives all lanes), "weighted_acceleration"
            (root mean square of the median lane [m/s^2]), "worst_lane" [m/s^2], "expert_share",
            "ended" (lanes that diverged or left the gauge) and "samples" (in all rounds).
        """
        hyper = self._hyper
        generator = np.random.default_rng([self._seed, self.steps])
        number = self.steps // (hyper.lanes * hyper.periods)
        seen = self._drive(generator, hyper.expert_share**number)
        hat = self._history.hat(seen.told)
        wrong, size = 0.0, 0.0
        for lane in range(hyper.lanes):
            used, label = seen.samples(lane, hyper.run_in)
            self._sums.add(seen.features[lane, used], hat[lane], label)
            if seen.driven[lane]:
                wrong += float(np.sum((seen.own[lane, used] - label) ** 2))
                size += float(np.sum(label**2))
            self._replay.offer(seen.features[lane, used], seen.told[lane], label)
        if self._sums.samples:
            gains = self._sums.solve(hyper.ridge)
            with torch.no_grad():
                self._module.weights.copy_(torch.from_numpy(gains))
        self._replay.settle(generator)
        self._fit_network(generator)
        self.steps += hyper.lanes * hyper.periods
        rms = np.sqrt(seen.power)
        return {
            "mismatch": float(np.sqrt(wrong / size)) if size else 0.0,
            "weighted_acceleration": float(np.median(rms)),
            "worst_lane": float(rms.max()),
            "expert_share": 1.0 - float(seen.driven.mean()),
            "ended": float(np.sum(seen.lasted < hyper.periods)),
            "samples": float(self._sums.samples),
        }

    def _drive(self, generator: np.random.Generator, expert_share: float) -> Round:
        """Run one episode in all lanes."""
        hyper, history, twin = self._hyper, self._history, self._twin
        lanes, periods = hyper.lanes, hyper.periods
        delay, told = self._delays.draw(lanes, generator, history.control_period)
        driven = generator.random(lanes) >= expert_share
        late = np.rint(delay / history.control_period).astype(np.int64)
        features = np.empty((lanes, periods, history.num_features), dtype=np.float32)
        wanted = np.empty((lanes, periods, history.num_actions))
        own, power, lasted = np.empty_like(wanted), np.zeros(lanes), np.zeros(lanes, dtype=int)
        self._expert.start(late)
        self._past.forget()
        with torch.no_grad():
            reading = twin.start(episode_seed(self._seed, self.name, self.steps), delay)
            told_tensor = torch.from_numpy(told)
            hidden = self._module.initial_hidden(lanes, told_tensor)
            for k in range(periods):
                wanted[:, k] = self._expert.see(twin.known())
                x = self._past.observe(reading)
                action, hidden = self._module(x, told_tensor, hidden)
                features[:, k], own[:, k] = x.numpy(), action.numpy()
                issued = own[:, k].copy()
                if not driven.all():
                    issued[~driven] = self._expert.command()[~driven]
                issued += hyper.exploration * generator.standard_normal(issued.shape)
                # The box of the environment; labels and features know what was really issued.
                issued = np.clip(issued, -1.0, 1.0)
                sent = torch.from_numpy(issued)
                self._past.remember(sent)
                reading, ends = twin.advance(sent)
                lasted += ~twin.ended
                power += ends.mean(dim=1).numpy() / periods
                self._expert.go_on(issued)
        return Round(features, wanted, own, late, told, driven, lasted, power)

    def _fit_network(self, generator: np.random.Generator) -> None:
        """Fit what stands beside the linear path to what that leaves, by Adam."""
        if not self._network or not len(self._replay):
            return
        for _ in range(self._hyper.batches):
            x, told, label = self._replay.batch(self._hyper.batch, generator)
            action, _ = self._module(x, told)
            loss = (action - label).square().mean()
            self._adam.zero_grad()
            loss.backward()
            self._adam.step()

    def module(self) -> PolicyModule:
        """Return a copy of the policy."""
        copy = self._fresh()
        set_module(copy, module_arrays(self._module))
        return copy

    def state(self) -> tuple[Arrays, Plain]:
        """Return the sums, the weights, the samples kept and Adam's moments."""
        arrays = {f"weights.{k}": v for k, v in module_arrays(self._module).items()}
        arrays.update({f"sums.{name}": getattr(self._sums, name).copy() for name in _SUMS})
        arrays.update(self._replay.arrays())
        arrays.update(adam_arrays(self._adam, self._network))
        return arrays, {"steps": self.steps, "samples": self._sums.samples}

    def restore(self, arrays: Arrays, plain: Plain) -> None:
        """Go back to what `state` returned."""
        weights = {k[8:]: v for k, v in arrays.items() if k.startswith("weights.")}
        set_module(self._module, weights)
        for name in _SUMS:
            setattr(self._sums, name, np.array(arrays[f"sums.{name}"]))
        self._replay.restore(arrays)
        set_adam(self._adam, self._network, arrays)
        self.steps, self._sums.samples = int(plain["steps"]), int(plain["samples"])
