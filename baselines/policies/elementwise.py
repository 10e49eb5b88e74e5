"""The curved functions of the policies, each entry computed by itself.

An array library may compute several entries at once and the rest of an array by another formula, so
that what it says of one lane depends in the last digit on how many lanes there are. Here every row
is worked through by itself, entry by entry, and a lane's numbers depend on that lane alone.
"""

import math
from typing import Any

import numpy as np
from numba import njit

from railenv.units import FloatArray


@njit(cache=True, nogil=True, error_model="numpy")
def sigmoid_of(value: Any) -> float:
    """Return 1 / (1 + exp(-value)) of one number, by way of tanh, which does not overflow."""
    return 0.5 + 0.5 * math.tanh(0.5 * value)


@njit(cache=True, nogil=True, error_model="numpy")
def tanh(values: FloatArray) -> FloatArray:
    """Return tanh of every entry of a matrix, shape (lanes, columns), a new array."""
    result = np.empty(values.shape)
    for lane in range(values.shape[0]):
        for column in range(values.shape[1]):
            result[lane, column] = math.tanh(values[lane, column])
    return result


@njit(cache=True, nogil=True, error_model="numpy")
def sigmoid(values: FloatArray) -> FloatArray:
    """Return 1 / (1 + exp(-values)) of every entry, shape (lanes, columns), a new array."""
    result = np.empty(values.shape)
    for lane in range(values.shape[0]):
        for column in range(values.shape[1]):
            result[lane, column] = sigmoid_of(values[lane, column])
    return result


@njit(cache=True, nogil=True, error_model="numpy")
def softmax(logits: FloatArray) -> FloatArray:
    """Return exp(logits) of every lane over its sum, shape (lanes, columns), a new array.

    The largest logit of a lane is taken off first, so that nothing overflows; sums in a fixed
    order.
    """
    result = np.empty(logits.shape)
    for lane in range(logits.shape[0]):
        largest = logits[lane, 0]
        for column in range(1, logits.shape[1]):
            largest = max(largest, logits[lane, column])
        total = 0.0
        for column in range(logits.shape[1]):
            result[lane, column] = math.exp(logits[lane, column] - largest)
            total += result[lane, column]
        for column in range(logits.shape[1]):
            result[lane, column] /= total
    return result
