"""A loss that says which gates a gated policy should have.

A gated policy learns much faster to find out a hidden delay if it is shown the delay in hindsight.
With sets of gains V_j that belong to delays d_j, the gates of a policy that knew the delay tau
would be the weights hat_j(tau) of linear interpolation between the d_j; the loss is the cross
entropy

    -sum_j hat_j(tau) log g_j,

whose minimum, at g = hat, is the entropy of the hat and not zero. While the policy drives it sees
nothing of this: the delay stays hidden.

On a quiet track there is little to see the delay by, and at rest nothing. A set of gains beyond
those of the delays, the one for rest, is what the gates should choose there: a lane of amplitude
alpha (`baselines.training.quiet_lanes`) is taught the mixture of both in which that set has the
share log(alpha) / log(alpha_min), and the gates at rest are taught that set alone.
"""

import dataclasses

import numpy as np
import torch
from torch import Tensor

from baselines.policies.gated_module import GatedModule
from baselines.policies.torch_modules import PolicyModule
from baselines.training.settings import TrainingSettings
from railenv.errors import ArgumentError
from railenv.units import Dimensionless, FloatArray, Second


class GateLoss:
    """Cross entropy between the gates of a policy and those of the true delays.

    Args:
        module: The policy that learns.
        delays: Delays that its sets of gains belong to, rising from 0; if there is one set more
            than delays, the last one is for rest [s].
        quietest: Amplitude at and below which the set for rest alone is right [1].
        pause: Control periods at the start of an episode that do not count; nobody knows a delay
            before its effect is seen.

    Raises:
        ArgumentError: There is not one delay per set of gains.
    """

    def __init__(
        self,
        module: GatedModule,
        delays: tuple[Second, ...],
        pause: int,
        quietest: Dimensionless = 0.1,
    ) -> None:
        number = len(module.experts)
        if len(delays) not in (number, number - 1):
            raise ArgumentError(
                f"experts has {len(delays)} delays for {number} sets of gains; give one each, or "
                "one less for a set for rest"
            )
        self._module, self._pause, self._quietest = module, pause, quietest
        self._rests = len(delays) < number
        self._delays = torch.tensor(delays, dtype=module.experts.dtype)
        self._knots = dataclasses.replace(module.history, told_knots=delays)
        self.begin(np.zeros(0), np.zeros(0))

    def begin(self, delay: FloatArray, amplitude: FloatArray) -> None:
        """Begin an episode.

        Args:
            delay: True delay of every lane, shape (lanes,) [s].
            amplitude: Of every lane's motion, shape (lanes,) [1].
        """
        dtype = self._delays.dtype
        self._true = torch.tensor(delay, dtype=dtype)
        wanted = self._knots.hat(delay)
        if self._rests:
            quiet = np.clip(np.log(amplitude) / np.log(self._quietest), 0.0, 1.0)[:, None]
            wanted = np.hstack([(1.0 - quiet) * wanted, quiet])
        self._wanted = torch.tensor(wanted, dtype=dtype)
        self._loud = torch.tensor(amplitude == 1.0)
        self._age = 0

    def at_rest(self) -> Tensor:
        """Return the cross entropy of the gates at rest; zero without a set for rest."""
        if not self._rests:
            return torch.zeros((), dtype=self._delays.dtype)
        return -self._module.gates_at_rest()[-1]

    def of_period(self) -> Tensor:
        """Return the cross entropy of the policy's last step, the lanes' mean; zero in the pause.

        Call it once after every step of the episode.
        """
        self._age += 1
        if self._age <= self._pause:
            return torch.zeros((), dtype=self._delays.dtype)
        return -(self._wanted * self._module.log_gates).sum(dim=1).mean()

    def delay_error(self) -> float:
        """Return how far off the last gates' mean delay is, the median of the loud lanes [s]."""
        with torch.no_grad():
            gates = self._module.log_gates.exp()[self._loud, : len(self._delays)]
            found = gates @ self._delays / gates.sum(dim=1)
        return float((found - self._true[self._loud]).abs().median())


def gate_loss(module: PolicyModule, settings: TrainingSettings) -> GateLoss:
    """Return the loss of a training run; the first half window of an episode does not count.

    Args:
        module: The policy that learns.
        settings: Of the run, by the analytic policy gradient.

    Raises:
        ArgumentError: The policy is no gated one.
    """
    hyper, policy = settings.hyper, settings.policy
    if not isinstance(module, GatedModule):
        raise ArgumentError(
            f"gate_weight = {hyper.gate_weight:g} is for class = 'gated'; a policy of "
            f"class = {policy.kind!r} has no gates, leave it out"
        )
    return GateLoss(module, policy.experts, hyper.window // 2, hyper.quietest)
