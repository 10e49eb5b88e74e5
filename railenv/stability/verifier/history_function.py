"""The characteristic function of a loop with a finite history, in balls.

With w = 1/z, x' = A x + B S v, y = C x + D S v and v_k = -sum_h G_h y_(k-h) - sum_h F_h v_(k-h)
held from d T + r on, f(w) = det(I + sum_h F_h w^h + w^d sum_h G_h w^(h+1) P(w, r)), where P is the
sum over the plant's modes of c_i b_i ((1 - w) g_i(T - r) + w g_i(T)) / (1 - exp(lambda_i T) w),
plus D S, and g_i(s) the integral of exp(lambda_i q) over [0, s].

On an arc w = exp(-i pi (t + s x)), |x| <= 1, functions are polynomials in x of degree ORDER whose
constant ball also holds what is left out. In rho = 2 r / T - 1 and in sigma, the place between two
knots, they are series of Chebyshev polynomials.
"""

from typing import Any, cast

from flint import acb, acb_mat, acb_poly, arb, arb_mat, ctx

from railenv.stability.verifier.history_modes import DEGREE, Modes, around
from railenv.stability.verifier.quasipolynomial import RejectedError, rational

ORDER = 10
_TERMS = ORDER + 1
# Bits for the modes, and for what is done on an arc.
_MODE_BITS, ARC_BITS = 256, 80

Matrix = Any
Poly = Any


class Function:
    """f of one loop with one or two signals.

    Args:
        system: `A B C D measured commanded spread told period` in plain numbers.
    """

    def __init__(self, system: dict[str, Any]) -> None:
        ctx.prec = _MODE_BITS
        _require_shapes(system)
        self.period = rational(system["period"])
        A, B, C, D, S = (_matrix(system[name]) for name in ("A", "B", "C", "D", "spread"))
        measured, commanded = system["measured"], system["commanded"]
        self.signals, self.knots, self.readings = S.ncols(), len(measured), C.nrows()
        if self.signals not in (1, 2) or len(commanded) != self.knots:
            raise RejectedError("a law has one or two signals and gains for every knot")
        self.modes = Modes(A, B * S, C, D * S, arb(self.period))
        r, p = self.signals, self.readings
        self.ages, self.past = len(measured[0]), len(commanded[0])
        self._G = acb_mat(
            [
                [acb(_exact(measured[k][h][a][s])) for h in range(self.ages)]
                for k in range(self.knots)
                for a in range(r)
                for s in range(p)
            ]
        )
        self._F = [
            [
                [[_exact(commanded[k][h][a][b]) for h in range(self.past)] for b in range(r)]
                for a in range(r)
            ]
            for k in range(self.knots)
        ]

    def parts(self, w: list[Poly], intervals: list[int]) -> dict[int, Any]:
        """Return xx, xy, yy of f = xx + w^d xy + w^(2 d) yy for intervals between knots.

        Each is a table of 3 rows (sigma) of DEGREE + 1 polynomials (rho).
        """
        plant = self._plant(w)
        r, p, width = self.signals, self.readings, self.signals * (DEGREE + 1)
        gains = self._G * acb_mat([_coefs(w[h + 1]) for h in range(self.ages)])
        rows = self.knots * r
        left = [
            acb_mat([[gains[i * p + s, e] for s in range(p)] for i in range(rows)])
            for e in range(_TERMS)
        ]
        right = [acb_mat([[row[e] for row in plant[s]] for s in range(p)]) for e in range(_TERMS)]
        products = [acb_mat(rows, width) for _ in range(2 * ORDER + 1)]
        for e in range(_TERMS):
            for g in range(_TERMS):
                products[e + g] += left[e] * right[g]
        tables: list[Any] = [product.tolist() for product in products]

        def through(k: int, a: int, b: int) -> list[Poly]:
            place = [b * (DEGREE + 1) + j for j in range(DEGREE + 1)]
            return [folded(acb_poly([table[k * r + a][c] for table in tables])) for c in place]

        found = dict[int, Any]()
        knots = sorted({k + i for k in intervals for i in (0, 1) if k + i < self.knots})
        Y = {k: [[through(k, a, b) for b in range(r)] for a in range(r)] for k in knots}
        X = {k: [[[self._own(w, k, a, b)] for b in range(r)] for a in range(r)] for k in knots}
        for k in intervals:
            found[k] = _determinant(_middle(X, k, self.knots), _middle(Y, k, self.knots))
        return found

    def _own(self, w: list[Poly], k: int, a: int, b: int) -> Poly:
        total = acb_poly([int(a == b)])
        for h in range(self.past):
            total += w[h + 1] * acb(self._F[k][a][b][h])
        return total

    def _plant(self, w: list[Poly]) -> list[list[list[Any]]]:
        """Return P: per reading a list over signals and rho of coefficient lists."""
        modes, held = self.modes, list[list[Any]]()
        for turn, late, whole in zip(modes.turns, modes.late, modes.whole, strict=True):
            resolvent = reciprocal(1 - w[1] * turn)
            early, other = folded(resolvent * w[1]), folded(resolvent * (1 - w[1]))
            row: list[Any] = [other * value for value in late]
            row[0] += early * whole
            held.append([c for poly in row for c in _coefs(poly)])
        product = (modes.residues * acb_mat(held)).tolist()
        m, plant = self.signals, list[list[list[Any]]]()
        for s in range(self.readings):
            row = [
                product[s * m + a][j * _TERMS : (j + 1) * _TERMS]
                for a in range(m)
                for j in range(DEGREE + 1)
            ]
            for a in range(m):
                row[a * (DEGREE + 1)][0] += modes.direct[s, a] + modes.drift[s]
            plant.append(row)
        return plant


