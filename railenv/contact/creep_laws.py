"""Creep force laws: from creepages and a contact patch to the force on the wheel.

Axes of the patch: x forward, y right in the contact plane, z down. The force acts on the wheel and
opposes its sliding; a positive spin turns x towards y. Every law but the linear one is bounded by
friction, and none feeds energy in: F_x xi_x + F_y xi_y + M_z spin <= 0. (FASTSIM does so in patches
longer than wide by 14 or more, where its moment is too small for its lateral force: 2 per cent of
the power exchanged, for small creepages of opposite sign.)

- linear: Kalker's linear theory, F_x = -f11 xi_x, F_y = -f22 xi_y - f23 spin,
  M_z = f23 xi_y - f33 spin, without any bound.
- shen-hedrick-elkins: the linear force F, its spin part included, and the linear moment times
  (n - n^2/3 + n^3/27)/n with n = F/(mu N) up to 3, and 1/n beyond (Z. Y. Shen, J. K. Hedrick,
  J. A. Elkins, 8th IAVSD Symposium, 1983). Meant for little spin: spin alone saturates the whole
  patch, which in truth it never does. A sliding force keeps the linear one's direction, which is
  not quite against the slip unless C11 = C22.
- polach: O. Polach (Vehicle System Dynamics Supplement 33, 1999) with his spin term and his
  reductions k_A and k_S of the gradient in adhesion and in slip (Wear 258, 2005):
      F = (2 mu N/pi) (k_A x/(1 + (k_A x)^2) + arctan(k_S x)),  x = (pi/4) G a b c_jj s_c/(mu N)
  The force points against the slip, also for small creepages, where Kalker's points slightly
  elsewhere unless C11 = C22. The spin's force, K_M = -(2/3) q/(1 + q^2)^2 in closed form, with
  q the paper's eps_s, is f23 spin times |s_yc|/s_c / (1 + q^2)^2; the moment, which Polach leaves
  open, is the linear one times the same, so that spin and lateral creepage trade no energy.
- fastsim: the simplified theory, summed at every call (`railenv.contact.fastsim`).
- fastsim-table: the same from a table (`railenv.contact.creep_table`).
"""

import hashlib
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numba import njit

from railenv.contact import creep_table, fastsim
from railenv.contact.creep_table import CreepTable, fastsim_table, look_up
from railenv.contact.fastsim import normalised_creepages, normalised_forces
from railenv.errors import ArgumentError, check_count, check_positive, unknown_name

LINEAR = 0
SHEN_HEDRICK_ELKINS = 1
POLACH = 2
FASTSIM = 3
FASTSIM_TABLE = 4

CREEP_LAWS = {
    "linear": LINEAR,
    "shen-hedrick-elkins": SHEN_HEDRICK_ELKINS,
    "polach": POLACH,
    "fastsim": FASTSIM,
    "fastsim-table": FASTSIM_TABLE,
}
"""The laws' numbers in compiled code, by the names that users give."""

_NO_FORCE = 1e-30  # mu N [N] below which there is no creep force; keeps ratios to it finite


def creep_law_number(name: str) -> int:
    """Return the number of a law.

    Args:
        name: One of `CREEP_LAWS`.

    Raises:
        ArgumentError: There is no such law.
    """
    if name not in CREEP_LAWS:
        raise unknown_name("creep law", name, CREEP_LAWS)
    return CREEP_LAWS[name]


def make_creep_table(
    law: str,
    *,
    adhesion_reduction: float = 1.0,
    slip_reduction: float = 1.0,
    strips: int = 32,
    steps: int = 48,
) -> CreepTable:
    """Prepare what `creep_force` needs besides the patch and the creepages.

    Args:
        law: One of `CREEP_LAWS`; only "fastsim-table" reads a file.
        adhesion_reduction: Polach's k_A [1], above zero and at most 1 (dry 1, wet 0.3).
        slip_reduction: Polach's k_S [1], above zero and at most k_A (dry 0.4, wet 0.1).
        strips: Strips of "fastsim", 3 or more.
        steps: Cells along each strip, 2 or more.

    Returns:
        Settings and table, for compiled code.

    Raises:
        ArgumentError: The law is not known, or a number is out of its range.
    """
    number = creep_law_number(law)
    k_a = check_positive("adhesion_reduction", adhesion_reduction)
    k_s = check_positive("slip_reduction", slip_reduction)
    if not k_s <= k_a <= 1.0:
        raise ArgumentError(
            f"slip_reduction = {k_s:g} and adhesion_reduction = {k_a:g} must rise in this order "
            "and not exceed 1; give k_S <= k_A <= 1"
        )
    check_count("strips", strips, 3)
    check_count("steps", steps, 2)
    values = np.zeros((1, 1, 1, 1, 3), dtype=np.int16)
    if number == FASTSIM_TABLE:
        values = fastsim_table()
    return CreepTable(values, k_a, k_s, strips, steps)


