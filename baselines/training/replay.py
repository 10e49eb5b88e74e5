"""Samples that a network learns from: a random choice of all that was seen, of limited size."""

import numpy as np
import torch
from torch import Tensor

from baselines.training.least_squares import AnyFloats
from baselines.training.method import Arrays
from railenv.units import FloatArray

_NAMES = ("features", "told", "labels")


class Replay:
    """Samples of all rounds.

    Args:
        most: How many are kept; 0 for none at all.
        features: Number of features F.
        actions: Number of actions A.
    """

    def __init__(self, most: int, features: int, actions: int) -> None:
        self._most = most
        self._kept = {
            "features": np.zeros((0, features), dtype=np.float32),
            "told": np.zeros(0, dtype=np.float32),
            "labels": np.zeros((0, actions), dtype=np.float32),
        }
        self._offered: list[dict[str, FloatArray]] = []

    def __len__(self) -> int:
        return len(self._kept["told"])

    def offer(self, features: AnyFloats, told: float, labels: FloatArray) -> None:
        """Bring the samples of one lane, from which `settle` chooses."""
        if self._most:
            given = {
                "features": features,
                "told": np.full(len(features), told),
                "labels": labels,
            }
            self._offered.append(given)

    def settle(self, generator: np.random.Generator) -> None:
        """Keep a random choice of the old samples and the new: half of what fits for each."""
        if not self._offered:
            return
        new = {
            name: np.concatenate([part[name] for part in self._offered], dtype=np.float32)
            for name in _NAMES
        }
        self._offered = []
        room = self._most if not len(self) else self._most // 2
        old_room = self._most - min(room, len(new["told"]))
        for samples, limit in ((self._kept, old_room), (new, room)):
            count = len(samples["told"])
            chosen = np.sort(generator.permutation(count)[: min(limit, count)])
            for name in _NAMES:
                samples[name] = samples[name][chosen]
        self._kept = {name: np.concatenate([self._kept[name], new[name]]) for name in _NAMES}

    def batch(self, size: int, generator: np.random.Generator) -> tuple[Tensor, Tensor, Tensor]:
        """Return features, told delays and labels of random samples, in double precision."""
        chosen = generator.integers(len(self), size=size)
        x, told, labels = (
            torch.tensor(self._kept[name][chosen], dtype=torch.float64) for name in _NAMES
        )
        return x, told, labels

    def arrays(self) -> Arrays:
        """Return copies of all samples, for a checkpoint."""
        return {f"replay.{name}": values.copy() for name, values in self._kept.items()}

    def restore(self, arrays: Arrays) -> None:
        """Go back to what `arrays` returned."""
        self._kept = {name: np.array(arrays[f"replay.{name}"]) for name in _NAMES}
        self._offered = []
