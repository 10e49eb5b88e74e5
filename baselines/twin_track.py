"""What the track does to the lanes of the differentiable twin, some control periods ahead.

No action changes the track, so that its inputs are sampled by the compiled code of the environment
and their effects found for many periods in one product.
"""

import numpy as np

from railenv.envs.episodes import Episodes
from railenv.simulation.excitation import excite, excite_start
from railenv.units import FloatArray
from railenv.vehicle.suspension import NUM_TRACK

WINDOW = 32
"""Control periods sampled at a time."""


class TrackAhead:
    """Track inputs of every lane, window by window.

    Args:
        episodes: Gives tracks, vehicles and places.
        steps: Physics steps in one control period, S.
        time_step: Physics step [s].
    """

    def __init__(self, episodes: Episodes, steps: int, time_step: float) -> None:
        self._episodes, self._steps, self._time_step = episodes, steps, time_step
        lanes = len(episodes.vehicle)
        self._inputs: FloatArray = np.zeros((lanes, WINDOW * steps + 1, NUM_TRACK))
        self._active = np.ones(lanes, dtype=np.bool_)

    def start(self) -> FloatArray:
        """Return the inputs of all lanes at the start of their episodes, shape (lanes, 8)."""
        here = self._episodes
        lanes = np.arange(len(here.vehicle), dtype=np.int64)
        excite_start(
            here.track_table,
            here.places,
            here.wheels,
            here.vehicle,
            lanes,
            self._inputs,
        )
        return self._inputs[:, -1].copy()

    def window(self, periods: int) -> FloatArray:
        """Return the inputs of the coming `WINDOW` periods; windows must follow each other.

        Args:
            periods: Control periods since the start.

        Returns:
            Alignment [m] and track roll [rad] at the wheelsets at every step's start and the last
            one's end, one after the other, shape (lanes, WINDOW, 8 (S + 1)).
        """
        here = self._episodes
        excite(
            here.track_table,
            here.places,
            here.wheels,
            here.vehicle,
            np.full(len(self._active), periods * self._steps, dtype=np.int64),
            self._time_step,
            self._active,
            0,
            len(self._active),
            self._inputs,
        )
        first = self._steps * np.arange(WINDOW)[:, None]
        inside = self._inputs[:, first + np.arange(self._steps + 1)]
        return inside.reshape(len(inside), WINDOW, -1)
