"""Plain measures of an acceleration: root mean square, peak, percentile.

Time is the last axis; axes before it are a batch. Nothing is filtered and no mean is removed, so a
constant acceleration counts in full.
"""

import numpy as np
from numpy.typing import ArrayLike

from railenv.errors import ArgumentError, check_finite
from railenv.metrics.sampling import as_signal, float_if_single
from railenv.units import FloatArray


def rms(acceleration: ArrayLike) -> FloatArray | float:
    """Root mean square about zero, sqrt(mean(a^2)).

    Args:
        acceleration: Signal [m/s^2], shape (..., time).

    Returns:
        The root mean square [m/s^2], shape (...); a float for a single signal.

    Raises:
        ArgumentError: No sample, or a sample that is not finite.
    """
    signal = as_signal("acceleration", acceleration)
    return float_if_single(np.asarray(np.sqrt(np.mean(signal**2, axis=-1)), dtype=np.float64))


def peak(acceleration: ArrayLike) -> FloatArray | float:
    """Largest magnitude, max |a|.

    Args:
        acceleration: Signal [m/s^2], shape (..., time).

    Returns:
        The peak [m/s^2], shape (...); a float for a single signal.

    Raises:
        ArgumentError: No sample, or a sample that is not finite.
    """
    signal = as_signal("acceleration", acceleration)
    return float_if_single(np.asarray(np.max(np.abs(signal), axis=-1), dtype=np.float64))


def percentile_abs(acceleration: ArrayLike, percent: float) -> FloatArray | float:
    """Magnitude that `percent` of the samples do not exceed, interpolated linearly.

    Args:
        acceleration: Signal [m/s^2], shape (..., time).
        percent: From 0 to 100.

    Returns:
        The percentile of |a| [m/s^2], shape (...); a float for a single signal.

    Raises:
        ArgumentError: No sample, a sample that is not finite, or a percentage out of range.
    """
    signal = as_signal("acceleration", acceleration)
    share = check_finite("percent", percent)
    if not 0.0 <= share <= 100.0:
        raise ArgumentError(f"percent = {share:g} is out of range; give a value from 0 to 100")
    value = np.percentile(np.abs(signal), share, axis=-1)
    return float_if_single(np.asarray(value, dtype=np.float64))
