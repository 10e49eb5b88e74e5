"""The lifted map of a sampled loop from its plain numbers, for the re-checker only.

The map is a sampling step, which appends the new signals, followed by a flow, which forgets the
oldest ones:

    state (x, xc, v_(k-1), ..., v_(k-d-1)),    u = M v,    T the period,    delay d T + r

x is in units of 2^exponents; v are the commands, or the reduced row echelon form of everything that
they are made of (over all knots) where it has fewer rows.
"""

from fractions import Fraction
from math import comb, isfinite
from typing import Any

from flint import arb, arb_mat, fmpq, fmpq_mat

_DEGREE, _TERMS = 4, 220


class RejectedError(Exception):
    """The evidence does not carry the claim."""


class Loop:
    """The loop in exact numbers, plant states in units of 2^exponents."""

    def __init__(self, data: dict[str, Any], exponents: list[int]) -> None:
        self.n, self.p, self.m = len(data["A"]), len(data["C"]), len(data["B"][0])
        n, p, m = self.n, self.p, self.m
        self.T = number(data["period"])
        self.told = [number(v) for v in data["told"]]
        rising = all(a < b for a, b in zip(self.told[:-1], self.told[1:], strict=True))
        require(self.T > 0 and rising, "period or knots are not usable")
        usable = len(exponents) == n and all(type(e) is int and abs(e) < 1100 for e in exponents)
        require(usable, "exponents are not one whole number per state")
        unit = [fmpq(2) ** e for e in exponents]
        A, B, C = _table(data["A"], n, n), _table(data["B"], n, m), _table(data["C"], p, n)
        self.A = [[A[i][j] * unit[j] / unit[i] for j in range(n)] for i in range(n)]
        self.B = [[v / unit[i] for v in B[i]] for i in range(n)]
        self.C = _matrix([[v * unit[j] for j, v in enumerate(row)] for row in C], n)
        self.D = _matrix(_table(data["D"], p, m), m)
        count = max(len(self.told), 1)
        self.c = len(data["Ac"][0])
        shapes = {"Ac": (self.c, self.c), "Bc": (self.c, p), "Cc": (m, self.c), "Dc": (m, p)}
        self.knots: list[list[Any]] = [[] for _ in range(count)]
        for name, shape in shapes.items():
            require(len(data[name]) == count, f"{name} is not one matrix per knot")
            for knot, rows in zip(self.knots, data[name], strict=True):
                knot.append(_matrix(_table(rows, *shape), shape[1]))
        # Commands of each channel from (x, xc, forces), all knots side by side.
        blocks = [[Dc * self.C, Cc, Dc * self.D] for _, _, Cc, Dc in self.knots]
        parts = [part.tolist() for block in blocks for part in block]
        self.commands = [[v for part in parts for v in part[k]] for k in range(m)]

    def maps(self, groups: list[list[int]], told: Fraction) -> "Maps":
        """Return the maps for channels grouped by delay and one told delay."""
        j = max([i for i, knot in enumerate(self.told) if knot <= told], default=0)
        share = Fraction(0)
        if j + 1 < len(self.told) and told > self.told[j]:
            share = (told - self.told[j]) / (self.told[j + 1] - self.told[j])
        return Maps(self, groups, j, rational(share))


