"""The plant's modes under a hold, in balls.

A = V (Lambda + E) V^-1 with V taken exactly and E enclosed and tiny; what E changes is a bound.
"""

from math import comb
from typing import Any

from flint import acb, acb_mat, arb

from railenv.stability.verifier.quasipolynomial import RejectedError

DEGREE = 7
_MOST_SERIES = 160

Matrix = Any


class Modes:
    """Modes of x' = A x + B v, y = C x + D v, with v held for a period T.

    Attributes:
        turns: exp(lambda_i T).
        residues: c_i b_i, a row per reading and signal, a column per mode.
        late: Chebyshev coefficients of g_i(T - r) in rho; the first holds what is left out.
        whole: g_i(T).
        direct: D.
        drift: Per reading, a ball for what E changes in P.
        outside: Number of modes outside the unit circle.

    Raises:
        RejectedError: The eigenvectors found do not split A, or a mode may be on the unit circle.
    """

    def __init__(self, A: Matrix, B: Matrix, C: Matrix, D: Matrix, T: Any) -> None:
        n = A.nrows()
        try:
            vectors = acb_mat(A).eig(right=True, algorithm="approx")[1]
            V = acb_mat(n, n, [acb(v.real.mid(), v.imag.mid()) for v in vectors.entries()])
            product = V.inv() * acb_mat(A) * V
        except (ValueError, ZeroDivisionError):
            raise RejectedError("the plant's eigenvectors are not independent") from None
        values = [acb(product[i, i].real.mid(), product[i, i].imag.mid()) for i in range(n)]
        off = arb(0)
        for i in range(n):
            others = (product[i, j] - (values[i] if i == j else 0) for j in range(n))
            off = _larger(off, sum((abs(v) for v in others), arb(0)))
        turns = [(value * T).exp() for value in values]
        self.outside, nearest, growth = 0, arb(1), arb(0)
        for turn, value in zip(turns, values, strict=True):
            distance = abs(abs(turn) - 1)
            if not distance > 0:
                raise RejectedError("a mode of the plant may be on the unit circle")
            self.outside += bool(abs(turn) > 1)
            nearest = -_larger(-nearest, -distance)
            growth = _larger(growth, value.real)
        # exp((Lambda + E) q) differs from exp(Lambda q) by at most this in rows, |E| <= off.
        change = T * off * ((growth + off) * T).exp()
        if not change < nearest / 2:
            raise RejectedError("the plant's eigenvectors do not split it into modes")
        # The resolvent is at most 1 / nearest, and that of the true plant at most twice that.
        held = 3 * T * (growth * T).exp()
        drift = 2 / nearest * (held * change / nearest + 3 * T * change)
        out, into = acb_mat(C) * V, V.inv() * acb_mat(B)
        p, m = C.nrows(), B.ncols()
        largest = arb(0)
        for entry in into.entries():
            largest = _larger(largest, abs(entry))
        rows = [sum((abs(out[s, i]) for i in range(n)), arb(0)) for s in range(p)]
        self.drift = [around(row * drift * largest) for row in rows]
        self.turns, self.direct = turns, acb_mat(D)
        self.residues = acb_mat(
            [[out[s, i] * into[i, a] for i in range(n)] for s in range(p) for a in range(m)]
        )
        self.late = [late_series(value, T) for value in values]
        self.whole = [T * _average(value * T) for value in values]


def _average(x: Any) -> Any:
    """Return (exp(x) - 1) / x = sum x^k / (k + 1)!."""
    total, term = acb(0), acb(1)
    for k in range(2, _MOST_SERIES):
        total += term
        term = term * x / k
        if abs(x) < (k + 1) / 2 and abs(term) < arb(2) ** -150:
            return total + around(2 * abs(term))
    raise RejectedError("a mode of the plant is too fast for the period")


def late_series(value: Any, T: Any) -> list[Any]:
    """Return Chebyshev coefficients of g(T - r) in rho, the first with what is left out.

    g(T - r) = g(T / 2) + (T / 2) exp(u) sum_(n >= 1) (-1)^n u^(n-1) rho^n / n!, u = lambda T / 2.
    """
    u = value * T / 2
    taylor, term = [T / 2 * _average(u)], T / 2 * u.exp()
    for n in range(1, _MOST_SERIES):
        term = -term / n
        taylor.append(term)
        if n > DEGREE and abs(u) < (n + 1) / 2 and abs(term) < arb(2) ** -150:
            break
        term = term * u
    else:
        raise RejectedError("a mode of the plant is too fast for the period")
    coefs, beyond = list[Any](), 2 * abs(taylor[-1])
    for k in range(len(taylor)):
        terms = range(k, len(taylor), 2)
        value = sum((taylor[n] * comb(n, (n - k) // 2) / acb(2) ** n for n in terms), acb(0))
        value = value * (1 if k == 0 else 2)
        if k <= DEGREE:
            coefs.append(value)
        else:
            beyond += abs(value)
    coefs[0] += around(beyond)
    return coefs


def around(radius: Any) -> Any:
    """Return the complex ball around zero that holds the disc of a radius."""
    ball = arb(0, radius.upper())
    return acb(ball, ball)


def _larger(a: Any, b: Any) -> Any:
    """Return an upper bound of both."""
    return a.upper() if a.upper() >= b.upper() else b.upper()
