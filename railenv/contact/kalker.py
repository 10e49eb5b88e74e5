"""Kalker's creep coefficients of an elliptic contact patch.

For small creepages the force on the wheel is (axes: x forward, y right)

    F_x = -G a b C11 xi_x
    F_y = -G a b C22 xi_y - G (a b)^(3/2) C23 spin
    M_z = +G (a b)^(3/2) C23 xi_y - G (a b)^2 C33 spin

with semi-axes a along rolling and b across. The coefficients depend on a/b and Poisson's ratio nu
only and are Kalker's tables (On the rolling contact of two elastic bodies in the presence of dry
friction, 1967; reprinted in Three-Dimensional Elastic Bodies in Rolling Contact, 1990, table E3),
C11, C22, C23 as CONTACT (Vollebregt) holds them. C33 at nu = 0 was typed from memory of the same
table and checked for its limit and its smoothness only; for steel it weighs 5 per cent.

Between the tabulated nu, 1/C is a parabola (as in CONTACT); between the tabulated a/b, ln C is a
cubic spline in ln(a/b). Below a/b = 0.1 the coefficients follow Kalker's limits for a slim patch,
scaled to meet the table; above 10 each goes on as the power of a/b that it had there.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from railenv.contact.hertz import POISSON_RATIO
from railenv.errors import ArgumentError, check_finite
from railenv.units import FloatArray

_TENTHS = np.arange(1, 11) / 10.0
_RATIOS = np.concatenate([_TENTHS, 1.0 / _TENTHS[-2::-1]])  # a/b up to 1, then 1/(b/a)
_POISSON = np.array([0.0, 0.25, 0.5])

# fmt: off
_TABLE = np.array([
    # nu = 0: C11, C22 (the same), C23, C33
    [[2.51, 2.59, 2.68, 2.78, 2.88, 2.98, 3.09, 3.19, 3.29, 3.40,
      3.51, 3.65, 3.82, 4.06, 4.37, 4.84, 5.57, 6.96, 10.7],
     [2.51, 2.59, 2.68, 2.78, 2.88, 2.98, 3.09, 3.19, 3.29, 3.40,
      3.51, 3.65, 3.82, 4.06, 4.37, 4.84, 5.57, 6.96, 10.7],
     [0.334, 0.483, 0.607, 0.720, 0.827, 0.930, 1.03, 1.13, 1.23, 1.33,
      1.44, 1.58, 1.76, 2.01, 2.35, 2.88, 3.79, 5.72, 12.2],
     [6.42, 3.46, 2.49, 2.02, 1.74, 1.56, 1.43, 1.34, 1.27, 1.21,
      1.16, 1.10, 1.05, 1.01, 0.958, 0.912, 0.868, 0.828, 0.795]],
    # nu = 0.25
    [[3.31, 3.37, 3.44, 3.53, 3.62, 3.72, 3.81, 3.91, 4.01, 4.12,
      4.22, 4.36, 4.54, 4.78, 5.10, 5.57, 6.34, 7.78, 11.7],
     [2.52, 2.63, 2.75, 2.88, 3.01, 3.14, 3.28, 3.41, 3.54, 3.67,
      3.81, 3.99, 4.21, 4.50, 4.90, 5.48, 6.40, 8.14, 12.8],
     [0.473, 0.603, 0.715, 0.823, 0.929, 1.03, 1.14, 1.25, 1.36, 1.47,
      1.59, 1.75, 1.95, 2.23, 2.62, 3.24, 4.32, 6.63, 14.6],
     [8.28, 4.27, 2.96, 2.32, 1.93, 1.68, 1.50, 1.37, 1.27, 1.19,
      1.11, 1.04, 0.965, 0.892, 0.819, 0.747, 0.674, 0.601, 0.526]],
    # nu = 0.5
    [[4.85, 4.81, 4.80, 4.82, 4.83, 4.91, 4.97, 5.05, 5.12, 5.20,
      5.30, 5.42, 5.58, 5.80, 6.11, 6.57, 7.34, 8.82, 12.9],
     [2.53, 2.66, 2.81, 2.98, 3.14, 3.31, 3.48, 3.65, 3.82, 3.98,
      4.16, 4.39, 4.67, 5.04, 5.56, 6.31, 7.51, 9.79, 16.0],
     [0.731, 0.809, 0.889, 0.977, 1.07, 1.18, 1.29, 1.40, 1.51, 1.63,
      1.77, 1.94, 2.18, 2.50, 2.96, 3.70, 5.01, 7.89, 18.0],
     [11.7, 5.66, 3.72, 2.77, 2.22, 1.86, 1.60, 1.42, 1.27, 1.16,
      1.06, 0.954, 0.852, 0.751, 0.650, 0.549, 0.446, 0.341, 0.228]],
])
# fmt: on


class KalkerCoefficients(NamedTuple):
    """C11 (along), C22 (across), C23 (lateral and spin) and C33 (spin), one shape [1]."""

    c11: FloatArray
    c22: FloatArray
    c23: FloatArray
    c33: FloatArray


def kalker_coefficients(
    axis_ratio: ArrayLike, poisson_ratio: float = POISSON_RATIO
) -> KalkerCoefficients:
    """Interpolate Kalker's creep coefficients.

    Args:
        axis_ratio: a/b, semi-axis along rolling over the one across [1], above zero; any shape.
        poisson_ratio: nu [1], 0 to 0.5.

    Returns:
        The coefficients, each of the shape of `axis_ratio`.

    Raises:
        ArgumentError: A ratio is not above zero, or nu is out of range.
    """
    ratio = np.asarray(axis_ratio, dtype=np.float64)
    wrong = ~(np.isfinite(ratio) & (ratio > 0.0))
    if wrong.any():
        raise ArgumentError(
            f"axis_ratio = {ratio[wrong].flat[0]:g} must be finite and above zero; give a/b"
        )
    nu = check_finite("poisson_ratio", poisson_ratio)
    if not 0.0 <= nu <= 0.5:
        raise ArgumentError(f"poisson_ratio = {nu:g} is outside Kalker's tables; give 0 to 0.5")
    shares = [
        np.prod([(nu - other) / (here - other) for other in _POISSON if other != here])
        for here in _POISSON
    ]
    knots = np.log(_RATIOS)
    spline = CubicSpline(knots, -np.log(np.tensordot(shares, 1.0 / _TABLE, axes=1)), axis=1)
    x = np.log(ratio)
    inside = np.clip(x, knots[0], knots[-1])
    beyond = np.maximum(x - knots[-1], 0.0)
    slopes = np.asarray(spline(knots[-1], 1)).reshape(4, *np.ones(ratio.ndim, dtype=np.int64))
    values = np.exp(spline(inside) + slopes * beyond)
    least = _RATIOS[0]
    values *= _slim(np.minimum(ratio, least), nu) / _slim(np.asarray(least), nu).reshape(
        4, *np.ones(ratio.ndim, dtype=np.int64)
    )
    return KalkerCoefficients(*values)


def _slim(ratio: FloatArray, nu: float) -> FloatArray:
    """Return Kalker's limits of the four coefficients for a/b -> 0, shape (4, ...)."""
    one = np.ones_like(ratio)
    c23 = np.sqrt(ratio) * (1.0 + nu * (np.log(16.0 / ratio) - 5.0)) * np.pi / (3.0 * (1.0 - nu))
    return np.stack(
        [
            one * np.pi**2 / (4.0 * (1.0 - nu)),
            one * np.pi**2 / 4.0,
            c23,
            np.pi**2 / (16.0 * (1.0 - nu) * ratio),
        ]
    )
