"""The yardstick of `railenv bench-speed`: the textbook's way to the roots of any delay equation.

Breda, Maset and Vermiglio (SIAM J. Sci. Comput. 27, 2005, 482-495): the generator of the solution
semigroup, which takes the whole state history x(theta), theta in [-tau, 0], to its derivative, is
collocated on N + 1 Chebyshev points. Its eigenvalues with the largest real parts are roots of
x' = A x - sum_i b_i K_i x(t - tau_i), with spectral accuracy in N. The matrix has n (N + 1) rows
and is dense; nothing of the loop's structure is used, and nothing is corrected or proved. The
oracle does not use this module.
"""

from collections.abc import Sequence

import numpy as np

from railenv.errors import ArgumentError, check_count, check_positive
from railenv.stability import DelaySystem
from railenv.units import ComplexArray, FloatArray


def generator_matrix(
    system: DelaySystem, delay: float | Sequence[float], nodes: int = 16
) -> FloatArray:
    """Return the collocated generator, shape (n (N + 1), n (N + 1)).

    Args:
        system: The loop.
        delay: One delay for all channels or one per channel [s].
        nodes: Degree N of the interpolation; N + 1 points from 0 to minus the longest delay.

    Returns:
        Block row 0 is the equation itself, with x(-tau_i) interpolated; the others differentiate.
        Without any delay it is A - B K.

    Raises:
        NeutralLoopError: The loop is not retarded.
        ArgumentError: A bad delay or number of nodes.
    """
    system.require_retarded("the generic method")
    N = check_count("nodes", nodes)
    delays = system.delays(delay)
    longest = float(delays.max(initial=0.0))
    if longest == 0.0:
        return system.undelayed
    n = system.num_states
    points = longest / 2 * (np.cos(np.pi * np.arange(N + 1) / N) - 1.0)
    # Chebyshev points of the second kind have these barycentric weights, up to a factor.
    weights: FloatArray = np.where(np.arange(N + 1) % 2, -1.0, 1.0)
    weights[[0, -1]] /= 2
    gaps = points[:, None] - points[None, :] + np.eye(N + 1)
    difference = weights[None, :] / weights[:, None] / gaps
    difference -= np.diag(difference.sum(axis=1))
    matrix = np.asarray(np.kron(difference, np.eye(n)), dtype=np.float64)
    matrix[:n] = 0.0
    matrix[:n, :n] = system.A
    for k, tau in enumerate(delays):
        feedback = np.outer(system.B[:, k], system.K[k])
        matrix[:n] -= np.kron(_interpolation(points, weights, -float(tau))[None, :], feedback)
    return matrix


def generic_roots(
    system: DelaySystem, delay: float | Sequence[float], count: int, nodes: int = 16
) -> ComplexArray:
    """Return the eigenvalues with the largest real parts, one per conjugate pair.

    Args:
        system: The loop.
        delay: One delay for all channels or one per channel [s].
        count: How many, at most.
        nodes: Degree N.
    """
    wanted = check_count("count", count)
    values = np.linalg.eigvals(generator_matrix(system.scaled, delay, nodes))
    return rightmost_first(values.astype(np.complex128))[:wanted]


def rightmost_first(roots: ComplexArray) -> ComplexArray:
    """Return the roots on (to rounding) and above the real axis by falling real part."""
    upper = roots[roots.imag >= -1e-9 * np.abs(roots)]
    return upper[np.argsort(-upper.real)]


def generic_unstable(system: DelaySystem, delay: float | Sequence[float], nodes: int = 16) -> int:
    """Return the number of eigenvalues with positive real part; a pair counts twice."""
    values = np.linalg.eigvals(generator_matrix(system.scaled, delay, nodes))
    return int(np.sum(values.real > 0.0))


def generic_critical_delays(
    system: DelaySystem,
    max_delay: float,
    step: float = 0.01,
    nodes: int = 16,
    tolerance: float = 1e-7,
) -> list[float]:
    """Find delays at which the number of unstable roots changes: a scan, then bisection.

    Two changes within one step that cancel each other are not seen.

    Args:
        system: The loop; all channels share the delay.
        max_delay: Longest delay searched [s].
        step: Distance of the scanned delays [s].
        nodes: Degree N.
        tolerance: Width at which bisection stops [s].

    Returns:
        The middles of the last intervals, by rising delay [s].

    Raises:
        ArgumentError: A length of time is not above zero, or the tolerance is not below the step.
    """
    longest = check_positive("max_delay", max_delay, "seconds")
    spacing = check_positive("step", step, "seconds")
    width = check_positive("tolerance", tolerance, "seconds")
    if width >= spacing:
        raise ArgumentError(
            f"tolerance = {width:g} s must be below the step of {spacing:g} s; "
            "give a smaller tolerance"
        )
    grid = np.linspace(0.0, longest, int(np.ceil(longest / spacing)) + 1).tolist()
    counts = [generic_unstable(system, delay, nodes) for delay in grid]
    found: list[float] = []
    for k in range(len(grid) - 1):
        low, high, below, above = grid[k], grid[k + 1], counts[k], counts[k + 1]
        if below == above:
            continue
        while high - low > width:
            middle = (low + high) / 2
            if generic_unstable(system, middle, nodes) == below:
                low = middle
            else:
                high = middle
        found.append((low + high) / 2)
    return found


def _interpolation(points: FloatArray, weights: FloatArray, place: float) -> FloatArray:
    """Lagrange polynomials of the points at one place, in barycentric form, shape (N + 1,)."""
    distance = place - points
    hit = np.abs(distance) <= 1e-14 * abs(float(points[-1]))
    if np.any(hit):
        return hit.astype(np.float64)
    terms = weights / distance
    return terms / terms.sum()
