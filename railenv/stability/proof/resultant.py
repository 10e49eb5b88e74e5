"""Elimination of z from h(s, z): the resultant with its reversed polynomial, and its factors."""

from typing import Any

from flint import Ordering, fmpq_mpoly_ctx, fmpq_poly, fmpz, fmpz_poly

from railenv.stability.proof.polynomials import UndecidedError

Polynomial = Any

# Factoring a polynomial in two variables grows quickly with its size; beyond this it is left.
_LARGEST_FACTORED = 150


def resultant(terms: list[Polynomial]) -> Any:
    """Return R(w), w = -s^2, primitive with integer coefficients, by the Bezout determinant."""
    r = len(terms) - 1
    denominator = fmpz(1)
    for p in terms:
        denominator = denominator.lcm(p.denom())
    f = [(p * denominator).numer() for p in terms]
    g = [p(fmpz_poly([0, -1])) for p in f[::-1]]
    matrix = [
        [
            sum(
                (
                    f[j + 1 + k] * g[i - k] - f[i - k] * g[j + 1 + k]
                    for k in range(min(i, r - 1 - j) + 1)
                ),
                fmpz_poly([0]),
            )
            for j in range(r)
        ]
        for i in range(r)
    ]
    determinant = _determinant(matrix)
    if determinant.is_zero():
        return determinant
    coefficients = determinant.coeffs()
    if any(c != 0 for c in coefficients[1::2]):
        raise ArithmeticError("the resultant is not even in s")
    # w = -s^2: alternate signs.
    even = [c if k % 2 == 0 else -c for k, c in enumerate(coefficients[0::2])]
    polynomial = fmpz_poly(even)
    return polynomial // fmpz_poly([polynomial.content()])


def _determinant(matrix: list[list[Any]]) -> Any:
    """Return the determinant by fraction-free elimination (Bareiss 1968)."""
    size = len(matrix)
    rows = [row[:] for row in matrix]
    last, sign = fmpz_poly([1]), 1
    for k in range(size - 1):
        pivot = next((i for i in range(k, size) if not rows[i][k].is_zero()), None)
        if pivot is None:
            return fmpz_poly([0])
        if pivot != k:
            rows[k], rows[pivot], sign = rows[pivot], rows[k], -sign
        for i in range(k + 1, size):
            for j in range(k + 1, size):
                rows[i][j] = (rows[i][j] * rows[k][k] - rows[i][k] * rows[k][j]) // last
        last = rows[k][k]
    return rows[-1][-1] * sign


def irreducible_factors(terms: list[Polynomial]) -> list[tuple[list[Polynomial], int]]:
    """Return the irreducible factors of h over the rationals, as p_k, with their powers.

    Raises:
        UndecidedError: h is too large to be factored.
    """
    size = sum(int(p.degree()) + 1 for p in terms)
    if size > _LARGEST_FACTORED:
        raise UndecidedError("two roots cross the imaginary axis together, or one touches it")
    context = fmpq_mpoly_ctx.get(("s", "z"), Ordering.lex)
    # Over the rationals and not the integers: there python-flint 0.9 fails on long coefficients.
    whole = context.from_dict(
        {
            (power, k): coefficient
            for k, p in enumerate(terms)
            for power, coefficient in enumerate(p.coeffs())
            if coefficient != 0
        }
    )
    found: list[tuple[list[Polynomial], int]] = []
    for factor, times in whole.factor()[1]:
        by_z: dict[int, dict[int, Any]] = {}
        for (power, k), coefficient in factor.to_dict().items():
            by_z.setdefault(int(k), {})[int(power)] = coefficient
        degree = max(by_z)
        parts = [
            fmpq_poly([by_z.get(k, {}).get(i, 0) for i in range(max(by_z.get(k, {0: 0})) + 1)])
            for k in range(degree + 1)
        ]
        found.append((parts, int(times)))
    return found
