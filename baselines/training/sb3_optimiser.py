"""Networks and optimisers of stable-baselines3 as plain arrays, and back: no pickle.

Moments of Adam are kept by group and place in it, which is the order in which it was given them.
"""

import torch
from torch import nn

from baselines.training.adam_state import adam_arrays, set_adam
from baselines.training.method import Arrays


def network_arrays(prefix: str, network: nn.Module) -> Arrays:
    """Return copies of all weights and buffers of a network, by `prefix` and name."""
    return {f"{prefix}{k}": v.detach().numpy().copy() for k, v in network.state_dict().items()}


def set_network(prefix: str, network: nn.Module, arrays: Arrays) -> None:
    """Set a network to what `network_arrays` returned, bit for bit."""
    own = {k[len(prefix) :]: torch.tensor(v) for k, v in arrays.items() if k.startswith(prefix)}
    network.load_state_dict(own)


def optimiser_arrays(prefix: str, adam: torch.optim.Adam) -> Arrays:
    """Return copies of Adam's moments and step counts, by `prefix`, group and place in it."""
    return {f"{prefix}{k}": v for k, v in adam_arrays(adam, _weights(adam)).items()}


def set_optimiser(prefix: str, adam: torch.optim.Adam, arrays: Arrays) -> None:
    """Set Adam to what `optimiser_arrays` returned."""
    own = {k[len(prefix) :]: v for k, v in arrays.items() if k.startswith(prefix)}
    set_adam(adam, _weights(adam), own)


def _weights(adam: torch.optim.Adam) -> dict[str, nn.Parameter]:
    return {
        f"{g}.{k}": weight
        for g, group in enumerate(adam.param_groups)
        for k, weight in enumerate(group["params"])
    }
