"""Analytic policy gradient: back-propagation through the differentiable twin.

The loss is a function of the weights like any other, so that its gradient is exact, not estimated
from returns (Wiedemann et al., ICRA 2023; Xu et al., ICLR 2022, for windows cut off one another).
It differentiates the model of the vehicle: this method is not model-free.

One update is one episode of all lanes: vehicles running under control, on new tracks and with new
delays, over some windows in a row. State and memory go on from window to window, the graph is cut
between them; so slow instabilities, which one window does not show, grow until they do. The loss of
a window is

    mean over lanes of log(p + soft^2) + effort_weight * mean square action,
    p = (1 - w) (p_front + p_rear) / 2 + w max(p_front, p_rear),   w = worse_end_weight,

with p_front and p_rear the mean squares of the ride-filtered acceleration of the floor ends over
the window. By the logarithm a lane with a long delay, which nobody can make smooth, counts as much
as one without delay; the ride index, too, is a power of p. A gated policy can be shown its delays
in hindsight besides: gate_weight times the cross entropy of `baselines.training.gate_loss`.
"""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from baselines.policies.gated_module import GatedModule
from baselines.policies.torch_modules import PolicyModule
from baselines.training.adam_state import adam_arrays, set_adam
from baselines.training.apg_settings import ApgSettings
from baselines.training.gate_loss import gate_loss
from baselines.training.guarded_loops import GuardedLoops
from baselines.training.imitation import Imitation, linear_part
from baselines.training.method import Arrays, Plain, episode_seed
from baselines.training.new_module import module_arrays, new_module, set_module
from baselines.training.past import Past
from baselines.training.quiet_lanes import QuietLanes
from baselines.training.settings import TrainingSettings
from baselines.training.told_draws import DelayLaw
from baselines.training.training_twin import TrainingTwin
from railenv.errors import ArgumentError

_GAINS = ("weights", "experts")
_GUARD, _QUIET = 1, 2
# Tell the random streams of the guard and of the amplitudes from that of the delays.


