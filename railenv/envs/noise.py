"""Noise of the sensors: white, Gaussian, in proportion to what a column usually shows.

Every reading of every measurement gets a number of its own, independent of all others. Lanes have
their own random streams, and what a lane draws does not depend on its neighbours. Numbers are drawn
in blocks of `AHEAD` measurements; the compiled step takes them from there.

Not known here: noise that is coloured, a bias or a drift.
"""

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from railenv.units import FloatArray

AHEAD = 64
"""Measurements for which noise is drawn at a time."""

IntArray = NDArray[np.int64]


class MeasurementNoise:
    """Noise of the coming measurements of every lane.

    Args:
        deviation: Standard deviation of every measured column, shape (measured,), in the column's
            unit; all zero for none, and then nothing is drawn.
        num_lanes: Number of lanes.

    Attributes:
        deviation: As given.
        ahead: What was drawn, shape (lanes, `AHEAD`, measured); (lanes, 0, measured) for no noise.
        row: Which of it is the next measurement's, shape (lanes,).
    """

    def __init__(self, deviation: FloatArray, num_lanes: int) -> None:
        self.deviation = deviation
        rows = AHEAD if np.any(deviation) else 0
        self.ahead = np.zeros((num_lanes, rows, len(deviation)))
        self.row: IntArray = np.zeros(num_lanes, dtype=np.int64)

    def __bool__(self) -> bool:
        """Whether there is any noise."""
        return self.ahead.shape[1] > 0

    def draw(self, lanes: Iterable[int], generator: Callable[[int], np.random.Generator]) -> None:
        """Draw a block anew for some lanes.

        Args:
            lanes: Lane numbers.
            generator: Gives a lane's random stream.
        """
        for lane in lanes:
            block = self.ahead[lane]
            generator(lane).standard_normal(out=block)
            block *= self.deviation
            self.row[lane] = 0

    def renew(
        self,
        generator: Callable[[int], np.random.Generator],
        active: NDArray[np.bool_] | None = None,
    ) -> None:
        """Draw a block anew for every lane whose block has no row left.

        Args:
            generator: Gives a lane's random stream.
            active: Lanes that measure next, shape (lanes,); None for all.
        """
        empty = self.row == self.ahead.shape[1]
        self.draw(np.flatnonzero(empty if active is None else empty & active).tolist(), generator)

    def take(self) -> FloatArray:
        """Return the noise of the next measurement of all lanes, shape (lanes, measured)."""
        found = self.ahead[np.arange(len(self.row)), self.row]
        self.row += 1
        return found
