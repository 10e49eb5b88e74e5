"""Proves claims about loops with a finite history anew, sharing nothing with the first proof.

Such a claim needs no evidence beside the loop's numbers: everything is computed again, here in
balls throughout. For every number d of whole periods, with r in [0, T] and all that may be told:

1. f (see `history_function`) has no zero on the unit circle: arcs and boxes of delay and told delay
   are cut until on each the constant coefficient is larger than all others together;
2. at one delay, the turns of f along the circle count the eigenvalues outside.

It takes some ten times as long as the first proof: minutes for a vehicle.
"""

from math import pi
from typing import Any, NamedTuple

from flint import acb, arb, ctx, fmpq

from railenv.stability.verifier.history_boxes import Box, at_point, halves, place_to_cut, table_of
from railenv.stability.verifier.history_function import ARC_BITS, Function, folded, powers
from railenv.stability.verifier.history_modes import DEGREE
from railenv.stability.verifier.quasipolynomial import RejectedError, rational

_ARCS, _SHORTEST = 64, fmpq(1, 2**27)
_MOST_BOXES, _MOST_PERIODS = 5_000_000, 400


class _Arc(NamedTuple):
    t: Any
    s: Any

    def halves(self) -> list["_Arc"]:
        half = self.s / 2
        return [_Arc(self.t - half, half), _Arc(self.t + half, half)]


def check_history(system: dict[str, Any], claim: dict[str, Any], roots: Any) -> None:
    """Prove the claim anew.

    Args:
        system: The loop's numbers.
        claim: What is claimed.
        roots: Number of eigenvalues outside that is claimed with it.

    Raises:
        RejectedError: It could not be proved.
    """
    before = ctx.prec
    try:
        _Check(system, claim).run(claim, roots)
    finally:
        ctx.prec = before


