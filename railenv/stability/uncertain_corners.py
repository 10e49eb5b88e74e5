"""Covers matrices that depend on parameters by affine models with radii, from their corners."""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from typing import Any, TypeVar

import numpy as np

from railenv.errors import ArgumentError, check_finite
from railenv.units import FloatArray

Corner = tuple[int, ...]
"""0 at the low end of a parameter's range, 1 at its high end."""


_Loop = TypeVar("_Loop")


def built_at_corners(
    build: Callable[..., _Loop], ranges: Sequence[tuple[float, float]], curved: int | None
) -> tuple[dict[Corner, _Loop], dict[Corner, _Loop]]:
    """Call `build` at all corners, and at the middles of the edges along the curved parameter."""
    built: dict[Corner, _Loop] = {}
    bends: dict[Corner, _Loop] = {}
    for corner in itertools.product((0, 1), repeat=len(ranges)):
        values = [ranges[k][b] for k, b in enumerate(corner)]
        built[corner] = build(*values)
        if curved is not None and corner[curved] == 0:
            values[curved] = ranges[curved][0] / 2 + ranges[curved][1] / 2
            bends[corner] = build(*values)
    return built, bends


def covering_model(
    values: Mapping[Corner, FloatArray], bends: Mapping[Corner, FloatArray], curved: int | None
) -> tuple[FloatArray, list[FloatArray], FloatArray]:
    """Return middle, slopes and radius that cover one matrix over all corners and between them.

    Between corners the truth and the affine model are the same weighted means of their values at
    the corners, so that the radius need only be large enough there. A convex or concave function
    with values f(-1), f(0), f(1) lies within |d| of its chord shifted by d = f(0) - (mean of ends).
    Everything is exact but the last rounding, which is outwards.

    Args:
        values: The matrix at every corner.
        bends: For each corner with 0 at `curved`: the matrix with that parameter at its middle.
        curved: The parameter in which entries are convex or concave instead of affine.
    """
    shape, parameters = next(iter(values.values())).shape, len(next(iter(values)))
    middle: FloatArray = np.array(next(iter(values.values())))
    slopes: list[FloatArray] = [np.zeros(shape) for _ in range(parameters)]
    radius: FloatArray = np.zeros(shape)
    matrices: FloatArray = np.array([*values.values(), *bends.values()])
    moving = np.any(matrices != matrices[0], axis=0)
    for place in zip(*np.nonzero(moving), strict=True):
        ends = {c: Fraction(float(v[place])) for c, v in values.items()}
        slack = Fraction(0)
        for c, bend in bends.items():
            k = curved or 0
            top = (*c[:k], 1, *c[k + 1 :])
            shift = Fraction(float(bend[place])) - (ends[c] + ends[top]) / 2
            ends[c], ends[top] = ends[c] + shift, ends[top] + shift
            slack = max(slack, abs(shift))
        middle[place] = float(sum(ends.values(), Fraction(0)) / len(ends))
        for k in range(parameters):
            rise = sum(((2 * c[k] - 1) * v for c, v in ends.items()), Fraction(0))
            slopes[k][place] = float(rise / len(ends))
        model = [Fraction(float(s[place])) for s in slopes]
        centre = Fraction(float(middle[place]))
        worst = slack + max(abs(v - centre - _at(model, c)) for c, v in ends.items())
        radius[place] = math.nextafter(float(worst), math.inf) if worst else 0.0
    return middle, slopes, radius


def _at(model: list[Fraction], corner: Corner) -> Fraction:
    return sum(((2 * b - 1) * s for b, s in zip(corner, model, strict=True)), Fraction(0))


def middle_and_radius(ball: Any) -> tuple[float, float]:
    """Return doubles that cover a real ball; ValueError if it is not finite."""
    middle = float(ball.mid())
    away = (ball - middle).abs_upper()
    radius = float(away)
    while not away <= radius:
        radius = math.nextafter(radius, math.inf)
    if not (math.isfinite(middle) and math.isfinite(radius)):
        raise ValueError("not finite")
    return middle, radius


def checked_range(k: int, pair: Any) -> tuple[float, float]:
    """Return a range of parameter k as two doubles, or raise `ArgumentError`."""
    try:
        first, last = pair
    except (TypeError, ValueError):
        raise ArgumentError(f"ranges[{k}] = {pair!r} is no range; give (low, high)") from None
    low, high = check_finite(f"ranges[{k}]", first), check_finite(f"ranges[{k}]", last)
    if low > high:
        raise ArgumentError(f"ranges[{k}] = {pair!r} is reversed; give (low, high)")
    return low, high
