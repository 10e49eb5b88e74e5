"""Recorded runs: named signals over time for every lane, and their file.

A file is a NumPy archive without pickled objects: one array per signal, plus time, plus the
settings of the run as JSON text.
"""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from railenv.errors import unknown_name
from railenv.files import replacing
from railenv.units import FloatArray


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Signals of a batch of runs.

    Attributes:
        time: Instants, shape (steps,) [s].
        names: Signal names.
        values: Shape (lanes, steps, signals), SI units.
        settings: What was run, plain values only.
    """

    time: FloatArray
    names: tuple[str, ...]
    values: FloatArray
    settings: dict[str, Any] = field(default_factory=dict[str, Any])

    def signal(self, name: str) -> FloatArray:
        """Return one signal of all lanes, shape (lanes, steps).

        Raises:
            ArgumentError: No signal has that name.
        """
        if name not in self.names:
            raise unknown_name("signal", name, self.names)
        return self.values[:, :, self.names.index(name)]

    @property
    def sample_rate(self) -> float:
        """Samples per second [Hz]."""
        return (len(self.time) - 1) / float(self.time[-1] - self.time[0])

    def save(self, path: Path) -> None:
        """Write the trajectory to a `.npz` file; an existing file is replaced as a whole or kept.

        Raises:
            OutputError: The file cannot be written.
        """
        arrays = {name: self.signal(name) for name in self.names}
        with replacing(path) as stream:
            np.savez_compressed(
                stream,
                allow_pickle=False,
                time=self.time,
                settings=np.array(json.dumps(self.settings)),
                **arrays,
            )
