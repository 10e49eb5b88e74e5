"""Pieces of rational and ball matrices, and what arb leaves to write oneself about them."""

from collections.abc import Iterable, Sequence
from fractions import Fraction
from typing import Any

import numpy as np
from flint import arb, arb_mat, fmpq, fmpq_mat

from railenv.units import FloatArray

Matrix = Any
"""An `fmpq_mat` (exact) or an `arb_mat` (balls)."""


def exact(value: float | Fraction) -> Any:
    """Return a double or a fraction as flint's rational number."""
    return fmpq(*value.as_integer_ratio())


def rational(values: FloatArray) -> Matrix:
    """Return a two-dimensional array of doubles as an exact matrix."""
    return fmpq_mat(values.shape[0], values.shape[1], [exact(v) for v in values.ravel().tolist()])


def balls(values: FloatArray) -> Matrix:
    """Return a two-dimensional array of doubles as a ball matrix of radius zero."""
    entries = [arb(v) for v in values.ravel().tolist()]
    return arb_mat(values.shape[0], values.shape[1], entries)


def in_balls(matrix: Matrix) -> Matrix:
    """Enclose an exact matrix at the working precision."""
    return arb_mat(matrix.nrows(), matrix.ncols(), [arb(v) for v in matrix.entries()])


def part(matrix: Matrix, rows: Iterable[int], columns: Iterable[int]) -> Matrix:
    """Return chosen rows and columns."""
    chosen, kept, table = list(rows), list(columns), matrix.tolist()
    return type(matrix)(len(chosen), len(kept), [table[i][j] for i in chosen for j in kept])


def beside(parts: Sequence[Matrix]) -> Matrix:
    """Lay matrices of one type and height side by side."""
    tables = [m.tolist() for m in parts]
    entries = [v for i in range(parts[0].nrows()) for table in tables for v in table[i]]
    return type(parts[0])(parts[0].nrows(), sum(m.ncols() for m in parts), entries)


def add_block(rows: list[list[Any]], top: int, left: int, block: Matrix) -> None:
    """Add a matrix to a place in a table of numbers."""
    for i, values in enumerate(block.tolist()):
        row = rows[top + i]
        for j, value in enumerate(values):
            row[left + j] += value


def norm_bound(matrix: Matrix) -> Any:
    """Return an upper bound on the largest row sum of absolute values, as a ball."""
    sums = [sum((abs(v) for v in row), arb(0)).upper() for row in matrix.tolist()]
    largest = arb(0)
    for value in sums:
        # A sum that is not a number must not get lost in a comparison.
        largest = value if not value <= largest else largest
    return largest


def middles(matrix: Matrix) -> FloatArray:
    """Return the centres of a ball matrix as doubles (a proposal, never a proof)."""
    values = [float(v) for v in matrix.entries()]
    return np.array(values).reshape(matrix.nrows(), matrix.ncols())
