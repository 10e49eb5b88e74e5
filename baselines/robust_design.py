"""What a search for a robust law hands over: the law, and where the search began and ended."""

from dataclasses import dataclass, field

from baselines.controller import LinearFeedback
from baselines.robust_family import ModalFamily
from baselines.robust_search import SearchResult
from railenv.units import FloatArray

LONGEST = 1.0
"""Longest delay to which crossings are looked for [s]."""


@dataclass(frozen=True, eq=False)
class RobustDesign:
    """A law found by a search, and where the search began.

    Attributes:
        controller: The law.
        gains: Gain of each reading to the force of its mode [N per unit of the reading].
        start: The same of the law it began with.
        abscissa: Largest real part of a root at the worst of the delays, at start and end [1/s].
        index: Ride index estimate over the delays, at start and end; NaN if unstable at one.
        critical_delay: At start and end [s]; `LONGEST` if none up to there.
        steps: Steps of the search that gave the law.
        evaluations: Loops looked at in all searches.
        settled: Whether that search ended by itself.
    """

    controller: LinearFeedback
    gains: dict[str, float]
    start: dict[str, float] = field(repr=False)
    abscissa: tuple[float, float]
    index: tuple[float, float]
    critical_delay: tuple[float, float]
    steps: int
    evaluations: int
    settled: bool


def first_crossing(family: ModalFamily, point: FloatArray) -> float:
    """Return the first crossing [s]; zero if unstable without delay, `LONGEST` if there is none."""
    crossings = family.crossings(point, LONGEST)
    return crossings[0][0] if crossings else 0.0


def finished(
    family: ModalFamily,
    start: FloatArray,
    found: SearchResult,
    evaluations: int,
    delays: tuple[float, ...],
) -> RobustDesign:
    """Measure a law and the one that the search began with.

    Args:
        family: The laws that were searched.
        start: Scaled gains of the first start.
        found: Where the best search ended.
        evaluations: Loops looked at in all searches.
        delays: The delays that counted [s].
    """
    ends = (start, found.point)
    abscissa = [max(family.roots(point, tau)[0][0] for tau in delays) for point in ends]
    index = [
        family.index(point, delays)[0] if growth < 0.0 else float("nan")
        for point, growth in zip(ends, abscissa, strict=True)
    ]
    critical = [first_crossing(family, point) for point in ends]
    names = family.signals.names
    gains = [dict(zip(names, map(float, point * family.scale), strict=True)) for point in ends]
    return RobustDesign(
        family.controller(found.point),
        gains[1],
        gains[0],
        (abscissa[0], abscissa[1]),
        (index[0], index[1]),
        (critical[0], critical[1]),
        found.steps,
        evaluations,
        found.settled,
    )
