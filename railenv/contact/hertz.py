"""Hertz contact of wheel and rail: the contact ellipse and the approach of the two bodies.

Both bodies are of the same material. Near the point of first touch the gap between them is

    gap(x, y) = (kappa_x x^2 + kappa_y y^2) / 2

with x along rolling, y across, and kappa the sums of both bodies' curvatures in that direction
(1/R_wheel + 1/R_rail; hollow counts negative). The patch is then an ellipse with semi-axes a along
and b across, which grow as N^(1/3), and the bodies approach by delta ~ N^(2/3):

    s^2 = (minor/major)^2,  m = 1 - s^2,  D = (K(m) - E(m))/m,  B = K(m) - D
    kappa_max / kappa_min = B / (s^2 D)                      (gives s)
    major^3 = 3 N D / (pi E* kappa_min),  delta = 3 N K / (2 pi E* major),  E* = G / (1 - nu)

K. L. Johnson, Contact Mechanics (1985), equations 4.26 to 4.32, rewritten with D and B, which lose
no digits for a nearly circular patch. Not known here: conformal contact (a hollow rounder than the
body in it), plasticity, roughness.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from railenv.errors import ArgumentError, check_finite, check_positive
from railenv.units import FloatArray

SHEAR_MODULUS = 82e9
"""Shear modulus of wheel and rail steel [Pa], as in the examples of CONTACT (Vollebregt)."""

POISSON_RATIO = 0.28
"""Poisson's ratio of wheel and rail steel [1], as in the examples of CONTACT (Vollebregt)."""

_ITERATIONS = 12  # Newton from the starting guess needs 5 up to a ratio of 1e6


@dataclass(frozen=True)
class HertzContact:
    """Contact ellipse and approach for any normal force N; all arrays have one common shape.

    Attributes:
        along: a / N^(1/3), semi-axis along rolling [m/N^(1/3)].
        across: b / N^(1/3), semi-axis across [m/N^(1/3)].
        approach: delta / N^(2/3) [m/N^(2/3)].
    """

    along: FloatArray
    across: FloatArray
    approach: FloatArray

    @property
    def stiffness(self) -> FloatArray:
        """k_n of N = k_n delta^(3/2) [N/m^(3/2)]."""
        return self.approach**-1.5

    @property
    def axis_ratio(self) -> FloatArray:
        """a/b, which Kalker's coefficients depend on [1]."""
        return self.along / self.across

    def pressure(self, normal: ArrayLike) -> FloatArray:
        """Return the greatest pressure 3 N / (2 pi a b) [Pa] for normal forces N [N]."""
        force = np.asarray(normal, dtype=np.float64)
        return 1.5 * np.cbrt(force) / (np.pi * self.along * self.across)


def hertz_contact(
    curvature_along: ArrayLike,
    curvature_across: ArrayLike,
    *,
    shear_modulus: float = SHEAR_MODULUS,
    poisson_ratio: float = POISSON_RATIO,
) -> HertzContact:
    """Solve Hertz's problem for pairs of curvature sums (the module's docstring has the equations).

    Args:
        curvature_along: kappa_x = 1/R_wheel + 1/R_rail along rolling [1/m], above zero; any shape.
        curvature_across: kappa_y likewise across [1/m], above zero; broadcast against the other.
        shear_modulus: G of both bodies [Pa].
        poisson_ratio: nu of both bodies [1], at least 0 and at most 0.5.

    Returns:
        Ellipse and approach for N = 1 newton, of the broadcast shape.

    Raises:
        ArgumentError: A curvature sum is not above zero, or a material constant is out of range.
    """
    modulus = check_positive("shear_modulus", shear_modulus, "Pa")
    nu = check_finite("poisson_ratio", poisson_ratio)
    if not 0.0 <= nu <= 0.5:
        raise ArgumentError(f"poisson_ratio = {nu:g} is no solid's; give 0 to 0.5")
    kappa_x, kappa_y = np.broadcast_arrays(
        _curvature("curvature_along", curvature_along),
        _curvature("curvature_across", curvature_across),
    )
    least, most = np.minimum(kappa_x, kappa_y), np.maximum(kappa_x, kappa_y)
    s = _minor_to_major(most / least)
    k, d = _integrals(s)
    combined = modulus / (1.0 - nu)
    major = np.cbrt(3.0 * d / (np.pi * combined * least))
    minor = s * major
    lengthwise = kappa_x <= kappa_y
    return HertzContact(
        along=np.where(lengthwise, major, minor),
        across=np.where(lengthwise, minor, major),
        approach=1.5 * k / (np.pi * combined * major),
    )


def _curvature(name: str, value: ArrayLike) -> FloatArray:
    array = np.asarray(value, dtype=np.float64)
    wrong = ~(np.isfinite(array) & (array > 0.0))
    if wrong.any():
        raise ArgumentError(
            f"{name} = {array[wrong].flat[0]:g} 1/m must be finite and above zero, since a hollow "
            "as round as the body in it is no Hertz contact; bound the curvature sum from below"
        )
    return array


def _integrals(s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return K(m) and D(m) = (K - E)/m for m = 1 - s^2 (Carlson's form is exact at m = 0 too)."""
    y = s * s
    k: FloatArray = special.ellipkm1(y)
    third = np.asarray(special.elliprd(0.0, y, 1.0), dtype=np.float64)
    return k, third / 3.0


def _minor_to_major(ratio: FloatArray) -> FloatArray:
    """Solve B/(s^2 D) = kappa_max/kappa_min for s = minor/major by Newton's method in ln s."""
    x = -0.63 * np.log(ratio)  # s ~ (kappa_min/kappa_max)^(2/3), a little less for slim ellipses
    target = np.log(ratio)
    for _ in range(_ITERATIONS):
        s = np.exp(x)
        k, d = _integrals(s)
        b = k - d
        y = s * s
        m = 1.0 - y
        # dD/d ln s = (y D - B)/m, which tends to -3/4 D in a circle; dK/d ln s = -B, B = K - D.
        slope_d = np.where(m > 1e-4, (y * d - b) / np.where(m > 1e-4, m, 1.0), -0.75 * d)
        slope = (-b - slope_d) / b - slope_d / d - 2.0
        step = (np.log(b / d) - 2.0 * x - target) / slope
        x = np.minimum(x - step, 0.0)
        if float(np.max(np.abs(step), initial=0.0)) < 1e-14:
            break
    return np.exp(x)
