"""The test of one part: is M(s) regular for its frequencies, delays, parameters and entries?

If W M V is an H-matrix for some fixed W and V (there are positive weights w such that
|d_i| w_i > sum_j |x_ij| w_j over its diagonal d and the rest x), M is regular. V holds eigenvectors
of M at the centre of the part and W is its inverse. There M is diagonal; s moves nothing but the
diagonal, and what delays, parameters and radii do off the diagonal counts in second order only,
since weights let a small coupling one way make up for a larger one the other way. On the diagonal,
first-order terms keep their direction (a root that moves along the contour does not come nearer):

    |d_i| >= Re(conj(u) c_i) - sum_v |Re(conj(u) l_iv)| - rest_i     for any u with |u| = 1.

Floats propose V, u and w, balls prove. Where exponentials turn a lot over the part, they are taken
as any number up to their largest modulus ("free"); that settles high frequencies for all delays.
"""

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from flint import arb, arb_mat
from scipy import linalg

from railenv.stability.proof.polynomials import UndecidedError
from railenv.stability.proof.uncertain_frames import BASIS_BITS, Frame, Matrix, Part, Scaled
from railenv.units import ComplexArray, FloatArray


@dataclass(frozen=True, eq=False)
class Guess:
    """What floats say of a part.

    Attributes:
        holds: Whether the test seems to hold.
        share: How much of the diagonal everything else takes, roughly: below one if it holds.
        weights: w, shape (n,).
        directions: u, shape (n,).
    """

    holds: bool
    share: float
    weights: FloatArray
    directions: ComplexArray


def guess(terms: tuple[Matrix, list[Matrix], Matrix]) -> Guess:
    """Test a part in floats."""
    centre, lines, rest = terms
    with np.errstate(all="ignore"):
        c: ComplexArray = np.diagonal(centre)
        stack: ComplexArray = np.array(lines)
        on_diagonal: ComplexArray = np.diagonal(stack, axis1=1, axis2=2)
        candidates = [c, *(1j * line for line in on_diagonal)]
        best: FloatArray = np.full(len(c), -np.inf)
        chosen: ComplexArray = np.ones(len(c), dtype=np.complex128)
        for candidate in candidates:
            u: ComplexArray = candidate / np.abs(candidate)
            u = np.where((u.conj() * c).real < 0.0, -u, u)
            ahead: FloatArray = (u.conj() * c).real - np.abs((u.conj() * on_diagonal).real).sum(
                axis=0
            )
            better = ahead > best
            best = np.asarray(np.where(better, ahead, best), dtype=np.float64)
            chosen = np.where(better, u, chosen)
        diagonal: FloatArray = best - np.diagonal(rest)
        size: Any = np.abs(centre) + np.abs(stack).sum(axis=0) + rest
        np.fill_diagonal(size, 0.0)
        holds, weights = False, np.ones(len(c))
        if np.all(diagonal > 0.0):
            try:
                weights = _solved(np.diag(diagonal) - size, weights)
                holds = bool(np.all(weights > 0.0) and np.all(np.isfinite(weights)))
            except np.linalg.LinAlgError:
                holds = False
        size[np.diag_indices(len(c))] = np.abs(c) - diagonal
        return Guess(holds, _radius(size / np.abs(c)[:, None]), weights, chosen)


def _solved(matrix: FloatArray, right: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.solve(matrix, right), dtype=np.float64)


def _radius(matrix: FloatArray) -> float:
    """Return a rough spectral radius; infinite if the matrix is not finite."""
    if not np.all(np.isfinite(matrix)):
        return np.inf
    v, largest = np.ones(len(matrix)), 0.0
    for _ in range(12):
        v = matrix @ v
        largest = float(np.max(np.abs(v)))
        if not largest > 0.0:
            return largest
        v = v / largest
    return largest


def proves(frame: Frame, part: Part, told: Guess, *, free: bool) -> bool:
    """Prove in balls that M is regular over a whole part."""
    centre, lines, rest = frame.terms(part, free=free)
    size = frame.family.arithmetic.size
    total = size(centre) + rest
    for line in lines:
        total = total + size(line)
    w: list[Any] = [arb(v) for v in told.weights.tolist()]
    rows: list[Any] = (total * arb_mat(len(w), 1, w)).entries()
    for i, row in enumerate(rows):
        x: Any = arb(float(told.directions[i].real))
        y: Any = arb(float(told.directions[i].imag))
        ahead: Any = x * centre[i, i].real + y * centre[i, i].imag
        for line in lines:
            ahead -= abs(x * line[i, i].real + y * line[i, i].imag)
        diagonal: Any = ahead / (x * x + y * y).sqrt() - rest[i, i]
        # The row's sum holds the diagonal's size, which does not count.
        if not (w[i] > 0 and diagonal * w[i] > row - total[i, i] * w[i]):
            return False
    return True


def modal_bases(frame: Frame, part: Part, *, free: bool) -> list[ComplexArray]:
    """Propose bases for a part: eigenvectors at its centre, and Schur vectors where these fail.

    Args:
        frame: The family in floats in the unit basis.
        part: The part.
        free: See `Frame.terms`.
    """
    middle = part.centre
    centre, _, _ = frame.terms(Part(middle, middle), free=free)
    found: list[ComplexArray] = []
    if not np.all(np.isfinite(centre)):
        return found
    vectors: ComplexArray = np.linalg.eig(centre)[1]
    schur = cast("Any", linalg.schur)(centre, output="complex")
    proposals: list[Any] = [vectors, schur[1]]
    for basis in proposals:
        rounded = _rounded(basis)
        if np.all(np.isfinite(rounded)) and np.linalg.matrix_rank(rounded) == len(centre):
            found.append(rounded)
    return found


def _rounded(basis: ComplexArray) -> ComplexArray:
    whole = basis / np.abs(basis).max(axis=0) * 2.0**BASIS_BITS
    return np.asarray(np.round(whole) * 2.0**-BASIS_BITS, dtype=np.complex128)


def far_radius(floats: Scaled, balls: Scaled, delays: Part) -> float:
    """Return a power of two beyond which s outweighs everything, for all members and delays.

    Raises:
        UndecidedError: There is none in doubles.
    """
    rough: FloatArray = floats.sizes(delays.low, delays.high)
    size = balls.sizes(delays.low, delays.high)
    n = len(rough)
    if not np.all(np.isfinite(rough)):
        raise UndecidedError("exponentials of decay rate and delay are beyond all doubles")
    largest = float(np.max(np.abs(np.linalg.eigvals(rough))))
    radius = float(2.0 ** np.ceil(np.log2(max(largest, 1e-30) * (1.0 + 1e-6))))
    for _ in range(8):
        weights = np.linalg.solve(radius * np.eye(n) - rough, np.ones(n)).tolist()
        w: Any = arb_mat(n, 1, weights)
        beyond: list[Any] = (w * arb(radius) - size * w).entries()
        if all(v > 0 for v in w.entries()) and all(v > 0 for v in beyond):
            return radius
        radius *= 2.0
    raise UndecidedError("no bound on the size of unstable roots was found")
