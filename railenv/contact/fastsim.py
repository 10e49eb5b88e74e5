"""FASTSIM: creep forces of an elliptic patch by Kalker's simplified theory.

The patch is cut into strips along rolling. From the leading edge on, tractions grow with the rigid
slip over three flexibilities L, and are scaled back to the bound wherever they would exceed it
(J. J. Kalker, A fast algorithm for the simplified theory of rolling contact, Vehicle System
Dynamics 11, 1982):

    dp_x/dx = (xi_x / L_1 - spin y / L_3),   dp_y/dx = (xi_y / L_2 + spin x / L_3),   |p| <= bound
    L_1 = 8 a/(3 C11 G),   L_2 = 8 a/(3 C22 G),   L_3 = pi a sqrt(a/b)/(4 C23 G)

Forces act on the wheel; x is forward, y right, z down, so that a positive spin turns x towards y.
A wheel that runs ahead of rolling (xi_x > 0) is pulled back (F_x < 0). The three flexibilities
make F_x and F_y Kalker's linear ones for small creepages; the moment is the simplified theory's
own and differs from Kalker's. With three flexibilities a sliding patch would not pull against its
slip. As in CONTACT (Vollebregt), they pass over to one L_c that does the same work,

    1/L_c = (xi_x^2/L_1 + xi_y^2/L_2 + s^2/L_3)/(xi_x^2 + xi_y^2 + s^2),   s = (3 pi/32) a spin

here as L_i + (L_c - L_i) r^2/(r^2 + 25), r^2 = u^2 + v^2 + w^2 (below), so that sliding, which is
whole at r = 2 without spin, ends up against the slip and small creepages keep Kalker's forces.

The kernel works with lengths in a and b, tractions in mu p_0 (p_0 = 2 N/(pi a b), the top of the
parabolic bound mu p_0 (1 - x^2/a^2 - y^2/b^2)), and four numbers that hold all there is:

    u = xi_x a/(L_1 mu p_0)              (3 pi/16) G a b C11 xi_x/(mu N) before L_c weighs in
    v = xi_y a/(L_2 mu p_0)              (3 pi/16) G a b C22 xi_y/(mu N)
    w = spin a (a + b)/(2 L_3 mu p_0)    (1 + b/a) G (a b)^(3/2) C23 spin/(mu N)
    e = (a - b)/(a + b)

Against the usual programs two things are finer. Strips are as wide as midpoints of equal steps in
theta, y = b sin(theta), make them. A step ends in the middle of a cell and takes the slip of its
own middle while the traction grows, passing over to the slip at its end as sliding takes hold: a
patch that slides as a whole then has its tractions where the slip is, not half a cell before.
"""

import math
from typing import NamedTuple

from numba import njit

from railenv.contact.hertz import POISSON_RATIO, SHEAR_MODULUS
from railenv.contact.kalker import kalker_coefficients
from railenv.errors import (
    ArgumentError,
    check_count,
    check_finite,
    check_not_negative,
    check_positive,
)

BOUNDS = ("parabolic", "elliptic")
"""Traction bounds: the parabola of the simplified theory, or friction times Hertz's pressure."""

_ONE_FLEXIBILITY = 25.0  # the r^2 at which half of the way is gone; near CONTACT's own blending


class CreepForce(NamedTuple):
    """Creep force and spin moment on the wheel [N, N, N m]."""

    fx: float
    fy: float
    mz: float


@njit(cache=True, nogil=True, error_model="numpy")
def normalised_forces(
    u: float, v: float, w: float, e: float, strips: int, steps: int, elliptic: bool
) -> tuple[float, float, float]:
    """Sum the tractions of a patch in the module's normalised creepages.

    Args:
        u: Longitudinal creepage.
        v: Lateral creepage.
        w: Spin.
        e: (a - b)/(a + b), -1 to 1.
        strips: Strips across the patch, 3 or more.
        steps: Cells along each strip.
        elliptic: Whether the bound is elliptic instead of parabolic.

    Returns:
        F_x/(mu N), F_y/(mu N) and M_z/(mu N (a + b)/2). The sums are taken relative to the sum of
        the bound over the same cells, hence the force is never beyond 1.
    """
    turn_x = (1.0 + e) * w
    turn_y = (1.0 - e) * w
    d_theta = math.pi / strips
    fx = 0.0
    fy = 0.0
    mz = 0.0
    whole = 0.0
    for j in range(strips):
        theta = (j + 0.5) * d_theta - 0.5 * math.pi
        y = math.sin(theta)
        half_length = math.cos(theta)
        cell = 2.0 * half_length / steps
        slip_x = u - turn_y * y
        px = 0.0
        py = 0.0
        sum_x = 0.0
        sum_y = 0.0
        sum_m = 0.0
        sum_bound = 0.0
        x = half_length
        step = 0.5 * cell
        for _ in range(steps):
            px -= slip_x * step
            py -= (v + turn_x * (x - 0.5 * step)) * step
            x -= step
            bound = half_length * half_length - x * x
            if elliptic:
                bound = 0.75 * math.sqrt(bound)
            square = px * px + py * py
            if square > bound * bound:
                # From the slip of the step's middle to that of its end, as sliding takes hold.
                py += (1.0 - bound * bound / square) * turn_x * 0.5 * step * step
                scale = bound / math.sqrt(px * px + py * py)
                if scale < 1.0:
                    px *= scale
                    py *= scale
            sum_x += px
            sum_y += py
            sum_m += x * py
            sum_bound += bound
            step = cell
        area = half_length * cell
        fx += area * sum_x
        fy += area * sum_y
        mz += area * ((1.0 + e) * sum_m - (1.0 - e) * y * sum_x)
        whole += area * sum_bound
    return fx / whole, fy / whole, mz / whole


