"""A family of delay systems for the verifier: is M(s) regular on a part of the line?

Written apart from the prover's; see `railenv.stability.verifier.uncertain` for what is checked.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from flint import acb, acb_mat, arb, arb_mat, fmpq

_MOST_PARTS = 2_000_000

Interval = tuple[float, float]


class RejectedError(Exception):
    """The evidence does not carry the claim."""


@dataclass
class _Seen:
    """Matrices in a basis: of A, and of B and K by group."""

    A: Any
    B: list[Any]
    K: list[Any]


class Family:
    """A family with states scaled by the evidence's powers of two."""

    def __init__(
        self, system: dict[str, Any], claim: dict[str, Any], evidence: dict[str, Any]
    ) -> None:
        self.n, self.groups = len(system["A"]), claim["groups"]
        self.low, self.high = claim["low"], claim["high"]
        self.rate = arb(number(claim["decay_rate"]))
        exponents = [whole(e, -5000, 5000) for e in evidence["scale"]]
        require(len(exponents) == self.n > 0, "the scale has not one exponent per state")
        self.scale = [arb(2) ** e for e in exponents]
        self.middle = self.scaled(system, "")
        self.radius = self.scaled(system, "_radius")
        for matrix in [self.radius.A, *self.radius.B, *self.radius.K]:
            require(all(v >= 0 for v in matrix.entries()), "a radius is negative")
        self.directions = [self.scaled(d, "") for d in system["directions"]]
        self.bases = [self.basis(rows, evidence["basis_bits"]) for rows in evidence["bases"]]
        self.left = _MOST_PARTS

    def scaled(self, source: dict[str, Any], suffix: str) -> _Seen:
        """Read A, B and K, and scale the states."""
        n, d, every = self.n, self.scale, range(self.n)
        A, B, K = (source[f"{name}{suffix}"] for name in "ABK")
        m = sum(len(group) for group in self.groups)
        sizes = {len(A), len(B), *map(len, A), *map(len, K)}
        require(sizes <= {n} and {len(K), *map(len, B)} <= {m}, "a matrix has another size")

        def block(height: Any, width: Any, entry: Callable[[int, int], Any]) -> Any:
            return arb_mat(len(height), len(width), [entry(i, j) for i in height for j in width])

        return _Seen(
            block(every, every, lambda i, j: arb(number(A[i][j])) * d[j] / d[i]),
            [block(every, g, lambda i, k: arb(number(B[i][k])) / d[i]) for g in self.groups],
            [block(g, every, lambda k, j: arb(number(K[k][j])) * d[j]) for g in self.groups],
        )

    def basis(self, rows: Any, bits: Any) -> tuple[_Seen, _Seen, list[_Seen]]:
        """See the family in a basis: V^-1 A V, V^-1 B, K V; likewise radii (bounds), directions."""
        unit = arb(2) ** -whole(bits, 1, 1000)
        require(len(rows) == self.n, "a basis has another size")
        entries: list[list[Any]] = []
        for row in rows:
            require(len(row) == 2 * self.n, "a basis has another size")
            parts = [arb(whole(v, -(1 << 64), 1 << 64)) * unit for v in row]
            entries.append([acb(x, y) for x, y in zip(parts[::2], parts[1::2], strict=True)])
        V = acb_mat(entries)
        W = V.inv()

        def seen(own: _Seen, left: Any, right: Any) -> _Seen:
            return _Seen(
                left * own.A * right, [left * b for b in own.B], [k * right for k in own.K]
            )

        return (
            seen(self.middle, W, V),
            seen(self.radius, _size(W), _size(V)),
            [seen(direction, W, V) for direction in self.directions],
        )

    def largest(self, low: float, high: float) -> Any:
        """Bound |exp(-s tau)| for Re s >= -rate and tau in an interval."""
        tau = high if self.rate > 0 else low
        return (self.rate * arb(number(tau))).exp()

    def check(self, evidence: dict[str, Any]) -> None:
        """Check radius, pieces and parts."""
        end = evidence["radius"]
        self.check_radius(arb(number(end)))
        start: float = 0.0
        every: list[Interval] = [
            *((float(a), float(b)) for a, b in zip(self.low, self.high, strict=True)),
            *((-1.0, 1.0) for _ in self.directions),
        ]
        for piece in evidence["pieces"]:
            require(number(piece["end"]) > number(start), "pieces do not follow each other")
            self.check_piece([(start, float(piece["end"])), *every], piece["cuts"])
            start = float(piece["end"])
        require(start >= float(end), "the pieces end before the radius")

    def check_radius(self, radius: Any) -> None:
        """Require that s I outweighs the rest wherever |s| >= radius, Re s >= -rate."""
        total = _size(self.middle.A) + self.radius.A
        for direction in self.directions:
            total += _size(direction.A)
        for g in range(len(self.groups)):
            left, right = _size(self.middle.B[g]) + self.radius.B[g], _size(self.middle.K[g])
            right += self.radius.K[g]
            for direction in self.directions:
                left, right = left + _size(direction.B[g]), right + _size(direction.K[g])
            total += left * right * self.largest(self.low[g], self.high[g])
        diagonal = arb_mat(
            [[radius if i == j else arb(0) for j in range(self.n)] for i in range(self.n)]
        )
        require(_is_m_matrix(diagonal - total), "roots may lie beyond the radius")

    def check_piece(self, box: list[Interval], cuts: list[Any]) -> None:
        """Walk the cuts in preorder; check every leaf."""
        work, place = [box], 0
        while work:
            part = work.pop()
            require(place < len(cuts), "the cuts of a piece end too early")
            cut = whole(cuts[place], -(1 << 40), len(box) - 1)
            place += 1
            if cut >= 0:
                a, b = part[cut]
                middle = (a + b) / 2
                require(a <= middle <= b, "a cut is not within its interval")
                work.append([*part[:cut], (middle, b), *part[cut + 1 :]])
                work.append([*part[:cut], (a, middle), *part[cut + 1 :]])
                self.left -= 1
                require(self.left > 0, "there are too many parts")
                continue
            basis, free = divmod(-cut - 1, 2)
            require(basis < len(self.bases), "a part names a basis that is not there")
            require(
                self.is_regular(part, basis, free == 1),
                f"a root may be on the line at frequencies {part[0][0]:.6g} to {part[0][1]:.6g}",
            )
        require(place == len(cuts), "the cuts of a piece go on after its end")

    def is_regular(self, part: list[Interval], basis: int, free: bool) -> bool:
        """Check one part in a basis."""
        own, spread, ways = self.bases[basis]
        balls = [(arb(number(a)), arb(number(b))) for a, b in part]
        mid, half = [(a + b) / 2 for a, b in balls], [(b - a) / 2 for a, b in balls]
        count = len(self.groups)
        p, q = mid[1 + count :], half[1 + count :]
        s = acb(-self.rate, mid[0])
        eye = acb_mat([[acb(int(i == j)) for j in range(self.n)] for i in range(self.n)])
        at, slack = eye * s - own.A, spread.A
        by_frequency = eye * acb(0, 1)
        by_parameter = [way.A * acb(-1) for way in ways]
        moves: list[Any] = []
        for x, way in zip(p, ways, strict=True):
            at -= way.A * x
        for g in range(count):
            tau, wide = mid[1 + g], half[1 + g]
            left, right = own.B[g], own.K[g]
            for x, way in zip(p, ways, strict=True):
                left, right = left + way.B[g] * x, right + way.K[g] * x
            dB = [_size(way.B[g]) * r for way, r in zip(ways, q, strict=True)]
            dK = [_size(way.K[g]) * r for way, r in zip(ways, q, strict=True)]
            B_moved = sum(dB, _size(left) * 0)
            # B K moves by dB K + B dK (first order), dB dK, and whatever the radii do.
            B_all, K_all = sum(dB, _size(left)), sum(dK, _size(right))
            extra = B_moved * (K_all - _size(right))
            extra += spread.B[g] * (K_all + spread.K[g]) + B_all * spread.K[g]
            cap = self.largest(*part[1 + g])
            slack += extra * cap
            loop = left * right
            if free:
                turn, slope, error = acb(0), cap, cap
            else:
                turn = (-s * tau).exp()
                angle = abs(s) * wide + half[0] * (tau + wide)
                slope = abs(turn) * angle * (abs(self.rate) * wide).exp()
                error = abs(turn) * half[0] * wide + slope * angle / 2
                at += loop * turn
                by_frequency -= loop * (acb(0, 1) * tau * turn)
                moves.append(loop * (-s * turn * wide))
            slack += _size(loop) * error
            for k, way in enumerate(ways):
                tied = way.B[g] * right + left * way.K[g]
                by_parameter[k] += tied * turn
                slack += _size(tied) * (slope * q[k])
        moves.append(by_frequency * half[0])
        moves += [way * r for way, r in zip(by_parameter, q, strict=True)]
        return _is_m_matrix(self.comparison(at, moves, slack))

    def comparison(self, at: Any, moves: list[Any], slack: Any) -> Any:
        """Return the comparison matrix of at + sum of +-moves + anything up to slack."""
        total: Any = sum((_size(move) for move in moves), _size(at) + slack)
        table: list[list[Any]] = (total * -1).tolist()
        for i in range(self.n):
            lines = [move[i, i] for move in moves]
            bounds = [abs(at[i, i]) - sum((abs(v) for v in lines), arb(0))]
            for direction in [at[i, i], *(v * acb(0, 1) for v in lines)]:
                u = direction.mid()
                if u == 0:
                    continue
                ahead = abs((u.conjugate() * at[i, i]).real)
                for v in lines:
                    ahead -= abs((u.conjugate() * v).real)
                bounds.append(ahead / abs(u))
            best = max(bounds, key=lambda v: float(v.mid()))
            table[i][i] = best.lower() - slack[i, i]
        return arb_mat(table)


def _is_m_matrix(matrix: Any) -> bool:
    """Whether C w = 1 has a solution w > 0, for C without positive entries off the diagonal."""
    try:
        w = matrix.solve(arb_mat([[arb(1)] for _ in range(matrix.nrows())]))
    except ZeroDivisionError:
        return False
    return all(v > 0 for v in w.entries())


def _size(matrix: Any) -> Any:
    return arb_mat(matrix.nrows(), matrix.ncols(), [abs(v) for v in matrix.entries()])


def number(value: Any) -> Any:
    """Return a plain number as the rational that the double is."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise RejectedError(f"{value!r} is not a number")
    return fmpq(*float(value).as_integer_ratio())


def whole(value: Any, least: int, most: int) -> int:
    """Return a whole number within bounds."""
    require(type(value) is int and least <= value <= most, f"{value!r} is no usable whole number")
    return int(value)


def require(condition: Any, reason: str) -> None:
    """Reject the evidence unless a condition holds."""
    if not condition:
        raise RejectedError(reason)
