"""Gated policies as torch modules, for training; see `baselines.policies.gated`."""

import torch
from torch import Tensor, nn

from baselines.controller import Controller
from baselines.policies.history import History
from baselines.policies.torch_modules import PolicyModule
from railenv.errors import check_count

_TO_REST = 400
_WITH_GRAPH = 20
# Steps without and with the graph. A unit that forgets slower than this is not yet at rest; it is
# judged by `GatedPolicy.gates_at_rest`, which waits.


class GatedModule(PolicyModule):
    """Sets of gains mixed by a gated recurrent unit, beside a linear path; see `GatedPolicy`.

    Args:
        history: What the policy sees.
        num_hidden: Number of units.
        num_experts: Number of sets of gains.
        base: See `PolicyModule`.
        seed: See `PolicyModule`.
        dtype: See `PolicyModule`.

    Attributes:
        experts: The gains, shape (num_experts, actions, F); zero at first.
        weight_ih, weight_hh, bias_ih, bias_hh: Arrays of the unit, as `torch.nn.GRUCell` has them.
        readout: From units to gates, shape (num_experts, num_hidden).
        readout_bias: Shape (num_experts,).
        log_gates: Logarithms of the last step's gates, shape (lanes, num_experts), for a loss that
            says which they should be.
    """

    def __init__(
        self,
        history: History,
        num_hidden: int = 48,
        num_experts: int = 8,
        *,
        base: Controller | None = None,
        seed: int = 0,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        super().__init__(history, base=base, seed=seed, dtype=dtype)
        self.num_hidden = units = check_count("num_hidden", num_hidden)
        number = check_count("num_experts", num_experts)
        inputs = history.num_features + int(history.is_told)
        gains = (number, history.num_actions, history.num_features)
        self.experts = nn.Parameter(torch.zeros(gains, dtype=dtype))
        self.weight_ih = nn.Parameter(self._random(3 * units, inputs))
        self.weight_hh = nn.Parameter(self._random(3 * units, units))
        self.bias_ih = nn.Parameter(torch.zeros(3 * units, dtype=dtype))
        self.bias_hh = nn.Parameter(torch.zeros(3 * units, dtype=dtype))
        self.readout = nn.Parameter(self._random(number, units))
        self.readout_bias = nn.Parameter(torch.zeros(number, dtype=dtype))
        self.log_gates = torch.zeros((0, number), dtype=dtype)

    def gates_at_rest(self, told: float = 0.0) -> Tensor:
        """Return the logarithms of the gates at rest, with the graph, shape (experts,).

        The graph goes back through the last steps of the unit on its way to rest; before them it
        has forgotten.

        Args:
            told: Told delay [s].
        """
        dtype = self.weights.dtype
        given = torch.tensor([told], dtype=dtype)
        inputs = self._with_told(torch.zeros((1, self.history.num_features), dtype=dtype), given)
        hidden = self.initial_hidden(1, given)
        with torch.no_grad():
            for _ in range(_TO_REST):
                hidden = self._advanced(inputs, hidden)
        for _ in range(_WITH_GRAPH):
            hidden = self._advanced(inputs, hidden)
        return self._log_gates(hidden)[0]

    def gains_at_rest(self, told: float) -> Tensor:
        """See `PolicyModule.gains_at_rest`; with the gates at rest."""
        return self.gains_with(self.gates_at_rest(told).exp(), told)

    def gains_with(self, gates: Tensor, told: float = 0.0) -> Tensor:
        """Return the gains of fixed gates, with the graph, shape (actions, F) [1].

        Args:
            gates: Shape (experts,) [1].
            told: Told delay [s].
        """
        mixed = torch.tensordot(gates.to(self.experts.dtype), self.experts, dims=1)
        return super().gains_at_rest(told) + mixed

    def _beside(
        self, features: Tensor, told: Tensor, hidden: Tensor
    ) -> tuple[Tensor | None, Tensor]:
        after = self._advanced(self._with_told(features, told), hidden)
        self.log_gates = self._log_gates(after)
        number, actions, _ = self.experts.shape
        each = features @ self.experts.reshape(number * actions, -1).T
        mixed = each.reshape(-1, number, actions) * self.log_gates.exp()[:, :, None]
        return mixed.sum(dim=1), after

    def _advanced(self, inputs: Tensor, hidden: Tensor) -> Tensor:
        units = self.num_hidden
        given = inputs @ self.weight_ih.T + self.bias_ih
        kept = hidden @ self.weight_hh.T + self.bias_hh
        reset = torch.sigmoid(given[:, :units] + kept[:, :units])
        update = torch.sigmoid(given[:, units : 2 * units] + kept[:, units : 2 * units])
        new = torch.tanh(given[:, 2 * units :] + reset * kept[:, 2 * units :])
        return (1.0 - update) * new + update * hidden

    def _log_gates(self, hidden: Tensor) -> Tensor:
        return torch.log_softmax(hidden @ self.readout.T + self.readout_bias, dim=1)
