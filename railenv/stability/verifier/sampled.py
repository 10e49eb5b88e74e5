"""Re-checks evidence about sampled loops, sharing nothing with the code that found it.

Reads plain numbers (`SampledLoop.to_plain`), a claim and its evidence. A symmetric P with
P - F' P F > 0 proves that the map F has as many eigenvalues outside the unit circle as P has
negative ones, and none on it. For P > 0 the inequality carries over to the convex hull of all maps
for which it holds.
"""

from fractions import Fraction
from itertools import pairwise
from math import isfinite, sqrt
from typing import Any, cast

import flint
from flint import arb, arb_mat

from railenv.stability.verifier.sampled_map import (
    Loop,
    RejectedError,
    is_double,
    number,
    rational,
    require,
)

_HALVINGS = 6


def check_sampled(loop_data: dict[str, Any], claim: dict[str, Any], evidence: Any) -> list[str]:
    """Return the reasons against a claim about a sampled loop; empty if its evidence carries it.

    Args:
        loop_data: `A B C D period Ac Bc Cc Dc told`, see `SampledLoop.to_plain`.
        claim: `verdict low high told_error unstable_roots witness witness_told`.
        evidence: `bits exponents` and either `pieces` or `point`.
    """
    before = flint.ctx.prec
    try:
        bits = evidence["bits"]
        require(type(bits) is int and 64 <= bits <= 20000, "bits is not a usable precision")
        flint.ctx.prec = bits + 64
        _check(Loop(loop_data, evidence["exponents"]), claim, evidence)
    except RejectedError as reason:
        return [str(reason)]
    except Exception as error:  # whatever a malformed file leads to is a reason, not a failure
        return [f"claim or evidence is malformed: {type(error).__name__}: {error}"[:300]]
    finally:
        flint.ctx.prec = before
    return []


