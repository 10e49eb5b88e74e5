"""The policies as torch modules, for training; the numbers are those of the numpy classes.

`forward(features, told, hidden)` gives the actions before the cut, the base's included, and the
next hidden state; lanes first. What it is given are the features of the `History` (for instance
`observation[:, history.columns(names)]`), and the told delay in seconds. A base must be static and
read sensors of the history: it then is a constant matrix of the features.
"""

from itertools import pairwise
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from baselines.controller import Controller
from baselines.policies.base_law import BaseLaw
from baselines.policies.gated import GatedPolicy
from baselines.policies.history import History
from baselines.policies.linear import LinearPolicy
from baselines.policies.network import NetworkPolicy
from baselines.policies.policy import TOLD_UNIT, HistoryPolicy
from baselines.policies.recurrent import RecurrentPolicy
from railenv.errors import ArgumentError, check_count
from railenv.units import FloatArray


class PolicyModule(nn.Module):
    """What all modules share: the linear path, zero at first, and the base.

    Args:
        history: What the policy sees.
        base: Static classical law whose action is added; None for none.
        seed: Seed of the first weights of what is not linear.
        dtype: `torch.float32` or `torch.float64`.

    Attributes:
        history: As given.
        base: As given.
        weights: Gains of the linear path, shape (knots, actions, F).
        num_hidden: Length of the hidden state; 0 for none.

    Raises:
        ArgumentError: The base has states, or reads what is no sensor of the history.
    """

    num_hidden = 0

    def __init__(
        self,
        history: History,
        *,
        base: Controller | None = None,
        seed: int = 0,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        super().__init__()
        self.history = history
        self.base = base
        self.seed = check_count("seed", seed, minimum=0)
        shape = (history.num_knots, history.num_actions, history.num_features)
        self.weights = nn.Parameter(torch.zeros(shape, dtype=dtype))
        fixed = None if base is None else BaseLaw(base, history).static_weights()
        if base is not None and fixed is None:
            raise ArgumentError(
                f"base {type(base).__name__} has states or reads what is no sensor of the history, "
                "and cannot be trained upon; give a static law, or add its sensors to the history"
            )
        self._fixed: Tensor | None
        self.register_buffer(
            "_fixed", None if fixed is None else torch.tensor(fixed, dtype=dtype), persistent=False
        )
        knots = torch.tensor(history.told_knots, dtype=dtype)
        self._knots: Tensor
        self.register_buffer("_knots", knots, persistent=False)

    def initial_hidden(self, lanes: int, told: Tensor) -> Tensor:
        """Return the hidden state at rest, shape (lanes, num_hidden): zeros.

        Args:
            lanes: Number of lanes.
            told: Told delay of every lane, shape (lanes,) [s].
        """
        return torch.zeros((lanes, self.num_hidden), dtype=told.dtype, device=told.device)

    def forward(
        self, features: Tensor, told: Tensor, hidden: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Return the actions before the cut, shape (lanes, actions), and the next hidden state.

        Args:
            features: Shape (lanes, F).
            told: Told delay, shape (lanes,) [s]; of no effect if the policy is not told.
            hidden: Hidden state, shape (lanes, num_hidden); that at rest unless given.
        """
        before = self.initial_hidden(len(features), features[:, 0]) if hidden is None else hidden
        extra, after = self._beside(features, told, before)
        actions = self._linear(features, told)
        if extra is not None:
            actions = actions + extra
        if self._fixed is not None:
            actions = actions + features @ self._fixed.T
        return actions, after

    def hat(self, told: Tensor) -> Tensor:
        """Return the weights of the knots, shape (lanes, knots); see `History.hat`."""
        knots = self._knots
        if len(knots) < 2:
            return torch.ones((len(told), 1), dtype=self.weights.dtype, device=told.device)
        inside = told.to(knots.dtype).clamp(knots[0], knots[-1]).contiguous()
        lower = (torch.searchsorted(knots, inside) - 1).clamp(0, len(knots) - 2)
        share = (inside - knots[lower]) / (knots[lower + 1] - knots[lower])
        weights = torch.zeros((len(told), len(knots)), dtype=knots.dtype, device=told.device)
        weights = weights.scatter(1, lower[:, None], (1.0 - share)[:, None])
        return weights.scatter(1, lower[:, None] + 1, share[:, None])

    def gains_at_rest(self, told: float) -> Tensor:
        """Return the gains of the features near rest, with the graph, shape (actions, F) [1].

        The base is not among them.

        Args:
            told: Told delay [s].

        Raises:
            ArgumentError: The policy near rest has states of its own.
        """
        share = self.hat(torch.tensor([told], dtype=self.weights.dtype))[0]
        return torch.tensordot(share, self.weights, dims=1)

    def _linear(self, features: Tensor, told: Tensor) -> Tensor:
        knots, actions, _ = self.weights.shape
        each = features @ self.weights.reshape(knots * actions, -1).T
        if knots == 1:
            return each
        return (each.reshape(-1, knots, actions) * self.hat(told)[:, :, None]).sum(dim=1)

    def _beside(
        self, _features: Tensor, _told: Tensor, hidden: Tensor
    ) -> tuple[Tensor | None, Tensor]:
        """Return what is added to the linear path, None for nothing, and the next hidden state."""
        return None, hidden

    def _with_told(self, features: Tensor, told: Tensor) -> Tensor:
        """Return the inputs of a network: the features, and the told delay in its unit."""
        if not self.history.is_told:
            return features
        return torch.cat([features, (told.to(features.dtype) / TOLD_UNIT)[:, None]], dim=1)

    def _random(self, *shape: int) -> Tensor:
        """Return first weights: uniform in +-1/sqrt(columns), from a generator of their own."""
        generator = np.random.default_rng([self.seed, len(list(self.parameters())), *shape])
        reach = 1.0 / np.sqrt(shape[-1])
        values = generator.uniform(-reach, reach, shape)
        return torch.tensor(values, dtype=self.weights.dtype)


class LinearModule(PolicyModule):
    """Gains of the features, interpolated in the told delay; see `LinearPolicy`."""


class NetworkModule(PolicyModule):
    """A linear path and a feed-forward network beside it; see `NetworkPolicy`.

    Args:
        history: What the policy sees.
        widths: Number of units of each hidden layer.
        base, seed, dtype: See `PolicyModule`.

    Attributes:
        layers: The layers; the last one begins at zero.
    """

    def __init__(
        self,
        history: History,
        widths: tuple[int, ...] = (64, 64),
        *,
        base: Controller | None = None,
        seed: int = 0,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        super().__init__(history, base=base, seed=seed, dtype=dtype)
        inputs = history.num_features + int(history.is_told)
        sizes = [inputs, *(check_count("widths", w) for w in widths), history.num_actions]
        self.layers = nn.ModuleList()
        for columns, rows in pairwise(sizes):
            layer = nn.Linear(columns, rows, dtype=dtype)
            with torch.no_grad():
                layer.weight.copy_(self._random(rows, columns))
                layer.bias.zero_()
            self.layers.append(layer)
        with torch.no_grad():
            self.layers[-1].weight.zero_()  # pyright: ignore

    def _network(self, inputs: Tensor) -> Tensor:
        for layer in self.layers[:-1]:
            inputs = torch.tanh(layer(inputs))
        return self.layers[-1](inputs)

    def gains_at_rest(self, told: float) -> Tensor:
        """See `PolicyModule.gains_at_rest`; the network's Jacobian at zero features is added."""
        width = self.history.num_features
        none = torch.zeros((1, width), dtype=self.weights.dtype)
        value = self._with_told(none, torch.tensor([told], dtype=self.weights.dtype))
        slope = torch.eye(value.shape[1], dtype=value.dtype)[:, :width]
        for layer in self.layers[:-1]:
            value = torch.tanh(layer(value))
            weight: Tensor = layer.weight  # pyright: ignore
            slope = (1.0 - value[0].square())[:, None] * (weight @ slope)
        last: Tensor = self.layers[-1].weight  # pyright: ignore
        return super().gains_at_rest(told) + last @ slope

    def _beside(
        self, features: Tensor, told: Tensor, hidden: Tensor
    ) -> tuple[Tensor | None, Tensor]:
        rest = self._network(self._with_told(torch.zeros_like(features), told))
        return self._network(self._with_told(features, told)) - rest, hidden


class RecurrentModule(PolicyModule):
    """A linear path and a gated recurrent unit beside it; see `RecurrentPolicy`.

    Args:
        history: What the policy sees.
        num_hidden: Number of units.
        base, seed, dtype: See `PolicyModule`.

    Attributes:
        weight_ih, weight_hh, bias_ih, bias_hh: Arrays of the unit, as `torch.nn.GRUCell` has them.
        readout: From units to actions, shape (actions, num_hidden); zero at first.
    """

    def __init__(
        self,
        history: History,
        num_hidden: int = 32,
        *,
        base: Controller | None = None,
        seed: int = 0,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        super().__init__(history, base=base, seed=seed, dtype=dtype)
        self.num_hidden = check_count("num_hidden", num_hidden)
        inputs, units = history.num_features + int(history.is_told), self.num_hidden
        self.weight_ih = nn.Parameter(self._random(3 * units, inputs))
        self.weight_hh = nn.Parameter(self._random(3 * units, units))
        self.bias_ih = nn.Parameter(torch.zeros(3 * units, dtype=dtype))
        self.bias_hh = nn.Parameter(torch.zeros(3 * units, dtype=dtype))
        self.readout = nn.Parameter(torch.zeros((history.num_actions, units), dtype=dtype))

    def gains_at_rest(self, told: float) -> Tensor:  # noqa: ARG002
        """Refuse: the unit is a state of the policy near rest, too."""
        raise ArgumentError(
            "a recurrent policy has states near rest, and no gains of its features alone"
        )

    def _beside(
        self, features: Tensor, told: Tensor, hidden: Tensor
    ) -> tuple[Tensor | None, Tensor]:
        units = self.num_hidden
        given = self._with_told(features, told) @ self.weight_ih.T + self.bias_ih
        rest = self._with_told(torch.zeros_like(features), told) @ self.weight_ih.T + self.bias_ih
        kept = hidden @ self.weight_hh.T + self.bias_hh
        reset = torch.sigmoid(given[:, :units] + kept[:, :units])
        update = torch.sigmoid(given[:, units : 2 * units] + kept[:, units : 2 * units])
        new = torch.tanh(given[:, 2 * units :] + reset * kept[:, 2 * units :])
        rest_reset = torch.sigmoid(rest[:, :units] + self.bias_hh[:units])
        rest_new = torch.tanh(rest[:, 2 * units :] + rest_reset * self.bias_hh[2 * units :])
        after = (1.0 - update) * (new - rest_new) + update * hidden
        return after @ self.readout.T, after


def module_of(policy: HistoryPolicy, dtype: torch.dtype = torch.float64) -> PolicyModule:
    """Return a policy as a module with the same numbers.

    Args:
        policy: The policy.
        dtype: Type of the module's weights; float64 holds the policy's exactly.

    Raises:
        ArgumentError: The class is another one, or the base cannot be trained upon.
    """
    history, given = policy.history, {"base": policy.base, "dtype": dtype}
    values: dict[str, FloatArray] = {"weights": policy.weights}
    if isinstance(policy, LinearPolicy):
        module: PolicyModule = LinearModule(history, **given)
    elif isinstance(policy, NetworkPolicy):
        widths = tuple(len(bias) for _, bias in policy.layers[:-1])
        module = NetworkModule(history, widths, **given)
        for k, (weight, bias) in enumerate(policy.layers):
            values |= {f"layers.{k}.weight": weight, f"layers.{k}.bias": bias}
    elif isinstance(policy, RecurrentPolicy):
        module = RecurrentModule(history, policy.readout.shape[1], **given)
        values |= {name: getattr(policy, name) for name in policy.arrays}
    elif isinstance(policy, GatedPolicy):
        # That module imports this one.
        from baselines.policies.gated_module import GatedModule

        module = GatedModule(history, policy.readout.shape[1], len(policy.readout), **given)
        values |= {name: getattr(policy, name) for name in policy.arrays}
    else:
        raise ArgumentError(f"policy {type(policy).__name__} has no module")
    module.load_state_dict({k: torch.tensor(v, dtype=dtype) for k, v in values.items()})
    return module


def policy_of(module: PolicyModule) -> HistoryPolicy:
    """Return a module as a policy, in double precision.

    Raises:
        ArgumentError: The class is another one, or a weight is not finite.
    """
    history, base = module.history, module.base
    weights = _array(module.weights)
    if isinstance(module, NetworkModule):
        layers: list[Any] = [(_array(each.weight), _array(each.bias)) for each in module.layers]
        return NetworkPolicy(history, weights, layers, base=base)
    if isinstance(module, LinearModule):
        return LinearPolicy(history, weights, base=base)
    kinds = {"RecurrentModule": RecurrentPolicy, "GatedModule": GatedPolicy}
    if type(module).__name__ in kinds:
        kind: Any = kinds[type(module).__name__]
        return kind(
            history, weights, **{n: _array(getattr(module, n)) for n in kind.arrays}, base=base
        )
    raise ArgumentError(f"module {type(module).__name__} has no policy")


def _array(tensor: Any) -> FloatArray:
    return tensor.detach().cpu().double().numpy().copy()
