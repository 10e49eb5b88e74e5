"""From what an episode's delays are drawn."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from railenv.actuation import DelaySpec
from railenv.errors import ArgumentError, check_not_negative
from railenv.units import FloatArray

if TYPE_CHECKING:
    from railenv.envs.settings import EnvSettings

_ALSO_IN_SPEC = ("sensor_delay", "jitter", "common_jitter", "dropout", "sensor_dropout")


@dataclass(frozen=True, eq=False)
class DelayDraw:
    """Ranges of an episode's delays, and what varies within the episode.

    Attributes:
        low: Shortest delay of each channel from controller to force, shape (channels,) [s].
        high: Longest one, shape (channels,) [s].
        sensor: (low, high) of the sensors' share [s].
        per_channel: Whether every channel has its own draw.
        varying: Jitter and dropouts.
        told_error: Largest error of the told delay [s].
    """

    low: FloatArray
    high: FloatArray
    sensor: tuple[float, float]
    per_channel: bool
    varying: DelaySpec
    told_error: float

    @staticmethod
    def of(settings: EnvSettings, channels: int) -> DelayDraw:
        """Read and check the settings that have to do with delay.

        Raises:
            ArgumentError: A value is out of range, upside down, given twice, or the longest delay
                is above `max_delay`.
        """
        given = settings.delay
        if isinstance(given, DelaySpec):
            for name in (*_ALSO_IN_SPEC, "delay_per_channel"):
                if getattr(settings, name):
                    raise ArgumentError(
                        f"{name} = {getattr(settings, name)!r} is given beside a DelaySpec; say "
                        "everything in the DelaySpec, or nothing"
                    )
            spec = given
            fixed = replace(given, sensor_delay=0.0).per_channel(channels)
            low, high, sensor = fixed, fixed, (given.sensor_delay, given.sensor_delay)
        else:
            shortest, longest = _pair("delay", given)
            low, high = np.full(channels, shortest), np.full(channels, longest)
            sensor = _pair("sensor_delay", settings.sensor_delay)
            spec = DelaySpec(
                jitter=settings.jitter,
                common_jitter=settings.common_jitter,
                dropout=settings.dropout,
                sensor_dropout=settings.sensor_dropout,
            )
        check_longest(float(high.max()) + sensor[1] + spec.jitter, settings.max_delay)
        return DelayDraw(
            low, high, sensor, settings.delay_per_channel, spec, float(settings.told_error)
        )

    @property
    def channels_differ(self) -> bool:
        """Whether channels can have different delays."""
        return self.per_channel or bool(np.ptp(self.low) or np.ptp(self.high))


def check_longest(longest: float, allowed: float) -> None:
    """Check the sum of all parts of a delay against `max_delay`.

    Raises:
        ArgumentError: It is above; what rounding adds to a sum of parts does not count.
    """
    if longest > allowed * (1.0 + 1e-12):
        raise ArgumentError(
            f"delay = {longest:g} s in all (sensors, actuation and jitter) is above max_delay = "
            f"{allowed:g} s; raise max_delay"
        )


def _pair(name: str, value: Any) -> tuple[float, float]:
    if isinstance(value, tuple | list):
        if len(value) != 2:  # pyright: ignore[reportUnknownArgumentType]
            raise ArgumentError(
                f"{name} = {value!r} is no (low, high) range; for one delay per channel "
                "give DelaySpec((...))"
            )
        low, high = (check_not_negative(name, v, "seconds") for v in value)  # pyright: ignore
        if low > high:
            raise ArgumentError(f"{name} = ({low:g}, {high:g}) is upside down; give (low, high)")
        return low, high
    fixed = check_not_negative(name, value, "seconds")
    return fixed, fixed
