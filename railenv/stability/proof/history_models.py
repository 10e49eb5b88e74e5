"""Polynomials with a bound on what they leave out: Taylor models in doubles.

A model of a complex function g of one real variable x in [-1, 1] is

    |g(x) - sum_e coefs_e x^e| <= rest    for every x in [-1, 1]

with ORDER + 1 complex coefficients (Makino and Berz 2003, "Taylor models and other validated
functional inclusion methods"). Many models are handled at once: leading axes are free.

Rounding. A sum of n complex products, formed in any order, has an error of at most
sqrt(2) (2 n + 4) 2^-53 times the same sum of absolute values (Higham 2002, sections 3.1 and 3.6).
`SLACK` = 2^-42 covers that for n up to 500 and leaves room for the rounding of the bounds
themselves, which are sums of positive numbers. A longer sum is refused. `TINY` stands for results
below the smallest normal double.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from railenv.errors import ArgumentError
from railenv.units import ComplexArray, FloatArray

ORDER = 10
"""Degree of the polynomials."""

SLACK = 2.0**-42
"""Bound of the rounding error of a sum of products, as a share of the sum of absolute values."""

TINY = 1e-280
"""Added to every bound: more than all that underflow can take away."""

LONGEST_SUM = 500
"""Most terms of a sum of products that `SLACK` covers."""


@dataclass(frozen=True, eq=False)
class Models:
    """Models with any leading axes.

    Attributes:
        coefs: Coefficients, shape (..., ORDER + 1).
        rest: Bounds of what is left out, shape (...).
    """

    coefs: ComplexArray
    rest: FloatArray

    def __getitem__(self, place: Any) -> "Models":
        """Take from the leading axes."""
        places = cast(tuple[Any, ...], place if isinstance(place, tuple) else (place,))
        return Models(self.coefs[(*places, slice(None))], self.rest[places])

    def __add__(self, other: "Models") -> "Models":
        size = self.size + other.size
        return Models(self.coefs + other.coefs, self.rest + other.rest + SLACK * size + TINY)

    def __sub__(self, other: "Models") -> "Models":
        return self + Models(-other.coefs, other.rest)

    def __mul__(self, other: "Models") -> "Models":
        """Multiply; what is beyond the order goes to the bound, as |x^e| <= 1."""
        shape = np.broadcast_shapes(self.rest.shape, other.rest.shape)
        coefs = np.zeros((*shape, ORDER + 1), complex)
        beyond = np.zeros(shape)
        sizes, others = np.abs(self.coefs), np.abs(other.coefs)
        tails = np.cumsum(others[..., ::-1], axis=-1)
        for e in range(ORDER + 1):
            coefs[..., e:] += self.coefs[..., e : e + 1] * other.coefs[..., : ORDER + 1 - e]
            if e:
                beyond += sizes[..., e] * tails[..., e - 1]
        return Models(coefs, _product_rest(self, other, beyond))

    @property
    def size(self) -> FloatArray:
        """Sum of absolute values of the coefficients, shape (...)."""
        return np.abs(self.coefs).sum(axis=-1)

    def scaled(self, factor: float) -> "Models":
        """Multiply by a power of two, which rounds nothing."""
        return Models(self.coefs * factor, self.rest * abs(factor))


@dataclass(frozen=True, eq=False)
class Constants:
    """Complex numbers known to within a radius, any shape."""

    middle: ComplexArray
    radius: FloatArray

    def reshape(self, *shape: int) -> "Constants":
        """Reshape both."""
        return Constants(self.middle.reshape(*shape), self.radius.reshape(*shape))


def _product_rest(a: Models, b: Models, beyond: FloatArray) -> FloatArray:
    left, right = a.size, b.size
    rest = a.rest * (right + b.rest) + left * b.rest
    return (1.0 + SLACK) * (beyond + rest + SLACK * left * right) + TINY


def constant(value: Constants) -> Models:
    """Return models of constants."""
    coefs = np.zeros((*value.middle.shape, ORDER + 1), complex)
    coefs[..., 0] = value.middle
    return Models(coefs, value.radius + TINY)


def combined(weights: Constants, models: Models) -> Models:
    """Return weights @ models: weights (a, n), models (n, ...) -> (a, ...)."""
    _check_length(weights.middle.shape[-1])
    tail = models.coefs.shape[1:]
    n = models.coefs.shape[0]
    coefs = weights.middle @ models.coefs.reshape(n, -1)
    size, rest = models.size.reshape(n, -1), models.rest.reshape(n, -1)
    large = np.abs(weights.middle)
    bound = large @ rest + weights.radius @ (size + rest) + SLACK * (large @ size)
    shape = (weights.middle.shape[0], *tail[:-1])
    return Models(coefs.reshape(*shape, ORDER + 1), ((1.0 + SLACK) * bound + TINY).reshape(shape))


def matrix_product(a: Models, b: Models) -> Models:
    """Return the matrix product of models a (m, p) and b (p, q) -> (m, q)."""
    m, p = a.rest.shape
    q = b.rest.shape[1]
    _check_length(p * (ORDER + 1))
    coefs = np.zeros((m, q, ORDER + 1), complex)
    beyond = np.zeros((m, q))
    sizes, others = np.abs(a.coefs), np.abs(b.coefs)
    for e in range(ORDER + 1):
        kept = b.coefs[..., : ORDER + 1 - e]
        coefs[..., e:] += (a.coefs[..., e] @ kept.reshape(p, -1)).reshape(m, q, -1)
        beyond += sizes[..., e] @ others[..., ORDER + 1 - e :].sum(axis=-1)
    left, right = a.size, b.size
    rest = a.rest @ (right + b.rest) + left @ b.rest
    bound = (1.0 + SLACK) * (beyond + rest + SLACK * (left @ right)) + TINY
    return Models(coefs, bound)


def chebyshev_product(a: Models, b: Models) -> Models:
    """Multiply series of Chebyshev polynomials whose coefficients are models.

    2 T_i T_j = T_(i+j) + T_|i-j|; what is beyond the degree goes to the bound of the first term,
    as |T_k| <= 1.

    Args:
        a: Shape (..., degree + 1).
        b: Shape (..., degree + 1).
    """
    terms = a.rest.shape[-1]
    pairs = a[..., :, None] * b[..., None, :]
    shape = pairs.rest.shape[:-2]
    coefs = pairs.coefs.reshape(*shape, terms * terms, ORDER + 1)
    size, rest = pairs.size.reshape(*shape, -1), pairs.rest.reshape(*shape, -1)
    kept, left_out = _folding(terms)
    bound = (1.0 + SLACK) * ((rest + SLACK * size) @ kept.T)
    bound[..., 0] += (1.0 + SLACK) * ((rest + size) @ left_out)
    return Models(kept @ coefs, (1.0 + SLACK) * bound + TINY)


@cache
def _folding(terms: int) -> tuple[FloatArray, FloatArray]:
    """Return which T_k a product T_i T_j adds to, (terms, terms^2), and its share beyond."""
    kept, beyond = np.zeros((terms, terms, terms)), np.zeros((terms, terms))
    for i in range(terms):
        for j in range(terms):
            kept[abs(i - j), i, j] += 0.5
            if i + j < terms:
                kept[i + j, i, j] += 0.5
            else:
                beyond[i, j] = 0.5
    return kept.reshape(terms, -1), beyond.ravel()


def reciprocal(a: Models) -> Models | None:
    """Return 1 / a, or None where one of them may vanish or varies too much.

    With p the truncated power series of 1 / a: |a p - 1| <= q < 1 gives |1 / a - p| <= |p| q /
    (1 - q).
    """
    if np.any(np.abs(a.coefs[..., 0]) < TINY):
        return None
    first = 1.0 / a.coefs[..., 0]
    coefs = np.zeros_like(a.coefs)
    coefs[..., 0] = first
    for e in range(1, ORDER + 1):
        known = (a.coefs[..., 1 : e + 1] * coefs[..., e - 1 :: -1][..., :e]).sum(axis=-1)
        coefs[..., e] = -first * known
    proposal = Models(coefs, np.zeros(a.rest.shape))
    product = a * proposal
    product.coefs[..., 0] -= 1.0
    error = (1.0 + SLACK) * (product.size + product.rest + 2.0 * SLACK)
    if not np.all(error < 0.5):
        return None
    return Models(coefs, (1.0 + 4.0 * SLACK) * proposal.size * error / (1.0 - error) + TINY)


def concatenated(parts: list[Models], axis: int = 0) -> Models:
    """Join models along a leading axis."""
    return Models(
        np.concatenate([part.coefs for part in parts], axis=axis),
        np.concatenate([part.rest for part in parts], axis=axis),
    )


def _check_length(terms: int) -> None:
    if terms > LONGEST_SUM:
        raise ArgumentError(
            f"the law's history makes sums of {terms} products, and rounding is bounded for "
            f"{LONGEST_SUM} at most; shorten its lags, or certify one told delay at a time"
        )


def powers(turn: list[complex], step: float) -> Models:
    """Return models of exp(-i n pi (t + s x)), n = 0, 1, ..., in x.

    The remainder of the exponential of an imaginary number is at most the first term left out.

    Args:
        turn: exp(-i n pi t) for n = 0, 1, ..., each part rounded to a double.
        step: s, a double.
    """
    n = np.arange(len(turn), dtype=float)
    exponent = -1j * np.pi * step * n
    terms: NDArray[Any] = np.zeros((len(turn), ORDER + 2), complex)
    terms[:, 0] = 1.0
    for e in range(1, ORDER + 2):
        terms[:, e] = terms[:, e - 1] * exponent / e
    coefs = np.asarray(turn)[:, None] * terms[:, : ORDER + 1]
    rest = np.abs(terms[:, -1]) + SLACK * np.abs(terms).sum(axis=1)
    return Models(coefs, (1.0 + SLACK) * rest + TINY)
