"""A matrix applied to every lane of a batch, each lane's numbers independent of the others.

A matrix library shares its sums among lanes in ways that depend on how many there are. Here every
sum runs over the columns in their order, zeros left out: the laws with a pipe of commands in them
are mostly zeros.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from railenv.units import FloatArray


class LaneMatrix:
    """A constant matrix, ready to be applied.

    Args:
        matrix: Shape (rows, columns).
    """

    def __init__(self, matrix: FloatArray) -> None:
        rows, self._columns = np.nonzero(matrix)
        self._values = np.ascontiguousarray(matrix[rows, self._columns])
        self._first = np.searchsorted(rows, np.arange(len(matrix) + 1))

    def __call__(self, lanes: FloatArray) -> FloatArray:
        """Return matrix @ lanes, a new array.

        Args:
            lanes: One column per lane, shape (columns, lanes), contiguous.
        """
        result = np.empty((len(self._first) - 1, lanes.shape[1]))
        _apply(self._first, self._columns, self._values, lanes, result)
        return result

    def advance(self, lanes: FloatArray, bound: float) -> None:
        """Replace the states in the first rows by matrix @ lanes, in place.

        Args:
            lanes: States, then what drives them, one column per lane, shape (columns, lanes),
                contiguous.
            bound: A lane that would get a number beyond it, or none at all, keeps its states.
        """
        following = np.empty((len(self._first) - 1, lanes.shape[1]))
        _apply(self._first, self._columns, self._values, lanes, following)
        _take_over(following, lanes, bound)


@njit(cache=True, nogil=True, error_model="numpy")
def _apply(
    first: NDArray[np.int64],
    columns: NDArray[np.int64],
    values: FloatArray,
    lanes: FloatArray,
    result: FloatArray,
) -> None:
    for row in range(len(result)):
        result[row] = 0.0
        for k in range(first[row], first[row + 1]):
            column, value = columns[k], values[k]
            for lane in range(result.shape[1]):
                result[row, lane] += value * lanes[column, lane]


@njit(cache=True, nogil=True, error_model="numpy")
def _take_over(following: FloatArray, lanes: FloatArray, bound: float) -> None:
    for lane in range(lanes.shape[1]):
        inside = True
        for row in range(len(following)):
            # Not a number is not inside either.
            inside &= abs(following[row, lane]) < bound
        if inside:
            lanes[: len(following), lane] = following[:, lane]
