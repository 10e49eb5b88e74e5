"""Re-check of a certificate for delays that vary in time, tau_i <= tau_i(t) <= tau_i + J.

What has to hold, for a constant D that commutes with what the channels of a block share:

    the loop with the constant delays tau_i is stable, and
    J |D T(j omega) D^-1| < 1 for all omega,  T(s) = s R M(s)^-1 L,
    M(s) = s I - A + sum_b exp(-s tau_b) L_b R_b,

where a block is one channel, or, if all share one jitter, those of one nominal delay; K_b is
P_b R_b and L_b is B_b P_b. With the weight Y = (D^T D)^-1, R = P R' and L = L' S that is

    |h|^2 (P^T Y^-1 P)^-1 - J^2 omega^2 N (S Y S^T) N^H > 0,   h = det M,  N = R' adj(M) L'.

The evidence names Y and a cut of the imaginary axis; h and N are found anew from the system's
numbers, and the matrix is shown to be positive definite on every piece and beyond the last. None of
the prover's code is used. Stability with constant delays is asked of a checker that the caller
gives.
"""

import itertools
import math
from collections.abc import Callable
from typing import Any

import flint
from flint import fmpq, fmpq_mat, fmpq_poly

from railenv.stability.verifier.jitter_gain import GainGap, Terms
from railenv.stability.verifier.quasipolynomial import RejectedError, matrix, rational

Plain = dict[str, Any]
Matrix = Any
_Part = tuple[Any, Matrix, Matrix]
"""Nominal delay, columns and rows of a block."""

_MOST_HALVINGS = 8
_MOST_PIECES = 1_000_000
_MOST_BITS = 1 << 14
_MOST_POLYNOMIALS = 20_000


def check_jitter(
    system: Plain, claim: Plain, evidence: Plain, count_checker: Callable[[Plain], list[str]]
) -> list[str]:
    """Re-check a claim about delays that vary in [tau_i, tau_i + jitter].

    Args:
        system: "A", "B", "K" and, if there is one, "feedthrough" as lists of rows of doubles.
        claim: "delays" (one per channel) and "jitter" [s], "common" (whether all channels share one
            jitter), "verdict" ("STABLE" unless given).
        evidence: What `prove_jitter` returned.
        count_checker: Returns why a count is not to be believed; the count says that with constant
            delays, the channels of each of `groups` sharing one of `delays`, exactly `roots` roots
            lie in `region`. An empty list accepts.

    Returns:
        Reasons for rejection; none if the claim is proved.
    """
    try:
        _check(system, claim, evidence, count_checker)
    except RejectedError as error:
        return [str(error)]
    except Exception as error:  # whatever a malformed file provokes is a rejection
        return [f"the evidence is malformed: {type(error).__name__}: {error}"]
    return []


def _check(
    system: Plain, claim: Plain, evidence: Plain, count_checker: Callable[[Plain], list[str]]
) -> None:
    A = matrix("A", system["A"])
    n, m = A.nrows(), len(system["K"])
    _require(n > 0 and m > 0, "the system has no states or no channels")
    B, K = matrix("B", system["B"], n, m), matrix("K", system["K"], m, n)
    _require(
        all(rational(v) == 0 for row in system.get("feedthrough", []) for v in row),
        "the loop is neutral",
    )
    delays = [rational(tau) for tau in claim["delays"]]
    jitter = rational(claim["jitter"])
    _require(len(delays) == m, "there must be one delay per channel")
    _require(jitter >= 0 and all(tau >= 0 for tau in delays), "a delay or the jitter is negative")
    common, verdict = claim["common"], claim.get("verdict", "STABLE")
    _require(isinstance(common, bool), "common is neither true nor false")
    count = evidence["count"]
    counted = _counted_delays(count, m)
    region = count["region"]
    _require(region["damping_ratio"] is None, "the count is of another region")
    edge = -rational(region["decay_rate"])
    roots = count["roots"]
    _require(type(roots) is int, "the number of roots is no whole number")
    if verdict == "UNSTABLE":
        _require(evidence["method"] == "witness", "there is no evidence of instability")
        _require(roots > 0 and edge >= 0, "the count shows no unstable root")
        _require(
            all(a <= t <= a + jitter for a, t in zip(delays, counted, strict=True)),
            "the unstable delays are none of those claimed",
        )
    else:
        _require(verdict == "STABLE", f"there is no verdict {verdict!r}")
        _require(evidence["method"] == "small gain", "there is no evidence of stability")
        _require(roots == 0 and edge == 0, "the count does not show stability")
        _require(counted == delays, "the count is for other delays")
        _check_gain((A, B, K), delays, jitter, common, evidence)
    reasons = count_checker(count)
    _require(not reasons, "; ".join(str(reason) for reason in reasons))


def _counted_delays(count: Plain, m: int) -> list[Any]:
    groups = [list(group) for group in count["groups"]]
    _require(
        sorted(k for group in groups for k in group) == list(range(m)),
        "the groups of the count are no partition of the channels",
    )
    values: list[Any] = [None] * m
    for group, tau in zip(groups, count["delays"], strict=True):
        for k in group:
            values[k] = rational(tau)
    return values


