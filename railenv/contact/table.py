"""Look-up of wheel-rail contact for time simulation: compiled, smooth, exactly conservative.

For the right wheel (the left one is its mirror image) and each zone, tread and flange, the normal
contact has one potential of the wheelset's pose relative to the rail,

    E = 2/5 k(u, phi, psi) p^(5/2),  p = z - h(u, phi, psi)   where p > 0

with the height of touch h of `railenv.contact.geometry` and the vertical Hertz constant
k = w k_n cos(angle)^(5/2) (N = k_n p_n^(3/2), p_n = p cos(angle), w the zone's weight). `touch`
returns h and k with their exact derivatives, so that forces taken from E do no work in closed
loops.

The table's coordinates are roll and the shift at the rail's level,

    v = u - r0 phi + c psi^2

where c, one number for each zone, is half of r0 tan(angle) - b, the shift by which yaw acts; h is
linear in psi^2, from two layers, k and all other quantities need only the first. In (v, phi) h and
k are bicubic B-splines (two continuous derivatives) whose coefficients are the values at the nodes,
h's less a sixth of its second differences (that makes smooth stretches exact to fourth order).
The correction takes the smallest of three neighbouring second differences. So where h has a kink,
because the point of touch jumps within a zone, its slope runs monotonously from one side's to the
other's over two steps to both sides; k, which is never corrected, cannot overshoot or fall below
zero. Where a zone has no touch of its own, its last one goes on along its tangent, so that a flange
comes to touch with its full stiffness. Beyond the table's edges h goes on linearly and everything
else stays as at the edge.

Against the exact search h errs by 1e-8 m (at most 2e-7 m) on smooth stretches of treads, 1e-5 m in
S1002's flange root and at kinks, and 1e-4 m where LMA's root and CN60's corner are all but equally
round and the contact angle rises by 50 degrees in 0.7 mm of shift.

Where the point of touch jumps, all that `patch` returns passes from one side to the other over the
shifts in which both places carry at the given load, and k over some millimetres
(`railenv.contact.table_nodes`): without that, small motion would depend on the table's steps.

Curvatures are averaged over the patch's width (see geometry), and a hollow as round as the rail in
it (conformal contact) is no Hertz contact: the sum of curvatures across is at least 1/(1.5 m) and
at least a tenth of the rail's own. That bounds k and the patch's width.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from railenv.contact.geometry import FLANGE, TREAD, WheelRail
from railenv.contact.hertz import POISSON_RATIO, SHEAR_MODULUS
from railenv.contact.table_nodes import PAD, QUANTITIES, HertzTable, grid, yaw_levers, zone_nodes
from railenv.errors import check_positive
from railenv.units import FloatArray

SHIFT_RANGE = (-25e-3, 45e-3)
"""Shifts at the rail's level that the table holds [m], to beyond the flange's tip."""

ROLL_RANGE = (-0.06, 0.06)
"""Rolls that the table holds [rad]."""

FREE_ROLL, FREE_YAW = 0.01, 0.01
"""Largest roll and yaw for which a free flange is told without looking it up [rad]."""

WHEEL_LOAD = 60e3
"""Load of a passenger train's wheel [N]."""

_FREE_BY = 1e-3  # [m] many times the approach of a loaded wheel

_YAW_LAYER = 0.02  # [rad] the second layer; linear in psi^2 between and beyond


