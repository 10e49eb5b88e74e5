"""The policy that a run begins with, and its weights as arrays."""

import numpy as np
import torch
from numpy.typing import NDArray

from baselines.policies.gated_module import GatedModule
from baselines.policies.torch_modules import (
    LinearModule,
    NetworkModule,
    PolicyModule,
    RecurrentModule,
)
from baselines.registry import make_controller
from baselines.training.method import Arrays
from baselines.training.settings import TrainingSettings


def new_module(
    settings: TrainingSettings, seed: int, dtype: torch.dtype = torch.float32
) -> PolicyModule:
    """Return the module of the table [policy] with its first weights.

    Args:
        settings: Of the run; a base that is designed for a vehicle gets that of the environment.
        seed: Seed of the weights.
        dtype: Type of the weights.

    Raises:
        ArgumentError: The base does not exist, or cannot be trained upon.
    """
    policy, history, environment = settings.policy, settings.history(), settings.environment
    base = None
    if policy.base:
        base = make_controller(
            policy.base, policy.layout, environment.vehicle, environment.speed_kmh
        )
    if policy.kind == "network":
        return NetworkModule(history, policy.hidden, base=base, seed=seed, dtype=dtype)
    if policy.kind == "recurrent":
        return RecurrentModule(history, policy.hidden[0], base=base, seed=seed, dtype=dtype)
    if policy.kind == "gated":
        units, number = policy.hidden[0], len(policy.experts) + int(policy.rest_expert)
        return GatedModule(history, units, number, base=base, seed=seed, dtype=dtype)
    return LinearModule(history, base=base, seed=seed, dtype=dtype)


def module_arrays(module: torch.nn.Module) -> Arrays:
    """Return copies of a module's weights by name."""
    return {name: weight.detach().cpu().numpy().copy() for name, weight in _weights(module).items()}


def set_module(module: torch.nn.Module, arrays: Arrays) -> None:
    """Set a module's weights to what `module_arrays` returned."""
    with torch.no_grad():
        for name, weight in _weights(module).items():
            value: NDArray[np.float64] = arrays[name]
            weight.copy_(torch.tensor(value))


def _weights(module: torch.nn.Module) -> dict[str, torch.nn.Parameter]:
    return dict(module.named_parameters())
