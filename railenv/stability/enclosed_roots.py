"""Rightmost characteristic roots, each enclosed in a ball, and proved to be all of them.

Floating point proposes the roots. Each is enclosed by interval Newton on the exact characteristic
function, or, where several stand at one place, by the argument principle around a small square.
The number of roots to the right of a line is proved by the argument principle; the list is complete
if the enclosures hold that many.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from flint import acb, arb

from railenv.errors import ArgumentError, check_count, check_finite
from railenv.stability.delay_system import DelaySystem
from railenv.stability.modes import Mode
from railenv.stability.proof.characteristic import characteristic
from railenv.stability.proof.contour import Line, Quasipolynomial, delay_ball
from railenv.stability.proof.counting import Contour, Effort, count, cover
from railenv.stability.proof.polynomials import UndecidedError
from railenv.stability.proof.precision import precision
from railenv.stability.proof.region import Region
from railenv.stability.spectrum import rightmost_roots

_FIRST_BITS, _MOST_BITS = 192, 3072
_MOST_PIECES = 40_000
# Estimated roots nearer to each other than this (relative) are enclosed together.
_TOGETHER = 1e-6
# The line to the left of the last root asked for lies in a gap at least this wide (relative).
_GAP = 1e-4


@dataclass(frozen=True, eq=False)
class EnclosedRoot:
    """One root, or several at one place, in a ball; with its conjugate if Im s > 0.

    Attributes:
        mode: Centre of the ball, and the (estimated) shape.
        radius: Radius of the ball [1/s].
        multiplicity: Roots in the ball.
    """

    mode: Mode
    radius: float
    multiplicity: int


@dataclass(frozen=True, eq=False)
class EnclosedRoots:
    """All roots to the right of a line.

    Attributes:
        roots: By falling real part.
        right_of: Every root with a real part above this is listed [1/s].
        number: How many these are, conjugates and multiplicities counted.
    """

    roots: tuple[EnclosedRoot, ...]
    right_of: float
    number: int


def enclosed_roots(
    system: DelaySystem,
    delay: float | Sequence[float] = 0.0,
    count: int = 10,
    right_of: float | None = None,
) -> EnclosedRoots:
    """Enclose all roots to the right of a line.

    Args:
        system: The loop.
        delay: One delay for all channels or one per channel [s].
        count: The line lies to the left of so many roots (a conjugate pair counts once), in the
            next gap; unless `right_of` says where it lies.
        right_of: Real part of the line [1/s].

    Returns:
        The roots, complete and proved.

    Raises:
        ArgumentError: A bad argument, or the proof does not succeed; the message says why.
    """
    system.require_retarded("enclosed_roots")
    delays = system.delays(delay)
    values, groups = _grouped(delays)
    h = characteristic(system, groups)
    edge, modes = _line(system, delays, check_count("count", count), right_of)
    bits = max(_FIRST_BITS, 4 * h.degree)
    while True:
        try:
            with precision(bits):
                return _enclosed(h, values, edge, modes, bits)
        except UndecidedError as error:
            if bits >= _MOST_BITS:
                raise ArgumentError(
                    f"the roots right of {edge:.6g} 1/s cannot be enclosed: {error}; ask for "
                    "another count or line"
                ) from None
        bits *= 4


def _grouped(delays: np.ndarray[Any, Any]) -> tuple[list[float], list[list[int]]]:
    values = sorted({float(tau) for tau in delays})
    return values, [[k for k in range(len(delays)) if delays[k] == tau] for tau in values]


def _line(
    system: DelaySystem, delays: Any, wanted: int, right_of: float | None
) -> tuple[float, list[Mode]]:
    """Choose the line, and propose the roots to the right of it."""
    if right_of is not None:
        edge = check_finite("right_of", right_of, "1/s")
        number = wanted
        while True:
            modes = rightmost_roots(system, delays, number)
            if len(modes) < number or modes[-1].root.real <= edge:
                return edge, [mode for mode in modes if mode.root.real > edge]
            number *= 2
    number = wanted + 1
    while True:
        modes = rightmost_roots(system, delays, number)
        if len(modes) < number:
            size = max((abs(mode.root) for mode in modes), default=1.0)
            return min((m.root.real for m in modes), default=0.0) - 0.01 * size - 1e-3, modes
        for k in range(wanted, number):
            left, right = modes[k].root.real, modes[k - 1].root.real
            if right - left > _GAP * max(abs(modes[k].root), 1e-300):
                return (left + right) / 2, modes[:k]
        number += 4


def _enclosed(
    exact: Any, values: list[float], edge: float, modes: list[Mode], bits: int
) -> EnclosedRoots:
    unit = exact.unit
    h = Quasipolynomial.of(exact)
    delays = [delay_ball(tau, unit) for tau in values]
    contour = Region(decay_rate=-edge).contour(h, exact.degree, unit, delays)
    pieces = cover(h, contour, delays, Effort(_MOST_PIECES), unit)
    number = count(h, contour, pieces, delays)
    found: list[EnclosedRoot] = []
    balls: list[Any] = []
    for cluster in _clusters(modes):
        ball, multiplicity = _enclose(h, cluster, delays, unit, bits)
        if not (ball / arb(unit)).real > edge or any(ball.overlaps(other) for other in balls):
            raise UndecidedError("enclosures of roots overlap")
        balls.append(ball)
        found.append(_answer(ball, multiplicity, cluster[0], unit))
    total = sum(r.multiplicity * (2 if r.mode.root.imag > 0.0 else 1) for r in found)
    if total != number:
        raise UndecidedError(f"{number} roots are there, the estimates lead to {total}")
    found.sort(key=lambda r: -r.mode.root.real)
    return EnclosedRoots(tuple(found), edge, number)


def _clusters(modes: list[Mode]) -> list[list[Mode]]:
    """Gather estimates that stand at one place."""
    found: list[list[Mode]] = []
    for mode in modes:
        near = next(
            (c for c in found if abs(c[0].root - mode.root) <= _TOGETHER * abs(mode.root)), None
        )
        if near is None:
            found.append([mode])
        else:
            near.append(mode)
    return found


def _enclose(
    h: Quasipolynomial, cluster: list[Mode], delays: Sequence[Any], unit: Any, bits: int
) -> tuple[Any, int]:
    """Return a ball and the number of roots in it; a ball around a real number holds conjugates."""
    root = cluster[0].root
    real = root.imag == 0.0
    if len(cluster) == 1:
        ball = _by_newton(h, acb(root.real, root.imag) * arb(unit), delays, bits, real)
        # A ball across the real axis may hold a real root, or both of a pair.
        if ball is not None and (real or not ball.imag.contains(0)):
            return ball, 1
    mean = sum(mode.root for mode in cluster) / len(cluster)
    half = 4.0 * _TOGETHER * max(abs(mean), 1e-300)
    on_axis = abs(mean.imag) <= half
    centre = (acb(mean.real, 0 if on_axis else mean.imag) * arb(unit)).mid()
    half *= float(unit)
    square = acb(arb(centre.real.mid(), half), arb(centre.imag.mid(), half))
    return square, _inside(h, centre, half, delays, unit)


def _by_newton(
    h: Quasipolynomial, s: Any, delays: Sequence[Any], bits: int, real: bool
) -> Any | None:
    """Enclose a simple root: Newton's iteration, then one interval Newton step."""
    for _ in range(12):
        slope = h.slope(s, delays)
        if slope.contains(0):
            return None
        step = h.at(s, delays) / slope
        s = (s - step).mid()
        if abs(step) <= abs(s) * arb(2) ** (-bits // 3):
            break
    size = abs(s) * arb(2) ** (-bits // 4)
    if not size > 0:
        size = arb(2) ** (-bits // 4)
    radius = float(size.upper())
    ball = acb(arb(s.real.mid(), radius), 0 if real else arb(s.imag.mid(), radius))
    slope = h.slope(ball, delays)
    if slope.contains(0):
        return None
    better = s - h.at(s, delays) / slope
    if real:
        better = acb(better.real, 0)
    contained = ball.real.contains_interior(better.real) if real else ball.contains_interior(better)
    return better if contained else None


def _inside(h: Quasipolynomial, centre: Any, half: float, delays: Sequence[Any], unit: Any) -> int:
    """Count the roots in a square by the argument principle along its four sides."""
    corners = [acb(-half, -half), acb(half, -half), acb(half, half), acb(-half, half)]
    directions = [acb(1), acb(0, 1), acb(-1), acb(0, -1)]
    change = arb(0)
    for corner, direction in zip(corners, directions, strict=True):
        side = Contour((Line(centre + corner, direction),), (2.0 * half,), 0)
        pieces = cover(h, side, delays, Effort(_MOST_PIECES), unit, first=half / 4.0)
        last = h.at(side.lines[0].at(0.0), delays)
        for x in pieces[0][1:]:
            value = h.at(side.lines[0].at(x), delays)
            change += (value / last).arg()
            last = value
    number = (change / (2 * arb.pi())).unique_fmpz()
    if number is None:
        raise UndecidedError("the number of roots at one place is not decided")
    return int(number)


def _answer(ball: Any, multiplicity: int, mode: Mode, unit: Any) -> EnclosedRoot:
    true = ball / arb(unit)
    centre = complex(float(true.real.mid()), float(true.imag.mid()))
    offset = abs(true - acb(centre.real, centre.imag)).upper()
    radius = float(offset)
    if not arb(radius) >= offset:
        radius = float(np.nextafter(radius, np.inf))
    return EnclosedRoot(Mode(centre, mode.shape), radius, multiplicity)
