"""Which loops of a policy in training the guard keeps stable.

Of every policy the loop near rest, for the told delays that it may meet. Of a gated policy, whose
delay is hidden, also the loops in motion: with the gates that are right for the delay, or for one
within an error of it.
"""

import dataclasses

import numpy as np
import torch
from torch import Tensor

from baselines.policies.gated_module import GatedModule
from baselines.policies.torch_modules import (
    PolicyModule,
    RecurrentModule,
    module_of,
    policy_of,
)
from baselines.training.settings import TrainingSettings
from baselines.training.stability_guard import GuardedDelays, StabilityGuard
from railenv.errors import ArgumentError
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle


class GuardedLoops:
    """The guard of a training run.

    Args:
        settings: Of the run, by the analytic policy gradient.
        module: The policy that learns.
        vehicle: The vehicle.
        low: Shortest delay [s].
        high: Longest delay [s].

    Raises:
        ArgumentError: The policy is recurrent.
    """

    def __init__(
        self,
        settings: TrainingSettings,
        module: PolicyModule,
        vehicle: LateralVehicle,
        low: float,
        high: float,
    ) -> None:
        hyper, environment = settings.hyper, settings.environment
        if isinstance(module, RecurrentModule):
            raise ArgumentError(
                f"growth_weight = {hyper.growth_weight:g} is not for recurrent policies, which "
                "have states near rest; give 0 or another class"
            )
        self._weight: float = hyper.growth_weight
        self._weights = dict(module.named_parameters())
        self._module = module
        error = environment.told_error if module.history.is_told else 0.0
        around = GuardedDelays(low, high, error, hyper.growth_margin, hyper.growth_looks)
        self._rest = StabilityGuard(vehicle, environment.actuator(), around)
        self._motion: StabilityGuard | None = None
        if isinstance(module, GatedModule):
            self._experts = settings.policy.experts
            near = dataclasses.replace(around, told_error=hyper.gate_error)
            self._motion = StabilityGuard(vehicle, environment.actuator(), near)

    def push(self, generator: np.random.Generator) -> float:
        """Add the guard's gradient to that of the module's weights.

        Args:
            generator: Chooses the delays.

        Returns:
            The largest growth rate that was seen [1/s].
        """
        twice = module_of(policy_of(self._module))
        history, base = twice.history, twice.base
        largest, slope = self._rest.slope(history, twice.gains_at_rest, base, generator)
        if self._motion is not None:
            assert isinstance(twice, GatedModule)
            knots = dataclasses.replace(history, told_knots=self._experts)

            def right(delay: float) -> Tensor:
                gates: FloatArray = np.zeros(len(twice.experts))
                gates[: len(self._experts)] = knots.hat(np.array([delay]))[0]
                return twice.gains_with(torch.tensor(gates))

            own, more = self._motion.slope(knots, right, base, generator)
            largest, slope = max(largest, own), slope + more
        if slope.requires_grad:
            slope.backward()
        for name, weight in twice.named_parameters():
            own_weight = self._weights[name]
            if weight.grad is not None and own_weight.grad is not None:
                own_weight.grad += (self._weight * weight.grad).to(own_weight.dtype)
        return largest

    def state(self) -> dict[str, FloatArray]:
        """Return the pairs of delays that are watched, by name."""
        pairs = {"watched": self._rest.watched.copy()}
        if self._motion is not None:
            pairs["watched_motion"] = self._motion.watched.copy()
        return pairs

    def restore(self, arrays: dict[str, FloatArray]) -> None:
        """Go back to what `state` returned."""
        self._rest.watched = arrays["watched"].copy()
        if self._motion is not None:
            self._motion.watched = arrays["watched_motion"].copy()
