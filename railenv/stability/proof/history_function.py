"""The characteristic function of a loop with a finite history, as models on an arc of the circle.

With w = 1/z and readings w^(d+1) P(w, r) v (see `history_modes`), the loop
v_k = -sum_h G_h y_(k-h) - sum_h F_h v_(k-h) has the characteristic function

    f(w) = det(X + w^d Y),   X = I + sum_h F_h w^h,   Y = sum_h G_h w^(h+1) P(w, r)

times det(I - w exp(A T)). Between two knots of the schedule X and Y are X_m + sigma X_d and
Y_m + sigma Y_d with sigma in [-1, 1], so that for two commands

    f = xx + w^d xy + w^(2 d) yy

with coefficients that are quadratic in sigma and do not depend on d. They are Chebyshev series in
sigma (degree 2) and in rho = 2 r / T - 1 (`DEGREE`), whose coefficients are models in x on the arc
w = exp(-i pi (t + s x)), x in [-1, 1].
"""

from dataclasses import dataclass

import numpy as np
from flint import acb, arb
from numpy.typing import NDArray

from railenv.stability.proof.history_models import (
    ORDER,
    SLACK,
    TINY,
    Constants,
    Models,
    chebyshev_product,
    combined,
    concatenated,
    constant,
    matrix_product,
    powers,
    reciprocal,
)
from railenv.stability.proof.history_modes import DEGREE, HeldModes
from railenv.stability.proof.precision import precision
from railenv.units import ComplexArray, FloatArray

_BITS = 80


@dataclass(frozen=True, eq=False)
class Arc:
    """The part w = exp(-i pi (t + s x)), |x| <= 1, of the unit circle; t and s are exact."""

    t: float
    s: float

    def halves(self) -> tuple["Arc", "Arc"]:
        """Cut it in the middle."""
        half = self.s / 2
        return Arc(self.t - half, half), Arc(self.t + half, half)


@dataclass(frozen=True, eq=False)
class Polynomials:
    """Polynomials in sigma (degree 2), rho (`DEGREE`) and x (ORDER), one per case.

    In sigma and rho they are Chebyshev series, in x a power series.

    Attributes:
        coefs: Shape (cases, 3, DEGREE + 1, ORDER + 1).
        rest: Bound of what is left out for |sigma|, |rho|, |x| <= 1, shape (cases,).
    """

    coefs: ComplexArray
    rest: FloatArray