class Maps:
    """Maps of a loop with its channels grouped by delay."""

    def __init__(self, loop: Loop, groups: list[list[int]], knot: int, share: Any) -> None:
        self.loop, self.groups = loop, groups
        width = loop.n + loop.c + loop.m
        after = knot + 1 if share != 0 else knot

        def mix(a: Any, b: Any) -> Any:
            return a * (1 - share) + b * share

        self.Ac = mix(loop.knots[knot][0], loop.knots[after][0])
        self.Bc = mix(loop.knots[knot][1], loop.knots[after][1])
        self.signals: list[Any] = []
        # M in full height: forces of all channels from a group's signals.
        self.spread: list[Any] = []
        for group in groups:
            rows = [loop.commands[k] for k in group]
            columns = [[fmpq(int(i == j)) for j in range(len(group))] for i in range(len(group))]
            if group:
                echelon, rank = fmpq_mat(rows).rref()
                if rank < len(group):
                    kept = echelon.tolist()[:rank]
                    pivots = [min(j for j, v in enumerate(row) if v != 0) for row in kept]
                    rows, columns = kept, [[row[j] for j in pivots] for row in rows]
            r = len(rows)
            at = [
                _matrix([row[i * width : (i + 1) * width] for row in rows], width)
                for i in (knot, after)
            ]
            self.signals.append(mix(*at).tolist())
            zero = [fmpq(0)] * r
            place = {k: columns[i] for i, k in enumerate(group)}
            self.spread.append(_matrix([place.get(k, zero) for k in range(loop.m)], r))
        self.ranks = [len(rows) for rows in self.signals]
        self._full = self._flow(rational(loop.T))

    def _flow(self, s: Any) -> tuple[Any, list[Any]]:
        """Return exp(A s) and the effect of each group's held signals after a time s."""
        loop, width = self.loop, sum(self.ranks)
        inputs = [(_matrix(loop.B, loop.m) * M).tolist() for M in self.spread]
        rows = [sum((part[i] for part in inputs), loop.A[i]) for i in range(loop.n)]
        rows += [[fmpq(0)] * (loop.n + width)] * width
        table = (_balls(rows) * arb(s)).exp().tolist()
        effects, start = list[Any](), loop.n
        for r in self.ranks:
            effects.append([row[start : start + r] for row in table[: loop.n]])
            start += r
        return [row[: loop.n] for row in table[: loop.n]], effects

    def held(self, group: int, s: Any) -> Any:
        """Return the effect G(s) of one group."""
        return self._flow(s)[1][group]

    def curve(self, short: Any, long: Any) -> list[Any] | None:
        """Return tables whose convex hull holds G(s) for all s in [short, long] (one group).

        Taylor's polynomial about the middle in Bernstein form; what is beyond its degree goes into
        the radii.
        """
        loop, h = self.loop, arb((long - short) / 2)
        flow, effects = self._flow((short + long) / 2)
        n, r = loop.n, self.ranks[0]
        if h == 0 or r == 0:
            return [effects[0]]
        A, E = _balls(loop.A), arb_mat(flow)
        size = arb(max(sum((abs(arb(v)) for v in row), arb(0)).upper() for row in loop.A))
        power = _balls((_matrix(loop.B, loop.m) * self.spread[0]).tolist())
        series, j = [arb_mat(effects[0])], 1
        while True:
            power = power * (h / j)
            series.append(E * power)
            power, j = A * power, j + 1
            biggest = max(v.abs_upper() for v in power.entries())
            left = biggest * max(sum((abs(v) for v in row), arb(0)).upper() for row in flow)
            # Left over: E A^(j-1) B h^j / j! and on, falling by at least this ratio.
            ratio = size * h / (j + 1)
            if j > _DEGREE + 1 and ratio < 1 and (left < 1e-25 or j > _TERMS):
                left = left * (h / j) / (1 - ratio)
                break
            if j > _TERMS:
                return None
        rest = [left] * (n * r)
        for term in series[_DEGREE + 1 :]:
            rest = [a + abs(b) for a, b in zip(rest, term.entries(), strict=True)]
        around = arb_mat(n, r, [arb(0, v.upper()) for v in rest])
        points: list[Any] = []
        for i in range(_DEGREE + 1):
            total = around
            for k, term in enumerate(series[: _DEGREE + 1]):
                # The blossom of t^k at i ones and minus ones for the rest.
                value = sum(
                    (-1) ** (k - q) * comb(i, q) * comb(_DEGREE - i, k - q) for q in range(k + 1)
                )
                total = total + term * arb(fmpq(value, comb(_DEGREE, k)))
            points.append(total.tolist())
        return points

    def lifted(self, wholes: list[int], late: list[Any]) -> Any:
        """Return the map: the sampling step, then the flow over one period."""
        loop, n, c = self.loop, self.loop.n, self.loop.c
        starts, size, longer = list[tuple[int, int]](), n + c, n + c
        for r, d in zip(self.ranks, wholes, strict=True):
            starts.append((size, longer))
            size, longer = size + r * (d + 1), longer + r * (d + 2)
        require(size < 5000, "the map is too large")
        # Forces at the end of the period before, from the state.
        zero = fmpq(0)
        acting = [[zero] * size for _ in range(loop.m)]
        sample = [[zero] * size for _ in range(longer)]
        flow = [[arb(0)] * longer for _ in range(size)]
        for g, (r, d) in enumerate(zip(self.ranks, wholes, strict=True)):
            for k, row in enumerate(self.spread[g].tolist()):
                for i in range(r):
                    acting[k][starts[g][0] + r * d + i] = row[i]
        force = _matrix(acting, size)
        plant = [row + [zero] * (size - n) for row in self.loop.C.tolist()]
        after = self.Bc * (_matrix(plant, size) + loop.D * force)
        for i in range(n):
            sample[i][i] = fmpq(1)
            flow[i][:n] = self._full[0][i]
        for i, row in enumerate(after.tolist()):
            sample[n + i] = row
            for j in range(c):
                sample[n + i][n + j] += self.Ac[i, j]
            flow[n + i][n + i] = arb(1)
        for g, (r, d) in enumerate(zip(self.ranks, wholes, strict=True)):
            here, there = starts[g]
            through = _matrix([row[n + c :] for row in self.signals[g]], loop.m) * force
            for i, row in enumerate(through.tolist()):
                sample[there + i] = row
                for j in range(n + c):
                    sample[there + i][j] += self.signals[g][i][j]
            for i in range(r * (d + 1)):
                sample[there + r + i][here + i] = fmpq(1)
                flow[here + i][there + i] = arb(1)
            for i in range(n):
                for j in range(r):
                    flow[i][there + r * d + j] += late[g][i][j]
                    flow[i][there + r * (d + 1) + j] += self._full[1][g][i][j] - late[g][i][j]
        return arb_mat(flow) * _balls(sample)


def require(holds: bool, reason: str) -> None:
    """Reject for a reason unless something holds."""
    if not holds:
        raise RejectedError(reason)


def is_double(value: Any) -> bool:
    """Say whether a value is a finite number as JSON spells it."""
    return type(value) in (int, float) and isfinite(value)


def number(value: Any) -> Fraction:
    """Return a finite number exactly."""
    require(is_double(value), f"{str(value)[:30]!r} is not a number")
    return Fraction(value)


def rational(value: Fraction) -> Any:
    """Return a fraction as flint's rational number."""
    return fmpq(value.numerator, value.denominator)


def _table(rows: list[list[float]], height: int, width: int) -> list[list[Any]]:
    fits = len(rows) == height and all(len(row) == width for row in rows)
    require(fits, "a matrix of the loop has the wrong shape")
    return [[rational(number(v)) for v in row] for row in rows]


def _matrix(rows: list[list[Any]], width: int) -> Any:
    return fmpq_mat(len(rows), width, [v for row in rows for v in row])


def _balls(rows: list[list[Any]]) -> Any:
    return arb_mat([[arb(v) for v in row] for row in rows])
