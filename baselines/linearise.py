"""A linear network as a gain: PyTorch layers that together are one matrix.

Only layers that are linear whatever their input are taken: Linear, Identity, Flatten over one
dimension, and Sequential of them, nested or not. Their product is formed in double precision.
A constant action (a bias) shifts the equilibrium and not its stability; a gain cannot hold it, so
that it is refused unless it is zero.
"""

from typing import Any

import numpy as np

from baselines.controller import LinearFeedback
from railenv.envs.observation import DEFAULT_ACTION_SCALE, sensor_names
from railenv.errors import ArgumentError
from railenv.units import FloatArray
from railenv.vehicle.coordinates import parse_layout

_TAKEN = "Linear, Identity, Flatten and Sequential of them"


def network_matrix(network: Any) -> FloatArray:
    """Return the matrix W of a linear network, actions = W @ observation.

    Args:
        network: A torch module.

    Returns:
        W, shape (outputs, inputs).

    Raises:
        ArgumentError: The network is not linear (the message names the first layer that is not),
            has no layer with weights, or a bias that is not zero.
    """
    from torch import nn

    if not isinstance(network, nn.Module):
        raise ArgumentError(f"network is a {type(network).__name__}; give a torch module")
    matrix: FloatArray | None = None
    constant: FloatArray = np.zeros(0)
    source = ""
    for name, layer in _layers("network", network, nn):
        weight = _numbers(f"{name}.weight", layer.weight)
        if matrix is not None and weight.shape[1] != matrix.shape[0]:
            raise ArgumentError(
                f"{name} takes {weight.shape[1]} inputs and is given {matrix.shape[0]}; "
                "the layers do not fit together"
            )
        constant = np.zeros(weight.shape[0]) if matrix is None else weight @ constant
        if layer.bias is not None:
            bias = _numbers(f"{name}.bias", layer.bias)
            source = source or (name if np.any(bias) else "")
            constant = constant + bias
        matrix = weight if matrix is None else weight @ matrix
    if matrix is None:
        raise ArgumentError("network has no Linear layer; give one with weights")
    if np.any(constant):
        raise ArgumentError(
            f"network has a constant action (up to {np.abs(constant).max():.3g}, first bias in "
            f"{source}), which a gain cannot hold; set the biases to zero (the stability is the "
            "same) or train with bias=False"
        )
    return matrix


def linearise(
    network: Any,
    layout: object,
    sensors: tuple[str, ...] | None = None,
    action_scale: float = DEFAULT_ACTION_SCALE,
) -> LinearFeedback:
    """Turn a linear network into linear feedback, for the oracle and for saving.

    Args:
        network: A torch module from sensor readings in SI units to actions; see the module's text.
        layout: "passive", 2 or 4.
        sensors: What its inputs are; the standard sensors of the layout unless given.
        action_scale: Force of an action of one [N].

    Returns:
        The feedback u = -gain @ y with gain = -action_scale * W.

    Raises:
        ArgumentError: The network is not linear or does not have one input per sensor and one
            output per actuator.
    """
    matrix = network_matrix(network)
    names = sensor_names(parse_layout(layout)) if sensors is None else tuple(sensors)
    if matrix.shape[1] != len(names):
        raise ArgumentError(
            f"network has {matrix.shape[1]} inputs and there are {len(names)} sensors; name the "
            "sensor of each input (past actions are no sensors: they make the law dynamic)"
        )
    return LinearFeedback(-action_scale * matrix, names, layout, action_scale)


def _layers(name: str, module: Any, nn: Any) -> list[tuple[str, Any]]:
    """Return the Linear layers in their order, or name the first layer that is not linear."""
    for hooks in ("_forward_hooks", "_forward_pre_hooks"):
        if getattr(module, hooks, None):
            raise ArgumentError(f"{name} has a forward hook, which may change it; remove the hook")
    kind = type(module)
    if kind is nn.Linear:
        return [(name, module)]
    if kind is nn.Identity or (
        kind is nn.Flatten and (module.start_dim, module.end_dim) == (1, -1)
    ):
        return []
    if kind is nn.Sequential:
        found: list[tuple[str, Any]] = []
        for part, child in module.named_children():
            found += _layers(f"{name}.{part}", child, nn)
        return found
    raise ArgumentError(
        f"{name} is a {kind.__name__}, which is not known to be linear; give {_TAKEN}"
    )


def _numbers(name: str, tensor: Any) -> FloatArray:
    if tensor.is_complex() or not tensor.is_floating_point():
        raise ArgumentError(f"{name} has type {tensor.dtype}; give real weights")
    values = tensor.detach().double().cpu().numpy()
    if not np.all(np.isfinite(values)):
        raise ArgumentError(
            f"{name} holds a value that is not finite; every weight must be a number"
        )
    return values