def _check(loop: Loop, claim: dict[str, Any], evidence: dict[str, Any]) -> None:
    low, high = (_delays(claim[name], loop.m) for name in ("low", "high"))
    error, roots = number(claim["told_error"]), claim["unstable_roots"]
    require(error >= 0 and all(0 <= a <= b for a, b in zip(low, high, strict=True)), "bad range")
    verdict = claim["verdict"]
    require(verdict in ("STABLE", "UNSTABLE"), f"nothing is claimed by {verdict!r}")
    if roots is not None or verdict == "STABLE":
        agree = type(roots) is int and (roots == 0) == (verdict == "STABLE")
        require(agree, "count and verdict differ")
    if verdict == "STABLE" and "pieces" in evidence:
        require(len({*low}) <= 1 and len({*high}) <= 1, "pieces are for a common delay")
        ends = (low[0], high[0]) if low else (Fraction(0), Fraction(0))
        _covered(loop, evidence["pieces"], *ends, error)
        for piece in evidence["pieces"]:
            _check_piece(loop, piece)
        return
    point = evidence["point"]
    delays, told = _delays(point["delays"], loop.m), number(point["told"])
    if verdict == "STABLE":
        require(low == high == delays, "a point proves stability at one delay only")
        exact = not loop.told or (error == 0 and all(told == tau for tau in delays))
        require(exact, "a point proves stability for one told delay only")
    else:
        require(_delays(claim["witness"], loop.m) == delays, "the witness is another delay")
        inside = all(a <= t <= b for a, t, b in zip(low, delays, high, strict=True))
        require(inside, "the witness is out of the range")
        if low != high:
            require(len({*delays}) <= 1, "the witness is not one common delay")
        if loop.told:
            require(claim["witness_told"] == point["told"], "another delay is told")
            near = told >= 0 and all(abs(told - tau) <= error for tau in delays)
            require(near, "the told delay is out of the error")
    order = sorted({*delays}) or [Fraction(0)]
    groups = [[k for k in range(loop.m) if delays[k] == tau] for tau in order]
    wholes = [tau // loop.T for tau in order]
    maps = loop.maps(groups, told)
    late = [
        maps.held(g, rational(loop.T - tau + d * loop.T))
        for g, (tau, d) in enumerate(zip(order, wholes, strict=True))
    ]
    F = maps.lifted(wholes, late)
    P, negative = _symmetric(point["P"], F.nrows())
    radius = number(point["radius"])
    require(radius >= 1, "roots within the unit circle say nothing")
    if radius > 1:
        # Roots outside a larger circle: unstable, and how many there are is left open.
        require(verdict == "UNSTABLE" and roots is None, "a count needs the unit circle")
        require(negative > 0, "P has no negative eigenvalue")
    else:
        require(negative == roots, f"P has {negative} negative eigenvalues, {roots} are claimed")
    scaled = F * arb(rational(1 / radius))
    require(_decreases(P, scaled), "P - F' P F is not positive definite at the point")


def _covered(
    loop: Loop, pieces: list[dict[str, Any]], low: Fraction, high: Fraction, error: Fraction
) -> None:
    """Require that pieces cover all delays from low to high with all told delays, without a gap.

    Strips between neighbouring ends count without their upper end, so that a delay of d periods
    is covered from d periods on; the last delay is looked at by itself.
    """
    boxes: list[tuple[Fraction, ...]] = []
    for piece in pieces:
        require(type(piece["whole"]) is int and piece["whole"] >= 0, "whole is no count")
        r1, r2, t1, t2 = (number(piece[k]) for k in ("low", "high", "told_low", "told_high"))
        require(0 <= r1 <= r2 <= loop.T and t1 <= t2, "a piece is not within one period")
        d = piece["whole"]
        boxes.append((d * loop.T + r1, d * loop.T + r2, t1, t2, Fraction(d)))
    inner = {end for box in boxes for end in box[:2] if low < end < high}
    ends = sorted({low, high} | inner)
    strips = [*pairwise(ends), (high, high)]
    for begin, end in strips:
        own = [b for b in boxes if b[0] <= begin and end <= b[1]]
        if begin == end:
            own = [b for b in own if b[4] == high // loop.T]
        require(bool(own), f"no piece covers the delays from {float(begin):.17g} s")
        require(
            not loop.told or _told_covered(own, max(begin - error, Fraction(0)), end + error),
            f"told delays are missing at delays from {float(begin):.17g} s",
        )


def _told_covered(boxes: list[tuple[Fraction, ...]], reached: Fraction, last: Fraction) -> bool:
    """Say whether the told ranges of some boxes cover everything from `reached` to `last`."""
    touched = False
    for _, _, begin, end, _ in sorted(boxes, key=lambda box: box[2]):
        if begin <= reached <= end:
            touched, reached = True, end
    return touched and reached >= last


def _check_piece(loop: Loop, piece: dict[str, Any]) -> None:
    d, r1, r2 = piece["whole"], number(piece["low"]), number(piece["high"])
    t1, t2 = number(piece["told_low"]), number(piece["told_high"])
    told = sorted({t1, t2, *(k for k in loop.told if t1 < k < t2)})
    corners = [loop.maps([list(range(loop.m))], t) for t in told]
    size = loop.n + loop.c + corners[0].ranks[0] * (d + 1)
    P, negative = _symmetric(piece["P"], size)
    where = f"in the piece from {float(d * loop.T + r1):.12g} s"
    require(negative == 0, f"P is not positive definite {where}")
    waiting = [(r1, r2, 0)]
    while waiting:
        a, b, depth = waiting.pop()
        points = corners[0].curve(rational(loop.T - b), rational(loop.T - a))
        maps = (m.lifted([d], [late]) for m in corners for late in points or [])
        if points is not None and all(_decreases(P, F) for F in maps):
            continue
        require(depth < _HALVINGS and a < b, f"P - F' P F is not positive definite {where}")
        waiting += [(a, (a + b) / 2, depth + 1), ((a + b) / 2, b, depth + 1)]


def _symmetric(lower: list[list[float]], size: int) -> tuple[Any, int]:
    """Return P from its lower triangle, and the number of its negative eigenvalues (L D L')."""
    require(len(lower) == size, f"P has {len(lower)} rows, the map has {size}")
    for i, row in enumerate(lower):
        require(len(row) == i + 1 and all(map(is_double, row)), "P is not a lower triangle")
    P = arb_mat([[lower[max(i, j)][min(i, j)] for j in range(size)] for i in range(size)])
    rows, negative = P.tolist(), 0
    for i, top in enumerate(rows):
        require(top[i] > 0 or top[i] < 0, "the signs of P's eigenvalues are not certain")
        negative += bool(top[i] < 0)
        for row in rows[i + 1 :]:
            factor = row[i] / top[i]
            row[i:] = [a - factor * b for a, b in zip(row[i:], top[i:], strict=True)]
    return P, negative


def _decreases(P: Any, F: Any) -> bool:
    """Prove P - F' P F > 0: near its inverse Cholesky factor W, W S W' is near the identity."""
    S, N = P - F.transpose() * P * F, P.nrows()
    middle = [[float(v) for v in row] for row in S.tolist()]
    if (
        not all(isfinite(v) for row in middle for v in row)
        or min(middle[i][i] for i in range(N)) <= 0.0
    ):
        return False
    scale = [1.0 / sqrt(middle[i][i]) for i in range(N)]
    L: list[list[float]] = []
    for i in range(N):
        row: list[float] = []
        for j in range(i + 1):
            done = L[j] if j < i else row
            left = middle[i][j] * scale[i] * scale[j] - sum(
                a * b for a, b in zip(row, done, strict=False)
            )
            if j == i and left <= 0.0:
                return False
            row.append(left / L[j][j] if j < i else sqrt(left))
        L.append(row)
    W: list[list[float]] = []
    for i, row in enumerate(L):
        new = [0.0] * N
        for j, factor in enumerate(row[:i]):
            new[: j + 1] = [a - factor * b for a, b in zip(new[: j + 1], W[j], strict=False)]
        new[i] = 1.0
        W.append([v / row[i] for v in new])
    X = arb_mat([[v * s for v, s in zip(row, scale, strict=True)] for row in W])
    near = (X * S * X.transpose()).tolist()
    for i in range(N):
        near[i][i] -= 1
    return all(sum((abs(v) for v in row), arb(0)) < 1 for row in near)


def _delays(value: Any, count: int) -> list[Fraction]:
    """Return one delay per channel from a number or a list."""
    if isinstance(value, list):
        values = [number(v) for v in cast(list[Any], value)]
        require(len(values) == count, "there is not one delay per channel")
        return values
    return [number(value)] * count
