"""Characteristic roots of a delay system, to rounding.

Seeds come from Chebyshev collocation of the delayed signals only: each w(t, theta) = R x(t + theta)
obeys the transport equation dw/dt = dw/dtheta on [-tau, 0], so that the matrix has n + r N rows (n
states, r independent delayed signals, N nodes) instead of n (N + 1). Every seed is then corrected
by Newton's iteration on M(s) x = 0 with the full matrices, and the number of nodes is doubled
until the wanted roots no longer move. The result is an estimate at rounding accuracy; it is not
proved.
"""

from collections.abc import Sequence

import numpy as np
from scipy import linalg

from railenv.errors import ArgumentError, check_count
from railenv.stability.delay_system import DelaySystem
from railenv.stability.modes import Mode, modes_of_matrix, normalised
from railenv.units import ComplexArray, FloatArray

_FIRST_NODES = 16
_MOST_NODES = 256
# A seed that Newton moves by more than this (relative) came from a grid too coarse.
_SEED_TOLERANCE = 1e-5
# Convergence is quadratic: after a relative step of this size only rounding is left.
_LAST_STEP = 1e-8
_NEWTON_STEPS = 30


def rightmost_roots(
    system: DelaySystem, delay: float | Sequence[float] = 0.0, count: int = 10
) -> list[Mode]:
    """Return the characteristic roots with the largest real parts.

    Args:
        system: The loop.
        delay: One delay for all channels or one per channel [s].
        count: How many; a conjugate pair counts once.

    Returns:
        Modes by falling real part; fewer than `count` only if the system has no more (no delay).
        Estimated to rounding, not proved.

    Raises:
        ArgumentError: A bad delay or count, or so many roots asked for that the finest grid
            (256 nodes per signal) does not resolve them.
    """
    wanted = check_count("count", count)
    delays = system.delays(delay)
    scaled = system.scaled
    nodes = _FIRST_NODES
    while True:
        seeds = modes_of_matrix(collocation_matrix(scaled, delays, nodes), scaled.num_states)
        if not np.any(delays > 0.0):
            found = seeds[:wanted]
            break
        corrected = _corrected(scaled, delays, seeds, wanted)
        if corrected is not None:
            found = corrected
            break
        nodes *= 2
        if nodes > _MOST_NODES:
            raise ArgumentError(
                f"count = {wanted} roots at delay = {delays.max():g} s are more than "
                f"{_MOST_NODES} nodes per signal resolve; ask for fewer"
            )
    return [Mode(mode.root, normalised(mode.shape * system.state_scale)) for mode in found]


def count_unstable(system: DelaySystem, delay: float | Sequence[float] = 0.0) -> int:
    """Return the number of roots with positive real part (a pair counts twice); not proved."""
    count = 8
    while True:
        modes = rightmost_roots(system, delay, count)
        if len(modes) < count or modes[-1].root.real <= 0.0:
            return sum(2 if m.root.imag > 0.0 else 1 for m in modes if m.root.real > 0.0)
        count *= 2


def collocation_matrix(system: DelaySystem, delays: FloatArray, nodes: int) -> FloatArray:
    """Return the matrix of the collocated system, shape (n + r N, n + r N).

    Args:
        system: The loop.
        delays: One delay per channel, shape (m,) [s].
        nodes: Chebyshev nodes N per delayed signal.
    """
    n = system.num_states
    difference = _chebyshev_difference(nodes)
    matrix = system.A.copy()
    for tau in np.unique(delays):
        L, R = system.factor([k for k in range(system.num_channels) if delays[k] == tau])
        rank = R.shape[0]
        if tau == 0.0:
            matrix[:n, :n] -= L @ R
            continue
        slope = 2.0 / tau * difference[1:]
        size = matrix.shape[0]
        grown = np.zeros((size + rank * nodes, size + rank * nodes))
        grown[:size, :size] = matrix
        # Node 0 is theta = 0, where the signal is R x itself; the last node is theta = -tau.
        grown[size:, :n] = np.kron(slope[:, :1], R)
        grown[size:, size:] = np.kron(slope[:, 1:], np.eye(rank))
        if rank:
            grown[:n, -rank:] -= L
        matrix = grown
    return matrix


def _chebyshev_difference(nodes: int) -> FloatArray:
    """Differentiation matrix on cos(k pi / N), k = 0..N, from 1 to -1 (Trefethen 2000, ch. 6)."""
    k = np.arange(nodes + 1)
    x = np.cos(np.pi * k / nodes)
    c = np.where((k == 0) | (k == nodes), 2.0, 1.0) * (-1.0) ** k
    D = np.outer(c, 1.0 / c) / (x[:, None] - x[None, :] + np.eye(nodes + 1))
    return D - np.diag(D.sum(axis=1))


def _corrected(
    system: DelaySystem, delays: FloatArray, seeds: list[Mode], wanted: int
) -> list[Mode] | None:
    """Correct the rightmost seeds; None if the grid was too coarse to trust them."""
    found: list[Mode] = []
    # One seed more than wanted, so that the order at the edge is decided after correction.
    for seed in seeds[: wanted + 1]:
        mode = newton(system, delays, seed)
        if mode is None or abs(mode.root - seed.root) > _SEED_TOLERANCE * max(abs(mode.root), 1.0):
            return None
        found.append(mode)
    found.sort(key=lambda mode: -mode.root.real)
    return found[:wanted]


def newton(system: DelaySystem, delays: FloatArray, seed: Mode) -> Mode | None:
    """Correct one root by Newton's iteration on M(s) x = 0 with singular vectors.

    The step is u^H M v / u^H M' v with u, v the singular vectors of the smallest singular value,
    which stays defined at semisimple multiple roots where a bordered system is singular.

    Returns:
        The corrected mode, or None if the iteration does not settle.
    """
    s = complex(seed.root)
    best, best_size = s, np.inf
    vector: ComplexArray = seed.shape
    for _ in range(_NEWTON_STEPS):
        M = system.characteristic_matrix(s, delays)
        if not np.all(np.isfinite(M)):
            return None
        U, sizes, V = linalg.svd(M)
        u, v = U[:, -1], np.conj(V[-1])
        if sizes[-1] < best_size:
            best, best_size, vector = s, sizes[-1], v
        slope = np.vdot(u, system.characteristic_derivative(s, delays) @ v)
        if sizes[-1] <= 1e-15 * sizes[0] or slope == 0.0:
            break
        step = sizes[-1] / slope
        s -= step
        if abs(step) <= _LAST_STEP * max(abs(s), 1.0):
            best, vector = s, v
            break
    else:
        # At a multiple root the last digits keep moving; the smallest residual tells.
        if best_size > 1e-12 * np.linalg.norm(system.characteristic_matrix(best, delays), 2):
            return None
    if abs(best.imag) <= 1e-12 * abs(best) and seed.root.imag == 0.0:
        best = complex(best.real)
    return Mode(best, vector)
