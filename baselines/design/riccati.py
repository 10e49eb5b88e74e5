"""Riccati, Stein and Lyapunov equations in discrete time, by doubling.

Doubling squares the number of periods looked at with every pass: 10 to 20 passes of matrix products
reach the limit, whatever zero eigenvalues the delay lines bring. scipy's solver, which takes a
pencil of twice the size apart, needs 20 to 60 times as long for the 250 states of a track in
preview. Every solution is judged by its residual.
"""

import numpy as np
from scipy import linalg

from railenv.errors import RailenvError
from railenv.units import FloatArray

_MOST_PASSES = 60
_SETTLED = 1e-14
_OUT_OF_BOUNDS = 1e100
RESIDUAL = 1e-8
"""Largest relative residual of a solution that is accepted."""


def solve_riccati(A: FloatArray, G: FloatArray, Q: FloatArray) -> FloatArray:
    """Return the stabilising X of X = A' X (I + G X)^-1 A + Q.

    By the structured doubling algorithm (Chu, Fan, Lin, Wang 2004, Int. J. Control 77, 767).

    Args:
        A: Shape (n, n).
        G: Symmetric, positive semidefinite, shape (n, n).
        Q: Symmetric, positive semidefinite, shape (n, n).

    Raises:
        RailenvError: There is no stabilising solution, or rounding spoils it.
    """
    a, g, x = A.copy(), G.copy(), Q.copy()
    for _ in range(_MOST_PASSES):
        try:
            # numpy's solver does not warn of bad conditioning: the residual is the judge.
            both = np.linalg.solve(np.eye(len(a)) + g @ x, np.hstack([a, g]))
        except np.linalg.LinAlgError:
            break
        inner, spread = both[:, : len(a)], both[:, len(a) :]
        grown = a.T @ x @ inner
        g = g + a @ spread @ a.T
        a = a @ inner
        x = x + (grown + grown.T) / 2
        g = (g + g.T) / 2
        # What has a solution stays far from here; this ends before anything overflows.
        if not np.max([np.abs(part).max() for part in (a, g, x)]) < _OUT_OF_BOUNDS:
            break
        if linalg.norm(grown) <= _SETTLED * linalg.norm(x):
            if riccati_residual(A, G, Q, x) <= RESIDUAL:
                return x
            break
    raise RailenvError(
        "the Riccati equation has no solution that can be computed: some motion is neither stable "
        "nor within reach; change the effort, the noise or the sensors"
    )


def riccati_residual(A: FloatArray, G: FloatArray, Q: FloatArray, X: FloatArray) -> float:
    """Return the residual of X = A' X (I + G X)^-1 A + Q over the norm of X."""
    right = A.T @ X @ np.linalg.solve(np.eye(len(A)) + G @ X, A) + Q
    return float(linalg.norm(right - X) / linalg.norm(X))


def solve_stein(left: FloatArray, right: FloatArray, constant: FloatArray) -> FloatArray:
    """Return the X of X = left X right + constant, with stable left and right.

    Raises:
        RailenvError: left and right are not stable enough for the sum to settle.
    """
    X, a, b = constant.copy(), left.copy(), right.copy()
    for _ in range(_MOST_PASSES):
        step = a @ X @ b
        X = X + step
        size, change = float(np.abs(X).max(initial=0.0)), float(np.abs(step).max(initial=0.0))
        if change <= _SETTLED * size:
            return X
        # What is stable has settled long before its square or its sum come near overflow.
        if not max(size, float(np.abs(a).max()), float(np.abs(b).max())) < _OUT_OF_BOUNDS:
            break
        a, b = a @ a, b @ b
    raise RailenvError("the loop is not stable: its mean squares grow without end")


def solve_lyapunov(A: FloatArray, W: FloatArray) -> FloatArray:
    """Return the covariance X of x_(k+1) = A x_k + noise of covariance W: X = A X A' + W."""
    X = solve_stein(A, A.T, W)
    return (X + X.T) / 2
