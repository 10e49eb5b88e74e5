"""FASTSIM as a table: what a time simulation reads instead of summing a patch's tractions.

The table holds `normalised_forces` (parabolic bound) for every creepage and every shape of the
patch up to an axis ratio of 24, since its four coordinates are bounded. With
r = sqrt(u^2 + v^2 + w^2), after making w >= 0 by the patch's symmetry (all three creepages reversed
reverse all forces):

    shape         e = (a - b)/(a + b)        from -0.92 to 0.92
    spin share    w/(w + sqrt(u^2 + v^2))    0 without spin, 1 spin alone
    direction     v/(|u| + |v|)              -1 and 1 lateral, 0 longitudinal
    extent        S = r/(r + 1.5)            0 without creepage, 1 sliding

Not the force itself is tabulated but three numbers T, B, M, which vary little:

    F_x = -S T u/r,   F_y = -S (T v/r + B),   M_z = S M

T and B are even in u. Without spin T is the same in every direction and B is zero, so that
direction costs no accuracy there; small creepages give exactly linear forces. Between nodes the
three are linear in every coordinate: the force is continuous and its slope jumps a little from cell
to cell, as FASTSIM's own does from grid cell to grid cell. A force that interpolation carries
beyond friction is scaled back. A patch slimmer than the table reaches is given the outermost shape.

The numbers come from `railenv.contact.creep_table_fill` and lie beside this file, as 16-bit whole
numbers in units of 1/4096 and as differences along all four coordinates. Where spin alone brings
the whole parabola to its bound at once (w (1 + e) = 2) the simplified theory has a sharp ridge, and
the table its largest errors. Against FASTSIM on a fine grid, with a/b from 0.1 to 10 and spin to
3 rad/m, the error's median is 0.01 per cent of friction; it is below 0.4 in 99 of 100 points, below
0.9 in 999 of 1000, and 1.7 at worst.
"""

import math
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from railenv.errors import InputFileError

NODES = (17, 33, 25, 49)
"""Nodes by shape, spin share, direction and extent."""

OUTERMOST_SHAPE = 0.92
"""Largest (a - b)/(a + b) in the table, an axis ratio of 24."""

HALF_EXTENT = 1.5
"""The r at which the extent is one half; without spin the whole patch slides from r = 2 on."""

UNIT = 1.0 / 4096.0
"""What one stands for in the table."""

TABLE_FILE = Path(__file__).with_name("creep_table.npz")
"""Where the table lies."""


class CreepTable(NamedTuple):
    """What `creep_force` needs besides the patch and the creepages.

    Attributes:
        values: T, B, M in units of `UNIT`, shape (shapes, spin shares, directions, extents, 3);
            zeros of length 1 for laws that read no table.
        adhesion_reduction: Polach's k_A [1].
        slip_reduction: Polach's k_S [1].
        strips: Strips of FASTSIM where it is summed at every call.
        steps: Cells along each of them.
    """

    values: NDArray[np.int16]
    adhesion_reduction: float
    slip_reduction: float
    strips: int
    steps: int


@njit(cache=True, nogil=True, error_model="numpy")
def look_up(
    values: NDArray[np.int16], u: float, v: float, w: float, e: float
) -> tuple[float, float, float]:
    """Interpolate the table.

    Args:
        values: The table, see `CreepTable`.
        u: Longitudinal creepage, normalised as in `railenv.contact.fastsim`.
        v: Lateral creepage.
        w: Spin.
        e: (a - b)/(a + b).

    Returns:
        F_x/(mu N), F_y/(mu N) and M_z/(mu N (a + b)/2); NaN where a number is not finite.
    """
    sign = 1.0
    if w < 0.0:
        sign = -1.0
        w = -w
        v = -v
    across = u * u + v * v
    r = math.sqrt(across + w * w)
    if r == 0.0:
        return 0.0, 0.0, 0.0
    if not r + abs(e) < math.inf:  # an index made of NaN would be anywhere in memory
        return math.nan, math.nan, math.nan
    last_e = values.shape[0] - 1
    last_w = values.shape[1] - 1
    last_v = values.shape[2] - 1
    last_r = values.shape[3] - 1
    extent = r / (r + HALF_EXTENT)
    width = abs(u) + abs(v)
    e = min(max(e, -OUTERMOST_SHAPE), OUTERMOST_SHAPE)
    at_e = (0.5 + (0.5 / OUTERMOST_SHAPE) * e) * last_e
    at_w = w / (w + math.sqrt(across)) * last_w
    at_v = 0.5 * last_v * (1.0 + (v / width if width > 0.0 else 0.0))
    at_r = extent * last_r
    i = min(int(at_e), last_e - 1)
    j = min(int(at_w), last_w - 1)
    k = min(int(at_v), last_v - 1)
    n = min(int(at_r), last_r - 1)
    at_e -= i
    at_w -= j
    at_v -= k
    at_r -= n
    sum_t = 0.0
    sum_b = 0.0
    sum_m = 0.0
    for di in range(2):
        part_e = at_e if di == 1 else 1.0 - at_e
        for dj in range(2):
            part_w = part_e * (at_w if dj == 1 else 1.0 - at_w)
            for dk in range(2):
                part = part_w * (at_v if dk == 1 else 1.0 - at_v)
                far = part * at_r
                near = part - far
                sum_t += (
                    near * values[i + di, j + dj, k + dk, n, 0]
                    + far * values[i + di, j + dj, k + dk, n + 1, 0]
                )
                sum_b += (
                    near * values[i + di, j + dj, k + dk, n, 1]
                    + far * values[i + di, j + dj, k + dk, n + 1, 1]
                )
                sum_m += (
                    near * values[i + di, j + dj, k + dk, n, 2]
                    + far * values[i + di, j + dj, k + dk, n + 1, 2]
                )
    extent *= UNIT
    fx = -extent * sum_t * (u / r)
    fy = -extent * (sum_t * (v / r) + sum_b)
    mz = extent * sum_m
    square = fx * fx + fy * fy
    if square > 1.0:
        scale = 1.0 / math.sqrt(square)
        fx *= scale
        fy *= scale
    return fx, sign * fy, sign * mz


@lru_cache(maxsize=1)
def _read() -> NDArray[np.int16]:
    try:
        with np.load(TABLE_FILE, allow_pickle=False) as stored:
            values = np.asarray(stored["differences"])
    except (OSError, KeyError, ValueError) as error:
        raise InputFileError(
            f"{TABLE_FILE} is not the package's table ({error}); install railenv again"
        ) from error
    if values.shape != (3, *NODES) or values.dtype != np.int16:
        raise InputFileError(
            f"{TABLE_FILE} holds {values.dtype} {values.shape}, not int16 {(3, *NODES)}; "
            "install railenv again"
        )
    for axis in range(1, 5):
        values = np.cumsum(values, axis=axis, dtype=np.int16)  # exact: both ways modulo 2^16
    return np.ascontiguousarray(np.moveaxis(values, 0, -1))


def fastsim_table() -> NDArray[np.int16]:
    """Return the table, shape (*NODES, 3), a new array every time.

    Raises:
        InputFileError: The file that comes with the package is missing or of another version.
    """
    return _read().copy()
