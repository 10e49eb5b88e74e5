"""A plant under a hold, mode by mode, enclosed.

x' = A x + B v with A = V (Lambda + E) V^-1, V taken exactly and E enclosed (tiny). With
w = 1/z, the readings under commands held from d T + r on are w^(d+1) P(w, r) v with

    P(w, r) = D + sum_i c_i b_i [(1 - w) g_i(T - r) + w g_i(T)] / (1 - mu_i w)

mu_i = exp(lambda_i T), g_i(s) = integral of exp(lambda_i q) over q in [0, s], c_i column i of C V
and b_i row i of V^-1 B. What E changes is added as a bound that holds for every |w| = 1 and r.

g_i(T - r) is a series of Chebyshev polynomials in 2 r / T - 1, with a bound on what is left out.
"""

from dataclasses import dataclass
from math import comb
from typing import Any

import numpy as np
from flint import acb, acb_mat, arb

from railenv.stability.proof.ball_matrices import Matrix, in_balls, rational
from railenv.stability.proof.history_models import SLACK, Constants
from railenv.stability.proof.precision import precision
from railenv.units import FloatArray

DEGREE = 7
"""Degree of the Chebyshev series in the rest of the delay."""

BITS = 256
"""Working precision of the modes."""

# The exponential series is cut where its next term is below this; a mode that needs more terms
# turns or decays by far too much within a period.
_CUT, _MOST_TERMS = 1e-40, 160


class ModesError(Exception):
    """The modes cannot be enclosed; the text says why."""


@dataclass(frozen=True, eq=False)
class HeldModes:
    """The plant's modes, n of them, between m commands and p readings.

    Attributes:
        turn: mu_i, shape (n,).
        residues: c_i b_i, shape (p, m, n).
        late: Chebyshev coefficients of g_i(T - r), shape (n, DEGREE + 1).
        late_rest: What they leave out, shape (n,).
        whole: g_i(T), shape (n,).
        direct: D, shape (p, m).
        drift: Bound of what E changes in P, shape (p, m).
        outside: Number of modes with |mu_i| > 1, proved.
    """

    turn: Constants
    residues: Constants
    late: Constants
    late_rest: FloatArray
    whole: Constants
    direct: Constants
    drift: FloatArray
    outside: int


def held_modes(A: FloatArray, B: Matrix, C: FloatArray, D: Matrix, period: float) -> HeldModes:
    """Enclose the modes.

    Args:
        A: Plant, shape (n, n); every entry is taken as the exact number it is.
        B: Commands, exact, (n, m).
        C: Readings, shape (p, n).
        D: Feedthrough, exact, (p, m).
        period: Control period T [s].

    Raises:
        ModesError: The eigenvectors found do not split the plant, a mode is on the unit circle, or
            a mode is too fast for the period.
    """
    with precision(BITS):
        n, T = len(A), arb(float(period))
        plant = acb_mat(in_balls(rational(A)))
        V, values, off = _split(plant, n)
        out = acb_mat(in_balls(rational(C))) * V
        into = V.inv() * acb_mat(in_balls(B))
        turns = [(value * T).exp() for value in values]
        late, rests, wholes = list[list[Any]](), list[float](), list[Any]()
        for value in values:
            coefs, rest = _late_series(value * T / 2, T)
            late.append(coefs)
            rests.append(rest)
            wholes.append(T * _average(value * T))
        p, m = out.nrows(), into.ncols()
        products = [out[s, i] * into[i, a] for s in range(p) for a in range(m) for i in range(n)]
        outside, nearest = _outside(turns)
        drift = _drift(values, turns, out, into, off, nearest, T)
        return HeldModes(
            turn=rounded(turns),
            residues=rounded(products).reshape(p, m, n),
            late=rounded([c for row in late for c in row]).reshape(n, DEGREE + 1),
            late_rest=np.array(rests),
            whole=rounded(wholes),
            direct=rounded(acb_mat(in_balls(D)).entries()).reshape(p, m),
            drift=drift,
            outside=outside,
        )


def rounded(values: list[Any]) -> Constants:
    """Round balls to doubles; the radius covers ball and rounding."""
    middle = np.array([complex(float(v.real.mid()), float(v.imag.mid())) for v in values])
    radius = np.array([float(abs(v - acb(c)).upper()) for v, c in zip(values, middle, strict=True)])
    return Constants(middle, radius * (1.0 + SLACK))


