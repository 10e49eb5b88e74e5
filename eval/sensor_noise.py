"""Noise of the sensors in a batch of runs: what a controller sees in place of the true values.

The noise is the environment's (`railenv.envs.noise`): white, Gaussian, a share of what a column
usually shows.
"""

from collections.abc import Sequence

import numpy as np

from railenv.envs.full_observation import bound_of
from railenv.envs.noise import MeasurementNoise
from railenv.errors import ArgumentError, check_count, check_not_negative
from railenv.units import FloatArray

_STREAM = 0x5E7502
"""Tells these streams apart from others of the same seed."""


class NoisyReadings:
    """Measurements of a batch of runs, as sensors with noise show them.

    Args:
        names: Measured columns: outputs or states of either vehicle.
        share: Standard deviation of the noise in units of the controlled response [1].
        streams: Whole numbers from zero up that name each lane's stream; a lane's noise follows
            from them alone, whatever the number of lanes.

    Raises:
        ArgumentError: `share` is negative or not finite, or a stream's number is none.
    """

    def __init__(
        self, names: Sequence[str], share: float, streams: Sequence[tuple[int, ...]]
    ) -> None:
        usual = np.array([usual_reading(name) for name in names], dtype=np.float64)
        deviation = check_not_negative("sensor_noise", share) * usual
        self._noise = MeasurementNoise(deviation, len(streams))
        self._streams: list[np.random.Generator] = []
        if self._noise:
            keys = [[check_count("seed", n, minimum=0) for n in numbers] for numbers in streams]
            self._streams = [np.random.Generator(np.random.PCG64([_STREAM, *k])) for k in keys]
            self._noise.draw(range(len(streams)), self._stream)

    def of(self, measured: FloatArray) -> FloatArray:
        """Return what the sensors show at the next measurement.

        Args:
            measured: True values, shape (lanes, columns), SI units.
        """
        if not self._noise:
            return measured
        self._noise.renew(self._stream)
        return measured + self._noise.take()

    def _stream(self, lane: int) -> np.random.Generator:
        return self._streams[lane]


def usual_reading(name: str) -> float:
    """Return the controlled response of a column, in its SI unit: what noise is a share of.

    Args:
        name: An output or a state of either vehicle; see `railenv.envs.observation.bound`.

    Returns:
        Zero for what has none on record: forces, the track's irregularity, and of the nonlinear
        vehicle vertical and pitch acceleration.
    """
    try:
        return bound_of(name)[2]
    except ArgumentError:
        return 0.0