class ContactArrays(NamedTuple):
    """The table; index 0 of both arrays is the zone.

    Attributes:
        spline: B-spline coefficients of h, its growth to the second layer, and k, then padding;
            for each node (v, phi), shape (2, nodes, nodes, 4) [m, m, N/m^1.5].
        patch: What `patch` returns, x per yaw angle, shape (2, nodes, nodes, 10).
        shift_start: v at which the first cell of `touch` starts, one node inside [m].
        shift_rate: Nodes per metre of v [1/m].
        roll_start: Likewise of roll [rad].
        roll_rate: Nodes per radian [1/rad].
        radius: r0, which turns roll into shift at the rail's level [m].
        tread_yaw: c of the tread zone [m].
        flange_yaw: c of the flange zone [m].
        layer_rate: 1 / psi^2 of the second layer [1/rad^2].
        free_shift: v up to which the flange is known to be free [m]; see `flange_is_free`.
        free_height: What it is free by there, less the wheel's motion by roll [m].
        free_lever: Distance of the wheel from the wheelset's centre [m].
    """

    spline: FloatArray
    patch: FloatArray
    shift_start: float
    shift_rate: float
    roll_start: float
    roll_rate: float
    radius: float
    tread_yaw: float
    flange_yaw: float
    layer_rate: float
    free_shift: float
    free_height: float
    free_lever: float


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _cell(position: float, cells: int) -> int:
    """Return the cell of a position in nodes, the nearest one where there is none (or for nan)."""
    if not position > 0.0:
        return 0
    if position >= cells - 1:
        return cells - 1
    return int(position)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _weights(t: float) -> tuple[float, float, float, float, float, float, float, float]:
    """Return the four cubic B-splines on a cell, t from 0 to 1, then their derivatives by t."""
    s = 1.0 - t
    return (
        s * s * s / 6.0,
        (4.0 + t * t * (3.0 * t - 6.0)) / 6.0,
        (4.0 + s * s * (3.0 * s - 6.0)) / 6.0,
        t * t * t / 6.0,
        -0.5 * s * s,
        t * (1.5 * t - 2.0),
        s * (2.0 - 1.5 * s),
        0.5 * t * t,
    )


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def flange_is_free(
    arrays: ContactArrays, shift: float, roll: float, yaw: float, down: float
) -> bool:
    """Return whether the flange surely does not touch, which most wheels' flanges do not.

    Two comparisons in place of `touch`: a B-spline lies above the least of its coefficients. False
    says nothing.

    Args:
        arrays: The table.
        shift: u [m].
        roll: phi [rad].
        yaw: psi [rad].
        down: How far down the wheelset's centre is, relative to the rail [m].
    """
    if not (abs(roll) <= FREE_ROLL and abs(yaw) <= FREE_YAW):
        return False
    v = shift - arrays.radius * roll + arrays.flange_yaw * yaw * yaw
    if not arrays.shift_start <= v <= arrays.free_shift:
        return False
    return down + arrays.free_lever * roll < arrays.free_height


@njit(cache=True, nogil=True, error_model="numpy")
def touch(
    arrays: ContactArrays, zone: int, shift: float, roll: float, yaw: float
) -> tuple[float, float, float, float, float, float, float, float]:
    """Return the height of touch and the stiffness of the right wheel, with derivatives.

    Args:
        arrays: The table.
        zone: 0 tread, 1 flange.
        shift: u, lateral displacement of the wheelset relative to the rail [m].
        roll: phi [rad].
        yaw: psi [rad].

    Returns:
        h [m], dh/du [1], dh/dphi [m/rad], dh/dpsi [m/rad], and k [N/m^1.5], dk/du, dk/dphi,
        dk/dpsi.
    """
    spline = arrays.spline
    yaw_lever = arrays.flange_yaw if zone == 1 else arrays.tread_yaw
    v = shift - arrays.radius * roll + yaw_lever * yaw * yaw
    x = (v - arrays.shift_start) * arrays.shift_rate
    y = (roll - arrays.roll_start) * arrays.roll_rate
    i = _cell(x, spline.shape[1] - 3)
    j = _cell(y, spline.shape[2] - 3)
    a0, a1, a2, a3, e0, e1, e2, e3 = _weights(x - i)
    b0, b1, b2, b3, d0, d1, d2, d3 = _weights(y - j)
    h = h_x = h_y = g = g_x = g_y = k = k_x = k_y = 0.0
    for row in range(4):
        n = np.uintp(i + row)
        a = a0 if row == 0 else (a1 if row == 1 else (a2 if row == 2 else a3))
        e = e0 if row == 0 else (e1 if row == 1 else (e2 if row == 2 else e3))
        h_0 = g_0 = k_0 = h_1 = g_1 = k_1 = 0.0
        for column in range(4):
            m = np.uintp(j + column)
            b = b0 if column == 0 else (b1 if column == 1 else (b2 if column == 2 else b3))
            d = d0 if column == 0 else (d1 if column == 1 else (d2 if column == 2 else d3))
            h_0 += b * spline[zone, n, m, 0]
            g_0 += b * spline[zone, n, m, 1]
            k_0 += b * spline[zone, n, m, 2]
            h_1 += d * spline[zone, n, m, 0]
            g_1 += d * spline[zone, n, m, 1]
            k_1 += d * spline[zone, n, m, 2]
        h += a * h_0
        g += a * g_0
        k += a * k_0
        h_x += e * h_0
        g_x += e * g_0
        k_x += e * k_0
        h_y += a * h_1
        g_y += a * g_1
        k_y += a * k_1
    layer = arrays.layer_rate * yaw * yaw
    h_v = (h_x + layer * g_x) * arrays.shift_rate
    k_v = k_x * arrays.shift_rate
    twice = 2.0 * yaw
    return (
        h + layer * g,
        h_v,
        (h_y + layer * g_y) * arrays.roll_rate - arrays.radius * h_v,
        twice * (yaw_lever * h_v + arrays.layer_rate * g),
        k,
        k_v,
        k_y * arrays.roll_rate - arrays.radius * k_v,
        twice * yaw_lever * k_v,
    )