class HistoryFunction:
    """The characteristic function of one loop.

    Args:
        modes: The plant under its hold, two commands.
        measured: G_0, G_1, ..., shape (q, ages, 2, p); each double is the exact number it is.
        commanded: F_1, F_2, ..., shape (q, ages, 2, 2).
        longest: Largest number d of whole periods.
    """

    def __init__(
        self, modes: HeldModes, measured: FloatArray, commanded: FloatArray, longest: int
    ) -> None:
        self.modes = modes
        q, ages, _, p = measured.shape
        self.knots, self.readings = q, p
        self._measured = _exactly(np.moveaxis(measured, 1, -1).reshape(q * 2 * p, ages))
        past = commanded.shape[1]
        self._commanded = _exactly(np.moveaxis(commanded, 1, -1).reshape(q * 4, past))
        self._ages, self._past = ages, past
        self._longest = max(ages, past, 2 * longest)

    @property
    def intervals(self) -> int:
        """Number of intervals between knots; one knot counts as one interval."""
        return max(self.knots - 1, 1)

    def on(self, arc: Arc, wholes: NDArray[np.int64], intervals: NDArray[np.int64]) -> Polynomials:
        """Enclose f for some pairs of a number of whole periods d and an interval between knots.

        Args:
            arc: Where on the circle.
            wholes: d of each case, shape (cases,).
            intervals: Number of the interval of each case, shape (cases,).

        Returns:
            The polynomials; with an infinite bound if the arc is too long beside a mode.
        """
        w = powers(self._turns(arc), arc.s)
        used, intervals = np.unique(intervals, return_inverse=True)
        plant = self._plant(w)
        if plant is None:
            shape = (len(wholes), 3, DEGREE + 1, ORDER + 1)
            return Polynomials(np.zeros(shape, complex), np.full(len(wholes), np.inf))
        xx, xy, yy = self._parts(w, plant, used)
        once, twice = w[wholes][:, None, None], w[2 * wholes][:, None, None]
        total = once * xy[intervals] + twice * yy[intervals]
        direct = xx[intervals]
        coefs, rest = total.coefs, total.rest
        coefs[:, :, 0] += direct.coefs
        rest[:, :, 0] += direct.rest
        size = np.abs(coefs).sum(axis=(1, 2, 3)) + direct.size.sum(axis=1)
        bound = (1.0 + SLACK) * (rest.sum(axis=(1, 2)) + SLACK * size) + TINY
        # What has overflowed says nothing.
        known = np.isfinite(bound)
        return Polynomials(
            np.where(known[:, None, None, None], coefs, 0.0), np.where(known, bound, np.inf)
        )

    def _turns(self, arc: Arc) -> list[complex]:
        """Return exp(-i n pi t), rounded."""
        with precision(_BITS):
            turn = acb(-arb(arc.t)).exp_pi_i()
            values, power = list[complex](), acb(1)
            for _ in range(self._longest + 1):
                values.append(complex(float(power.real.mid()), float(power.imag.mid())))
                power = power * turn
        return values

    def _parts(
        self, w: Models, plant: Models, used: NDArray[np.int64]
    ) -> tuple[Models, Models, Models]:
        """Return xx (intervals, 3), xy and yy (intervals, 3, DEGREE + 1) of some intervals."""
        X, Y = self._middles(self._own(w), used), self._middles(self._through(w, plant), used)
        flat = X[..., None]
        both = _polar(flat, Y, plain=True)
        return (
            _in_sigma(_polar(flat, flat, plain=True))[..., 0],
            _in_sigma(both + _polar(Y, flat, plain=True)),
            _in_sigma(_polar(Y, Y, plain=False)),
        )

    def _own(self, w: Models) -> Models:
        """Return X at the knots, shape (q, 2, 2)."""
        eye = constant(_exactly(np.tile(np.eye(2).ravel(), self.knots)))
        if self._past:
            eye = eye + combined(self._commanded, w[1 : self._past + 1])
        return _reshaped(eye, self.knots, 2, 2)

    def _through(self, w: Models, plant: Models) -> Models:
        """Return Y at the knots, shape (q, 2, 2, DEGREE + 1)."""
        q, p = self.knots, self.readings
        gains = combined(self._measured, w[1 : self._ages + 1])
        product = matrix_product(_reshaped(gains, q * 2, p), plant)
        return _reshaped(product, q, 2, 2, DEGREE + 1)

    def _plant(self, w: Models) -> Models | None:
        """Return P, shape (p, 2 (DEGREE + 1)); None if the arc is too long beside a mode."""
        modes = self.modes
        one = constant(_exactly(np.ones(1)))
        turned = combined(Constants(modes.turn.middle[:, None], modes.turn.radius[:, None]), w[1:2])
        resolvent = reciprocal(one - turned)
        if resolvent is None:
            return None
        early, late = resolvent * w[1:2], resolvent * (one - w[1:2])
        n = len(modes.late_rest)
        shaped = Constants(modes.late.middle, modes.late.radius.copy())
        # What the series leaves out stands at its first term, as every |T_k| <= 1.
        shaped.radius[:, 0] += modes.late_rest
        held = _each(shaped, late) + _first(_each(_column(modes.whole), early))
        p, m = modes.direct.middle.shape
        flat = modes.residues.reshape(p * m, n)
        result = _reshaped(combined(flat, held), p, m, DEGREE + 1)
        direct = constant(modes.direct)
        result.coefs[:, :, 0] += direct.coefs
        result.rest[:, :, 0] += (
            direct.rest + modes.drift + SLACK * (result.size[:, :, 0] + direct.size)
        )
        return _reshaped(result, p, m * (DEGREE + 1))

    def _middles(self, at_knots: Models, used: NDArray[np.int64]) -> Models:
        """Return X_m and X_d of some intervals: shape (intervals, 2, ...) from (q, ...)."""
        if self.knots == 1:
            zero = Models(np.zeros_like(at_knots.coefs), np.zeros_like(at_knots.rest))
            return _stacked([at_knots, zero])
        low, high = at_knots[used], at_knots[used + 1]
        return _stacked([(low + high).scaled(0.5), (high - low).scaled(0.5)])


def _polar(A: Models, B: Models, plain: bool) -> Models:
    """Return A_11 B_22 - A_12 B_21 for both sigma of A and both of B, shape (.., 2, 2, terms).

    Args:
        A: Shape (intervals, 2, 2, 2, terms).
        B: The same.
        plain: Whether one of both does not depend on rho (one term).
    """
    left, right = A[:, :, None], B[:, None, :]

    def times(a: Models, b: Models) -> Models:
        return a * b if plain else chebyshev_product(a, b)

    return times(left[:, :, :, 0, 0], right[:, :, :, 1, 1]) - times(
        left[:, :, :, 0, 1], right[:, :, :, 1, 0]
    )


def _in_sigma(product: Models) -> Models:
    """Return the Chebyshev coefficients of sum sigma^(i + j) product_ij: (intervals, 3, ...)."""
    constant_part, square = product[:, 0, 0], product[:, 1, 1].scaled(0.5)
    return _stacked([constant_part + square, product[:, 0, 1] + product[:, 1, 0], square])


def _stacked(parts: list[Models]) -> Models:
    return concatenated([part[:, None] for part in parts], axis=1)


def _each(weights: Constants, models: Models) -> Models:
    """Return weights_ij models_i, shape (n, columns)."""
    return constant(weights) * models[:, None]


def _first(models: Models) -> Models:
    """Widen one column to DEGREE + 1 with zeros."""
    n = len(models.rest)
    coefs = np.zeros((n, DEGREE + 1, ORDER + 1), complex)
    rest = np.zeros((n, DEGREE + 1))
    coefs[:, :1], rest[:, :1] = models.coefs, models.rest
    return Models(coefs, rest)


def _column(value: Constants) -> Constants:
    return Constants(value.middle[:, None], value.radius[:, None])


def _exactly(values: FloatArray) -> Constants:
    return Constants(values.astype(complex), np.zeros(values.shape))


def _reshaped(models: Models, *shape: int) -> Models:
    return Models(models.coefs.reshape(*shape, ORDER + 1), models.rest.reshape(shape))
