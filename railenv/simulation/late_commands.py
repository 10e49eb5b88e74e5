"""Delays of a batch of lanes: what is asked of them, and what varies from command to command.

A command takes force by its channel's constant delay after the measurement it answers, later by a
time of its own, or never where it gets lost; see `railenv.actuation.delay_line`. Who draws those
times is not known here.
"""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from railenv.errors import ArgumentError, check_not_negative
from railenv.units import FloatArray

LONGEST_DELAY = 1000.0
"""Longest delay that is simulated [s]; its commands must be stored."""


class Commanded(Protocol):
    """Lanes that take commands; see `railenv.simulation.batch.VehicleBatch`."""

    commands: FloatArray
    later: FloatArray
    lost: NDArray[np.bool_]


def checked_delays(delays: FloatArray, num_channels: int, longest_jitter: float) -> float:
    """Return the longest time from a measurement to its force, for which there must be room [s].

    Args:
        delays: Delay of every lane and channel, shape (lanes, channels) [s].
        num_channels: Actuator channels.
        longest_jitter: What a command may be late beyond its delay [s].

    Raises:
        ArgumentError: The delays have the wrong shape, or a time is negative, not finite or too
            long.
    """
    if delays.ndim != 2 or delays.shape[1] != num_channels or delays.shape[0] == 0:
        raise ArgumentError(f"delays has shape {delays.shape}; it must be (lanes, {num_channels})")
    if not np.all((delays >= 0.0) & (delays <= LONGEST_DELAY)):
        raise ArgumentError(
            "delays holds a value that is negative, not finite or above "
            f"{LONGEST_DELAY:g} s; give seconds"
        )
    jitter = check_not_negative("longest_jitter", longest_jitter, "seconds")
    longest = float(delays.max(initial=0.0)) + jitter
    if longest > LONGEST_DELAY:
        raise ArgumentError(
            f"longest_jitter = {jitter:g} s makes a delay of {longest:g} s, above "
            f"{LONGEST_DELAY:g} s; give less"
        )
    return longest


def send(
    batch: Commanded,
    commands: FloatArray,
    later: FloatArray | None,
    lost: NDArray[np.bool_] | None,
    longest_jitter: float,
) -> None:
    """Write the commands of the coming period, what they are late, and which of them get lost.

    Args:
        batch: The lanes; changed.
        commands: Wanted forces, before the limits, shape (lanes, channels) [N].
        later: What each is late beyond its delay, shape (lanes, channels) [s]; None for nothing.
        lost: Which of them get lost, shape (lanes, channels); None for none.
        longest_jitter: What there is room for in the delay line [s].

    Raises:
        ArgumentError: An array has the wrong shape or type, or a value is out of its range; nothing
            has been written then.
    """
    shape = batch.commands.shape
    if commands.shape != shape:
        raise ArgumentError(f"commands has shape {commands.shape}; it must be {shape}")
    if not np.all(np.isfinite(commands)):
        raise ArgumentError("commands holds a value that is not finite; give newtons")
    if later is not None:
        if later.shape != shape:
            raise ArgumentError(f"later has shape {later.shape}; it must be {shape}")
        if not np.all((later >= 0.0) & (later <= longest_jitter)):
            raise ArgumentError(
                "later holds a value that is negative, not finite or above longest_jitter = "
                f"{longest_jitter:g} s; give seconds, and the longest of all to reset"
            )
    if lost is not None and (lost.shape != shape or lost.dtype != np.bool_):
        raise ArgumentError(
            f"lost has shape {lost.shape} and type {lost.dtype}; it must be {shape} of bool"
        )
    batch.commands[:] = commands
    batch.later[:] = 0.0 if later is None else later
    batch.lost[:] = False if lost is None else lost
