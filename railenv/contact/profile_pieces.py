"""Pieces of which nominal wheel and rail profiles are made: lines, arcs and polynomials.

Here lengths are millimetres, as in the standards' drawings: y across, z down. An arc is written by
its centre and `side`: -1 for the half above the centre (z smaller), +1 for the half below it. The
slope of a tangent is dz/dy.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from railenv.errors import ArgumentError
from railenv.units import FloatArray

_FINE = 2001
"""Points by which the length of a piece is measured; arcs are then spaced evenly to 1e-3."""


class Piece(NamedTuple):
    """Part of a profile between two lateral positions.

    Attributes:
        low: Its smallest y [mm].
        high: Its largest y [mm].
        height: z as a function of y [mm].
    """

    low: float
    high: float
    height: Callable[[FloatArray], FloatArray]


class Line(NamedTuple):
    """The straight line z = offset + slope y [mm]."""

    offset: float
    slope: float

    def between(self, low: float, high: float) -> Piece:
        """Return the part of the line over low <= y <= high [mm]."""

        def height(y: FloatArray) -> FloatArray:
            return self.offset + self.slope * y

        return Piece(low, high, height)

    def at(self, y: float) -> float:
        """Return z at y [mm]."""
        return self.offset + self.slope * y


class Arc(NamedTuple):
    """Half a circle: z = centre_z + side sqrt(radius^2 - (y - centre_y)^2) [mm]."""

    centre_y: float
    centre_z: float
    radius: float
    side: int

    def between(self, low: float, high: float) -> Piece:
        """Return the part of the arc over low <= y <= high [mm]."""

        def height(y: FloatArray) -> FloatArray:
            square = self.radius**2 - (y - self.centre_y) ** 2
            return self.centre_z + self.side * np.sqrt(square)

        return Piece(low, high, height)

    def at(self, y: float) -> float:
        """Return z at y [mm]."""
        return self.centre_z + self.side * math.sqrt(self.radius**2 - (y - self.centre_y) ** 2)

    def slope_at(self, y: float) -> float:
        """Return dz/dy at y [mm]."""
        across = y - self.centre_y
        return -self.side * across / math.sqrt(self.radius**2 - across**2)

    def where(self, slope: float) -> float:
        """Return the y at which the arc has a slope [mm]."""
        return self.centre_y - self.side * self.radius * slope / math.hypot(1.0, slope)


def arc_from(y: float, z: float, slope: float, radius: float, side: int) -> Arc:
    """Return the arc through a point with a given slope there [mm]."""
    length = math.hypot(1.0, slope)
    return Arc(y + side * radius * slope / length, z - side * radius / length, radius, side)


def fillet(left: Line, right: Line, radius: float, side: int) -> Arc:
    """Return the arc that is tangent to two lines; it touches them at `where` of their slopes."""

    def shifted(line: Line) -> float:
        return line.offset - side * radius * math.hypot(1.0, line.slope)

    y = (shifted(left) - shifted(right)) / (right.slope - left.slope)
    return Arc(y, shifted(right) + right.slope * y, radius, side)


def inner_tangent_y(outer: Arc, inner: Arc) -> float:
    """Return y of the point where a smaller circle touches a larger one from inside [mm]."""
    share = outer.radius / (outer.radius - inner.radius)
    return outer.centre_y + share * (inner.centre_y - outer.centre_y)


def sampled(pieces: Sequence[Piece], spacing: float) -> tuple[FloatArray, FloatArray]:
    """Return points of a chain of pieces, evenly spaced along each, ends included.

    Args:
        pieces: By rising y; each begins where the one before ends [mm].
        spacing: Largest distance of neighbours along the outline [mm].

    Returns:
        y and z, each of shape (n,) [mm]; at a joint the right piece's value.
    """
    across: list[FloatArray] = []
    down: list[FloatArray] = []
    for number, piece in enumerate(pieces):
        if number and piece.low != pieces[number - 1].high:
            raise ArgumentError(
                f"piece {number} begins at y = {piece.low} mm, beside its neighbour"
            )
        # A cosine spacing resolves steep ends.
        share = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, _FINE))
        fine = piece.low + (piece.high - piece.low) * share
        length = np.concatenate(
            [[0.0], np.cumsum(np.hypot(np.diff(fine), np.diff(piece.height(fine))))]
        )
        steps = math.ceil(float(length[-1]) / spacing)
        y = np.interp(np.linspace(0.0, float(length[-1]), steps + 1), length, fine)
        y[0], y[-1] = piece.low, piece.high
        if number + 1 < len(pieces):
            y = y[:-1]
        across.append(y)
        down.append(piece.height(y))
    return np.concatenate(across), np.concatenate(down)
