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
# A seed that Newton moves by less than this (relative) is a root that the grid resolves.
_SEED_TOLERANCE = 1e-5
# A seed that moves by more than this has nothing to do with the root it ends at.
_SEED_REACH = 0.3
# Convergence is quadratic: after a relative step of this size only rounding is left.
_LAST_STEP = 1e-8
_NODES_TO_SPARE = 8
# Allowance for the seed's own error in the bound on its size.
_SLACK = 1.1
# Part of |s| to the left of the imaginary axis that is searched when unstable roots are counted.
_NEAR_AXIS = 0.2
_NEWTON_STEPS = 30
# exp of more than this is not looked at; such a root has decayed long before one delay has passed.
_LARGEST_EXPONENT = 300.0


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
    system.require_retarded("rightmost_roots")
    wanted = check_count("count", count)
    delays = system.delays(delay)
    scaled = system.scaled
    nodes = _FIRST_NODES
    before: list[Mode] | None = None
    while True:
        seeds = modes_of_matrix(collocation_matrix(scaled, delays, nodes), scaled.num_states)
        if not np.any(delays > 0.0) or not np.any(scaled.B @ scaled.K):
            found = seeds[:wanted]
            break
        found, trusted = _corrected(scaled, delays, seeds, wanted)
        if len(found) == wanted and (
            trusted
            or (_same(before, found) and nodes >= _required(scaled, delays, found[-1].root.real))
        ):
            break
        before = found
        nodes *= 2
        if nodes > _MOST_NODES:
            raise ArgumentError(
                f"count = {wanted} roots at delay = {delays.max():g} s do not settle on "
                f"{_MOST_NODES} nodes per signal: the later ones decay within one delay; "
                "ask for fewer"
            )
    return [Mode(mode.root, normalised(mode.shape * system.state_scale)) for mode in found]


def count_unstable(system: DelaySystem, delay: float | Sequence[float] = 0.0) -> int:
    """Return the number of roots with positive real part; a conjugate pair counts twice.

    Every eigenvalue of the grid that lies near the imaginary axis or to the right of it is
    corrected; the grid is refined until all of them are roots, or until two grids agree that
    resolve every frequency at which the loop gain allows an unstable root. An estimate, not proved.

    Raises:
        ArgumentError: A bad delay, or the finest grid does not settle the count.
    """
    system.require_retarded("count_unstable")
    delays = system.delays(delay)
    scaled = system.scaled
    nodes = _FIRST_NODES
    before: int | None = None
    while nodes <= _MOST_NODES:
        seeds = modes_of_matrix(collocation_matrix(scaled, delays, nodes), scaled.num_states)
        if not np.any(delays > 0.0):
            return _number_unstable(seeds)
        near = [seed for seed in seeds if seed.root.real > -_NEAR_AXIS * abs(seed.root)]
        found, trusted = _corrected(scaled, delays, near, len(near))
        number = _number_unstable(found)
        if trusted or (number == before and nodes >= _required(scaled, delays, 0.0)):
            return number
        before = number
        nodes *= 2
    raise ArgumentError(
        f"the count at delay = {delays.max():g} s does not settle on {_MOST_NODES} nodes per "
        "signal; give a delay that is shorter against the system's own times"
    )


def _number_unstable(modes: list[Mode]) -> int:
    return sum(2 if m.root.imag > 0.0 else 1 for m in modes if m.root.real > 0.0)


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
) -> tuple[list[Mode], bool]:
    """Correct seeds from the right until enough roots are found.

    The grid also has eigenvalues that are no roots: they stand beyond what it resolves, and Newton
    takes them far away or nowhere. They are passed over, and then the list is not to be trusted
    before a finer grid has given it again.

    Returns:
        Up to `wanted` roots by falling real part, and whether every seed looked at was a root.
    """
    settled: list[Mode] = []
    moved: list[Mode] = []
    trusted = True
    plant = float(np.linalg.norm(system.A, 2))
    feedback = np.linalg.norm(system.B, axis=0) * np.linalg.norm(system.K, axis=1)
    for seed in seeds:
        # One more than wanted, so that the order at the edge is decided after correction.
        if len(settled) + len(moved) > wanted:
            break
        # s x = A x - sum b_i K_i exp(-s tau_i) x: no root is larger than its own right-hand side.
        decay = np.minimum(-seed.root.real * delays, _LARGEST_EXPONENT)
        if abs(seed.root) > _SLACK * (plant + float(feedback @ np.exp(decay))):
            trusted = False
            continue
        mode = newton(system, delays, seed)
        size = max(abs(seed.root), 1e-6 * plant)
        if mode is not None and abs(mode.root - seed.root) <= _SEED_TOLERANCE * size:
            # Each settled seed is a root of its own (multiple roots have several); a seed that
            # moved to the same place before was not.
            moved = [m for m in moved if abs(m.root - mode.root) > _SEED_TOLERANCE * size]
            settled.append(mode)
            continue
        trusted = False
        if mode is None or abs(mode.root - seed.root) > _SEED_REACH * size:
            continue
        if all(abs(mode.root - m.root) > _SEED_TOLERANCE * size for m in settled + moved):
            moved.append(mode)
    found = sorted(settled + moved, key=lambda mode: -mode.root.real)
    return found[:wanted], trusted