def _split(plant: Matrix, n: int) -> tuple[Matrix, list[Any], Any]:
    """Return exact V, the diagonal of V^-1 A V, and a bound of the rows of the rest."""
    try:
        vectors = plant.eig(right=True, algorithm="approx")[1]
        V = acb_mat(n, n, [acb(v.real.mid(), v.imag.mid()) for v in vectors.entries()])
        product = V.inv() * plant * V
    except (ValueError, ZeroDivisionError):
        raise ModesError("the plant's eigenvectors are not independent") from None
    values = [acb(product[i, i].real.mid(), product[i, i].imag.mid()) for i in range(n)]
    off = arb(0)
    for i in range(n):
        row = arb(0)
        for j in range(n):
            row += abs(product[i, j] - (values[i] if i == j else acb(0)))
        off = arb(max(off.upper(), row.upper()))
    if not off < arb(2) ** -60:
        raise ModesError("the plant's eigenvectors do not split it into modes")
    return V, values, off


def _average(x: Any) -> Any:
    """Return (exp(x) - 1) / x, entire."""
    total, term = acb(0), acb(1)
    for k in range(1, _MOST_TERMS):
        total += term
        term = term * x / (k + 1)
        if abs(term) < _CUT and abs(x) < (k + 2) / 2:
            # The terms left out fall at least by one half each.
            bound = 2 * abs(term).upper()
            return total + acb(arb(0, bound), arb(0, bound))
    raise ModesError("a mode of the plant is too fast for the control period")


def _late_series(x: Any, T: Any) -> tuple[list[Any], float]:
    """Return Chebyshev coefficients of g(T - r) in rho = 2 r / T - 1, for x = lambda T / 2.

    g(T - r) = g(T / 2) + (T / 2) exp(x) sum_(n >= 1) (-1)^n x^(n-1) rho^n / n!
    """
    scale = T / 2 * x.exp()
    taylor = [T / 2 * _average(x)]
    power = scale
    while True:
        n = len(taylor)
        power = power * (-1) / n
        taylor.append(power)
        if abs(power) < _CUT * T and abs(x) < (n + 1) / 2 and n > DEGREE:
            left_out = 2 * abs(power).upper()
            break
        if n > _MOST_TERMS:
            raise ModesError("a mode of the plant is too fast for the control period")
        power = power * x
    coefs, rest = [acb(0)] * (DEGREE + 1), arb(left_out)
    for k in range(len(taylor)):
        value = acb(0)
        for n in range(k, len(taylor), 2):
            share = arb(comb(n, (n - k) // 2)) / arb(2) ** (n if k == 0 else n - 1)
            value += taylor[n] * share
        if k <= DEGREE:
            coefs[k] = value
        else:
            rest += abs(value)
    return coefs, float(rest.upper()) * (1.0 + SLACK)


def _outside(turns: list[Any]) -> tuple[int, Any]:
    """Return how many modes are outside the unit circle, and the nearest distance to it."""
    outside, nearest = 0, arb(1)
    for turn in turns:
        distance = abs(abs(turn) - 1)
        if not distance > 0:
            raise ModesError("a mode of the plant without control is on the unit circle")
        outside += bool(abs(turn) > 1)
        nearest = arb(min(nearest.lower(), distance.lower()))
    return outside, nearest


def _drift(
    values: list[Any], turns: list[Any], out: Matrix, into: Matrix, off: Any, nearest: Any, T: Any
) -> FloatArray:
    """Bound what E changes in P.

    For s <= T, |exp((Lambda + E) s) - exp(Lambda s)| <= e = T |E| exp((a + |E|) T) in the maximum
    norm, a the largest real part or zero, and the integral over s changes by at most T e. With
    N = (1 - w) g(T - r) + w g(T), |N| <= 3 T exp(a T), and the resolvent R on the unit circle,
    |R| <= 1 / nearest: R' N' - R N = (R' - R) N + R' (N' - N), where R' - R = R w (change) R',
    |R'| <= |R| / (1 - |R| e) and |N' - N| <= 3 T e.
    """
    growth = arb(0)
    for value in values:
        growth = arb(max(growth.upper(), value.real.upper()))
    change = T * off * ((growth + off) * T).exp()
    resolvent = 1 / nearest
    if not resolvent * change < 1:
        raise ModesError("the plant's eigenvectors do not split it into modes")
    changed = resolvent / (1 - resolvent * change)
    held = 3 * T * (growth * T).exp()
    factor = resolvent * change * changed * held + changed * 3 * T * change
    p, m, n = out.nrows(), into.ncols(), len(turns)
    result = np.zeros((p, m))
    for a in range(m):
        column = arb(0)
        for i in range(n):
            column = arb(max(column.upper(), abs(into[i, a]).upper()))
        for s in range(p):
            row = sum((abs(out[s, i]) for i in range(n)), arb(0))
            result[s, a] = float((row * factor * column).upper()) * (1.0 + SLACK)
    return result