@njit(cache=True, nogil=True, error_model="numpy")
def normalised_creepages(
    a: float,
    b: float,
    c11: float,
    c22: float,
    c23: float,
    shear_modulus: float,
    limit: float,
    xi_x: float,
    xi_y: float,
    spin: float,
) -> tuple[float, float, float]:
    """Return u, v, w of a patch, its flexibilities passing over to one as it slides.

    Args:
        a: Semi-axis along rolling [m].
        b: Semi-axis across [m].
        c11: Kalker's coefficients [1].
        c22: Likewise.
        c23: Likewise.
        shear_modulus: G [Pa].
        limit: mu N [N], above zero.
        xi_x: Longitudinal creepage [1].
        xi_y: Lateral creepage [1].
        spin: Spin creepage [1/m].
    """
    # q = 8 a/(3 G L), so that q1 = C11 and q2 = C22.
    q3 = 32.0 / (3.0 * math.pi) * c23 * math.sqrt(b / a)
    factor = 0.1875 * math.pi * shear_modulus * a * b / limit
    x = factor * xi_x
    y = factor * xi_y
    z = factor * 0.5 * (a + b) * spin
    turn = factor * 0.09375 * math.pi * a * spin
    square = x * x + y * y + turn * turn
    if square == 0.0:
        return 0.0, 0.0, 0.0
    common = (x * x * c11 + y * y * c22 + turn * turn * q3) / square
    square = (x * c11) ** 2 + (y * c22) ** 2 + (z * q3) ** 2
    share = square / (square + _ONE_FLEXIBILITY)
    rest = (1.0 - share) * common
    return (
        x * c11 * common / (rest + share * c11),
        y * c22 * common / (rest + share * c22),
        z * q3 * common / (rest + share * q3),
    )


def flexibilities(
    a: float,
    b: float,
    *,
    shear_modulus: float = SHEAR_MODULUS,
    poisson_ratio: float = POISSON_RATIO,
) -> tuple[float, float, float]:
    """Return Kalker's flexibilities L_1, L_2, L_3 [m^3/N] of an elliptic patch, before sliding.

    Args:
        a: Semi-axis along rolling [m].
        b: Semi-axis across [m].
        shear_modulus: G [Pa].
        poisson_ratio: nu [1].
    """
    along, across = check_positive("a", a, "m"), check_positive("b", b, "m")
    modulus = check_positive("shear_modulus", shear_modulus, "Pa")
    c11, c22, c23, _ = (float(c) for c in kalker_coefficients(along / across, poisson_ratio))
    return (
        8.0 * along / (3.0 * c11 * modulus),
        8.0 * along / (3.0 * c22 * modulus),
        math.pi * along * math.sqrt(along / across) / (4.0 * c23 * modulus),
    )


def fastsim(
    a: float,
    b: float,
    normal: float,
    friction: float,
    xi_x: float,
    xi_y: float,
    spin: float,
    *,
    flexibility: tuple[float, float, float] | None = None,
    bound: str = "parabolic",
    strips: int = 100,
    steps: int = 100,
) -> CreepForce:
    """Return the creep force of an elliptic patch by FASTSIM.

    Args:
        a: Semi-axis along rolling [m].
        b: Semi-axis across [m].
        normal: Normal force [N].
        friction: Friction coefficient mu [1].
        xi_x: Longitudinal creepage [1].
        xi_y: Lateral creepage [1].
        spin: Spin creepage [1/m].
        flexibility: L_1, L_2, L_3 [m^3/N], used as they are; unless given, those of
            `flexibilities` for steel, passing over to one.
        bound: "parabolic" or "elliptic".
        strips: Strips across the patch, 3 or more.
        steps: Cells along each strip.

    Returns:
        Force and spin moment on the wheel.

    Raises:
        ArgumentError: A number is out of its range, or the bound is not known.
    """
    along, across = check_positive("a", a, "m"), check_positive("b", b, "m")
    limit = check_not_negative("normal", normal, "N") * check_not_negative("friction", friction)
    creepages = (
        check_finite("xi_x", xi_x),
        check_finite("xi_y", xi_y),
        check_finite("spin", spin, "1/m"),
    )
    check_count("strips", strips, 3)
    check_count("steps", steps, 2)
    if bound not in BOUNDS:
        raise ArgumentError(f"bound = {bound!r} is not known; give 'parabolic' or 'elliptic'")
    if limit == 0.0:
        return CreepForce(0.0, 0.0, 0.0)
    if flexibility is None:
        c11, c22, c23, _ = (float(c) for c in kalker_coefficients(along / across))
        u, v, w = normalised_creepages(
            along, across, c11, c22, c23, SHEAR_MODULUS, limit, *creepages
        )
    else:
        l1, l2, l3 = (check_positive("flexibility", value, "m^3/N") for value in flexibility)
        scale = 0.5 * math.pi * along * along * across / limit
        u, v = creepages[0] * scale / l1, creepages[1] * scale / l2
        w = creepages[2] * scale * 0.5 * (along + across) / l3
    e = (along - across) / (along + across)
    fx, fy, mz = normalised_forces(u, v, w, e, strips, steps, bound == "elliptic")
    return CreepForce(limit * fx, limit * fy, limit * 0.5 * (along + across) * mz)
