"""Pade model of a delayed loop, as in section 4 of the source paper.

The diagonal Pade approximant of exp(-s tau) of order N is realised as a lossless ladder: with r_k
the first Routh column of its denominator (a reverse Bessel polynomial in s tau / 2),

    T tridiagonal, T_11 = -N (N + 1) / 2, T_(k+1,k) = -T_(k,k+1) = sqrt(r_(k+1) / r_(k-1))
    A = (2 / tau) T, B = sqrt(2 N (N + 1) / tau) e_1, C = -D B^T, D = (-1)^N.

It satisfies A + A^T + B B^T = 0, so it is perfectly balanced; a companion form of the same transfer
function has entries beyond 1e30 at order 8 and 2 ms. Every channel carries a block of its own.

The paper's order rule for a correlation of at least 0.99: 3.631 tau / T + 0.421, rounded up, with T
the period of the fastest motion of interest. A low order errs on the unsafe side: its critical
delay is too large.
"""

import math
from fractions import Fraction
from functools import cache

import numpy as np

from railenv.errors import ArgumentError, check_count, check_not_negative, check_positive
from railenv.stability.crossings import CriticalDelays, Crossing
from railenv.stability.delay_system import DelaySystem
from railenv.stability.modes import Mode, modes_of_matrix
from railenv.units import FloatArray

# Spacing of the scan for crossings of the Pade model [s]; the paper steps by 2 ms.
_SCAN_STEP = 0.002
_MOST_SCANNED = 10_000

MAX_ORDER = 64
"""Highest order offered; nothing is gained beyond 16 for omega tau up to 4 pi."""