def powers(t: Any, s: Any, most: int) -> list[Poly]:
    """Return w^n for n up to `most` on an arc; t and s are exact."""
    turn, step = acb(-arb(t)).exp_pi_i(), arb.pi() * arb(s)
    result, value = list[Poly](), acb(1)
    for n in range(most + 1):
        term, coefs = value, list[Any]()
        for e in range(_TERMS):
            coefs.append(term)
            term = term * acb(0, -1) * step * n / (e + 1)
        coefs[0] += around(abs(term))
        result.append(acb_poly(coefs))
        value = value * turn
    return result


def _require_shapes(system: dict[str, Any]) -> None:
    n, m, p = (len(system[name]) for name in ("A", "spread", "C"))
    r, q = len(system["spread"][0]), len(system["told"])
    ages, past = len(system["measured"][0]), len(system["commanded"][0])
    shapes = {
        "A": (n, n),
        "B": (n, m),
        "C": (p, n),
        "D": (p, m),
        "spread": (m, r),
        "measured": (q, ages, r, p),
        "commanded": (q, past, r, r),
    }
    if 0 in (n, m, p, r, q, ages):
        raise RejectedError("a part of the loop is empty")
    for name, shape in shapes.items():
        _require_shape(name, system[name], shape)


def _require_shape(name: str, value: Any, shape: tuple[int, ...]) -> None:
    if not shape:
        rational(value)
        return
    if not isinstance(value, list) or len(cast(list[Any], value)) != shape[0]:
        raise RejectedError(f"{name} has not the shape that the rest of the loop asks for")
    for entry in cast(list[Any], value):
        _require_shape(name, entry, shape[1:])


def folded(poly: Poly) -> Poly:
    """Cut a polynomial at ORDER; what is beyond goes to the constant ball, as |x| <= 1."""
    coefs = poly.coeffs()
    if len(coefs) <= _TERMS:
        return poly
    beyond = sum((abs(c) for c in coefs[_TERMS:]), arb(0))
    coefs = coefs[:_TERMS]
    coefs[0] += around(beyond)
    return acb_poly(coefs)


