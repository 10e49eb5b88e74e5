"""What a round of imitation has shown: features, and what the expert wanted when."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from railenv.units import FloatArray


@dataclass(frozen=True, eq=False)
class Round:
    """What one round has shown.

    Attributes:
        features: Shape (lanes, periods, F).
        wanted: What the expert wants to act in each period, shape (lanes, periods, actions) [1].
        own: What the policy would issue, before the cut, shape (lanes, periods, actions) [1].
        late: Delay of each lane in control periods, shape (lanes,).
        told: Told delay, shape (lanes,) [s].
        driven: Lanes that the policy drove, shape (lanes,).
        lasted: Periods of each lane until it diverged or left the gauge, if it did, (lanes,).
        power: Mean square ride-filtered acceleration of both ends, (lanes,) [(m/s^2)^2].
    """

    features: NDArray[np.float32]
    wanted: FloatArray
    own: FloatArray
    late: NDArray[np.int64]
    told: FloatArray
    driven: NDArray[np.bool_]
    lasted: NDArray[np.int64]
    power: FloatArray

    def samples(self, lane: int, first: int) -> tuple[slice, FloatArray]:
        """Return which periods of a lane are samples, and their labels.

        Args:
            lane: The lane.
            first: First period to learn from.
        """
        late = int(self.late[lane])
        last = max(first, int(self.lasted[lane]) - late)
        return slice(first, last), self.wanted[lane, first + late : last + late]
