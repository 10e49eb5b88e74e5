"""A range of delays as a convex hull: control points of G(T - r), r in [low, high].

G(s) is the integral of exp(A q) B over q in [0, s]. About the middle s_m of the range of s,

    G(s_m + h t) = G(s_m) + exp(A s_m) sum_(j >= 1) A^(j-1) B h^j t^j / j!,    t in [-1, 1].

The series is cut with a bound on its rest, written in Chebyshev polynomials, those of low degree in
Bernstein form (the curve lies in the convex hull of the coefficients), and the others, never larger
than one, go into the radii together with the rest.
"""

from functools import lru_cache
from math import comb, lgamma, log
from typing import Any

from flint import arb, arb_mat, fmpq, fmpq_mat

from railenv.stability.proof.ball_matrices import Matrix, norm_bound

# The series is cut where its next term is below 2^-_CUT, and not followed beyond this many terms:
# a shorter range of delays is to be asked for instead.
_CUT, _LONGEST_SERIES = 120, 250


def control_points(
    A: Matrix, B: Matrix, flow: Matrix, effect: Matrix, half: Any, degree: int
) -> list[Matrix] | None:
    """Enclose the curve.

    Args:
        A: Plant, balls.
        B: Inputs, balls.
        flow: exp(A s_m).
        effect: G(s_m).
        half: Half the width h of the range [s], exact.
        degree: Of the Bernstein form.

    Returns:
        degree + 1 ball matrices whose convex hull contains the curve, from the shortest s to the
        longest; None if the range is too long for the series.
    """
    size = float(norm_bound(A) * arb(half))
    terms = degree + 2
    while terms * log(max(size, 1e-300)) - lgamma(terms + 1.0) > -_CUT * log(2.0):
        terms += 1
        if terms > _LONGEST_SERIES:
            return None
    power, series = B, [effect]
    for j in range(1, terms):
        power = power * arb(half / j)
        series.append(flow * power)
        power = A * power
    # The next term is flow A^(J-1) B h^J / J!, the following ones fall at least by this ratio.
    ratio = norm_bound(A) * arb(half / (terms + 1))
    if not ratio < 1:
        return None
    rest = norm_bound(flow) * norm_bound(power) * arb(half / terms) / (1 - ratio)
    coefficients = arb_mat(terms, B.nrows() * B.ncols(), [v for m in series for v in m.entries()])
    near, far = _weights(terms, degree)
    radii = [rest] * coefficients.ncols()
    for row in (arb_mat(far) * coefficients).tolist():
        radii = [radius + abs(value) for radius, value in zip(radii, row, strict=True)]
    around = [arb(0, radius.upper()) for radius in radii]
    return [
        arb_mat(B.nrows(), B.ncols(), [v + r for v, r in zip(point, around, strict=True)])
        for point in (arb_mat(near) * coefficients).tolist()
    ]


@lru_cache(maxsize=64)
def _weights(terms: int, degree: int) -> tuple[Matrix, Matrix]:
    """Return exact weights for sum_j c_j t^j: control points, and Chebyshev coefficients beyond."""
    chebyshev = [[fmpq(0)] * terms for _ in range(terms)]
    for j in range(terms):
        for k in range(j % 2, j + 1, 2):
            weight = fmpq(2 * comb(j, (j - k) // 2), 2**j)
            chebyshev[k][j] = weight / 2 if k == 0 else weight
    bernstein = [[fmpq(0)] * (degree + 1) for _ in range(degree + 1)]
    for k in range(degree + 1):
        # T_k on [-1, 1] has the control values (-1)^(k-i) C(2k, 2i) / C(k, i); then the degree is
        # raised step by step.
        values = [fmpq((-1) ** (k - i) * comb(2 * k, 2 * i), comb(k, i)) for i in range(k + 1)]
        for d in range(k + 1, degree + 1):
            inner = [(values[i - 1] * i + values[i] * (d - i)) / d for i in range(1, d)]
            values = [values[0], *inner, values[-1]]
        for i, value in enumerate(values):
            bernstein[i][k] = value
    return fmpq_mat(bernstein) * fmpq_mat(chebyshev[: degree + 1]), fmpq_mat(
        chebyshev[degree + 1 :]
    )
