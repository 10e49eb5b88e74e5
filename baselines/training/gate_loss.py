"""A loss that says which gates a gated policy should have.

A gated policy learns much faster to find out a hidden delay if it is shown the delay in hindsight.
With sets of gains V_j that belong to delays d_j, the gates of a policy that knew the delay tau
would be the weights hat_j(tau) of linear interpolation between the d_j; the loss is the cross
entropy

    -sum_j hat_j(tau) log g_j,

whose minimum, at g = hat, is the entropy of the hat and not zero. While the policy drives it sees
nothing of this: the delay stays hidden.
"""

import dataclasses

import numpy as np
import torch
from torch import Tensor

from baselines.policies.gated_module import GatedModule
from baselines.policies.torch_modules import PolicyModule
from baselines.training.settings import TrainingSettings
from railenv.errors import ArgumentError
from railenv.units import FloatArray, Second


class GateLoss:
    """Cross entropy between the gates of a policy and those of the true delays.

    Args:
        module: The policy that learns.
        delays: Delays that its sets of gains belong to, rising from 0 [s].
        pause: Control periods at the start of an episode that do not count; nobody knows a delay
            before its effect is seen.

    Raises:
        ArgumentError: There is not one delay per set of gains.
    """

    def __init__(self, module: GatedModule, delays: tuple[Second, ...], pause: int) -> None:
        number = len(module.experts)
        if len(delays) != number:
            raise ArgumentError(
                f"experts has {len(delays)} delays for {number} sets of gains; give one each"
            )
        self._module, self._pause = module, pause
        self._delays = torch.tensor(delays, dtype=module.experts.dtype)
        self._knots = dataclasses.replace(module.history, told_knots=delays)
        self.begin(np.zeros(0))

    def begin(self, delay: FloatArray) -> None:
        """Begin an episode.

        Args:
            delay: True delay of every lane, shape (lanes,) [s].
        """
        dtype = self._delays.dtype
        self._true = torch.tensor(delay, dtype=dtype)
        self._wanted = torch.tensor(self._knots.hat(delay), dtype=dtype)
        self._age = 0

    def of_period(self) -> Tensor:
        """Return the cross entropy of the policy's last step, the lanes' mean; zero in the pause.

        Call it once after every step of the episode.
        """
        self._age += 1
        if self._age <= self._pause:
            return torch.zeros((), dtype=self._delays.dtype)
        return -(self._wanted * self._module.log_gates).sum(dim=1).mean()

    def delay_error(self) -> float:
        """Return how far off the last gates' mean delay is, the lanes' median [s]."""
        with torch.no_grad():
            found = self._module.log_gates.exp() @ self._delays
        return float((found - self._true).abs().median())


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
    return GateLoss(module, policy.experts, hyper.window // 2)
