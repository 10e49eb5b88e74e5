"""Certificates for maps z_(k+1) = F z_k: a symmetric P with P - F' P F positive definite.

For a vector with F z = lambda z the inequality says (1 - |lambda|^2) z* P z > 0: no eigenvalue is
on the unit circle, and the number of those outside is the number of negative eigenvalues of P
(inertia theorem of the Stein equation, Ostrowski and Schneider 1962). P > 0 thus proves stability;
for P > 0 the difference is concave in F, so that one P which does for some maps does for all of
their convex hull, even if the map changes from step to step.

P is proposed in floating point (which may fail with LinAlgError or ValueError) and taken as the
exact doubles it is; the inequality is proved in balls.
"""

from collections.abc import Sequence

import numpy as np
from scipy import linalg

from railenv.stability.proof.ball_matrices import Matrix, balls, middles, norm_bound
from railenv.units import ComplexArray, FloatArray

# Doubling steps: 2^60 periods; what has not settled by then is on the unit circle in doubles.
_DOUBLINGS = 60
# Shares of the identity tried in the Riccati equation: large ones leave room for rounding and for
# what is not in the linear model of the uncertainty, small ones exist closer to the critical delay.
_SHARES = (0.5, 0.2, 0.05, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
# Angles at which the gain of the uncertainty is looked at: those of the largest eigenvalues, and
# even ones; and rounds of balancing it.
_NEAR, _ANGLES, _BALANCING_ROUNDS, _FLOOR = 12, 48, 30, 1e-3
# Circles that are tried when no proof is found for the unit circle.
_RADII = 3


def balancing(maps: Sequence[FloatArray]) -> FloatArray:
    """Return powers of two d so that the maps F d_j / d_i are balanced together."""
    _, (scale, _) = linalg.matrix_balance(
        np.max(np.abs(maps), axis=0), permute=False, separate=True
    )
    return np.asarray(scale, dtype=np.float64)


def point_proposal(F: FloatArray) -> FloatArray | None:
    """Propose P for one map, of whatever inertia; None if an eigenvalue seems on the circle."""
    T, Z, inside = linalg.schur(F, sort="iuc")
    k = int(inside)
    # Block-diagonal: the parts inside and outside get their own equation, so that products of
    # eigenvalues close to one do no harm.
    to_parts = Z.T.copy()
    if 0 < k < len(F):
        coupling = linalg.solve_sylvester(T[:k, :k], -T[k:, k:], -T[:k, k:])
        to_parts[:k] -= coupling @ Z[:, k:].T
    inner = _stein(T[:k, :k], np.eye(k))
    if k < len(F):
        back = np.asarray(np.linalg.inv(T[k:, k:]), dtype=np.float64)
        outer = _stein(back, back.T @ back)
    else:
        outer = np.zeros((0, 0))
    if inner is None or outer is None:
        return None
    return _symmetric(to_parts.T @ linalg.block_diag(inner, -outer) @ to_parts)


def directions(maps: FloatArray) -> list[FloatArray]:
    """Return in which directions a hull extends from its middle.

    Without the last three, which are small, P would have no room for a curved hull.

    Args:
        maps: Corners by told delay and by control point of the delay, shape (told, delays, n, n).

    Returns:
        With the delay, with what is told, with both at once, and the bends of both.
    """
    delays, told = maps.mean(axis=0), maps.mean(axis=1)
    return [
        (delays[-1] - delays[0]) / 2,
        (told[-1] - told[0]) / 2,
        (maps[-1, -1] - maps[-1, 0] - maps[0, -1] + maps[0, 0]) / 4,
        delays[len(delays) // 2] - (delays[-1] + delays[0]) / 2,
        told[len(told) // 2] - (told[-1] + told[0]) / 2 if len(told) > 2 else 0.0 * told[0],
    ]


def other_radii(F: FloatArray) -> list[float]:
    """Return radii above one with eigenvalues outside, in the widest gaps between them."""
    sizes = np.abs(np.linalg.eigvals(F))
    edges = np.sort(np.append(sizes[sizes > 1.0], 1.0))
    gaps = edges[1:] / edges[:-1]
    widest = np.argsort(-gaps)[:_RADII]
    return [float(np.sqrt(edges[i] * edges[i + 1])) for i in widest if gaps[i] > 1.0 + 1e-9]


def common_proposal(maps: Sequence[FloatArray], extents: Sequence[FloatArray]) -> FloatArray | None:
    """Propose P > 0 that may do for all maps of a hull; None if none was found.

    The hull is modelled as F + sum_i delta_i E_i, |delta_i| <= 1, and P solves the bounded-real
    Riccati equation P = F'PF + Q + C'C + F'PB (I - B'PB)^-1 B'PF with B C the stacked factors of
    the directions E_i.

    Args:
        maps: Corners of the hull, balanced.
        extents: E_i.
    """
    F = np.mean(maps, axis=0)
    B, C = _factored(extents, len(F))
    weights = _weights(F, B, C) if B.shape[1] else np.ones(0)
    if weights is None:
        return None
    inputs, outputs = B * weights, C / weights[:, None]
    plain = _stein(F, np.eye(len(F)))
    if plain is None:
        return None
    # With a share of one, what the identity adds to P would use up I - B'PB by itself.
    largest = float(np.linalg.norm(inputs.T @ plain @ inputs, 2)) if B.shape[1] else 0.0
    for share in _SHARES if largest > 0.0 else (1.0,):
        size = share / largest if largest > 0.0 else 1.0
        P = _riccati(F, inputs, outputs.T @ outputs + size * np.eye(len(F)))
        if P is not None and all(_passes(P, corner) for corner in maps):
            return P
    return None


def proved_decrease(P: FloatArray, F: Matrix) -> bool:
    """Prove P - F' P F positive definite for every matrix in F."""
    S = balls(P) - F.transpose() * (balls(P) * F)
    return inertia(S) == 0


def inertia(S: Matrix) -> int | None:
    """Return the proved number of negative eigenvalues of every symmetric matrix in S.

    None if it could not be proved, or S may be singular. X' S X is shown to be closer than one to a
    diagonal of signs for some X: by Sylvester's law the signs are those of S. S must be enclosed so
    that its entries (i, j) and (j, i) belong to one symmetric matrix.
    """
    middle = _symmetric(middles(S))
    if not np.all(np.isfinite(middle)):
        return None
    size = np.sqrt(np.abs(np.diag(middle)))
    size[size == 0.0] = 1.0
    try:
        values, vectors = linalg.eigh(middle / size / size[:, None])
    except linalg.LinAlgError:
        return None
    if np.any(values == 0.0):
        return None
    X = balls(vectors / np.sqrt(np.abs(values)) / size[:, None])
    signs = np.sign(values)
    off = X.transpose() * S * X - balls(np.diag(signs))
    return int(np.sum(signs < 0.0)) if norm_bound(off) < 1 else None


def _symmetric(P: FloatArray) -> FloatArray:
    return np.asarray((P + P.T) / 2, dtype=np.float64)


def _stein(F: FloatArray, Q: FloatArray) -> FloatArray | None:
    """Solve P = F'PF + Q by doubling; None if it does not settle."""
    total, power = Q.copy(), F.copy()
    for _ in range(_DOUBLINGS):
        more = power.T @ total @ power
        total = total + more
        power = power @ power
        if not np.all(np.isfinite(total)):
            return None
        if np.abs(more).max(initial=0.0) <= 1e-16 * np.abs(total).max(initial=0.0):
            return total
    return None


def _riccati(F: FloatArray, B: FloatArray, Q: FloatArray) -> FloatArray | None:
    """Solve P = F'PF + Q + F'PB (I - B'PB)^-1 B'PF by structured doubling; None if it fails."""
    power, spread, total, eye = F, -B @ B.T, Q, np.eye(len(F))
    for _ in range(_DOUBLINGS):
        solved = np.linalg.solve(eye + spread @ total, np.hstack([power, spread]))
        flow, wide = solved[:, : len(F)], solved[:, len(F) :]
        more = power.T @ total @ flow
        spread = _symmetric(spread + power @ wide @ power.T)
        total, power = _symmetric(total + more), power @ flow
        if not np.all(np.isfinite(total)):
            return None
        if np.abs(more).max() <= 1e-15 * np.abs(total).max():
            return total
    return None


def _passes(P: FloatArray, F: FloatArray) -> bool:
    """Say whether P and P - F'PF, scaled to a unit diagonal, factor by Cholesky."""
    for S in (P, _symmetric(P - F.T @ P @ F)):
        size = np.diag(S)
        if not np.all(size > 0.0):
            return False
        try:
            linalg.cholesky(S / np.sqrt(size) / np.sqrt(size)[:, None])
        except linalg.LinAlgError:
            return False
    return True


def _factored(extents: Sequence[FloatArray], n: int) -> tuple[FloatArray, FloatArray]:
    """Return B and C with sum_i delta_i E_i = B diag(delta) C, by singular values."""
    left, right = [np.zeros((n, 0))], [np.zeros((0, n))]
    # What is far below the largest is left out; the check of all corners includes it.
    least = 1e-10 * max(float(np.linalg.norm(E)) for E in extents)
    for E in extents:
        U, sizes, V = linalg.svd(E)
        kept = sizes > least
        root = np.sqrt(sizes[kept])
        left.append(U[:, kept] * root)
        right.append(root[:, None] * V[kept])
    return np.hstack(left), np.vstack(right)


def _weights(F: FloatArray, B: FloatArray, C: FloatArray) -> FloatArray | None:
    """Return weights w that make |C (z - F)^-1 B|, rows over and columns times w, small.

    They balance it where it is largest on the unit circle. None if it is still one or more there:
    then the Riccati equation has no solution.
    """
    values = np.linalg.eigvals(F)
    near = values[np.argsort(-np.abs(values))[:_NEAR]]
    angles = np.concatenate([np.abs(np.angle(near)), np.linspace(0.0, np.pi, _ANGLES)])
    largest = -1.0
    worst: ComplexArray = np.zeros((B.shape[1], B.shape[1]), np.complex128)
    for angle in np.unique(angles):
        shifted: ComplexArray = np.exp(1j * angle) * np.eye(len(F)) - F
        gain: ComplexArray = C @ np.linalg.solve(shifted, B)
        radius = float(np.abs(np.linalg.eigvals(np.abs(gain))).max())
        if radius > largest:
            largest, worst = radius, gain
    # The floor keeps weights of loosely coupled parts from running away.
    size, w = np.abs(worst) + _FLOOR * np.abs(worst).max(), np.ones(B.shape[1])
    for _ in range(_BALANCING_ROUNDS):
        for j in range(len(w)):
            scaled = size * w / w[:, None]
            column, row = scaled[:, j].sum() - size[j, j], scaled[j].sum() - size[j, j]
            if column > 0.0 and row > 0.0:
                w[j] *= np.sqrt(row / column)
    return w if np.linalg.norm(worst * w / w[:, None], 2) < 1.0 else None