def reciprocal(q: Poly) -> Poly:
    """Return 1 / q: with |q p - 1| <= e < 1/2 the error of p is at most |p| e / (1 - e)."""
    middle = [_mid(c) for c in _coefs(q)]
    if middle[0] == 0:
        raise ZeroDivisionError
    coefs = [1 / middle[0]]
    for e in range(1, _TERMS):
        known = sum((middle[j] * coefs[e - j] for j in range(1, e + 1)), acb(0))
        coefs.append(-known * coefs[0])
    coefs = [_mid(c) for c in coefs]
    proposal = acb_poly(coefs)
    error = sum((abs(c) for c in (q * proposal - 1).coeffs()), arb(0))
    if not error < 0.5:
        raise ZeroDivisionError
    coefs[0] += around(sum((abs(c) for c in coefs), arb(0)) * error / (1 - error))
    return acb_poly(coefs)


def _middle(table: dict[int, Any], k: int, knots: int) -> list[Any]:
    """Return the mean of two neighbouring knots and half their difference."""
    if knots == 1:
        return [table[k], [[[poly * 0 for poly in b] for b in a] for a in table[k]]]
    low, high = table[k], table[k + 1]
    half = acb(1) / 2
    both = list[Any]()
    for sign in (1, -1):
        both.append(
            [
                [
                    [(y + x * sign) * half for x, y in zip(u, v, strict=True)]
                    for u, v in zip(a, b, strict=True)
                ]
                for a, b in zip(low, high, strict=True)
            ]
        )
    return both


def _determinant(X: list[Any], Y: list[Any]) -> tuple[Any, Any, Any]:
    """Return xx, xy and yy with their Chebyshev coefficients in sigma."""
    if len(X[0]) == 1:
        linear = [[_pad(M[i][0][0]) for i in (0, 1)] for M in (X, Y)]
        empty = _pad([])
        return (*((low, high, empty) for low, high in linear), (empty, empty, empty))
    return (
        _in_sigma([[_polar(a, b) for b in X] for a in X]),
        _in_sigma([[_sum(_polar(X[i], Y[j]), _polar(Y[i], X[j])) for j in (0, 1)] for i in (0, 1)]),
        _in_sigma([[_polar(a, b) for b in Y] for a in Y]),
    )


def _in_sigma(product: list[list[Any]]) -> tuple[list[Poly], list[Poly], list[Poly]]:
    """Return sigma^0 and sigma^1 parts and half the square's: sigma^2 = (T_2 + 1) / 2."""
    square = [poly * (acb(1) / 2) for poly in product[1][1]]
    return (
        _sum(product[0][0], square),
        _sum(product[0][1], product[1][0]),
        square,
    )


def _polar(A: Any, B: Any) -> list[Poly]:
    plus, minus = chebyshev_product(A[0][0], B[1][1]), chebyshev_product(A[0][1], B[1][0])
    return [folded(u - v) for u, v in zip(plus, minus, strict=True)]


def chebyshev_product(a: list[Poly], b: list[Poly]) -> list[Poly]:
    """Multiply Chebyshev series: 2 T_i T_j = T_(i+j) + T_|i-j|; beyond DEGREE |T| <= 1."""
    result = [acb_poly([]) for _ in range(DEGREE + 1)]
    beyond, half = arb(0), acb(1) / 2
    for i, u in enumerate(a):
        for j, v in enumerate(b):
            term = u * v * half
            result[abs(i - j)] += term
            if i + j <= DEGREE:
                result[i + j] += term
            else:
                beyond += sum((abs(c) for c in term.coeffs()), arb(0))
    result[0] += around(beyond)
    return result


def _sum(a: list[Poly], b: list[Poly]) -> list[Poly]:
    return [u + v for u, v in zip(_pad(a), _pad(b), strict=True)]


def _pad(a: list[Poly]) -> list[Poly]:
    return [*a, *(acb_poly([]) for _ in range(DEGREE + 1 - len(a)))]


def _coefs(poly: Poly) -> list[Any]:
    coefs = poly.coeffs()
    return [*coefs, *[acb(0)] * (_TERMS - len(coefs))]


def _mid(value: Any) -> Any:
    return acb(value.real.mid(), value.imag.mid())


def _matrix(rows: Any) -> Matrix:
    return arb_mat([[arb(_exact(v)) for v in row] for row in rows])


def _exact(value: Any) -> Any:
    return rational(value)
