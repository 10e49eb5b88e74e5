"""Showing that polynomials have no zero, over boxes of true delay and told delay.

A polynomial in Chebyshev form has no zero on [-1, 1]^3 if its constant coefficient is larger than
all others and the bound of what is left out together, as |T_k| <= 1. Otherwise the box is halved
where that helps most: in sigma (told delay) or rho (rest of the true delay). Where x (the place on
the circle) is what varies most, or what is left out is too large, a shorter arc is needed; such
boxes are handed back.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from railenv.stability.proof.history_function import Polynomials
from railenv.stability.proof.history_models import ORDER
from railenv.units import ComplexArray, FloatArray

IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

GRID = 2.0**-24
"""Ends of the first boxes are multiples of this, and so halving them rounds nothing."""

SMALLEST = 2.0**-20
"""A box of a smaller half width is not halved further."""

# Boxes that are looked at together.
_CHUNK = 2048
# Share of the sum of all coefficients that covers rounding here. The entries of `chebyshev_part`
# are at most 2 in size, as the polynomials are at most 1; each of the 7 steps of the recurrence
# amplifies rounding by at most 1 + sqrt(2), to 2^-41. The changes of basis in rho (8 terms) and
# sigma (3 terms) thus add at most (8 * 6 + 3 * 16) 2^-41 < 2^-34 of the sum.
_ROUNDING = 2.0**-32


@dataclass(frozen=True, eq=False)
class Boxes:
    """Boxes of rho and sigma, each belonging to a case (a number of periods and an interval).

    Attributes:
        case: Number of the case, shape (boxes,).
        middle: Centre in sigma and rho, shape (boxes, 2).
        half: Half widths, shape (boxes, 2).
    """

    case: IntArray
    middle: FloatArray
    half: FloatArray

    def __len__(self) -> int:
        return len(self.case)

    def __getitem__(self, place: Any) -> "Boxes":
        """Choose some of them."""
        return Boxes(self.case[place], self.middle[place], self.half[place])

    def halves(self, axis: IntArray) -> "Boxes":
        """Halve each along its axis (0 sigma, 1 rho)."""
        row = np.arange(len(self))
        half = self.half.copy()
        half[row, axis] /= 2
        low, high = self.middle.copy(), self.middle.copy()
        low[row, axis] -= half[row, axis]
        high[row, axis] += half[row, axis]
        return joined([Boxes(self.case, low, half), Boxes(self.case, high, half)])


def joined(parts: list[Boxes]) -> Boxes:
    """Return all boxes of some lists."""
    return Boxes(
        np.concatenate([part.case for part in parts]),
        np.concatenate([part.middle for part in parts]),
        np.concatenate([part.half for part in parts]),
    )


def chebyshev_part(terms: int, middle: FloatArray, half: FloatArray) -> FloatArray:
    """Return R with T_j(middle + half x) = sum_i R_ij T_i(x), shape (..., terms, terms)."""
    R = np.zeros((*middle.shape, terms, terms))
    R[..., 0, 0] = 1.0
    if terms > 1:
        R[..., 0, 1], R[..., 1, 1] = middle, half
    for j in range(2, terms):
        before = R[..., :, j - 1]
        # x T_0 = T_1 and x T_i = (T_(i+1) + T_(i-1)) / 2.
        moved = np.zeros_like(before)
        moved[..., 1:] += before[..., :-1] / 2
        moved[..., :-1] += before[..., 1:] / 2
        moved[..., 1] += before[..., 0] / 2
        R[..., :, j] = (
            2 * middle[..., None] * before + 2 * half[..., None] * moved - R[..., :, j - 2]
        )
    return R


def _power_to_chebyshev() -> FloatArray:
    """Return P with x^j = sum_i P_ij T_i(x)."""
    P = np.zeros((ORDER + 1, ORDER + 1))
    P[0, 0] = 1.0
    for j in range(1, ORDER + 1):
        P[1:, j] += P[:-1, j - 1] / 2
        P[:-1, j] += P[1:, j - 1] / 2
        P[1, j] += P[0, j - 1] / 2
    return P


_TO_CHEBYSHEV = _power_to_chebyshev()


class Cover:
    """Excludes zeros of the polynomials of one arc over boxes.

    Args:
        polynomials: One per case.
        most: Boxes that may be looked at.

    Attributes:
        looked: Boxes that were looked at.
    """

    def __init__(self, polynomials: Polynomials, most: int) -> None:
        self._coefs: ComplexArray = polynomials.coefs @ _TO_CHEBYSHEV.T
        size = np.abs(polynomials.coefs).sum(axis=(1, 2, 3))
        self._rest = (1.0 + 1e-9) * (polynomials.rest + _ROUNDING * size)
        self._most, self.looked = most, 0

    def run(self, boxes: Boxes, wanted: Callable[[Boxes], BoolArray]) -> Boxes:
        """Exclude zeros in boxes.

        Args:
            boxes: The boxes.
            wanted: Says which boxes matter; others are dropped.

        Returns:
            Boxes that need a shorter arc, or that were not looked at any more.
        """
        failed: list[Boxes] = []
        stack = [boxes]
        while stack:
            now = stack.pop()
            if self.looked >= self._most:
                failed.append(now)
                continue
            if len(now) > _CHUNK:
                stack.append(now[_CHUNK:])
                now = now[:_CHUNK]
            now = now[wanted(now)]
            if not len(now):
                continue
            self.looked += len(now)
            good, axis = self._tested(now)
            short = axis < 0
            failed.append(now[~good & short])
            split = ~good & ~short
            if np.any(split):
                stack.append(now[split].halves(axis[split]))
        return joined(failed) if failed else boxes[:0]

    def _tested(self, boxes: Boxes) -> tuple[BoolArray, IntArray]:
        """Return where there is no zero, and where to halve: 0 sigma, 1 rho, -1 neither."""
        coefs, rest = self._coefs[boxes.case], self._rest[boxes.case]
        n, _, r, x = coefs.shape
        S = chebyshev_part(3, boxes.middle[:, 0], boxes.half[:, 0])
        R = chebyshev_part(r, boxes.middle[:, 1], boxes.half[:, 1])
        coefs = (S @ coefs.reshape(n, 3, -1)).reshape(n, 3, r, x)
        size = np.abs(R[:, None] @ coefs)
        total = size.sum(axis=(1, 2, 3))
        lead = size[:, 0, 0, 0]
        good = 2.0 * lead > (1.0 + 1e-9) * (total + rest)
        told = total - size[:, 0].sum(axis=(1, 2))
        late = total - size[:, :, 0].sum(axis=(1, 2))
        place = total - size[..., 0].sum(axis=(1, 2))
        axis = np.where(told >= late, 0, 1)
        most = np.maximum(told, late)
        smallest = boxes.half[np.arange(n), axis] < SMALLEST
        axis = np.where((place > most) | (4.0 * rest > total) | smallest, -1, axis)
        return good, axis