def _check_gain(
    matrices: tuple[Matrix, Matrix, Matrix],
    delays: list[Any],
    jitter: Any,
    common: bool,
    evidence: Plain,
) -> None:
    unit, bits = rational(evidence["unit"]), evidence["bits"]
    _require(unit > 0, "the unit of time is not positive")
    sides = list(range(len(delays)))
    blocks = [[k] for k in sides]
    if common:
        blocks = [[k for k in sides if delays[k] == t] for t in dict.fromkeys(delays)]
    parts = _parts(matrices, blocks, delays, unit)
    if not parts or jitter == 0:
        return
    Y = _weight(evidence["weight"], [columns.ncols() for _, columns, _ in parts])
    P, R = _full_rank(fmpq_mat([row for _, _, rows in parts for row in rows.tolist()]))
    beside = fmpq_mat([row for _, c, _ in parts for row in c.transpose().tolist()]).transpose()
    L, S = _full_rank(beside)
    h, N = _terms(matrices[0] * unit, parts, L, R)
    own = (jitter / unit) ** 2 * (S * Y * S.transpose())
    other = (P.transpose() * Y.inv() * P).inv()
    _require(type(bits) is int and 32 <= bits <= _MOST_BITS, f"there are no {bits!r} bits")
    ends = [rational(x) for x in evidence["pieces"]]
    _require(2 <= len(ends) <= _MOST_PIECES, "the pieces are too few or too many")
    _require(
        ends[0] == 0 and all(a < b for a, b in itertools.pairwise(ends)),
        "the pieces do not rise from 0",
    )
    before = flint.ctx.prec
    flint.ctx.prec = bits
    try:
        gap = GainGap(h, N, own, other, matrices[0].nrows())
        _require(gap.beyond(ends[-1]), "the gain at high frequency is not bounded")
        for low, high in itertools.pairwise(ends):
            if not gap.between(low, high, _MOST_HALVINGS):
                a, b = (int(x.p) / int(x.q) for x in (low / unit, high / unit))
                raise RejectedError(f"the gain is not bounded between {a:.6g} and {b:.6g} rad/s")
    finally:
        flint.ctx.prec = before


def _parts(
    matrices: tuple[Matrix, Matrix, Matrix], blocks: list[list[int]], delays: list[Any], unit: Any
) -> list[_Part]:
    """Return tau_b, L_b and R_b of every block that has an effect, in the unit of time."""
    _, B, K = matrices
    found: list[_Part] = []
    for block in blocks:
        P, rows = _full_rank(fmpq_mat([K.tolist()[k] for k in block]))
        # Whether a block counts is asked of B itself: the weight's shape depends on it.
        inputs = fmpq_mat([[row[k] for k in block] for row in B.tolist()])
        if P.ncols() > 0 and inputs.rank() > 0:
            found.append((delays[block[0]] / unit, inputs * P * unit, rows))
    return found


def _weight(rows: list[list[float]], sizes: list[int]) -> Matrix:
    size = sum(sizes)
    Y = matrix("weight", rows, size)
    owner = [number for number, width in enumerate(sizes) for _ in range(width)]
    for i, j in itertools.product(range(size), repeat=2):
        _require(Y[i, j] == Y[j, i], "the weight is not symmetric")
        _require(owner[i] == owner[j] or Y[i, j] == 0, "the weight mixes blocks")
    for k in range(1, size + 1):
        leading = fmpq_mat([row[:k] for row in Y.tolist()[:k]])
        _require(leading.det() > 0, "the weight is not positive definite")
    return Y


def _terms(A: Matrix, parts: list[_Part], L: Matrix, R: Matrix) -> tuple[Terms, list[list[Terms]]]:
    """Return det M and R adj(M) L: exact polynomials on a grid of numbers z for exp(-s tau)."""
    late: dict[Any, Matrix] = {}
    for tau, columns, rows in parts:
        late[tau] = late[tau] + columns * rows if tau in late else columns * rows
    closed = A - late.pop(fmpq(0), fmpq_mat(A.nrows(), A.nrows()))
    grid = list(itertools.product(*(range(part.rank() + 1) for part in late.values())))
    r, q = R.nrows(), L.ncols()
    _require(len(grid) * (1 + r * q) <= _MOST_POLYNOMIALS, "there are too many delays to re-check")
    changes = [
        fmpq_mat([[row[j]] for row in L.tolist()]) * fmpq_mat([R.tolist()[i]])
        for i in range(r)
        for j in range(q)
    ]
    values: list[list[Any]] = []
    for z in grid:
        loop = closed
        for number, part in zip(z, late.values(), strict=True):
            loop = loop - number * part
        h = loop.charpoly()
        values.append([h, *((loop - change).charpoly() - h for change in changes)])
    # Coefficients of the monomials in z from the values on the grid.
    inverse = fmpq_mat([[_monomial(z, powers) for powers in grid] for z in grid]).inv()
    totals = [sum((k * t for k, t in zip(powers, late, strict=True)), fmpq(0)) for powers in grid]

    def of(number: int) -> Terms:
        merged: dict[Any, Any] = {}
        for row, total in enumerate(totals):
            p = sum((inverse[row, k] * v[number] for k, v in enumerate(values)), fmpq_poly([0]))
            merged[total] = merged.get(total, fmpq_poly([0])) + p
        return [(p, total) for total, p in merged.items() if not p.is_zero()]

    return of(0), [[of(1 + i * q + j) for j in range(q)] for i in range(r)]


def _monomial(z: tuple[int, ...], powers: tuple[int, ...]) -> Any:
    return math.prod((x**k for x, k in zip(z, powers, strict=True)), start=1)


def _full_rank(matrix: Matrix) -> tuple[Matrix, Matrix]:
    """Factor exactly into pivot columns times the reduced echelon form."""
    echelon, rank = matrix.rref()
    rows = echelon.tolist()[:rank]
    pivots = [next(j for j, v in enumerate(row) if v != 0) for row in rows]
    if rank == 0:
        return fmpq_mat(matrix.nrows(), 0), fmpq_mat(0, matrix.ncols())
    return fmpq_mat([[row[j] for j in pivots] for row in matrix.tolist()]), fmpq_mat(rows)


def _require(condition: bool, reason: str) -> None:
    if not condition:
        raise RejectedError(reason)
