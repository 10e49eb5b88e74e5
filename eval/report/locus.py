"""The root locus on a controller's card: how the loop's roots move as commands come later."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from markupsafe import Markup

from eval.benchmark_roots import DEEPEST, FASTEST_HZ
from eval.report.svg import Chart, Point, mark
from eval.report.words import number

MARKED: tuple[float, ...] = (0.0, 0.1, 0.2, 0.3)
"""Delays whose roots have a mark [s]."""

_SHAPES = ("o", "s", "^", "D")
_FARTHEST = 8.0
"""The real axis ends there at the latest; see `_edge` [1/s]."""

_KINDS = {
    "exact": "Roots of the continuous loop",
    "sampled": "Roots of the sampled loop, s = ln(z)/T",
    "passive": "Roots of the vehicle, on which no command acts",
    "designs": "Roots of the sampled loop, s = ln(z)/T, of one design per delay, each at its own",
}


@dataclass(frozen=True)
class Step:
    """The rightmost root shown at one delay.

    Attributes:
        delay: Delay [s].
        real: Real part [1/s].
        hertz: Frequency of its oscillation [Hz].
    """

    delay: float
    real: float
    hertz: float


def locus_chart(name: str, roots: dict[str, Any], passive: dict[str, Any] | None) -> Markup:
    """Draw a locus: real part across, frequency up; marks at `MARKED`.

    Args:
        name: Unique in the page; ids begin with it.
        roots: What `eval.benchmark_roots.root_motion` has found, no `none`.
        passive: The same of the passive vehicle, drawn as crosses; None for none.
    """
    delays: list[float] = roots["delays_s"]
    branches = [
        (branch["first"], [_place(root) for root in branch["roots"]])
        for branch in roots["branches"]
    ]
    points = [point for _, places in branches for point in places]
    right = _edge(max((x for x, _ in points), default=0.0))
    top = max(FASTEST_HZ, 1.05 * max((y for _, y in points), default=0.0))
    chart = Chart(
        name,
        locus_sentence(roots),
        "real part [1/s]",
        "frequency [Hz]",
        (DEEPEST, right),
        (-0.03 * top, top),
        height=320.0,
        strip=20.0,
    )
    chart.add(
        Markup('<rect class="grows" x="{}" y="{}" width="{}" height="{}"/>').format(
            f"{chart.x(0.0):.1f}", f"{chart.top:.1f}", f"{chart.right - chart.x(0.0):.1f}",
            f"{chart.bottom - chart.top:.1f}",
        )
    )  # fmt: skip
    chart.text((chart.right - 4.0, chart.top + 14.0), "grows", "note end")
    for point in [] if passive is None else _points(passive):
        chart.add(_cross(chart.x(point[0]), chart.y(point[1])))
    single: list[Point] = []
    for _, places in branches:
        if len(places) > 1:
            chart.line(places, "locus", "", "")
        elif roots["kind"] != "designs":
            single += places
    for x, y in single:
        if x <= right:
            chart.add(
                Markup('<circle class="locus-dot" cx="{}" cy="{}" r="1.6"/>').format(
                    f"{chart.x(x):.1f}", f"{chart.y(y):.1f}"
                )
            )
    for first, places in branches:
        for number_there, (x, y) in enumerate(places):
            delay = delays[first + number_there]
            if delay in MARKED and x <= right:
                k = MARKED.index(delay)
                chart.mark(_SHAPES[k], (x, y), f"at{k}", "", "")
    _legend(chart, passive is not None)
    return chart.markup()


def locus_sentence(roots: dict[str, Any]) -> str:
    """Say in words what the locus shows."""
    steps = rightmost(roots)
    head = _KINDS[roots["kind"]]
    if not steps:
        return f"{head}: none this far right at any delay shown."
    grown = [step for step in steps if step.real >= 0.0]
    most = max(step.real for step in steps)
    far = f" Those beyond {_FARTHEST:g} 1/s are not drawn." if most > _FARTHEST else ""
    if not grown:
        return f"{head}: all are left of the axis at every delay shown, so that small motion dies."
    if len(grown) == len(steps):
        first = grown[0]
        return f"{head}: at every delay shown one grows, at 0 ms with {_motion(first)}.{far}"
    changes: list[str] = []
    for before, after in pairwise(steps):
        if (before.real < 0.0) != (after.real < 0.0):
            verb = "crosses to growth" if after.real >= 0.0 else "the last one is back"
            there = after if after.real >= 0.0 else before
            changes.append(
                f"{verb} between {1000 * before.delay:g} and {1000 * after.delay:g} ms "
                f"({number(there.hertz, 1)} Hz)"
            )
    start = f"one grows at 0 ms with {_motion(steps[0])}; " if steps[0].real >= 0.0 else ""
    subject = "" if changes[0].startswith("the last") else "one "
    return f"{head}: {start}{subject}{', '.join(changes)}.{far}"


def rightmost(roots: dict[str, Any]) -> list[Step]:
    """Return the rightmost root shown at every delay that has one."""
    found: dict[int, tuple[float, float]] = {}
    for branch in roots["branches"]:
        for k, (real, imaginary) in enumerate(branch["roots"], branch["first"]):
            if k not in found or real > found[k][0]:
                found[k] = (real, imaginary)
    delays = roots["delays_s"]
    return [Step(delays[k], real, y / (2.0 * np.pi)) for k, (real, y) in sorted(found.items())]


def _motion(step: Step) -> str:
    return f"{number(step.real)} 1/s at {number(step.hertz, 1)} Hz"


def _place(root: list[float]) -> Point:
    return root[0], root[1] / (2.0 * float(np.pi))


def _points(roots: dict[str, Any]) -> list[Point]:
    return [_place(root) for branch in roots["branches"] for root in branch["roots"]]


def _edge(right: float) -> float:
    """Return the right end of the axis [1/s]. What lies beyond is not drawn, and said."""
    return min(max(1.0, 1.15 * right), _FARTHEST)


def _cross(x: float, y: float) -> Markup:
    return Markup('<path class="was-root" d="M{} {}l7 7m0 -7l-7 7"/>').format(
        f"{x - 3.5:.1f}", f"{y - 3.5:.1f}"
    )


def _legend(chart: Chart, passive: bool) -> None:
    """Write what the marks mean over the axes."""
    x = chart.left + 6.0
    for k, delay in enumerate(MARKED):
        chart.add(mark(_SHAPES[k], "", (x, 12.0), f"at{k}", ""))
        chart.text((x + 9.0, 16.5), f"{1000 * delay:g} ms", "note")
        x += 62.0 if delay == 0.0 else 74.0
    if passive:
        chart.add(_cross(x, 12.0))
        chart.text((x + 9.0, 16.5), "passive", "note")