class AnalyticPolicyGradient:
    """The method; see `baselines.training.method.Method`.

    Args:
        settings: Of the run; its hyper-parameters are `ApgSettings`.
        seed: Of weights and episodes.
        dtype: `torch.float32`; `torch.float64` for checks.

    Attributes:
        name: "apg".
        steps: Lane-steps taken so far.

    Raises:
        ArgumentError: The environment's delays are no plain range, the policy's base is not
            static, or the policy is a gated one and imitation is asked for, or it is none and has
            a gate_weight, or it is recurrent and has a growth_weight.
    """

    name = "apg"

    def __init__(
        self, settings: TrainingSettings, seed: int, dtype: torch.dtype = torch.float32
    ) -> None:
        hyper = settings.hyper
        self._hyper: ApgSettings = hyper
        self._settings = settings
        self._budget, self._seed, self._dtype = settings.steps, seed, dtype
        self._delays = DelayLaw.of(
            settings.environment,
            hyper.exact_share,
            hyper.shortest_share,
            hyper.longest_share,
            hyper.edge_share,
        )
        history = settings.history()
        periods = hyper.window * hyper.windows_per_episode
        environment = replace(
            settings.environment, episode_seconds=periods * settings.environment.control_period
        )
        self._twin = TrainingTwin(hyper.lanes, environment, dtype)
        self._past = Past(history, self._twin.observation_names, hyper.lanes, dtype)
        self._module = new_module(settings, seed, dtype)
        if hyper.imitation_rounds:
            self._check_imitation()
        self._average = new_module(settings, seed, dtype)
        self._fresh = partial(new_module, settings, seed, dtype)
        self._weights = dict(self._module.named_parameters())
        self._adam = torch.optim.Adam(self._groups(), lr=hyper.learning_rate)
        self._gates = gate_loss(self._module, settings) if hyper.gate_weight > 0.0 else None
        self._gate_row = [0.0, 0.0]
        self._quiet = QuietLanes(hyper.quiet_share, hyper.quietest)
        self._guard: GuardedLoops | None = None
        if hyper.growth_weight > 0.0:
            d, vehicle = self._delays, self._twin.vehicle
            self._guard = GuardedLoops(settings, self._module, vehicle, d.low, d.high)
        self.steps = 0

    def _check_imitation(self) -> None:
        if isinstance(self._module, GatedModule):
            raise ArgumentError(
                "imitation_rounds give a linear path its weights, and the gains of a gated policy "
                "are not in it; set imitation_rounds = 0"
            )
        linear_part(self._settings, self._hyper.imitation_effort)

    def _groups(self) -> list[dict[str, Any]]:
        """The weights in groups that share a learning rate, "share" times that of the gains."""
        split: dict[float, list[torch.nn.Parameter]] = {}
        for name, weight in self._weights.items():
            share = 1.0 if name in _GAINS else self._hyper.unit_rate
            split.setdefault(share, []).append(weight)
        return [{"params": weights, "share": share} for share, weights in split.items()]

    @classmethod
    def hyper_parameters(cls, name: str) -> type[ApgSettings]:  # noqa: ARG003
        """Return the dataclass of the table [method]."""
        return ApgSettings

    def begin(self) -> None:
        """Nothing to do: every update begins new episodes, seeded by `steps`."""

    def update(self) -> dict[str, float]:
        """Run one episode in all lanes, with one step of Adam per window.

        The first one begins with the rounds of imitation, if there are any.

        Returns:
            Means over the windows: "loss", "weighted_acceleration" (root mean square of the lanes'
            median [m/s^2]), "worst_lane" (largest of all windows [m/s^2]), "effort" (mean square
            action), "gradient" (norm before it is shortened); "ended" (lanes that diverged or left
            the gauge), "skipped" (windows whose gradient was not finite), "largest_growth" (that
            the guard saw [1/s]; 0 without one) and "learning_rate". With a gate_weight also
            "gate_entropy" (cross entropy of the gates) and "delay_error" (of the delay that they
            say at the end of a window, the lanes' median [s]).
        """
        hyper, seen = self._hyper, list[list[float]]()
        if self.steps == 0 and hyper.imitation_rounds:
            self._imitate()
        self.start_episode()
        for _ in range(hyper.windows_per_episode):
            for group in self._adam.param_groups:
                group["lr"] = group["share"] * hyper.rate(self.steps / self._budget)
            loss, power, effort = self.window_loss()
            self._adam.zero_grad()
            loss.backward()
            growth = 0.0
            if self._guard is not None:
                stream = np.random.default_rng([self._seed, self.steps, _GUARD])
                growth = self._guard.push(stream)
            norm = torch.nn.utils.clip_grad_norm_(self._weights.values(), hyper.gradient_norm)
            usable = bool(torch.isfinite(norm))
            if usable:
                self._adam.step()
                self._follow()
            self.steps += hyper.window * hyper.lanes
            size = power.detach().mean(dim=1).sqrt()
            row = (loss.detach(), size.median(), size.max(), effort)
            gradient = float(norm) if usable else 0.0
            whole = [*(float(value) for value in row), gradient, float(not usable), growth]
            seen.append(whole + self._gate_row)
            self._cut()
        table = np.array(seen)
        mean = table.mean(axis=0).tolist()
        return {
            "loss": mean[0],
            "weighted_acceleration": mean[1],
            "worst_lane": float(table[:, 2].max()),
            "effort": mean[3],
            "gradient": mean[4],
            "ended": float(self._twin.ended.sum()),
            "skipped": float(table[:, 5].sum()),
            "largest_growth": float(table[:, 6].max()),
            "learning_rate": hyper.rate(self.steps / self._budget),
            **({} if self._gates is None else {"gate_entropy": mean[7], "delay_error": mean[8]}),
        }

    def _imitate(self) -> None:
        """Give the linear path the weights that imitation finds."""
        teacher = Imitation(linear_part(self._settings, self._hyper.imitation_effort), self._seed)
        for _ in range(self._hyper.imitation_rounds):
            teacher.update()
        self.steps = teacher.steps
        found = module_arrays(teacher.module())
        for module in (self._module, self._average):
            set_module(module, {**module_arrays(module), **found})

    def start_episode(self) -> None:
        """Begin the episode that belongs to `steps`: tracks, delays and what is told."""
        number = episode_seed(self._seed, "apg", self.steps)
        generator = np.random.default_rng([self._seed, self.steps])
        delay, told = self._delays.draw(self._hyper.lanes, generator)
        self._reading = self._twin.start(number, delay)
        self._told = torch.tensor(told, dtype=self._dtype)
        self._past.forget()
        stream = np.random.default_rng([self._seed, self.steps, _QUIET])
        amplitude = self._quiet.draw(self._hyper.lanes, stream)
        self._amplitude = torch.tensor(amplitude, dtype=self._dtype)[:, None]
        if self._gates is not None:
            self._gates.begin(delay, amplitude)
        with torch.no_grad():
            self._hidden = self._module.initial_hidden(self._hyper.lanes, self._told)

    def window_loss(self) -> tuple[Tensor, Tensor, Tensor]:
        """Run one window, with the graph.

        Returns:
            The loss, the mean square ride-filtered acceleration of each floor end, front first,
            shape (lanes, 2) [(m/s^2)^2], and the mean square action [1].
        """
        hyper = self._hyper
        power, effort, entropy = (torch.zeros((), dtype=self._dtype) for _ in range(3))
        for _ in range(hyper.window):
            features = self._past.observe(self._reading)
            seen = features * self._amplitude
            action, self._hidden = self._module(seen, self._told, self._hidden)
            if self._gates is not None:
                entropy = entropy + self._gates.of_period() / hyper.window
            action = action.clamp(-1.0, 1.0) / self._amplitude
            self._past.remember(action)
            self._reading, ends = self._twin.advance(action)
            power = power + ends / hyper.window
            effort = effort + action.square().mean() / hyper.window
        both = power.mean(dim=1)
        cost = both + hyper.worse_end_weight * (power.amax(dim=1) - both)
        loss = torch.log(cost + hyper.soft**2).mean() + hyper.effort_weight * effort
        if self._gates is not None:
            loss = loss + hyper.gate_weight * (entropy + self._gates.at_rest())
            self._gate_row = [float(entropy.detach()), self._gates.delay_error()]
        return loss, power, effort.detach()

    def _cut(self) -> None:
        """Keep state, memory and hidden state, and cut the graph."""
        self._reading = self._twin.detach()
        self._past.detach()
        self._hidden = self._hidden.detach()

    def _follow(self) -> None:
        """Bring the running mean of the weights up to date."""
        share = 1.0 - self._hyper.averaging
        with torch.no_grad():
            for name, mean in self._average.named_parameters():
                mean.lerp_(self._weights[name], share)

    def module(self) -> PolicyModule:
        """Return a copy of the policy, with the running mean of the weights."""
        copy = self._fresh()
        set_module(copy, module_arrays(self._average))
        return copy

    def state(self) -> tuple[Arrays, Plain]:
        """Return weights, their running mean, Adam's moments and the steps taken."""
        arrays = {f"weights.{k}": v for k, v in module_arrays(self._module).items()}
        arrays.update({f"average.{k}": v for k, v in module_arrays(self._average).items()})
        arrays.update(adam_arrays(self._adam, self._weights))
        if self._guard is not None:
            arrays.update(self._guard.state())
        return arrays, {"steps": self.steps}

    def restore(self, arrays: Arrays, plain: Plain) -> None:
        """Go back to what `state` returned."""
        for prefix, module in (("weights.", self._module), ("average.", self._average)):
            own = {k[len(prefix) :]: v for k, v in arrays.items() if k.startswith(prefix)}
            set_module(module, own)
        set_adam(self._adam, self._weights, arrays)
        if self._guard is not None:
            self._guard.restore(arrays)
        self.steps = int(plain["steps"])