@njit(cache=True, nogil=True, error_model="numpy")
def patch(
    arrays: ContactArrays, zone: int, shift: float, roll: float, yaw: float
) -> tuple[float, float, float, float, float, float, float, float, float, float]:
    """Return where the right wheel's patch is and how large it is, bilinear between nodes.

    Args:
        arrays: The table.
        zone: 0 tread, 1 flange.
        shift: u, lateral displacement of the wheelset relative to the rail [m].
        roll: phi [rad].
        yaw: psi [rad].

    Returns:
        Rolling radius [m], y and x of the point in wheelset axes [m], contact angle [rad],
        semi-axes along and across per cube root of the normal force [m/N^(1/3)], and Kalker's C11,
        C22, C23, C33 [1].
    """
    table = arrays.patch
    yaw_lever = arrays.flange_yaw if zone == 1 else arrays.tread_yaw
    v = shift - arrays.radius * roll + yaw_lever * yaw * yaw
    x = (v - arrays.shift_start) * arrays.shift_rate + 1.0  # a cell of `touch` starts at
    y = (roll - arrays.roll_start) * arrays.roll_rate + 1.0  # the second of its four nodes
    row = _cell(x, table.shape[1] - 1)
    column = _cell(y, table.shape[2] - 1)
    x = min(max(x - row, 0.0), 1.0)
    y = min(max(y - column, 0.0), 1.0)
    i, j = np.uintp(row), np.uintp(column)
    m, n = np.uintp(row + 1), np.uintp(column + 1)
    w3 = x * y
    w2, w1 = x - w3, y - w3
    w0 = 1.0 - x - w1
    return (
        w0 * table[zone, i, j, 0]
        + w1 * table[zone, i, n, 0]
        + w2 * table[zone, m, j, 0]
        + w3 * table[zone, m, n, 0],
        w0 * table[zone, i, j, 1]
        + w1 * table[zone, i, n, 1]
        + w2 * table[zone, m, j, 1]
        + w3 * table[zone, m, n, 1],
        (
            w0 * table[zone, i, j, 2]
            + w1 * table[zone, i, n, 2]
            + w2 * table[zone, m, j, 2]
            + w3 * table[zone, m, n, 2]
        )
        * yaw,
        w0 * table[zone, i, j, 3]
        + w1 * table[zone, i, n, 3]
        + w2 * table[zone, m, j, 3]
        + w3 * table[zone, m, n, 3],
        w0 * table[zone, i, j, 4]
        + w1 * table[zone, i, n, 4]
        + w2 * table[zone, m, j, 4]
        + w3 * table[zone, m, n, 4],
        w0 * table[zone, i, j, 5]
        + w1 * table[zone, i, n, 5]
        + w2 * table[zone, m, j, 5]
        + w3 * table[zone, m, n, 5],
        w0 * table[zone, i, j, 6]
        + w1 * table[zone, i, n, 6]
        + w2 * table[zone, m, j, 6]
        + w3 * table[zone, m, n, 6],
        w0 * table[zone, i, j, 7]
        + w1 * table[zone, i, n, 7]
        + w2 * table[zone, m, j, 7]
        + w3 * table[zone, m, n, 7],
        w0 * table[zone, i, j, 8]
        + w1 * table[zone, i, n, 8]
        + w2 * table[zone, m, j, 8]
        + w3 * table[zone, m, n, 8],
        w0 * table[zone, i, j, 9]
        + w1 * table[zone, i, n, 9]
        + w2 * table[zone, m, j, 9]
        + w3 * table[zone, m, n, 9],
    )