def pade_block(order: int, delay: float) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Return the ladder realisation of the diagonal Pade approximant of exp(-s delay).

    Args:
        order: Order N, 1 to `MAX_ORDER`.
        delay: Delay [s], above zero.

    Returns:
        A, shape (N, N), B, shape (N,), C, shape (N,), and D.

    Raises:
        ArgumentError: The order or the delay is out of range.
    """
    N = _check_order(order)
    tau = check_positive("delay", delay, "seconds")
    T = np.zeros((N, N))
    T[0, 0] = -N * (N + 1) / 2
    for k, link in enumerate(_ladder_links(N)):
        T[k + 1, k], T[k, k + 1] = link, -link
    B = np.zeros(N)
    B[0] = math.sqrt(2 * N * (N + 1) / tau)
    D = -1.0 if N % 2 else 1.0
    return T * (2 / tau), B, B * -D, D


def pade_matrix(system: DelaySystem, delay: float, order: int) -> FloatArray:
    """Return the closed-loop matrix with each channel's delay replaced by a Pade block.

    Args:
        system: The loop.
        delay: Common delay [s], zero or more; zero gives A - B K.
        order: Order N.

    Returns:
        Matrix of the vehicle's states followed by the blocks' states, shape (n + m N, n + m N).

    Raises:
        ArgumentError: The order or the delay is out of range.
    """
    system.require_retarded("the Pade model")
    N = _check_order(order)
    if check_not_negative("delay", delay, "seconds") == 0.0:
        return system.undelayed
    A, B, C, D = pade_block(N, delay)
    eye = np.eye(system.num_channels)
    matrix = np.block(
        [
            [system.A - D * system.B @ system.K, -system.B @ np.kron(eye, C[None, :])],
            [np.kron(eye, B[:, None]) @ system.K, np.kron(eye, A)],
        ]
    )
    return np.asarray(matrix, dtype=np.float64)


def pade_roots(system: DelaySystem, delay: float, order: int, count: int = 10) -> list[Mode]:
    """Return the rightmost eigenvalues of the Pade model.

    Args:
        system: The loop.
        delay: Common delay [s].
        order: Order N.
        count: How many, at most; one per conjugate pair.

    Returns:
        Modes by falling real part, shapes over the system's states. An estimate of the delay
        system's roots, not proved.
    """
    matrix = pade_matrix(system.scaled, delay, order)
    scale = np.concatenate([system.state_scale, np.ones(matrix.shape[0] - system.num_states)])
    return modes_of_matrix(matrix, system.num_states, scale)[: check_count("count", count)]


def required_order(delay: float, frequency_hz: float) -> int:
    """Return the paper's order for a correlation of at least 0.99, 3.631 f tau + 0.421, rounded up.

    Args:
        delay: Delay [s].
        frequency_hz: Highest frequency of interest [Hz].
    """
    tau = check_not_negative("delay", delay, "seconds")
    frequency = check_positive("frequency_hz", frequency_hz, "Hz")
    return math.ceil(3.631 * tau * frequency + 0.421)


def pade_critical_delays(system: DelaySystem, order: int, max_delay: float = 2.0) -> CriticalDelays:
    """Find the crossings of the Pade model by counting unstable eigenvalues over the delay.

    Args:
        system: The loop.
        order: Order N.
        max_delay: Longest delay searched [s].

    Returns:
        The crossings. An estimate: a low order errs on the unsafe side, and a pair of crossings
        closer than `_SCAN_STEP` may be missed.

    Raises:
        ArgumentError: The order or the longest delay is out of range.
    """
    longest = check_positive("max_delay", max_delay, "seconds")
    if longest > _SCAN_STEP * _MOST_SCANNED:
        raise ArgumentError(
            f"max_delay = {longest:g} s takes more than {_MOST_SCANNED} steps of {_SCAN_STEP:g} s; "
            "give a shorter one"
        )
    scaled = system.scaled

    def unstable(delay: float) -> int:
        return int(np.sum(np.linalg.eigvals(pade_matrix(scaled, delay, order)).real > 0.0))

    grid = np.linspace(0.0, longest, math.ceil(longest / _SCAN_STEP) + 1)
    counts = [unstable(float(tau)) for tau in grid]
    found: list[Crossing] = []
    intervals = list(zip(grid, grid[1:], counts, counts[1:], strict=False))
    while intervals:
        low, high, below, above = intervals.pop(0)
        if below == above:
            continue
        if high - low > 1e-12 * longest:
            middle = (low + high) / 2
            number = unstable(float(middle))
            intervals[:0] = [(low, middle, below, number), (middle, high, number, above)]
            continue
        modes = pade_roots(system, float(high), order, count=system.num_states)
        nearest = min(modes, key=lambda m: abs(m.root.real) + 1e9 * (m.root.imag == 0.0))
        on_axis = Mode(1j * nearest.root.imag, nearest.shape)
        direction = 1 if above > below else -1
        crossing = Crossing(float(high), on_axis, direction, complex(np.nan))
        found += [crossing] * max(1, abs(above - below) // 2)
    return CriticalDelays(tuple(found), counts[0], longest)


@cache
def _ladder_links(order: int) -> tuple[float, ...]:
    """Off-diagonal entries of T, from exact fractions."""
    N = order
    # Reverse Bessel polynomial, coefficient of p^(N-k): (N+k)! / ((N-k)! k! 2^k).
    coefficients = [
        Fraction(math.factorial(N + k), math.factorial(N - k) * math.factorial(k) * 2**k)
        for k in range(N + 1)
    ]
    above, row = coefficients[0::2], coefficients[1::2]
    column = [above[0], row[0]]
    while len(column) <= N:
        ratio = above[0] / row[0]
        padded = [*row[1:], *([Fraction(0)] * len(above))]
        above, row = row, [a - ratio * b for a, b in zip(above[1:], padded, strict=False)]
        column.append(row[0])
    return tuple(math.sqrt(column[k + 2] / column[k]) for k in range(N - 1))


def _check_order(order: int) -> int:
    N = check_count("order", order)
    if N > MAX_ORDER:
        raise ArgumentError(f"order = {N} is above {MAX_ORDER}; nothing is gained beyond 16")
    return N
