"""What a controller is told of the delay: the lane's mean over its channels, and an error.

A controller that wants to be told has a method `tell(delays)`; it is called after every reset.
"""

import numpy as np

from railenv.errors import ArgumentError, check_finite
from railenv.units import FloatArray


def told_delays(delays: FloatArray, told_error: float) -> FloatArray:
    """Return the delay that every lane is told.

    Args:
        delays: True delays, shape (lanes, channels) [s].
        told_error: What is added to the mean of the channels; below zero, zero is told [s].

    Returns:
        Shape (lanes,) [s].
    """
    error = check_finite("told_error", told_error, "seconds")
    # The mean of equal numbers is that number, without rounding.
    same = np.all(delays == delays[:, :1], axis=1)
    return np.maximum(np.where(same, delays[:, 0], delays.mean(axis=1)) + error, 0.0)


def check_can_be_told(controller: object, told_error: float, name: str) -> None:
    """Raise `ArgumentError` if a told error is given and the controller is not told the delay.

    Args:
        controller: The controller.
        told_error: What is given [s].
        name: Names the controller in messages.
    """
    is_told = getattr(controller, "is_told", hasattr(controller, "tell"))
    if told_error != 0.0 and not is_told:
        raise ArgumentError(
            f"told_error = {told_error:g} s has no effect on {name!r} "
            f"({type(controller).__name__}), which is not told the delay; leave it out"
        )