def _compiled(sources: str) -> Callable[..., tuple[float, float, float]]:
    @njit(cache=True, nogil=True, error_model="numpy")
    def creep_force(
        law: int,
        a: float,
        b: float,
        c11: float,
        c22: float,
        c23: float,
        c33: float,
        shear_modulus: float,
        normal: float,
        friction: float,
        xi_x: float,
        xi_y: float,
        spin: float,
        table: CreepTable,
    ) -> tuple[float, float, float]:
        len(sources)  # makes it a part of this function, see below
        limit = normal * friction
        if not (normal > 0.0 and limit > _NO_FORCE):
            return 0.0, 0.0, 0.0
        area = a * b
        f11 = shear_modulus * area * c11
        f22 = shear_modulus * area * c22
        f23 = shear_modulus * area * math.sqrt(area) * c23
        f33 = shear_modulus * area * area * c33

        if law in (FASTSIM, FASTSIM_TABLE):
            u, v, w = normalised_creepages(
                a, b, c11, c22, c23, shear_modulus, limit, xi_x, xi_y, spin
            )
            e = (a - b) / (a + b)
            if law == FASTSIM:
                fx, fy, mz = normalised_forces(u, v, w, e, table.strips, table.steps, False)
            else:
                fx, fy, mz = look_up(table.values, u, v, w, e)
            return limit * fx, limit * fy, limit * 0.5 * (a + b) * mz

        if law == POLACH:
            turned = xi_y + spin * a
            lateral = turned if abs(turned) > abs(xi_y) else xi_y
            slip = math.sqrt(xi_x * xi_x + lateral * lateral)
            if slip == 0.0:
                return 0.0, 0.0, 0.0
            square = xi_x * xi_x + xi_y * xi_y
            c_jj = c22
            if square > 0.0:
                c_jj = math.sqrt(((c11 * xi_x) ** 2 + (c22 * xi_y) ** 2) / square)
            x = 0.25 * math.pi * shear_modulus * area * c_jj * slip / limit
            adhesion = table.adhesion_reduction * x
            force = adhesion / (1.0 + adhesion * adhesion) + math.atan(table.slip_reduction * x)
            force *= 2.0 * limit / math.pi
            widening = 1.0 + 6.3 * (1.0 - math.exp(-a / b))
            q = 8.0 / 3.0 * f23 / a * lateral / (limit * widening)
            spin_part = abs(lateral) / slip / (1.0 + q * q) ** 2
            fx = -force * (xi_x / slip)
            fy = -force * (xi_y / slip) - spin_part * f23 * spin
            mz = spin_part * (f23 * xi_y - f33 * spin)
            resultant = math.sqrt(fx * fx + fy * fy)
            if resultant > limit:
                scale = limit / resultant
                return scale * fx, scale * fy, scale * mz
            return fx, fy, mz

        fx = -f11 * xi_x
        fy = -f22 * xi_y - f23 * spin
        mz = f23 * xi_y - f33 * spin
        if law == SHEN_HEDRICK_ELKINS:
            n = math.sqrt(fx * fx + fy * fy) / limit
            scale = 1.0 / n if n > 3.0 else 1.0 - n / 3.0 + n * n / 27.0
            return scale * fx, scale * fy, scale * mz
        return fx, fy, mz

    return creep_force


# The compiler's cache does not see that a function of another file has changed; a digest of those
# files, as a variable of the scope around, makes it look again.
_parts = [Path(str(part.__file__)).read_bytes() for part in (fastsim, creep_table)]
creep_force = _compiled(hashlib.sha256(b"".join(_parts)).hexdigest())
"""Return the creep force of one patch, for compiled code.

Args:
    law: A law's number, see `CREEP_LAWS`.
    a: Semi-axis of the patch along rolling [m].
    b: Semi-axis across [m].
    c11: Kalker's coefficients [1], see `railenv.contact.kalker`.
    c22: Likewise.
    c23: Likewise.
    c33: Likewise.
    shear_modulus: G [Pa].
    normal: Normal force [N]; without one there is no creep force.
    friction: Friction coefficient mu [1].
    xi_x: Longitudinal creepage [1], positive where the wheel's surface runs forward on the rail.
    xi_y: Lateral creepage [1].
    spin: Spin creepage [1/m].
    table: What `make_creep_table` returned for this law.

Returns:
    F_x [N], F_y [N] and M_z [N m] on the wheel.
"""
