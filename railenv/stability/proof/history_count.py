"""How many eigenvalues of a loop with a finite history are outside the unit circle, proved.

By the argument principle f(w) det(I - w exp(A T)) has as many zeros in |w| < 1 as f winds around
zero on |w| = 1, counted counterclockwise, plus the plant's own modes outside (zeros of the second
factor, poles of f). w = exp(-i pi t) runs clockwise, f(conj w) is the conjugate of f(w), and so t
from 0 to 1 gives half of the turns.

On an arc f stays in a disc around its middle value c that does not hold zero. Neighbouring arcs
share an end, where f is in both discs; so from one middle to the next the angle of f changes by the
principal value of arg(c_next / c), and no value at an end is needed. At t = 0 and 1 f is real.
"""

import numpy as np

from railenv.stability.proof.history_boxes import BoolArray, Boxes, IntArray, chebyshev_part
from railenv.stability.proof.history_function import Arc, HistoryFunction
from railenv.units import ComplexArray, FloatArray

# Share of the sum of all coefficients that covers rounding; see `history_boxes`.
_ROUNDING = 2.0**-32
# The turns found must be this close to a whole number: they are sums of angles in doubles.
_WHOLE = 1e-6


def first_arcs(number: int) -> list[Arc]:
    """Cut the half circle t from 0 to 1 into equal arcs, a power of two of them."""
    return [Arc((2 * i + 1) / (2 * number), 1 / (2 * number)) for i in range(number)]


def count_outside(
    function: HistoryFunction,
    wholes: IntArray,
    intervals: IntArray,
    points: Boxes,
    arcs: int,
    shortest: float,
) -> list[int | None]:
    """Count eigenvalues outside the unit circle at some pairs of delay and told delay.

    Args:
        function: f of the loop.
        wholes: d of each pair.
        intervals: Interval between knots of each pair.
        points: One very small box for each pair, in order.
        arcs: Number of arcs to begin with, a power of two.
        shortest: Half width in t of the shortest arc that is tried.

    Returns:
        The numbers, multiplicities included; None where f may vanish on the circle.
    """
    number = len(points)
    angle = np.zeros(number)
    last: ComplexArray = np.zeros(number, np.complex128)
    lost = np.zeros(number, bool)
    stack = [(arc, np.arange(number)) for arc in first_arcs(arcs)[::-1]]
    while stack:
        arc, now = stack.pop()
        now = now[~lost[now]]
        if not len(now):
            continue
        middle, good = _discs(function, arc, wholes[now], intervals[now], points[now])
        done = now[good]
        values: ComplexArray = middle[good]
        # The first value counts from the real axis, on the side that f(1) is on.
        before = np.where(last[done] == 0.0, np.sign(np.real(values)), last[done])
        angle[done] += np.angle(values / before)
        last[done] = values
        rest = now[~good]
        if arc.s / 2 < shortest:
            lost[rest] = True
        elif len(rest):
            first, second = arc.halves()
            stack += [(second, rest), (first, rest)]
    with np.errstate(invalid="ignore"):
        angle += np.angle(np.sign(np.real(last)) / last)
    turns = -angle / np.pi
    counts = np.round(np.where(lost, 0.0, turns))
    if np.any(np.abs(turns - counts)[~lost] > _WHOLE):
        raise ArithmeticError("angles do not add up to whole turns")
    found = counts.astype(int) + function.modes.outside
    return [None if gone else int(c) for gone, c in zip(lost, found, strict=True)]


def _discs(
    function: HistoryFunction, arc: Arc, wholes: IntArray, intervals: IntArray, points: Boxes
) -> tuple[ComplexArray, BoolArray]:
    """Return the middle values of f on an arc, and whether f stays nearer to them than zero is."""
    cases, number = np.unique(np.stack([wholes, intervals]), axis=1, return_inverse=True)
    found = function.on(arc, cases[0], cases[1])
    coefs = found.coefs[number]
    n, _, r, x = coefs.shape
    S = chebyshev_part(3, points.middle[:, 0], points.half[:, 0])
    R = chebyshev_part(r, points.middle[:, 1], points.half[:, 1])
    moved = R[:, None] @ (S @ coefs.reshape(n, 3, -1)).reshape(n, 3, r, x)
    total: FloatArray = np.abs(moved).sum(axis=(1, 2, 3))
    large = np.abs(coefs).sum(axis=(1, 2, 3))
    middle: ComplexArray = moved[:, 0, 0, 0]
    rest = found.rest[number] + _ROUNDING * large
    return middle, 2.0 * np.abs(middle) > (1.0 + 1e-9) * (total + rest)
