"""The state of Adam as arrays, for checkpoints."""

import numpy as np
import torch

from baselines.training.method import Arrays

_MOMENTS = ("exp_avg", "exp_avg_sq")


def adam_arrays(adam: torch.optim.Adam, weights: dict[str, torch.nn.Parameter]) -> Arrays:
    """Return copies of moments and step counts; zeros before the first step, as Adam begins.

    Args:
        adam: The optimiser.
        weights: What it changes, by name.
    """
    arrays: Arrays = {}
    for name, weight in weights.items():
        known = adam.state.get(weight, {})
        for moment in _MOMENTS:
            value = known.get(moment, torch.zeros_like(weight))
            arrays[f"{moment}.{name}"] = value.detach().numpy().copy()
        arrays[f"step.{name}"] = np.array(float(known.get("step", 0.0)))
    return arrays


def set_adam(
    adam: torch.optim.Adam, weights: dict[str, torch.nn.Parameter], arrays: Arrays
) -> None:
    """Set moments and step counts to what `adam_arrays` returned."""
    for name, weight in weights.items():
        adam.state[weight] = {
            "step": torch.tensor(float(arrays[f"step.{name}"]), dtype=torch.float32),
            **{m: torch.tensor(arrays[f"{m}.{name}"], dtype=weight.dtype) for m in _MOMENTS},
        }
