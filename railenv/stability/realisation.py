"""State spaces of transfer functions, in canonical form and exact but for one rounding per entry.

Entries with the same monic denominator s^n + a_1 s^(n-1) + ... + a_n in one column share a chain of
n states (controllable canonical form: first row of A is -a_k, B = e_1, C_k = b_k - b_0 a_k); the
transposed form lets the entries of one row share. Of the two, the one with fewer states is taken.
Beyond that nothing is reduced: poles that stand in several rows and columns are repeated, and all
of them are roots of the loop.
"""

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from railenv.errors import ArgumentError
from railenv.units import FloatArray

_Polynomial = tuple[Fraction, ...]
"""Coefficients by falling power; the leading one is not zero, and zero itself is empty."""

_Matrices = tuple[FloatArray, FloatArray, FloatArray, FloatArray]


def of_fractions(entries: Sequence[Sequence[tuple[Any, Any]]]) -> _Matrices:
    """Realise a matrix of transfer functions.

    Args:
        entries: Numerator and denominator coefficients by falling power, rows being outputs.

    Returns:
        A, B, C, D.

    Raises:
        ArgumentError: A coefficient is no finite real number, a denominator is zero, or an entry is
            improper (no state space has it).
    """
    table: list[list[tuple[_Polynomial, _Polynomial]]] = []
    for i, row in enumerate(entries):
        table.append([])
        for j, (num, den) in enumerate(row):
            where = "" if len(entries) == len(row) == 1 else f" of entry ({i + 1}, {j + 1})"
            above = _polynomial(f"the numerator{where}", num)
            below = _polynomial(f"the denominator{where}", den)
            table[i].append(_proper(above, below, where))
    return _smaller(table)


def of_zeros_and_poles(zeros: Any, poles: Any, gain: Any) -> _Matrices:
    """Realise gain * prod(s - zero) / prod(s - pole).

    Raises:
        ArgumentError: A number is not finite, the zeros or poles are no exact conjugate pairs, or
            there are more zeros than poles.
    """
    (factor,) = _polynomial("the gain", [gain]) or (Fraction(0),)
    above = tuple(factor * c for c in _expanded("zeros", zeros)) if factor else ()
    return _smaller([[_proper(above, _expanded("poles", poles), "")]])


def _proper(above: _Polynomial, below: _Polynomial, where: str) -> tuple[_Polynomial, _Polynomial]:
    """Return numerator and denominator divided by the leading coefficient, of equal length."""
    if not below:
        raise ArgumentError(f"the denominator{where} is zero; give one with a coefficient")
    if len(above) > len(below):
        raise ArgumentError(
            f"the transfer function{where} is improper: degree {len(above) - 1} over "
            f"{len(below) - 1}; give it a roll-off, so that the numerator's degree is not the "
            "larger one"
        )
    padded = (Fraction(0),) * (len(below) - len(above)) + above
    return tuple(c / below[0] for c in padded), tuple(c / below[0] for c in below)


def _smaller(table: list[list[tuple[_Polynomial, _Polynomial]]]) -> _Matrices:
    turned = [list(column) for column in zip(*table, strict=True)]
    if _order(turned) <= _order(table):
        return _by_columns(turned)
    A, B, C, D = _by_columns(table)
    return A.T, C.T, B.T, D.T


def _order(groups: list[list[tuple[_Polynomial, _Polynomial]]]) -> int:
    return sum(len(below) - 1 for group in groups for below in {below for _, below in group})


def _by_columns(columns: list[list[tuple[_Polynomial, _Polynomial]]]) -> _Matrices:
    """Realise columns of entries, each denominator of a column once."""
    n, outputs = _order(columns), len(columns[0])
    A, B = np.zeros((n, n)), np.zeros((n, len(columns)))
    C, D = np.zeros((outputs, n)), np.zeros((outputs, len(columns)))
    at = 0
    for j, column in enumerate(columns):
        for below in dict.fromkeys(below for _, below in column):
            order = len(below) - 1
            chain = slice(at, at + order)
            A[chain, chain] = np.eye(order, k=-1)
            if order:
                A[at, chain] = [_rounded(-a) for a in below[1:]]
                B[at, j] = 1.0
            for i, (above, own) in enumerate(column):
                if own == below:
                    D[i, j] = _rounded(above[0])
                    C[i, chain] = [
                        _rounded(b - above[0] * a)
                        for b, a in zip(above[1:], below[1:], strict=True)
                    ]
            at += order
    return A, B, C, D


def _polynomial(what: str, coefficients: Any) -> _Polynomial:
    values = _numbers(what, coefficients)
    if np.any(values.imag):
        raise ArgumentError(f"{what} has complex coefficients; give real ones")
    exact = [Fraction(float(value)) for value in values.real]
    while exact and not exact[0]:
        del exact[0]
    return tuple(exact)


def _expanded(what: str, roots: Any) -> _Polynomial:
    """Multiply prod(s - root) out, exactly."""
    real, imaginary = [Fraction(1)], [Fraction(0)]
    for root in _numbers(what, roots):
        a, b = Fraction(float(root.real)), Fraction(float(root.imag))
        zero = [Fraction(0)]
        terms = list(zip(real + zero, imaginary + zero, zero + real, zero + imaginary, strict=True))
        real = [re - a * r + b * i for re, _, r, i in terms]
        imaginary = [im - a * i - b * r for _, im, r, i in terms]
    if any(imaginary):
        raise ArgumentError(
            f"{what} are not in exact conjugate pairs; give a transfer function with real "
            "coefficients"
        )
    return tuple(real)


def _numbers(what: str, values: Any) -> Any:
    try:
        numbers = np.array(values, dtype=np.complex128)
    except (TypeError, ValueError, OverflowError):
        raise ArgumentError(f"{what} holds something that is no number; give a list") from None
    if numbers.ndim != 1:
        raise ArgumentError(f"{what} has {numbers.ndim} dimensions; give a list of numbers")
    if not np.all(np.isfinite(numbers)):
        raise ArgumentError(f"{what} holds a value that is not finite; give numbers")
    return numbers


def _rounded(value: Fraction) -> float:
    try:
        number = float(value)
    except OverflowError:
        number = 0.0
    if value and not number:
        raise ArgumentError(
            "the coefficients differ by more powers of ten than a number holds; change the unit "
            "of time"
        )
    return number
