"""The gain of a loop from what jitter adds to what jitter feeds on, bounded in balls.

In the words of `jitter_loop` the gain in question is that of T(s) = s R M(s)^-1 L, and

    J^2 omega^2 N Q_1 N^H < |h|^2 Q_2,   Q_1 = S Y S^T,   Q_2 = (P^T Y^-1 P)^-1

says J |D T(j omega) D^-1| < 1 for Y = (D^T D)^-1. On a piece of the imaginary axis h and N are
expanded about its centre, with bounds on what is left out. The difference of both sides is then a
polynomial in t, |t| <= 1, that some congruence takes to I + sum_k E_k t^k: positive definite if the
norms of the E_k sum to less than one. Beyond the last piece sizes of coefficients do.
"""

import math
from typing import Any

import numpy as np
from flint import acb, acb_mat, acb_poly, arb, fmpq_mat

from railenv.stability.proof.characteristic import exact
from railenv.stability.proof.counting import Effort
from railenv.stability.proof.jitter_loop import JitterLoop
from railenv.stability.proof.polynomials import UndecidedError
from railenv.units import FloatArray

Polynomial = Any
Ball = Any

_ORDER = 10
_FIRST_PIECE, _GROWTH, _SHRINK, _NARROWEST = 0.01, 3.0, 0.3, 1e-13
# The sum that the next piece's length aims at, and the largest that passes: the re-check bounds the
# same sum by other roundings and must not fail where this one passes.
_AIM, _ENOUGH = 0.75, 0.99
_FACTORIAL = math.factorial(_ORDER + 1)

_Terms = list[tuple[Polynomial, int]]


class GainBound:
    """The inequality for one weight and one jitter, at the working precision.

    Args:
        loop: The loop.
        weight: Y, symmetric and positive definite, zero between blocks.
        jitter: J [s].

    Raises:
        UndecidedError: Y is not proved to be positive definite.
    """

    def __init__(self, loop: JitterLoop, weight: FloatArray, jitter: float) -> None:
        P, _, _, S = loop.factors
        Y = fmpq_mat([[exact(v) for v in row] for row in weight.tolist()])
        for k in range(1, Y.nrows() + 1):
            if not fmpq_mat([row[:k] for row in Y.tolist()[:k]]).det() > 0:
                raise UndecidedError("the proposed weight is not positive definite")
        factor = (exact(jitter) / loop.unit) ** 2
        self._Q1 = (factor * (S * Y * S.transpose())).tolist()
        self._Q2 = (P.transpose() * Y.inv() * P).inv().tolist()
        self._h = [(acb_poly(p), k) for p, k in loop.h]
        self._N = [[[(acb_poly(p), k) for p, k in entry] for entry in row] for row in loop.response]
        self._totals = [arb(total) for total in loop.totals]
        self._degree = loop.A.nrows()

    def pieces(self, effort: Effort) -> list[float]:
        """Cut the imaginary axis into pieces on which the inequality is proved.

        Returns:
            Rising ends, from 0 to a frequency beyond which it is proved as a whole, in the unit of
            time.

        Raises:
            UndecidedError: Not proved within the effort.
        """
        end = self._far()
        ends, size = [0.0], min(_FIRST_PIECE, end)
        while ends[-1] < end:
            high = min(ends[-1] + size, end)
            effort.spend()
            size, total = high - ends[-1], self.between(ends[-1], high)
            # The sum grows about as the piece does.
            size *= min(max(_AIM / max(total, 1e-9), _SHRINK), _GROWTH)
            if total < _ENOUGH:
                ends.append(high)
            elif size < _NARROWEST * (1.0 + ends[-1]):
                raise UndecidedError("the gain comes too near to its bound")
        return ends

    def between(self, low: float, high: float) -> float:
        """Return the sum of |E_k| on a piece of the axis; below one the inequality is proved."""
        middle, half = (arb(low) + arb(high)) / 2, (arb(high) - arb(low)) / 2
        inner = acb_poly([acb(0, middle), acb(0, half)])
        phases: list[tuple[Any, Ball]] = []
        for total in self._totals:
            x = acb(0, -half * total)
            series = [acb(0, -middle * total).exp()]
            for k in range(1, _ORDER + 1):
                series.append(series[-1] * x / k)
            # Taylor's remainder of exp(j y) for real y.
            phases.append((acb_poly(series), abs(x) ** (_ORDER + 1) / _FACTORIAL))
        h = _expanded(self._h, inner, phases)
        N = [[_expanded(entry, inner, phases) for entry in row] for row in self._N]
        omega = acb_poly([middle, half])
        return self._definite(h, [[entry * omega for entry in row] for row in N])

    def _far(self) -> float:
        """Return a power of two beyond which the inequality holds, from sizes of coefficients."""
        for exponent in range(-40, 400):
            radius = arb(2) ** exponent
            h = self._leading(self._h, self._degree, radius)
            N = [
                [self._leading(entry, self._degree - 1, radius) for entry in row] for row in self._N
            ]
            if self._definite(h, N) < _ENOUGH:
                return 2.0**exponent
        raise UndecidedError("the gain at high frequency is not below its bound")

    def _leading(self, terms: _Terms, degree: int, radius: Ball) -> Any:
        """Enclose f(s) / s^degree for all |s| >= radius on the axis, as a constant."""
        value, rest = acb(0), arb(0)
        for p, k in terms:
            for power, c in enumerate(p.coeffs()):
                if power == degree and self._totals[k].is_zero():
                    value += c
                else:
                    rest += abs(c) * radius ** (power - degree)
        return acb_poly([value + _disc(rest)])

    def _definite(self, h: Polynomial, sN: list[list[Polynomial]]) -> float:
        """Return the sum of |E_k| for |h|^2 Q_2 - (s N) Q_1 (s N)^H; infinite if there is none."""
        centre = h[0].mid()
        if h[0].contains(0):
            return math.inf
        # The numbers may be as large as |s|^n: what follows, doubles among it, is relative to h.
        inverse = (1 / centre).mid()
        h, sN = h * inverse, [[entry * inverse for entry in row] for row in sN]
        size, inner = len(sN), range(len(self._Q1))
        sQ = [
            [
                sum((row[k] * q[j] for k, q in enumerate(self._Q1) if q[j] != 0), acb_poly())
                for j in inner
            ]
            for row in sN
        ]
        own, others = h * _conjugate(h), [[_conjugate(entry) for entry in row] for row in sN]
        G = [
            [
                own * self._Q2[i][j] - sum((sQ[i][k] * others[j][k] for k in inner), acb_poly())
                for j in range(size)
            ]
            for i in range(size)
        ]
        constant = np.array([[complex(entry[0].mid()) for entry in row] for row in G])
        C = _congruence(constant)
        if C is None:
            return math.inf
        across = acb_mat([[acb(z.real, z.imag) for z in row] for row in C.tolist()])
        back = across.conjugate().transpose()
        identity = acb_mat([[int(i == j) for j in range(size)] for i in range(size)])
        total = arb(0)
        for power in range(max(entry.length() for row in G for entry in row)):
            part = back * acb_mat([[entry[power] for entry in row] for row in G]) * across
            excess = part - identity if power == 0 else part
            # Upper bounds first: the square root of a ball that reaches below zero is none.
            total += sum((abs(z).upper() ** 2 for z in excess.entries()), arb(0)).sqrt()
        bound = float(total.upper())
        # The nearest double may lie below; it is compared with what is well above or below it.
        return bound if math.isfinite(bound) else math.inf