class _Check:
    """The loop, and the range that is claimed."""

    def __init__(self, system: dict[str, Any], claim: dict[str, Any]) -> None:
        self.T = rational(system["period"])
        self.knots = [rational(v) for v in system["told"]]
        self.low, self.high = rational(claim["low"]), rational(claim["high"])
        self.error = rational(claim["told_error"])
        rising = all(a < b for a, b in zip(self.knots[:-1], self.knots[1:], strict=True))
        if not (self.T > 0 and self.knots and self.knots[0] >= 0 and rising):
            raise RejectedError("the period is not above zero, or the knots do not rise")
        if not (0 <= self.low <= self.high <= _MOST_PERIODS * self.T and self.error >= 0):
            raise RejectedError("the claim has no usable range of delays")
        self.function = Function(system)
        if self.function.knots != len(self.knots):
            raise RejectedError("a law has gains for every knot")
        self.most = max(
            self.function.ages, self.function.past, 2 * (_whole(self.high / self.T) + 1)
        )
        ctx.prec = ARC_BITS

    def run(self, claim: dict[str, Any], roots: Any) -> None:
        """Prove the claim, or raise `RejectedError`."""
        if claim["verdict"] == "UNSTABLE":
            self._unstable(claim, roots)
            return
        if type(roots) is not int or roots != 0:
            raise RejectedError("a stable loop has no unstable roots")
        wholes = range(_whole(self.low / self.T), _whole(self.high / self.T) + 1)
        members = list[Box]()
        for d in wholes:
            begin, end = self._rests(d)
            rest = (begin + end) / 2
            members.append(self._point(d, rest, d * self.T + rest))
        if any(count != 0 for count in self._counted(members)):
            raise RejectedError("eigenvalues are not all inside the unit circle")
        self._cover([box for d in wholes for box in self._boxes(d)])

    def _unstable(self, claim: dict[str, Any], roots: Any) -> None:
        delay = rational(claim["witness"])
        told = delay
        if len(self.knots) > 1:
            told = rational(claim["witness_told"])
            # What is cut at zero was below it.
            if told < 0 or abs(told - delay) > self.error:
                raise RejectedError("what is told at the witness is out of the error")
        if not self.low <= delay <= self.high:
            raise RejectedError("the witness is out of the range")
        d = _whole(delay / self.T)
        (count,) = self._counted([self._point(d, delay - d * self.T, told)])
        if type(roots) is not int or count != roots or not roots:
            raise RejectedError(f"{count} unstable roots are counted and {roots!r:.40} claimed")

    def _rests(self, d: int) -> tuple[Any, Any]:
        begin, end = self.low - d * self.T, self.high - d * self.T
        return (begin if begin > 0 else fmpq(0)), (end if end < self.T else self.T)

    def _clipped(self, told: Any) -> Any:
        return min(max(told, self.knots[0]), self.knots[-1])

    def _point(self, d: int, rest: Any, told: Any) -> Box:
        k, sigma, place = 0, fmpq(0), self._clipped(told)
        if len(self.knots) > 1:
            k = max(i for i in range(len(self.knots) - 1) if self.knots[i] <= place)
            sigma = 2 * (place - self.knots[k]) / (self.knots[k + 1] - self.knots[k]) - 1
        return Box(d, k, sigma, fmpq(0), 2 * rest / self.T - 1, fmpq(0))

    def _boxes(self, d: int) -> list[Box]:
        """Return one box per interval that holds all that may be told with d whole periods."""
        begin, end = self._rests(d)
        rho, rho_half = (begin + end) / self.T - 1, (end - begin) / self.T
        if len(self.knots) == 1:
            return [Box(d, 0, fmpq(0), fmpq(0), rho, rho_half)]
        least = self._clipped(d * self.T + begin - self.error)
        most = self._clipped(d * self.T + end + self.error)
        boxes = list[Box]()
        for k in range(len(self.knots) - 1):
            low, high = self.knots[k], self.knots[k + 1]
            a, b = max(low, least), min(high, most)
            if a <= b:
                middle = ((a + b) - (low + high)) / (high - low)
                boxes.append(Box(d, k, middle, (b - a) / (high - low), rho, rho_half))
        return boxes

    def _matters(self, box: Box) -> bool:
        """Whether something of the range is in the box."""
        if len(self.knots) == 1:
            return True
        begin = (box.whole + (1 + box.rho - box.rho_half) / 2) * self.T
        end = (box.whole + (1 + box.rho + box.rho_half) / 2) * self.T
        low, high = self.knots[box.interval], self.knots[box.interval + 1]
        ends = [
            (low + high) / 2 + (box.sigma + side * box.sigma_half) * (high - low) / 2
            for side in (-1, 1)
        ]
        below = ends[0] > self.knots[0] and ends[0] > end + self.error
        above = ends[1] < self.knots[-1] and ends[1] < begin - self.error
        return not (below or above)

    def _cases(self, arc: _Arc, pairs: set[tuple[int, int]]) -> dict[tuple[int, int], Any] | None:
        """Return f on an arc for pairs of d and interval: polynomials [sigma][rho]."""
        w = powers(arc.t, arc.s, self.most)
        try:
            parts = self.function.parts(w, sorted({k for _, k in pairs}))
        except ZeroDivisionError:
            return None
        found = dict[tuple[int, int], Any]()
        for d, k in pairs:
            xx, xy, yy = parts[k]
            found[d, k] = [
                [
                    folded(
                        (xx[i][j] if j < len(xx[i]) else 0) + w[d] * xy[i][j] + w[2 * d] * yy[i][j]
                    )
                    for j in range(DEGREE + 1)
                ]
                for i in range(3)
            ]
        return found

    def _counted(self, members: list[Box]) -> list[int | None]:
        """Count eigenvalues outside at single delays, by the turns of f (argument principle)."""
        angle, last = [0.0] * len(members), list[Any]([None] * len(members))
        lost = set[int]()
        stack = [(arc, list(range(len(members)))) for arc in _first_arcs()[::-1]]
        while stack:
            arc, now = stack.pop()
            now = [i for i in now if i not in lost]
            if not now:
                continue
            cases = self._cases(arc, {members[i][:2] for i in now})
            rest = list[int]()
            for i in now:
                coefs = None if cases is None else at_point(cases[members[i][:2]], members[i])
                if coefs is None or not abs(coefs[0]) > sum((abs(c) for c in coefs[1:]), arb(0)):
                    rest.append(i)
                    continue
                # The disc around the middle of the constant ball holds f and not zero, so that
                # neighbouring middles are less than half a turn apart.
                middle = acb(coefs[0].real.mid(), coefs[0].imag.mid())
                before = last[i]
                if before is None:
                    # f is real at w = 1, and of this sign.
                    before = acb(1 if middle.real > 0 else -1)
                angle[i] += float((middle / before).arg().mid())
                last[i] = middle
            if rest and arc.s / 2 < _SHORTEST:
                lost |= set(rest)
            elif rest:
                stack += [(half, rest) for half in arc.halves()[::-1]]
        return [None if i in lost else self._turns(angle[i], last[i]) for i in range(len(members))]

    def _turns(self, angle: float, last: Any) -> int:
        end = acb(1 if last.real > 0 else -1)
        turns = -(angle + float((end / last).arg().mid())) / pi
        if abs(turns - round(turns)) > 1e-6:
            raise RejectedError("angles do not add up to whole turns")
        return round(turns) + self.function.modes.outside

    def _cover(self, boxes: list[Box]) -> None:
        """Show that f has no zero on the circle for anything in the boxes."""
        looked = 0
        stack = [(arc, boxes) for arc in _first_arcs()[::-1]]
        while stack:
            arc, now = stack.pop()
            cases = self._cases(arc, {box[:2] for box in now})
            rest = list[Box]() if cases is not None else now
            tables = {} if cases is None else {pair: table_of(f) for pair, f in cases.items()}
            waiting = now[:] if cases is not None else []
            while waiting:
                box = waiting.pop()
                if not self._matters(box):
                    continue
                looked += 1
                axis = place_to_cut(tables[box[:2]], box)
                if axis == "x":
                    rest.append(box)
                elif axis:
                    waiting += halves(box, axis)
            if rest and (arc.s / 2 < _SHORTEST or looked > _MOST_BOXES):
                raise RejectedError("the unit circle could not be shown to be free of roots")
            if rest:
                stack += [(half, rest) for half in arc.halves()[::-1]]


def _whole(ratio: Any) -> int:
    return int(ratio.floor())


def _first_arcs() -> list[_Arc]:
    return [_Arc(fmpq(2 * i + 1, 2 * _ARCS), fmpq(1, 2 * _ARCS)) for i in range(_ARCS)]
