"""Channels of the benchmark: how a delay is spread over actuators and over time.

Named by a kind and a delay d in milliseconds, "constant:100":

- constant: d in every channel.
- spread: d in the last channel, d/2 in the first, evenly between them.
- jitter: every command of every channel is later than d by a draw from [0, 20 ms].
- dropout: d, and every command of every channel is lost with a probability of a tenth; the actuator
  holds its last one.
"""

from dataclasses import dataclass

import numpy as np

from railenv.errors import ArgumentError, check_not_negative, check_text, unknown_name
from railenv.units import Dimensionless, FloatArray, Second

CHANNELS = ("constant", "spread", "jitter", "dropout")
"""Kinds of channels."""

JITTER: Second = 0.02
DROPOUT: Dimensionless = 0.1
_SHORTEST_SHARE = 0.5


def number_text(number: float) -> str:
    """Return a number as keys have it: short, and read back it is the same."""
    short = f"{number:g}"
    return short if float(short) == number else repr(float(number))


@dataclass(frozen=True)
class Channel:
    """A kind and a delay.

    Attributes:
        kind: One of `CHANNELS`.
        delay_ms: Delay [ms].

    Raises:
        ArgumentError: The kind does not exist or the delay is negative.
    """

    kind: str
    delay_ms: float

    def __post_init__(self) -> None:
        if self.kind not in CHANNELS:
            raise unknown_name("channel", self.kind, CHANNELS)
        # Minus zero is zero, and its key too.
        object.__setattr__(
            self, "delay_ms", check_not_negative("delay_ms", self.delay_ms, "ms") + 0.0
        )

    @staticmethod
    def of(key: str) -> "Channel":
        """Read a channel's name.

        Raises:
            ArgumentError: It is none.
        """
        kind, colon, delay = key.partition(":")
        if not colon:
            raise ArgumentError(
                f"channel {key!r} is not understood; write kind:delay in ms, as constant:100"
            )
        return Channel(kind, check_text(f"channel {key!r}: delay", delay, "ms"))

    @property
    def key(self) -> str:
        """The name, e.g. "jitter:50"."""
        return f"{self.kind}:{number_text(self.delay_ms)}"

    @property
    def delay(self) -> Second:
        """The delay [s]."""
        return self.delay_ms / 1000.0

    @property
    def jitter(self) -> Second:
        """Longest lateness of a command beyond the delay [s]."""
        return JITTER if self.kind == "jitter" else 0.0

    @property
    def dropout(self) -> Dimensionless:
        """Probability that a command is lost [1]."""
        return DROPOUT if self.kind == "dropout" else 0.0

    def delays(self, num_channels: int) -> FloatArray:
        """Return the delay of every channel, shape (channels,) [s]."""
        if self.kind != "spread" or num_channels < 2:
            return np.full(num_channels, self.delay)
        return self.delay * np.linspace(_SHORTEST_SHARE, 1.0, num_channels)
