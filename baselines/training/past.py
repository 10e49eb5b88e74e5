"""What a policy remembers while it learns on the twin: readings and actions, in torch.

The features of `baselines.policies.history`, put together from the single readings and actions, so
that back-propagation adds up small pieces and no long row of the past is copied in every period.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from baselines.policies.history import History
from railenv.errors import ArgumentError


class Past:
    """Readings and actions of every lane, as far back as a history looks.

    Args:
        history: What the policy sees.
        names: Names of the twin's readings.
        lanes: Number of lanes.
        dtype: Of the features.

    Raises:
        ArgumentError: The twin does not read a sensor, or not in the history's scale.
    """

    def __init__(
        self, history: History, names: Sequence[str], lanes: int, dtype: torch.dtype
    ) -> None:
        history.environment()
        missing = [name for name in history.sensors if name not in names]
        if missing:
            raise ArgumentError(f"sensor {missing[0]!r} is not read by the twin")
        self._history, self._shape, self._dtype = history, lanes, dtype
        columns = [list(names).index(name) for name in history.sensors]
        everything = columns == list(range(len(names)))
        self._columns = None if everything else torch.tensor(columns)
        self._depth = history.sensor_lags[-1] + 1
        self._length = history.action_lags[-1] if history.action_lags else 0
        self.forget()

    def forget(self) -> None:
        """Set everything past to zero, as before the first sample."""
        lanes, h = self._shape, self._history
        self._readings = [torch.zeros(lanes, len(h.sensors), dtype=self._dtype)] * self._depth
        self._actions = [torch.zeros(lanes, h.num_actions, dtype=self._dtype)] * self._length

    def observe(self, reading: Tensor) -> Tensor:
        """Take a reading and return the features.

        Args:
            reading: In units of the columns' scales, shape (lanes, measured).

        Returns:
            Shape (lanes, F).
        """
        seen = reading if self._columns is None else reading.index_select(1, self._columns)
        self._readings = [seen, *self._readings[:-1]]
        h = self._history
        parts = [self._readings[age] for age in h.sensor_lags]
        return torch.cat([*parts, *(self._actions[age - 1] for age in h.action_lags)], dim=1)

    def remember(self, actions: Tensor) -> None:
        """Note the actions just issued, cut already, shape (lanes, actions)."""
        if self._length:
            self._actions = [actions, *self._actions[:-1]]

    def detach(self) -> None:
        """Cut the graph and keep the numbers."""
        self._readings = [reading.detach() for reading in self._readings]
        self._actions = [action.detach() for action in self._actions]
