"""Minimising the largest of several functions under constraints, where that largest has kinks.

Every step solves the linear programme of the pieces at hand inside a box,

    minimise t + penalty * sum_k s_k   subject to
    f_i + g_i'd <= t,   c_kj + h_kj'd <= s_k,   s_k >= 0,   |d| <= radius,

and is taken if the exact penalty function max_i f_i + penalty * sum_k max(0, max_j c_kj) falls by a
share of what was foretold; else the box shrinks (Madsen, J. Inst. Maths Applics 16, 1975, 321-328).
Because all pieces near the largest stand in the programme, a kink does not stop it, where descent
along one gradient ends on it. A piece may come or go from one point to the next. The result is
locally optimal at best.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from railenv.errors import ArgumentError, RailenvError
from railenv.units import FloatArray

Piece = tuple[float, FloatArray]
"""Value and gradient of one smooth function."""

PENALTY = 10.0
"""Price of one unit of a constraint in units of the objective, unless said."""

_FIRST, _LARGEST, _SMALLEST = 0.3, 1.0, 1e-4
_ACCEPTED, _GOOD = 0.05, 0.6
_SHRINK, _GROW = 0.4, 2.0


@dataclass(frozen=True)
class Pieces:
    """What is known at a point.

    Attributes:
        objective: Functions whose largest is to be small.
        constraints: Groups of functions, the largest of each group not to be above zero.
    """

    objective: list[Piece]
    constraints: list[list[Piece]]

    @property
    def missed(self) -> float:
        """Sum of what each group of constraints is above zero."""
        return sum(max(0.0, *(value for value, _ in group)) for group in self.constraints)

    def merit(self, penalty: float) -> float:
        """Return the exact penalty function."""
        return max(value for value, _ in self.objective) + penalty * self.missed


@dataclass(frozen=True, eq=False)
class SearchResult:
    """Where a search ended.

    Attributes:
        point: The best point, shape (n,).
        merit: The penalty function there.
        missed: How far constraints are missed there.
        steps: Steps taken.
        evaluations: Points looked at.
        settled: Whether it ended because no step brings enough, and not for their number.
    """

    point: FloatArray
    merit: float
    missed: float
    steps: int
    evaluations: int
    settled: bool


def minimise_largest(
    pieces: Callable[[FloatArray], Pieces | None],
    start: FloatArray,
    *,
    most_steps: int = 150,
    enough: float = 1e-6,
    penalty: float = PENALTY,
) -> SearchResult:
    """Minimise the largest piece from a point on.

    Args:
        pieces: The functions at a point, or None where they do not exist.
        start: Where to begin, shape (n,), scaled so that steps of 0.3 are sensible.
        most_steps: Give up after so many.
        enough: End when a step foretells no more than this, in units of the objective.
        penalty: Price of one unit of a constraint.

    Returns:
        The best point found.

    Raises:
        ArgumentError: The functions do not exist at the start.
    """
    point = np.array(start, dtype=np.float64)
    here = pieces(point)
    if here is None:
        raise ArgumentError(
            "start lies where the functions do not exist; give gains whose loop is stable at every "
            "delay that counts"
        )
    radius, evaluations, steps = _FIRST, 1, 0
    settled = False
    while steps < most_steps:
        move, foretold = _programme(here, radius, penalty)
        gain = here.merit(penalty) - foretold
        if radius < _SMALLEST or gain <= enough:
            settled = True
            break
        there = pieces(point + move)
        evaluations += 1
        fallen = -np.inf if there is None else here.merit(penalty) - there.merit(penalty)
        if there is None or fallen <= _ACCEPTED * gain:
            radius *= _SHRINK
            continue
        if fallen > _GOOD * gain:
            radius = min(_GROW * radius, _LARGEST)
        point, here = point + move, there
        steps += 1
    return SearchResult(point, here.merit(penalty), here.missed, steps, evaluations, settled)


def _programme(pieces: Pieces, radius: float, penalty: float) -> tuple[FloatArray, float]:
    """Solve the linear programme; return the move and the merit that it foretells."""
    n, groups = len(pieces.objective[0][1]), len(pieces.constraints)
    rows = [np.concatenate([g, [-1.0], np.zeros(groups)]) for _, g in pieces.objective]
    limits = [-value for value, _ in pieces.objective]
    for k, group in enumerate(pieces.constraints):
        slack = np.concatenate([[0.0], -np.eye(groups)[k]])
        rows += [np.concatenate([gradient, slack]) for _, gradient in group]
        limits += [-value for value, _ in group]
    cost = np.concatenate([np.zeros(n), [1.0], penalty * np.ones(groups)])
    bounds = [(-radius, radius)] * n + [(None, None)] + [(0.0, None)] * groups
    answer = linprog(cost, np.array(rows), np.array(limits), bounds=bounds, method="highs")
    if answer.x is None or answer.fun is None:
        raise RailenvError(f"the linear programme of a step has no answer: {answer.message}")
    return np.asarray(answer.x[:n]), float(answer.fun)