def _required(system: DelaySystem, delays: FloatArray, real: float) -> float:
    """Return the nodes that resolve every root with at least this real part.

    At a root s the loop gain |exp(-s tau) K (s I - A)^-1 B| is one or more. The largest frequency
    at which it can be, at this real part, is looked for on a grid with the plant's own
    frequencies; N nodes resolve omega tau up to 2 N, less a few nodes for accuracy.
    """
    weight = np.exp(np.minimum(-real * delays, _LARGEST_EXPONENT))
    norms = np.linalg.norm(system.B, axis=0) * np.linalg.norm(system.K, axis=1)
    largest = float(np.linalg.norm(system.A, 2) + norms @ weight)
    own = np.abs(np.linalg.eigvals(system.A).imag)
    grid = np.geomspace(1e-9 * largest, largest, 600)
    omega = np.unique(np.concatenate([grid, *(own[own > 0.0] * f for f in (0.97, 1.0, 1.03))]))
    s = real + 1j * omega[:, None, None] * (1.0 + 1e-9)
    gain = (system.K * weight[:, None]) @ np.linalg.solve(
        s * np.eye(system.num_states) - system.A, system.B.astype(np.complex128)
    )
    # One common delay turns all channels alike: then only the eigenvalues count.
    common = bool(np.all(delays == delays[0]))
    size = (
        np.abs(np.linalg.eigvals(gain)).max(axis=1)
        if common
        else np.linalg.norm(gain, ord=2, axis=(1, 2))
    )
    allowed = np.flatnonzero(size >= 1.0 / _SLACK)
    if allowed.size == 0:
        return 0.0
    highest = omega[min(int(allowed[-1]) + 1, len(omega) - 1)]
    return float(highest * delays.max()) / 2.0 + _NODES_TO_SPARE


def _same(before: list[Mode] | None, now: list[Mode]) -> bool:
    """Whether two grids gave the same full list of roots."""
    if before is None or len(before) < len(now):
        return False
    return all(
        abs(a.root - b.root) <= _SEED_TOLERANCE * abs(b.root)
        for a, b in zip(before, now, strict=True)
    )


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
        if -s.real * delays.max() > _LARGEST_EXPONENT:
            return None
        M = system.characteristic_matrix(s, delays)
        U, sizes, V = linalg.svd(M)
        u, v = U[:, -1], np.conj(V[-1])
        if sizes[-1] < best_size:
            best, best_size, vector = s, sizes[-1], v
        slope = np.vdot(u, system.characteristic_derivative(s, delays) @ v)
        if sizes[-1] <= 1e-15 * sizes[0]:
            # This very s, and not the best so far: far to the left M is huge and tells nothing.
            best, vector = s, v
            break
        if slope == 0.0:
            return None
        step = sizes[-1] / slope
        s -= step
        if abs(step) <= _LAST_STEP * max(abs(s), 1e-9 * sizes[0]):
            best, vector = s, v
            break
    else:
        # At a multiple root the last digits keep moving; the smallest residual tells.
        if best_size > 1e-12 * np.linalg.norm(system.characteristic_matrix(best, delays), 2):
            return None
    if abs(best.imag) <= 1e-12 * abs(best) and seed.root.imag == 0.0:
        best = complex(best.real)
    return Mode(best, vector)
