"""Boxes of told delay (sigma) and rest of the delay (rho), and whether f has a zero over one."""

from typing import Any, NamedTuple

from flint import acb, acb_mat, acb_poly, arb, arb_mat, fmpq

from railenv.stability.verifier.history_function import ORDER
from railenv.stability.verifier.history_modes import DEGREE

_SMALLEST = fmpq(1, 2**20)
_SAFE = 1.0 + 1e-9
_X, _R = ORDER + 1, DEGREE + 1


class Box(NamedTuple):
    """Centre and half width in sigma and rho, for d whole periods and an interval."""

    whole: int
    interval: int
    sigma: Any
    sigma_half: Any
    rho: Any
    rho_half: Any


def halves(box: Box, axis: str) -> list[Box]:
    """Halve a box in "sigma" or "rho"."""
    half = getattr(box, f"{axis}_half") / 2
    middle = getattr(box, axis)
    return [box._replace(**{axis: middle + side * half, f"{axis}_half": half}) for side in (1, -1)]


def _chebyshev(value: Any, terms: int) -> list[Any]:
    """Return T_0, T_1, ... at a number or a polynomial."""
    values = [value * 0 + 1, value]
    while len(values) < terms:
        values.append(2 * value * values[-1] - values[-2])
    return values[:terms]


def at_point(table: Any, point: Box) -> list[Any]:
    """Return the coefficients in x of f at one sigma and rho."""
    total = acb_poly([])
    sigma, rho = _chebyshev(arb(point.sigma), 3), _chebyshev(arb(point.rho), _R)
    for i in range(3):
        for j in range(_R):
            total += table[i][j] * acb(sigma[i] * rho[j])
    return [*total.coeffs(), acb(0)]


def table_of(f: Any) -> Any:
    """Return f as a matrix, a row per rho and a column per sigma and Chebyshev term in x."""
    powers = acb_mat(_powers())
    rows = list[list[Any]]()
    for j in range(_R):
        row = list[Any]()
        for i in range(3):
            coefs = f[i][j].coeffs()
            row.append([*coefs, *[acb(0)] * (_X - len(coefs))])
        rows.append([c for part in (acb_mat(row) * powers).tolist() for c in part])
    return acb_mat(rows)


def _powers() -> list[list[Any]]:
    """Return rows of Chebyshev coefficients of x^0, x^1, ..."""
    rows = [[arb(int(i == 0)) for i in range(_X)]]
    for _ in range(ORDER):
        row = [arb(0)] * _X
        for i, value in enumerate(rows[-1]):
            for place in (i + 1, abs(i - 1)):
                if place < _X:
                    row[place] += value / 2
        rows.append(row)
    return rows


def _part(terms: int, middle: Any, half: Any) -> Any:
    """Return R with T_j(middle + half x) = sum_i R_ij T_i(x)."""
    m, h = arb(middle), arb(half)
    columns = [[arb(int(i == 0)) for i in range(terms)]]
    columns.append([m, h, *[arb(0)] * (terms - 2)])
    while len(columns) < terms:
        last, before = columns[-1], columns[-2]
        moved = [arb(0)] * terms
        for i, value in enumerate(last):
            for place in (i + 1, abs(i - 1)):
                if place < terms:
                    moved[place] += value / 2
        columns.append(
            [2 * m * a + 2 * h * b - c for a, b, c in zip(last, moved, before, strict=True)]
        )
    return arb_mat(columns).transpose()


def place_to_cut(table: Any, box: Box) -> str:
    """Return where to cut: "sigma", "rho" or "x" (the arc); empty if there is no zero."""
    R = _part(_R, box.rho, box.rho_half)
    S = _part(3, box.sigma, box.sigma_half).tolist()
    rows = (acb_mat(R) * table).tolist()
    told = late = place = total = 0.0
    lead: Any = acb(0)
    for j, row in enumerate(rows):
        parts = [row[i * _X : (i + 1) * _X] for i in range(3)]
        for i in range(3):
            for e in range(_X):
                value = sum((parts[g][e] * S[i][g] for g in range(i, 3)), acb(0))
                size = float(abs(value).upper())
                if i == j == e == 0:
                    lead = value
                    continue
                total += size
                told += size if i else 0.0
                late += size if j else 0.0
                place += size if e else 0.0
    if float(abs(lead).lower()) > total * _SAFE:
        return ""
    rest = float(lead.rad())
    if place > max(told, late) or 4.0 * rest > total + float(abs(lead).upper()):
        return "x"
    axis = "sigma" if told >= late else "rho"
    return axis if getattr(box, f"{axis}_half") >= _SMALLEST else "x"
