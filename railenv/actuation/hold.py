"""Exact discretisation of x' = A x + B u under held and under linearly varying inputs.

Everything is a block of a matrix exponential (Van Loan 1978), valid for singular A too.
"""

import numpy as np
from scipy import linalg

from railenv.units import FloatArray


def held_input(A: FloatArray, B: FloatArray, duration: float) -> tuple[FloatArray, FloatArray]:
    """Return the transition over a time in which the input is constant.

    Args:
        A: Shape (n, n).
        B: Shape (n, m).
        duration: Time [s], zero or more.

    Returns:
        exp(A t), shape (n, n), and the integral of exp(A s) B over s in [0, t], shape (n, m).
    """
    n, m = B.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = A, B
    transition = linalg.expm(block * duration)
    return transition[:n, :n], transition[:n, n:]


def ramped_input(
    A: FloatArray, E: FloatArray, E_rate: FloatArray, duration: float
) -> tuple[FloatArray, FloatArray]:
    """Return the effect of an input that moves linearly from w_0 to w_1, with its rate.

    For x' = A x + E w + E_rate w': x(t) = exp(A t) x(0) + W_0 w_0 + W_1 w_1 (first-order hold).

    Args:
        A: Shape (n, n).
        E: Input columns, shape (n, k).
        E_rate: Columns of the input's rate, shape (n, k).
        duration: Time t [s], above zero.

    Returns:
        W_0 and W_1, each of shape (n, k).
    """
    n, k = E.shape
    block = np.zeros((n + 2 * k, n + 2 * k))
    block[:n, :n], block[:n, n : n + k] = A, E
    block[n : n + k, n + k :] = np.eye(k)
    transition = linalg.expm(block * duration)
    held, ramp = transition[:n, n : n + k], transition[:n, n + k :]
    _, rate = held_input(A, E_rate, duration)
    W_1 = (ramp + rate) / duration
    return held - W_1, W_1