def _congruence(G: Any) -> Any:
    """Propose C with C^H G C = I; None if G does not look positive definite."""
    diagonal = np.real(np.diag(G))
    if not (np.all(np.isfinite(G)) and np.all(diagonal > 0.0)):
        return None
    scale = 1.0 / np.sqrt(diagonal)
    values, vectors = np.linalg.eigh(G * scale * scale[:, None])
    if values[0] <= 0.0:
        return None
    return scale[:, None] * vectors / np.sqrt(values)


def _expanded(terms: _Terms, inner: Polynomial, phases: list[tuple[Any, Ball]]) -> Polynomial:
    """Expand a quasi-polynomial on a piece; the bound on the rest goes into the constant."""
    value, rest = acb_poly(), arb(0)
    for p, k in terms:
        coefficients = p(inner).coeffs()
        sizes = [abs(c) for c in coefficients]
        size, (series, remainder) = sum(sizes, arb(0)), phases[k]
        if not remainder < 1:
            # Too long a piece for the series, but exp(-s T) has modulus one on the axis.
            rest += size
            continue
        value += acb_poly(coefficients[: _ORDER + 1]) * series
        rest += size * remainder + sum(sizes[_ORDER + 1 :], arb(0))
    whole = value.coeffs()
    rest += sum((abs(c) for c in whole[_ORDER + 1 :]), arb(0))
    return acb_poly(whole[: _ORDER + 1]) + _disc(rest)


def _disc(radius: Ball) -> Any:
    """Return a ball that holds all complex numbers up to this modulus."""
    bound = radius.upper()
    return acb(arb(0, bound), arb(0, bound))


def _conjugate(p: Polynomial) -> Polynomial:
    return acb_poly([c.conjugate() for c in p.coeffs()])
