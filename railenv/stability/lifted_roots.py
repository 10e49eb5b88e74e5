"""Eigenvalues of a sampled loop's lifted one-period map, as growth rates ln(z) / T.

Which side of a whole multiple of the period a delay is on matters where the loop jumps there
(`railenv.stability.sampled_loop`); `at_multiple` reads decimal fractions as the simulation does.

Floating point; nothing here is proved.
"""

from collections.abc import Sequence

import numpy as np
from scipy import linalg

from railenv.errors import check_count, check_not_negative
from railenv.stability.modes import Mode, normalised
from railenv.stability.sampled_loop import SampledLoop
from railenv.units import ComplexArray, FloatArray

# An eigenvalue counts as inside the unit circle below -ln|z| of this: above what rounding does to
# separated eigenvalues there (1e-13), and far below what a vehicle's modes decay in a period (1e-4
# and more). So a mode that is marginal by nature always counts as unstable, not now and then.
_ON_CIRCLE = 1e-9
# A delay this close to a whole multiple of the period (share of the period) is that multiple: the
# quotient of two decimal fractions is off by rounding, 0.29 / 0.01 < 29, and the simulation counts
# 29 periods.
_AT_MULTIPLE = 1e-9
# A mode whose vehicle part is below this share of the largest entry is a mode of the law alone.
_NO_PLANT = 1e-9


def lifted_roots(loop: SampledLoop, delay: float | Sequence[float], count: int = 10) -> list[Mode]:
    """Return the dominant modes of a sampled loop as growth rates ln(z) / T.

    Args:
        loop: The loop; a scheduled controller is told the true delay.
        delay: One delay for all channels or one per channel [s]; see `at_multiple`.
        count: How many, at most; a conjugate pair counts once.

    Returns:
        Modes by falling real part; the imaginary part lies in [0, pi / T]. The shape is over the
        plant's states, and zero for a mode that is the law's alone. Not proved.

    Raises:
        ArgumentError: An argument is out of its range, or the delay spans too many periods.
    """
    number = check_count("count", count)
    z, vectors = eigen(loop, [at_multiple(tau, loop.period) for tau in loop.delays(delay)])
    chosen = [k for k in range(len(z)) if z[k].imag >= 0.0 and z[k] != 0.0]
    chosen.sort(key=lambda k: -abs(z[k]))
    return [lifted_mode(loop, z[k], vectors[:, k]) for k in chosen[:number]]


def unstable_at(loop: SampledLoop, delay: float) -> int:
    """Return how many eigenvalues are on or outside the unit circle at a common delay [s].

    Not proved.
    The delay is read as `at_multiple` says.
    """
    place = at_multiple(check_not_negative("delay", delay, "seconds"), loop.period)
    return count_outside(outward_rates(loop, place))


def at_multiple(delay: float, period: float) -> float:
    """Return the delay, or the whole multiple of the period that rounding alone keeps it from.

    The loop jumps at the multiples: 0.29 s, as a double, is just below 29 periods of 0.01 s, and is
    meant to be on the side on which the simulation counts 29.

    Args:
        delay: Delay [s].
        period: Control period T [s].
    """
    whole = round(delay / period)
    if abs(delay - whole * period) > _AT_MULTIPLE * period:
        return delay
    place = whole * period
    while np.floor(place / period) < whole:
        place = float(np.nextafter(place, np.inf))
    return place


def just_before(multiple: float, period: float) -> float:
    """Return the last delay before a whole multiple of the period that is not that multiple [s]."""
    place, whole = multiple, np.floor(multiple / period)
    while np.floor(place / period) >= whole:
        place = float(np.nextafter(place, 0.0))
    return place


def eigen(loop: SampledLoop, delay: float | Sequence[float]) -> tuple[ComplexArray, ComplexArray]:
    """Return eigenvalues z and right eigenvectors of the lifted map at one delay [s]."""
    z, vectors = linalg.eig(loop.lifted_matrix(delay))
    return z.astype(np.complex128), vectors.astype(np.complex128)


def outward_rates(loop: SampledLoop, delay: float) -> FloatArray:
    """Return ln|z| of all eigenvalues, falling, with the width of the circle added."""
    sizes = np.sort(np.abs(linalg.eigvals(loop.lifted_matrix(delay))))[::-1]
    return np.log(np.maximum(sizes, np.finfo(float).tiny)) + _ON_CIRCLE


def count_outside(rates: FloatArray) -> int:
    """Return how many eigenvalues are on or outside the unit circle."""
    return int(np.sum(rates > 0.0))


def lifted_mode(loop: SampledLoop, z: complex, vector: ComplexArray) -> Mode:
    """Return an eigenvalue and its vector as a mode, over the plant's states in their own units."""
    shape = vector[: loop.num_states]
    if np.abs(shape).max() < _NO_PLANT * np.abs(vector).max():
        shape = np.zeros_like(shape)
    root = complex(np.log(z)) / loop.period
    return Mode(complex(root.real, abs(root.imag)), normalised(shape * loop.state_scale))