def contact_arrays(
    pair: WheelRail,
    *,
    shift_step: float = 2e-4,
    roll_step: float = 1.5e-3,
    shear_modulus: float = SHEAR_MODULUS,
    poisson_ratio: float = POISSON_RATIO,
    load: float = WHEEL_LOAD,
) -> ContactArrays:
    """Build the table of a wheel on a rail.

    Args:
        pair: Profiles and their placing.
        shift_step: Distance of its nodes in shift [m].
        roll_step: Distance of its nodes in roll [rad].
        shear_modulus: G of wheel and rail [Pa].
        poisson_ratio: nu of both [1].
        load: Vertical load of a wheel [N]; where the point of touch jumps, patches to both sides
            share it.

    Returns:
        The table; 7 MB and half a second with the steps given here.

    Raises:
        ArgumentError: A step is not above zero or is so large that the table has no inside.
    """
    v = grid("shift_step", shift_step, SHIFT_RANGE, "m")
    roll = grid("roll_step", roll_step, ROLL_RANGE, "rad")
    check_positive("load", load, "N")
    levers, hertz = yaw_levers(pair), HertzTable(shear_modulus, poisson_ratio)
    spline = np.zeros((2, len(v) + 2 * PAD, len(roll) + 2 * PAD, 4))
    patches = np.empty((*spline.shape[:3], QUANTITIES))
    for zone in (TREAD, FLANGE):
        filled = zone_nodes(pair, zone, v, roll, levers[zone], _YAW_LAYER, hertz, load)
        spline[zone, ..., :3], patches[zone] = filled
    lever = pair.tape_circle
    steps, first = (shift_step, roll_step), float(v[0]) - PAD * shift_step
    free_shift, free_height = _free(spline[FLANGE], first, steps, lever)
    return ContactArrays(
        spline=spline,
        patch=patches,
        shift_start=float(v[0]) - (PAD - 1) * shift_step,
        shift_rate=1.0 / shift_step,
        roll_start=float(roll[0]) - (PAD - 1) * roll_step,
        roll_rate=1.0 / roll_step,
        radius=pair.wheel_radius,
        tread_yaw=levers[TREAD],
        flange_yaw=levers[FLANGE],
        layer_rate=_YAW_LAYER**-2,
        free_shift=free_shift,
        free_height=free_height,
        free_lever=lever,
    )


def _free(
    flange: FloatArray, first: float, steps: tuple[float, float], lever: float
) -> tuple[float, float]:
    """Return up to which v, and by how much, the flange is free at small roll and yaw."""
    half = flange.shape[1] // 2  # the node without roll
    shift_step, roll_step = steps
    reach = int(FREE_ROLL / roll_step) + 3  # a point of a cell depends on two nodes to each side
    near = slice(half - reach, half + reach + 1)
    rolls = roll_step * np.arange(-reach, reach + 1)
    bent = np.minimum(flange[:, near, 1], 0.0) * (FREE_YAW / _YAW_LAYER) ** 2
    least = np.minimum.accumulate((flange[:, near, 0] + bent + lever * rolls).min(axis=1))
    if not least[0] >= _FREE_BY:
        return -math.inf, 0.0
    last = int(np.flatnonzero(least >= _FREE_BY)[-1])
    return first + (last - 2) * shift_step, float(least[last])
