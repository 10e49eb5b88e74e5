"""The matrix inequality of a jitter certificate, shown on pieces of the imaginary axis."""

import itertools
import math
from typing import Any

from flint import acb, acb_poly, arb

from railenv.stability.verifier.quasipolynomial import RejectedError

Matrix = Any
Terms = list[tuple[Any, Any]]
"""Polynomials, each with its total delay: sum of p(s) exp(-s T)."""

_ORDER = 12


class GainGap:
    """|h|^2 Q2 - omega^2 N Q1 N^H, to be shown positive definite."""

    def __init__(self, h: Terms, N: list[list[Terms]], Q1: Matrix, Q2: Matrix, degree: int) -> None:
        self._Q1, self._Q2, self._degree = Q1.tolist(), Q2.tolist(), degree
        self._h = [(acb_poly(p), arb(total)) for p, total in h]
        self._N = [[[(acb_poly(p), arb(t)) for p, t in entry] for entry in row] for row in N]

    def between(self, low: Any, high: Any, halvings: int) -> bool:
        """Show it on a piece, or on both halves of it."""
        middle, half = (low + high) / 2, (high - low) / 2
        h = _on_piece(self._h, arb(middle), arb(half))
        omega = acb_poly([acb(arb(middle)), acb(arb(half))])
        sN = [[omega * _on_piece(e, arb(middle), arb(half)) for e in row] for row in self._N]
        if self._positive(h, sN):
            return True
        return halvings > 0 and (
            self.between(low, middle, halvings - 1) and self.between(middle, high, halvings - 1)
        )

    def beyond(self, radius: Any) -> bool:
        """Show it for every |omega| >= radius, divided by omega^(2 n)."""
        size = arb(radius)
        h = _far(self._h, self._degree, size)
        sN = [[_far(entry, self._degree - 1, size) for entry in row] for row in self._N]
        return self._positive(h, sN)

    def _positive(self, h: Any, sN: list[list[Any]]) -> bool:
        """Whether it is positive definite for every t in [-1, 1]."""
        if h[0].contains(0):
            return False
        factor = 1 / acb(h[0].mid())
        h, sN = h * factor, [[entry * factor for entry in row] for row in sN]
        size, inner = range(len(sN)), range(len(self._Q1))
        bars = [[_bar(entry) for entry in row] for row in sN]
        square = h * _bar(h)
        G = [[square * self._Q2[i][j] for j in size] for i in size]
        for i, k in itertools.product(size, inner):
            weighted = sum((sN[i][a] * self._Q1[a][k] for a in inner), acb_poly([]))
            for j in size:
                G[i][j] = G[i][j] - weighted * bars[j][k]
        C = _inverse_factor([[acb(G[i][j][0].mid()) for j in size] for i in size])
        if C is None:
            return False
        # C G C^H = I + E_0 + E_1 t + ...: the norms of the E_k must sum to less than one.
        total = arb(0)
        for power in range(max(len(entry.coeffs()) for row in G for entry in row)):
            squares = arb(0)
            for i, j in itertools.product(size, repeat=2):
                z = sum(
                    (C[i][a] * G[a][b][power] * C[j][b].conjugate() for a in size for b in size),
                    acb(-1 if power == 0 and i == j else 0),
                )
                squares += z.abs_upper() ** 2
            total += squares.sqrt()
        return bool(total < 1)


def _inverse_factor(G: list[list[Any]]) -> list[list[Any]] | None:
    """Return C near the inverse of G's Cholesky factor, entries without radius; None if none."""
    size = len(G)
    low: list[list[Any]] = [[acb(0)] * size for _ in range(size)]
    for j in range(size):
        rest = G[j][j].real - sum((abs(low[j][k]) ** 2 for k in range(j)), arb(0))
        if not rest > 0:
            return None
        low[j][j] = acb(rest.sqrt())
        for i in range(j + 1, size):
            mixed = sum((low[i][k] * low[j][k].conjugate() for k in range(j)), acb(0))
            low[i][j] = (G[i][j] - mixed) / low[j][j]
    C: list[list[Any]] = [[acb(0)] * size for _ in range(size)]
    for j in range(size):
        for i in range(j, size):
            known = sum((low[i][k] * C[k][j] for k in range(j, i)), acb(0))
            C[i][j] = acb((((1 if i == j else 0) - known) / low[i][i]).mid())
    return C


def _on_piece(terms: Terms, middle: Any, half: Any) -> Any:
    """Enclose sum p(s) exp(-s T) at s = j (middle + half t) as a polynomial in t, |t| <= 1."""
    line = acb_poly([acb(0, middle), acb(0, half)])
    value, rest = acb_poly([]), arb(0)
    for p, total in terms:
        moved = p(line).coeffs()
        size = sum((abs(c) for c in moved), arb(0))
        # |exp(j y) - its Taylor polynomial| <= |y|^k / k!, and |exp(j y)| = 1.
        y = half * total
        beyond = y ** (_ORDER + 1) / math.factorial(_ORDER + 1)
        if not beyond < 1:
            rest += size
            continue
        series = [acb(0, -middle * total).exp()]
        for k in range(1, _ORDER + 1):
            series.append(series[-1] * acb(0, -y) / k)
        value += acb_poly(moved[: _ORDER + 1]) * acb_poly(series)
        rest += size * beyond + sum((abs(c) for c in moved[_ORDER + 1 :]), arb(0))
    whole = value.coeffs()
    rest += sum((abs(c) for c in whole[_ORDER + 1 :]), arb(0))
    return acb_poly(whole[: _ORDER + 1]) + acb_poly([_disc(rest)])


def _far(terms: Terms, degree: int, radius: Any) -> Any:
    """Enclose sum p(s) exp(-s T) / s^degree for |s| >= radius on the axis, as a constant."""
    value, rest = acb(0), arb(0)
    for p, total in terms:
        for power, c in enumerate(p.coeffs()):
            if power == degree and total.is_zero():
                value += c
            elif power <= degree:
                rest += abs(c) / radius ** (degree - power)
            else:
                raise RejectedError("the loop is not retarded")
    return acb_poly([value + _disc(rest)])


def _disc(radius: Any) -> Any:
    bound = radius.abs_upper()
    return acb(arb(0, bound), arb(0, bound))


def _bar(p: Any) -> Any:
    return acb_poly([c.conjugate() for c in p.coeffs()])
