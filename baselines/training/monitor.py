"""The learning curve for TensorBoard."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from railenv.errors import ArgumentError


class Monitor:
    """Writes scalars for TensorBoard.

    Args:
        folder: Where the event files go.
        steps: Lane-steps at which the run goes on; what a killed run wrote beyond is not shown.

    Raises:
        ArgumentError: TensorBoard is not installed.
    """

    def __init__(self, folder: Path, steps: int) -> None:
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ModuleNotFoundError as missing:
            raise ArgumentError(
                f"the learning curve needs {missing.name}, which is not installed: "
                'pip install "railenv[train]"'
            ) from None
        writer: Any = SummaryWriter  # torch's hints leave the constructor untyped
        self._writer = writer(str(folder), purge_step=steps if steps else None)

    def add(self, steps: int, group: str, values: Mapping[str, float]) -> None:
        """Add numbers by name to a group of curves."""
        for name, value in values.items():
            self._writer.add_scalar(f"{group}/{name}", value, steps)

    def flush(self) -> None:
        """Write what was added."""
        self._writer.flush()

    def close(self) -> None:
        """Write and close."""
        self._writer.close()
