"""Linear critical speed: where small motions about the straight run cease to die out."""

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from railenv.errors import ArgumentError, check_count, check_positive
from railenv.units import FloatArray, Hertz, MetrePerSecond


@dataclass(frozen=True)
class LinearCriticalSpeed:
    """Where the rightmost eigenvalues reach the imaginary axis; estimated on a grid of speeds.

    Attributes:
        speed: The crossing.
        frequency: |Im s| / 2 pi there; zero for a divergence.
        scanned_from: Lowest speed looked at: a crossing below it is not seen.
        scan_step: Distance of the speeds looked at: a stretch of instability narrower than this
            may be missed.
    """

    speed: MetrePerSecond
    frequency: Hertz
    scanned_from: MetrePerSecond
    scan_step: MetrePerSecond


def linear_critical_speed(
    linearisation: Callable[[float], FloatArray],
    lowest: MetrePerSecond,
    highest: MetrePerSecond,
    count: int = 100,
) -> LinearCriticalSpeed | None:
    """Return the lowest speed at which the straight run loses its stability.

    Args:
        linearisation: System matrix of small motions at a speed [m/s], shape (n, n). A coordinate
            that nothing holds (a zero eigenvalue) must have been left out.
        lowest: Speed to begin at [m/s].
        highest: Speed to end at [m/s].
        count: Intervals to look at.

    Returns:
        The first crossing from stable to unstable; None if there is none.

    Raises:
        ArgumentError: Speeds do not increase from above zero, or `lowest` is unstable already.
    """
    lowest, highest = (
        check_positive("lowest", lowest, "m/s"),
        check_positive("highest", highest, "m/s"),
    )
    if highest <= lowest:
        raise ArgumentError(f"highest = {highest:g} m/s must be above lowest = {lowest:g} m/s")
    speeds = np.linspace(lowest, highest, check_count("count", count) + 1)

    def abscissa(speed: float) -> float:
        return float(np.linalg.eigvals(linearisation(speed)).real.max())

    before = abscissa(lowest)
    if before >= 0.0:
        raise ArgumentError(
            f"lowest = {lowest:g} m/s is not stable (spectral abscissa {before:.3g} 1/s); "
            "begin at a lower speed"
        )
    for left, right in itertools.pairwise(speeds):
        if abscissa(float(right)) >= 0.0:
            speed = float(brentq(abscissa, float(left), float(right), xtol=1e-12, rtol=1e-14))
            roots = np.linalg.eigvals(linearisation(speed))
            root = roots[np.argmax(roots.real)]
            frequency = abs(float(root.imag)) / (2 * np.pi)
            return LinearCriticalSpeed(speed, frequency, lowest, float(speeds[1] - speeds[0]))
    return None
