"""Modal quantities of characteristic roots, and following modes along a sweep.

Frequency is |s| / (2 pi), the damping ratio -Re s / |s|, the damped frequency |Im s| / (2 pi).
"""

from dataclasses import dataclass, field

import numpy as np
from scipy import linalg
from scipy.optimize import linear_sum_assignment

from railenv.units import ComplexArray, FloatArray


@dataclass(frozen=True, eq=False)
class Mode:
    """One characteristic root with its shape; a conjugate pair is one mode, Im s >= 0.

    Attributes:
        root: s [1/s].
        shape: Right null vector over the system's states, shape (n,), largest entry scaled to 1.
    """

    root: complex
    shape: ComplexArray = field(repr=False)

    @property
    def frequency_hz(self) -> float:
        """Modal frequency |s| / (2 pi) [Hz]."""
        return abs(self.root) / (2 * np.pi)

    @property
    def damped_frequency_hz(self) -> float:
        """Frequency of the oscillation itself, |Im s| / (2 pi) [Hz]."""
        return abs(self.root.imag) / (2 * np.pi)

    @property
    def damping_ratio(self) -> float:
        """-Re s / |s| [1]; negative when the mode grows."""
        size = abs(self.root)
        return -self.root.real / size if size > 0.0 else 0.0


def modes_of_matrix(
    matrix: FloatArray, num_states: int, scale: FloatArray | None = None
) -> list[Mode]:
    """Return the modes of x' = matrix x, by falling real part.

    Args:
        matrix: Real square matrix.
        num_states: Shapes keep the first so many states.
        scale: Factors that turn the matrix's states into physical ones, shape (size,).

    Returns:
        One mode per real root and per conjugate pair.
    """
    roots, vectors = linalg.eig(matrix)
    if scale is not None:
        vectors = vectors * scale[:, None]
    chosen = [k for k in range(len(roots)) if roots[k].imag >= 0.0]
    chosen.sort(key=lambda k: -roots[k].real)
    return [Mode(complex(roots[k]), normalised(vectors[:num_states, k])) for k in chosen]


def normalised(shape: ComplexArray) -> ComplexArray:
    """Scale a shape so that its largest entry is 1."""
    largest = shape[np.argmax(np.abs(shape))]
    return shape / largest if largest != 0.0 else shape


def modal_assurance(first: ComplexArray, second: ComplexArray, weight: FloatArray) -> float:
    """Return the modal assurance criterion, |x^H W y|^2 / (x^H W x  y^H W y), in [0, 1].

    Args:
        first: Shape x, at least as long as `weight`.
        second: Shape y.
        weight: Diagonal of W, e.g. the masses, over the leading entries.
    """
    x, y = first[: len(weight)], second[: len(weight)]
    cross = abs(np.vdot(x, weight * y)) ** 2
    sizes = np.vdot(x, weight * x).real * np.vdot(y, weight * y).real
    return float(cross / sizes) if sizes > 0.0 else 0.0


def follow(
    previous: list[Mode], candidates: list[Mode], weight: FloatArray, limit: float = np.inf
) -> list[Mode | None]:
    """Match modes from one step of a sweep to the next.

    The cost of a match is 1 - MAC plus the relative step of the root; the sum over the matches is
    smallest.

    Args:
        previous: Modes to be followed.
        candidates: Modes of the next step; each is given to one mode at most.
        weight: Diagonal weight of the assurance criterion.
        limit: Matches that cost more are no matches.

    Returns:
        The matched candidate for each of `previous`, None where there is none.
    """
    found: list[Mode | None] = [None] * len(previous)
    if not previous or not candidates:
        return found
    cost = np.array(
        [
            [
                1.0
                - modal_assurance(old.shape, new.shape, weight)
                + abs(old.root - new.root) / max(abs(old.root), abs(new.root), 1e-300)
                for new in candidates
            ]
            for old in previous
        ]
    )
    for row, column in zip(*linear_sum_assignment(cost), strict=True):
        if cost[row, column] <= limit:
            found[int(row)] = candidates[int(column)]
    return found
