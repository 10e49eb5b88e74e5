"""Cutting a range of delays, and of the delays told, into pieces that share their ends exactly.

A delay is d T + r with d whole and r a double in [0, T]: d T itself is rarely a double, and so the
cuts at whole periods stay exact. What is told lies within an error of the delay, not below zero.
"""

from dataclasses import dataclass
from fractions import Fraction
from math import inf, nextafter
from typing import NamedTuple

from railenv.units import Second

# Pieces shorter than this share of the period (of delay and of told delay) are not split further.
_SHORTEST = 2.0**-22


class Piece(NamedTuple):
    """Delays d T + r, r in [low, high], with a range of told delays."""

    whole: int
    low: float
    high: float
    told_low: float
    told_high: float


@dataclass(frozen=True)
class DelayRange:
    """Common delays from low to high, each told with an error.

    Attributes:
        low: Smallest delay [s].
        high: Largest delay [s].
        period: Control period T [s].
        knots: Knots of the schedule [s]; empty without one, then nothing is told.
        error: Largest difference between told and true delay [s].
    """

    low: Second
    high: Second
    period: Second
    knots: tuple[float, ...]
    error: Second

    def pieces(self) -> list[Piece]:
        """Cut the range where the number of whole periods changes.

        A delay of a whole number of periods belongs to the piece that begins there: with
        feedthrough the loop is continuous from the right only.
        """
        T, low, high = Fraction(self.period), Fraction(self.low), Fraction(self.high)
        pieces: list[Piece] = []
        for d in range(low // T, high // T + 1):
            begin, stop = max(low - d * T, Fraction(0)), min(high - d * T, T)
            piece = Piece(d, below(begin), min(above(stop), self.period), 0.0, 0.0)
            pieces.append(self._with_told(piece, 0.0, inf))
        return pieces

    def parts(self, piece: Piece, told_first: bool) -> list[Piece]:
        """Halve a piece in the delay, or in what is told (at a knot, if one is inside).

        Args:
            piece: The piece.
            told_first: Which of the two, if both are long enough.

        Returns:
            The parts that contain something of the range; none if the piece is too short.
        """
        shortest = _SHORTEST * self.period
        by_delay = piece.high - piece.low > shortest
        if piece.told_high - piece.told_low > shortest and (told_first or not by_delay):
            middle = (piece.told_low + piece.told_high) / 2
            inside = [k for k in self.knots if piece.told_low < k < piece.told_high]
            cut = min(inside, key=lambda knot: abs(knot - middle), default=middle)
            return [piece._replace(told_high=cut), piece._replace(told_low=cut)]
        if not by_delay:
            return []
        middle = (piece.low + piece.high) / 2
        halves = [piece._replace(high=middle), piece._replace(low=middle)]
        cut_halves = [self._with_told(half, piece.told_low, piece.told_high) for half in halves]
        return [half for half in cut_halves if half.told_low <= half.told_high]

    def start(self, piece: Piece) -> float:
        """Return the smallest delay of a piece [s], rounded."""
        return float(piece.whole * Fraction(self.period) + Fraction(piece.low))

    def end(self, piece: Piece) -> float:
        """Return the largest delay of a piece [s], rounded."""
        return float(piece.whole * Fraction(self.period) + Fraction(piece.high))

    def samples(self, piece: Piece) -> list[tuple[float, float]]:
        """Return pairs of a delay and a told delay, of the range and in or next to the piece."""
        begin, stop = self.start(piece), self.end(piece)
        places = [min(max(d, self.low), self.high) for d in (begin, (begin + stop) / 2, stop)]
        return [
            (d, min(max(told, ends[0]), ends[-1]))
            for d in places
            for ends in [self.told(d)]
            for told in (piece.told_low, piece.told_high)
        ]

    def told(self, delay: float) -> list[float]:
        """Return the smallest told delay that a delay can come with, itself, and the largest."""
        if not self.knots:
            return [0.0]
        least = above(max(Fraction(delay) - Fraction(self.error), Fraction(0)))
        return sorted({least, delay, below(Fraction(delay) + Fraction(self.error))})

    def _with_told(self, piece: Piece, low: float, high: float) -> Piece:
        """Cut [low, high] to the told delays that can occur with the piece's delays."""
        if not self.knots:
            return piece
        T, error = Fraction(self.period), Fraction(self.error)
        begin, stop = (piece.whole * T + Fraction(r) for r in (piece.low, piece.high))
        return piece._replace(
            told_low=max(low, below(max(begin - error, Fraction(0)))),
            told_high=min(high, above(stop + error)),
        )


def below(value: Fraction) -> float:
    """Return the largest double that is not above a number."""
    nearest = float(value)
    return nearest if Fraction(nearest) <= value else nextafter(nearest, -inf)


def above(value: Fraction) -> float:
    """Return the smallest double that is not below a number."""
    nearest = float(value)
    return nearest if Fraction(nearest) >= value else nextafter(nearest, inf)
