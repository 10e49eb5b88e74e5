"""The sums of rows that the physics step is made of, against plain loops."""

import numpy as np
import pytest
from numba import njit

from railenv.simulation.stepping import add_rows
from railenv.units import FloatArray


@njit
def added(
    rows: FloatArray, number: int, values: FloatArray, first: int, start: FloatArray
) -> FloatArray:
    sums = start.copy()
    add_rows(rows, number, values, first, sums)
    return sums


def by_loops(
    rows: FloatArray, number: int, values: FloatArray, first: int, start: FloatArray
) -> FloatArray:
    sums = start.copy()
    for j in range(0, rows.shape[1], 4):
        a, b, c, d = (rows[number, j + k] * values[first + j + k] for k in range(4))
        sums += a + b + c + d
    return sums


# Every way to put blocks of 40, 24, 8 columns and single ones together.
@pytest.mark.parametrize("columns", [0, 1, 7, 8, 24, 33, 40, 44, 95])
@pytest.mark.parametrize("count", [0, 4, 52])
def test_sums_of_rows_are_those_of_plain_loops_to_the_last_bit(columns: int, count: int) -> None:
    rng = np.random.default_rng(columns)
    rows, values = rng.standard_normal((3, count, columns)), rng.standard_normal(count + 5)
    start = rng.standard_normal(columns)
    for number, first in ((0, 0), (2, 5)):
        arguments = rows, number, values, first, start
        np.testing.assert_array_equal(added(*arguments), by_loops(*arguments))
