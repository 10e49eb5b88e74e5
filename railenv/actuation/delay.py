"""Delay between measurement and force: the value that names it and the line that realises it.

`DelaySpec` is read by the simulator and by the stability oracle, so that both mean the same. A
command computed from the measurement at time t_k takes force in channel i at t_k + delay_i and is
held until the next one arrives. Delays are continuous: they are split into whole physics steps and
a remainder that the exact stepping honours, and never rounded.

The sampled controller's own hold (about half a control period) is not part of the delay.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from railenv.errors import ArgumentError, check_not_negative
from railenv.units import FloatArray, Second


@dataclass(frozen=True)
class DelaySpec:
    """Constant delay of the actuation channels.

    Attributes:
        delay: One delay for all channels, or one per channel [s].

    Raises:
        ArgumentError: A delay is negative or not finite, or none is given.
    """

    delay: Second | tuple[Second, ...] = 0.0

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

    def per_channel(self, num_channels: int) -> FloatArray:
        """Return the delays of all channels, shape (channels,) [s].

        Raises:
            ArgumentError: The number of delays is neither one nor `num_channels`.
        """
        if isinstance(self.delay, tuple):
            if len(self.delay) not in (1, num_channels):
                raise ArgumentError(
                    f"delay has {len(self.delay)} entries for {num_channels} channels; "
                    f"give one or {num_channels}"
                )
            return np.broadcast_to(np.array(self.delay), (num_channels,)).copy()
        return np.full(num_channels, float(self.delay))


class DelayLine:
    """Commands on their way to the actuators, for a batch of lanes.

    Attributes:
        commands: Ring of issued commands, shape (lanes, capacity, channels) [N]; command number j
            lies in slot j modulo capacity. Before the first command every slot holds zero force.
        whole_steps: Whole physics steps in each delay, shape (lanes, channels).
        remainder: What is left of each delay, in [0, time_step), shape (lanes, channels) [s].
        issued: Number of commands issued so far.

    The compiled stepping reads the line; see `railenv.simulation.stepping.arriving`.
    """

    def __init__(
        self, num_lanes: int, num_channels: int, time_step: float, steps_per_command: int
    ) -> None:
        self._time_step = time_step
        self._steps_per_command = steps_per_command
        self.issued = 0
        self.whole_steps: NDArray[np.int64] = np.zeros((num_lanes, num_channels), dtype=np.int64)
        self.remainder: FloatArray = np.zeros((num_lanes, num_channels))
        self.commands: FloatArray = np.zeros((num_lanes, 2, num_channels))

    def reset(self, delays: FloatArray) -> None:
        """Empty the line and set the delays.

        Args:
            delays: Delay of every lane and channel, shape (lanes, channels) [s], not negative.
        """
        self.whole_steps = np.floor(delays / self._time_step).astype(np.int64)
        # The quotient may round up to the next whole number: then the remainder would be negative.
        self.whole_steps -= (delays < self.whole_steps * self._time_step).astype(np.int64)
        self.remainder = np.minimum(delays - self.whole_steps * self._time_step, self._time_step)
        longest = int(self.whole_steps.max(initial=0))
        lanes, channels = delays.shape
        self.commands = np.zeros((lanes, longest // self._steps_per_command + 3, channels))
        self.issued = 0

    def issue(self, commands: FloatArray) -> None:
        """Send one command per lane and channel on its way, shape (lanes, channels) [N]."""
        self.commands[:, self.issued % self.commands.shape[1]] = commands
        self.issued += 1
