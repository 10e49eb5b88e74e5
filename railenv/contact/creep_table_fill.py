"""Fill the table that `railenv.contact.creep_table` reads.

    python -m railenv.contact.creep_table_fill

sums FASTSIM on a fine grid at every node (some minutes) and writes the file beside the code. To be
run again whenever `railenv.contact.fastsim.normalised_forces` or the table's coordinates change; a
test compares nodes of the stored table with FASTSIM.
"""

import math
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

from railenv.contact.creep_table import HALF_EXTENT, NODES, OUTERMOST_SHAPE, TABLE_FILE, UNIT
from railenv.contact.fastsim import normalised_forces

STRIPS, STEPS = 48, 96
"""FASTSIM's grid at every node."""

_NEAR_AXIS = 1e-2  # F_x / u is taken this far from u = 0, where it is even in u and so flat
_NEAR_END = 1e-6  # likewise for creepages of nothing and without end


@njit
def _direction(share: float, d: float) -> tuple[float, float, float]:
    """Return u/r, v/r, w/r of a spin share and a direction."""
    plane = (1.0 - share) / math.sqrt(d * d + (1.0 - abs(d)) ** 2)
    u, v = plane * (1.0 - abs(d)), plane * d
    r = math.sqrt(u * u + v * v + share * share)
    return u / r, v / r, share / r


@njit
def node(e: float, share: float, d: float, extent: float) -> tuple[float, float, float]:
    """Return T, B and M at a node given by shape, spin share, direction and extent."""
    extent = min(max(extent, _NEAR_END), 1.0 - _NEAR_END)
    r = HALF_EXTENT * extent / (1.0 - extent)
    u, v, w = _direction(share, d)
    near_share = min(share, 1.0 - _NEAR_AXIS)
    near_d = min(max(d, _NEAR_AXIS - 1.0), 1.0 - _NEAR_AXIS)
    x, y, z = _direction(near_share, near_d)
    fx, fy, mz = normalised_forces(r * x, r * y, r * z, e, STRIPS, STEPS, False)
    t = -fx / (extent * x)
    if near_share != share or near_d != d:
        fx, fy, mz = normalised_forces(r * u, r * v, r * w, e, STRIPS, STEPS, False)
    return t, -fy / extent - t * v, mz / extent


@njit
def _fill(values: NDArray[np.float64]) -> None:
    count_e, count_w, count_v, count_r = values.shape[:4]
    for i in range(count_e):
        e = OUTERMOST_SHAPE * (2.0 * i / (count_e - 1) - 1.0)
        for j in range(count_w):
            for k in range(count_v):
                for n in range(count_r):
                    t, b, m = node(
                        e, j / (count_w - 1), 2.0 * k / (count_v - 1) - 1.0, n / (count_r - 1)
                    )
                    values[i, j, k, n, 0] = t
                    values[i, j, k, n, 1] = b
                    values[i, j, k, n, 2] = m


def write_table(path: Path = TABLE_FILE) -> None:
    """Fill the table and write it.

    Args:
        path: File to write, ending in .npz.

    Raises:
        OverflowError: A number does not fit; the unit is too small.
    """
    values = np.zeros((*NODES, 3))
    _fill(values)
    whole = np.rint(values / UNIT)
    if float(np.max(np.abs(whole))) > np.iinfo(np.int16).max:
        raise OverflowError(f"largest number {np.max(np.abs(values)):g} is too large for the unit")
    differences = np.moveaxis(whole, -1, 0).astype(np.int16)
    for axis in range(1, 5):
        first = np.zeros_like(differences.take([0], axis=axis))
        differences = np.diff(differences, axis=axis, prepend=first)
    np.savez_compressed(path, differences=differences)


if __name__ == "__main__":
    write_table()
