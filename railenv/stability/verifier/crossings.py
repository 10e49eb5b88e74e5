"""Re-checks that no root meets the imaginary axis for any common delay of an interval.

At a crossing h(j omega, z) = 0 with z = exp(-j omega tau) on the unit circle, and then the reversed
polynomial has the same zero: their resultant vanishes. It is a polynomial in omega^2, found here by
exact Sylvester determinants at whole numbers and interpolation; its zeros are enclosed by the
polynomial root finder of the ball arithmetic library.
"""

from typing import Any

from flint import acb, acb_poly, arb, fmpq, fmpq_mat, fmpq_poly

from railenv.stability.verifier.quasipolynomial import (
    CharacteristicFunction,
    RejectedError,
    rational,
)

_NARROWING = 8
_LARGEST_WORK = 5e7
"""Points of the interpolation times (size of the determinant)^3; some minutes."""


def check_no_crossing(h: CharacteristicFunction, low: list[float], high: list[float]) -> None:
    """Check that no root is on the axis for any common delay between low and high.

    Raises:
        RejectedError: One may be.
    """
    if len(low) != 1:
        raise RejectedError("crossings are listed for one common delay")
    ends = [arb(rational(tau[0]) / h.unit) for tau in (low, high)]
    r = max(k for (k,) in h.exact)
    polynomials = [h.exact.get((k,), fmpq_poly([0])) for k in range(r + 1)]
    common = polynomials[0]
    for p in polynomials[1:]:
        common = common.gcd(p)
    # A common factor's zeros do not move: the count at one delay has found none on the axis.
    polynomials = [p // common for p in polynomials]
    if r == 0:
        return
    for factor, _ in _resultant(polynomials).numer().factor_squarefree()[1]:
        for w, _ in factor.complex_roots():
            if not w.imag.contains(0) or w.real < 0:
                continue
            if w.real.contains(0) and factor[0] == 0:
                continue  # s = 0 has the phase z = 1 at every delay: the count covers it
            if not w.real > 0:
                raise RejectedError("a frequency is not told from zero")
            _check_frequency(polynomials, w.real.sqrt(), ends)


def _check_frequency(polynomials: list[Any], omega: Any, ends: list[Any]) -> None:
    values = [acb_poly(p)(acb(0, omega)) for p in polynomials]
    if values[-1].contains(0):
        raise RejectedError("a leading coefficient is not told from zero")
    in_z = acb_poly(values)
    roots = [-values[0] / values[1]] if len(values) == 2 else in_z.roots()
    for wide in roots:
        z = wide
        for _ in range(_NARROWING):
            # Interval Newton: the zero is also in here.
            slope = in_z.derivative()(z)
            better = z if slope.contains(0) else z.mid() - in_z(z.mid()) / slope
            z = better if z.contains(better) else z
        if not abs(z).contains(1):
            continue
        phase = -z.arg() if z.real > 0 else arb.pi() - (-z).arg()
        turns = [(tau * omega - phase) / (2 * arb.pi()) for tau in ends]
        if not turns[0].ceil() > turns[1].floor():
            raise RejectedError(
                "a root may be on the imaginary axis at a delay of the interval, at about "
                f"{float((omega / (2 * arb.pi())).mid()):.6g} cycles per unit of time"
            )


def _resultant(polynomials: list[Any]) -> Any:
    """Return the resultant in z of h and its reversed, as a polynomial in w = -s^2."""
    r = len(polynomials) - 1
    degree = r * max(p.degree() for p in polynomials)
    if degree * (2 * r) ** 3 > _LARGEST_WORK:
        raise RejectedError("the resultant is too large to be checked")
    points: list[Any] = []
    values: list[Any] = []
    for s in range(int(degree) + 1):
        forward = [p(fmpq(s)) for p in polynomials]
        backward = [p(fmpq(-s)) for p in polynomials][::-1]
        rows = [
            [fmpq(0)] * shift + coefficients[::-1] + [fmpq(0)] * (r - 1 - shift)
            for coefficients in (forward, backward)
            for shift in range(r)
        ]
        points.append(fmpq(-s * s))
        values.append(fmpq_mat(rows).det())
    # Newton's divided differences.
    for level in range(1, len(points)):
        for i in range(len(points) - 1, level - 1, -1):
            values[i] = (values[i] - values[i - 1]) / (points[i] - points[i - level])
    polynomial = fmpq_poly([values[-1]])
    for value, point in zip(values[-2::-1], points[-2::-1], strict=True):
        polynomial = polynomial * fmpq_poly([-point, 1]) + value
    if polynomial.is_zero():
        raise RejectedError("the resultant vanishes everywhere")
    return polynomial
