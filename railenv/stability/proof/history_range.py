"""True and told delays of a range, cut into cases, as boxes of normalised coordinates.

A case is a number d of whole periods and an interval between two knots of the schedule:

    delay = d T + r, r = T (1 + rho) / 2,    told = middle of the interval + sigma half its width

What is told lies within an error of the delay, not below zero; before the first and beyond the last
knot the law is constant, so that what is told there counts as the knot. All bounds are widened a
little, so that rounding leaves nothing out: what is covered holds what was asked for.
"""

from dataclasses import dataclass
from fractions import Fraction
from math import ceil, floor

import numpy as np

from railenv.stability.proof.history_boxes import GRID, BoolArray, Boxes, IntArray
from railenv.units import FloatArray, Second

# A largest delay this close below a whole number of periods, as a share of the period, is taken as
# that many periods too: 0.3 s is a little less than 30 periods of 0.01 s, and nobody means that.
_CLOSE = 1e-9
# Margin in seconds in which a box counts as touching the range asked for.
_MARGIN = 1e-12
# Half width of the box that stands for one pair of delays: far above rounding.
_POINT = 2.0**-30


@dataclass(frozen=True, eq=False)
class HistoryRange:
    """Common delays from low to high, told with an error.

    Attributes:
        low: Smallest delay [s].
        high: Largest delay [s].
        error: Largest difference between told and true delay [s].
        period: Control period T [s].
        knots: Knots of the schedule, shape (q,) [s].
    """

    low: Second
    high: Second
    error: Second
    period: Second
    knots: FloatArray

    @property
    def first(self) -> int:
        """Smallest number of whole periods."""
        return floor(Fraction(self.low) / Fraction(self.period))

    @property
    def last(self) -> int:
        """Largest number of whole periods."""
        return floor(Fraction(self.high) / Fraction(self.period) + Fraction(_CLOSE))

    def cases(self) -> tuple[IntArray, IntArray, Boxes]:
        """Return d and the interval of each case, and one box per case that holds its part."""
        wholes, intervals = list[int](), list[int]()
        middles, halves = list[tuple[float, float]](), list[tuple[float, float]]()
        for d in range(self.first, self.last + 1):
            begin = max(self.low - d * self.period, 0.0)
            end = min(self.high - d * self.period, self.period)
            late = _snapped(2 * begin / self.period - 1, 2 * max(end, begin) / self.period - 1)
            for k in range(max(len(self.knots) - 1, 1)):
                share = self._shares(k, begin + d * self.period, max(end, begin) + d * self.period)
                if share is None:
                    continue
                wholes.append(d)
                intervals.append(k)
                middles.append((share[0], late[0]))
                halves.append((share[1], late[1]))
        boxes = Boxes(np.arange(len(wholes)), np.array(middles), np.array(halves))
        return np.array(wholes), np.array(intervals), boxes

    def _shares(self, k: int, begin: float, end: float) -> tuple[float, float] | None:
        """Return centre and half width in sigma of what may be told in an interval."""
        if len(self.knots) == 1:
            return 0.0, 0.0
        low, high = self.knots[k], self.knots[k + 1]
        ends = (self.knots[0], self.knots[-1])
        a = min(max(begin - self.error, ends[0]), ends[1])
        b = min(max(end + self.error, ends[0]), ends[1])
        if a - _MARGIN > high or b + _MARGIN < low:
            return None
        width = high - low
        return _snapped(2 * (max(a, low) - low) / width - 1, 2 * (min(b, high) - low) / width - 1)

    def wanted(self, wholes: IntArray, intervals: IntArray, boxes: Boxes) -> BoolArray:
        """Say which boxes touch the range; d and interval are given per box."""
        begin = (wholes + (1 + boxes.middle[:, 1] - boxes.half[:, 1]) / 2) * self.period
        end = (wholes + (1 + boxes.middle[:, 1] + boxes.half[:, 1]) / 2) * self.period
        kept = (end >= self.low - _MARGIN) & (begin <= self.high + _MARGIN)
        if len(self.knots) == 1:
            return kept
        low, width = self.knots[intervals], np.diff(self.knots)[intervals]
        least = low + width * (1 + boxes.middle[:, 0] - boxes.half[:, 0]) / 2
        most = low + width * (1 + boxes.middle[:, 0] + boxes.half[:, 0]) / 2
        least = np.where(least <= self.knots[0] + _MARGIN, -np.inf, least)
        most = np.where(most >= self.knots[-1] - _MARGIN, np.inf, most)
        margin = self.error + _MARGIN
        return kept & (most >= begin - margin) & (least <= end + margin)

    def points(self, pairs: list[tuple[int, float, float]]) -> tuple[IntArray, IntArray, Boxes]:
        """Return d, interval and a very small box for triples of d, r [s] and told delay [s]."""
        wholes, intervals, middles = list[int](), list[int](), list[list[float]]()
        for d, rest, told in pairs:
            k, sigma = 0, 0.0
            if len(self.knots) > 1:
                place = min(max(told, self.knots[0]), self.knots[-1])
                k = min(max(int(np.searchsorted(self.knots, place)) - 1, 0), len(self.knots) - 2)
                width = self.knots[k + 1] - self.knots[k]
                sigma = 2 * (place - self.knots[k]) / width - 1
            rho = 2 * rest / self.period - 1
            wholes.append(d)
            intervals.append(k)
            middles.append([min(max(x, _POINT - 1), 1 - _POINT) for x in (sigma, rho)])
        halves = np.full((len(pairs), 2), _POINT)
        boxes = Boxes(np.arange(len(pairs)), np.array(middles), halves)
        return np.array(wholes), np.array(intervals), boxes

    def place(self, whole: int, interval: int, middle: FloatArray) -> tuple[float, float]:
        """Return delay and told delay [s] of normalised coordinates, rounded."""
        delay = (whole + (1 + float(middle[1])) / 2) * self.period
        if len(self.knots) == 1:
            return delay, delay
        low, high = self.knots[interval], self.knots[interval + 1]
        return delay, float(low + (high - low) * (1 + middle[0]) / 2)


def _snapped(low: float, high: float) -> tuple[float, float]:
    """Widen [low, high] to a grid and cut it to [-1, 1]; return centre and half width, exact."""
    a, b = max(floor(low / GRID) - 1, -round(1 / GRID)), min(ceil(high / GRID) + 1, round(1 / GRID))
    return (a + b) * GRID / 2, (b - a) * GRID / 2
