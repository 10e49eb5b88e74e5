"""Delay that varies within a run: commands that are late, commands and measurements that get lost.

What varies is that of `railenv.actuation.DelaySpec`, here for every lane on its own, and it means
what it means in the environments: a command is later than its channel's constant delay by a draw
from [0, jitter], independent of all others and, unless jitter is common, of the other channels'; it
is lost with probability dropout, and then the actuator holds its last one; a measurement is lost
with probability sensor_dropout, and then the controller sees the last one again, with its noise.

Every lane draws from a stream of its own, so that its draws depend on its seed alone. They are
taken in the environments' order: per control period what each channel is late, which command is
lost, and whether the measurement at the period's end is.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from railenv.actuation import DelaySpec
from railenv.errors import ArgumentError, check_count
from railenv.units import FloatArray

IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

_STREAM = 0x7A2D1E
"""Tells these streams apart from others of the same seed."""

_BLOCK = 64
"""Control periods that are drawn at a time; the draws do not depend on it."""


@dataclass(frozen=True, eq=False)
class VaryingDelay:
    """What varies in the channels of a batch of lanes.

    A number in the place of an array holds for all lanes.

    Attributes:
        seeds: Seed of every lane's stream; equal seeds are equal draws, shape (lanes,).
        jitter: Longest time by which a command is later than its delay, shape (lanes,) [s].
        dropout: Probability that a command is lost, in [0, 1), shape (lanes,) [1].
        sensor_dropout: Probability that a measurement is lost, in [0, 1), shape (lanes,) [1].
        common_jitter: Whether all channels of a lane share the draw.

    Raises:
        ArgumentError: An array has the wrong shape, a jitter is negative or not finite, a
            probability is not in [0, 1), or a seed is no whole number from zero up.
    """

    seeds: IntArray | Sequence[int]
    jitter: FloatArray | float = 0.0
    dropout: FloatArray | float = 0.0
    sensor_dropout: FloatArray | float = 0.0
    common_jitter: bool = False

    def __post_init__(self) -> None:
        if np.ndim(self.seeds) != 1 or len(self.seeds) == 0:
            raise ArgumentError(f"seeds = {self.seeds!r:.60} must hold one whole number per lane")
        seeds = tuple(check_count("seeds", seed, minimum=0) for seed in self.seeds)
        object.__setattr__(self, "seeds", seeds)
        for name in ("jitter", "dropout", "sensor_dropout"):
            # The value that DelaySpec takes for one channel is what a lane may have.
            given = _per_lane(name, getattr(self, name), len(seeds))
            for value in given.tolist():
                DelaySpec(**{name: value})
            given.flags.writeable = False
            object.__setattr__(self, name, given)

    @staticmethod
    def of(spec: DelaySpec, seeds: IntArray | Sequence[int]) -> "VaryingDelay":
        """Return what varies in a `DelaySpec`, alike in all lanes.

        Args:
            spec: Its constant delays are not read: see `DelaySpec.per_channel`.
            seeds: Seed of every lane's stream, shape (lanes,).
        """
        return VaryingDelay(
            seeds, spec.jitter, spec.dropout, spec.sensor_dropout, spec.common_jitter
        )

    @property
    def num_lanes(self) -> int:
        """Number of lanes."""
        return len(self.seeds)

    @property
    def longest_jitter(self) -> float:
        """Longest jitter of all lanes [s]."""
        return float(np.max(self.jitter))


class ChannelDraws:
    """What varies, from one control period of a batch of lanes to the next.

    Args:
        channel: What varies; None for nothing.
        num_lanes: Number of lanes.
        num_channels: Actuator channels.

    Attributes:
        later: What the commands of this period are late, shape (lanes, channels) [s]; None for
            nothing.
        lost: Which of them are lost, shape (lanes, channels); None for none.

    Raises:
        ArgumentError: `channel` is for another number of lanes.
    """

    def __init__(self, channel: VaryingDelay | None, num_lanes: int, num_channels: int) -> None:
        if channel is not None and channel.num_lanes != num_lanes:
            raise ArgumentError(
                f"channel is for {channel.num_lanes} lanes and there are {num_lanes}; "
                "give one seed per lane"
            )
        self._channel = channel
        self.later: FloatArray | None = None
        self.lost: BoolArray | None = None
        self._reading_lost: BoolArray | None = None
        self._reading: FloatArray | None = None
        self._streams = [
            np.random.Generator(np.random.PCG64([_STREAM, int(seed)]))
            for seed in (() if channel is None else channel.seeds)
        ]
        self._uniform: FloatArray = np.zeros((len(self._streams), _BLOCK, 2 * num_channels + 1))
        self._period = 0

    @property
    def longest_jitter(self) -> float:
        """Longest time by which a command can be late [s]."""
        return 0.0 if self._channel is None else self._channel.longest_jitter

    def renew(self) -> None:
        """Draw for the coming control period."""
        channel = self._channel
        if channel is None:
            return
        place = self._period % _BLOCK
        if place == 0:
            for lane, stream in enumerate(self._streams):
                self._uniform[lane] = stream.random(self._uniform.shape[1:])
        self._period += 1
        here = self._uniform[:, place]
        channels = here.shape[1] // 2
        late = here[:, :channels]
        if channel.common_jitter:
            late = np.broadcast_to(late[:, :1], late.shape)
        jitter, dropout, sensor_dropout = (
            np.asarray(each) for each in (channel.jitter, channel.dropout, channel.sensor_dropout)
        )
        self.later = jitter[:, None] * late
        self.lost = here[:, channels:-1] < dropout[:, None]
        self._reading_lost = here[:, -1] < sensor_dropout

    def seen(self, readings: FloatArray) -> FloatArray:
        """Return what the controller sees at the end of this period, once per period.

        Before the first `renew` it is the measurement at the start, which is never lost.

        Args:
            readings: What the sensors show now, shape (lanes, columns), SI units.
        """
        if self._channel is None:
            return readings
        if self._reading is None or self._reading_lost is None:
            self._reading = readings.copy()
        else:
            self._reading = np.where(self._reading_lost[:, None], self._reading, readings)
        return self._reading.copy()


def _per_lane(name: str, value: FloatArray | float, num_lanes: int) -> FloatArray:
    """Return a new array of one number per lane."""
    given = np.asarray(value)
    if given.dtype.kind not in "fiu" or given.shape not in ((), (num_lanes,)):
        raise ArgumentError(
            f"{name} of shape {given.shape} and type {given.dtype} must be one number, or "
            f"{num_lanes}, one per lane"
        )
    return np.array(np.broadcast_to(given, (num_lanes,)), dtype=np.float64)
