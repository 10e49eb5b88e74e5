"""Delay between measurement and force: the value that names it.

A command computed from the measurement at time t_k takes force in channel i at t_k + delay_i and is
held until the next one arrives. Simulator and stability oracle read the same value, so that both
mean the same. Delays are continuous and never rounded.

The delay has two parts, that of the sensors (measurement to controller) and that of the actuation
(controller to force). In the loop only their sum counts: simulation and environment run on the
clock of the measurements, and a command takes force by the sum after the measurement it answers.

The sampled controller's own hold (about half a control period) is not part of the delay.
`railenv.actuation.delay_line` realises it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from railenv.errors import ArgumentError, check_not_negative
from railenv.units import Dimensionless, FloatArray, Second


@dataclass(frozen=True)
class DelaySpec:
    """Delay of the actuation channels and how it varies.

    Attributes:
        delay: Controller to force, one for all channels or one per channel [s].
        sensor_delay: Measurement to controller, added to every channel [s].
        jitter: Each command is later by a draw from [0, jitter] [s], as the oracle's `jitter`.
        common_jitter: Whether all channels share the draw.
        dropout: Probability that a command is lost; the actuator holds its last one [1].
        sensor_dropout: Probability that a measurement is lost; the controller sees the last [1].

    Raises:
        ArgumentError: A time is negative or not finite, no delay is given, or a probability is
            not in [0, 1).
    """

    delay: Second | tuple[Second, ...] = 0.0
    sensor_delay: Second = 0.0
    jitter: Second = 0.0
    common_jitter: bool = False
    dropout: Dimensionless = 0.0
    sensor_dropout: Dimensionless = 0.0

    def __post_init__(self) -> None:
        if isinstance(self.delay, str):
            raise ArgumentError(f"delay = {self.delay!r} is not a number; give seconds")
        if isinstance(self.delay, Sequence) or np.ndim(self.delay) == 1:
            given = cast("Sequence[float]", self.delay)
            values = tuple(check_not_negative("delay", d, "seconds") for d in given)
            if not values:
                raise ArgumentError("delay is empty; give one value or one per channel")
            object.__setattr__(self, "delay", values)
        else:
            object.__setattr__(self, "delay", check_not_negative("delay", self.delay, "seconds"))
        for name in ("sensor_delay", "jitter"):
            value = check_not_negative(name, getattr(self, name), "seconds")
            object.__setattr__(self, name, value)
        for name in ("dropout", "sensor_dropout"):
            value = check_not_negative(name, getattr(self, name))
            if value >= 1.0:
                raise ArgumentError(
                    f"{name} = {value:g} must be below 1: something has to arrive; give a "
                    "probability in [0, 1)"
                )
            object.__setattr__(self, name, value)

    def per_channel(self, num_channels: int) -> FloatArray:
        """Return the delays from measurement to force without jitter, shape (channels,) [s].

        Raises:
            ArgumentError: The number of delays is neither one nor `num_channels`.
        """
        if isinstance(self.delay, tuple):
            if len(self.delay) not in (1, num_channels):
                raise ArgumentError(
                    f"delay has {len(self.delay)} entries for {num_channels} channels; "
                    f"give one or {num_channels}"
                )
            return np.broadcast_to(np.array(self.delay), (num_channels,)) + self.sensor_delay
        return np.full(num_channels, float(self.delay) + self.sensor_delay)

    @property
    def longest(self) -> Second:
        """Longest time from measurement to force, jitter included [s]."""
        delay = max(self.delay) if isinstance(self.delay, tuple) else self.delay
        return delay + self.sensor_delay + self.jitter
