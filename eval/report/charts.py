"""The charts of a leaderboard: ride index by delay, comfort over critical delay, profiles."""

import math
from collections.abc import Iterable, Sequence

import numpy as np
from markupsafe import Markup

from eval.report.svg import HEIGHT, Chart, Point, ticks
from eval.report.view import BoardView, Entrant, shown_rows
from eval.report.words import critical_ms, critical_words, layout_words, number, shown_words
from eval.scoring.baseline import Row, worse_end
from eval.scoring.gain import track_scores
from eval.scoring.statistics import Interval, Resampling, performance_profile

_ROW = 9.0
"""Distance between rows of triangles over the axes [px]."""

_ROOM_ABOVE = 1.3
"""Upper end of the axis of ride indices, in ride indices of the passive vehicle [1]."""

_THRESHOLDS = np.linspace(-1.0, 1.0, 81)
_PROFILE_DRAWS = 1000

_LONGEST = 1000.0
"""Critical delays beyond stand with those that were not found [ms]."""

_AROUND = (
    (8.0, 4.0), (-8.0, 4.0), (0.0, -8.0), (0.0, 16.0), (8.0, -6.0), (-8.0, -6.0),
    (8.0, 14.0), (-8.0, 14.0), (16.0, -12.0), (-16.0, -12.0), (16.0, 20.0), (-16.0, 20.0),
)  # fmt: skip
"""Where a rank may stand beside its mark [px], the best place first."""


def indices_by_delay(rows: Iterable[Row]) -> dict[float, list[float | None]]:
    """Return by delay [s] the ride indices of the worse end on the condition that is drawn.

    One per track; None where the run diverged or came to no end.
    """
    found: dict[float, list[float | None]] = {}
    for row in shown_rows(rows):
        found.setdefault(row["delay_s"], []).append(worse_end(row))
    return dict(sorted(found.items()))


def ride_chart(view: BoardView) -> Markup | None:
    """Draw the ride index of the worse end against delay; None without such runs.

    Lines are means over the tracks, broken where a run diverged; bands reach from the smallest to
    the largest track. Delays with diverged runs are triangles over the axes.
    """
    series = {e: indices_by_delay(e.rows) for e in view.entrants}
    delays = sorted({1000.0 * d for found in series.values() for d in found})
    lines = {e: _means(series[e]) for e in view.entrants}
    base = {
        "passive": _means(indices_by_delay(view.passive)),
        "reference": _means(indices_by_delay(view.reference)),
    }
    known = [y for line in (*base.values(), *lines.values()) for _, y in line]
    if not delays or not known:
        return None
    roof = max((y for _, y in base["passive"]), default=max(known)) * _ROOM_ABOVE
    low = math.floor(min(known) * 2.0) / 2.0
    top = ticks(low, max(roof, low + 0.5), 6)[-1]
    above = {e: _above(series[e], top) for e in view.coloured}
    rows = [e for e in view.coloured if above[e]]
    chart = Chart(
        f"wz-{view.board.layout}",
        f"Ride index of the worse floor end against delay, {layout_words(view.board.layout)}, "
        f"{shown_words()}. The numbers are in the table of ride indices.",
        "delay [ms]",
        "ride index Wz [1]",
        _room(delays),
        (low, top),
        strip=_ROW * len(rows) + (14.0 if rows else 0.0),
    )
    ends = (min(delays), max(delays))
    for name, line in base.items():
        if line:
            level = line[0][1]
            chart.line(
                [(d, level) for d in _room(delays)], f"base {name}", "", f"{name}, without delay"
            )
            chart.text((chart.right, chart.y(level) - 4), name, "note end")
    for entrant in sorted(view.entrants, key=lambda e: (e.colour is not None, -e.rank)):
        title = f"{entrant.rank}. {entrant.name}"
        if entrant.colour is not None:
            for low_ends, high_ends in _bands(series[entrant]):
                chart.area(low_ends, high_ends, f"band {entrant.classes}", entrant.place)
        for piece in _pieces(series[entrant]):
            means = [(delay, float(np.mean(known))) for delay, known in piece]
            chart.line(means, f"line {entrant.classes}", entrant.place, title)
    for entrant in view.coloured:
        for delay, index in lines[entrant]:
            if index <= top:
                title = f"{entrant.rank}. {entrant.name}: {number(index)} at {delay:g} ms"
                chart.mark(
                    entrant.shape, (delay, index), f"mark {entrant.classes}", entrant.place, title
                )
    for k, entrant in enumerate(rows):
        height = chart.top - 8.0 - _ROW * k
        for delay, words in above[entrant]:
            at = (delay, chart.y_range[0] + (chart.bottom - height) / (chart.bottom - chart.top)
                  * (chart.y_range[1] - chart.y_range[0]))  # fmt: skip
            title = f"{entrant.rank}. {entrant.name}: {words} at {delay:g} ms"
            chart.mark("^", at, f"mark hollow {entrant.classes}", entrant.place, title)
    if rows:
        chart.text((chart.left, 12.0), "diverged, or above the range:", "note")
    return chart.markup(delays if len(delays) <= 8 else ticks(*ends))


def pareto_chart(view: BoardView) -> tuple[Markup | None, list[str]]:
    """Draw the comfort gain without delay against the critical delay.

    Returns:
        The chart, None if nothing can be drawn; and who is missing, with the reason.
    """
    points: dict[Entrant, Point] = {}
    missing: list[str] = []
    for entrant in view.entrants:
        score, delay = entrant.standing.score, critical_ms(entrant.standing.stability)
        gain = None if score is None else score.by_delay.get(0.0)
        if gain is None or delay is None:
            what = "run without delay is scored" if gain is None else "critical delay is known"
            missing.append(f"{entrant.rank}. {entrant.name} (no {what})")
        else:
            points[entrant] = (delay, gain)
    if not points:
        return None, missing
    far = max((d for d, _ in points.values() if d <= _LONGEST), default=0.0)
    edge = ticks(0.0, max(100.0, 1.05 * far))
    last = edge[-1] if edge[-1] >= far else edge[-1] + edge[1] - edge[0]
    beyond = any(d > last for d, _ in points.values())
    gains = [gain for _, gain in points.values()]
    low = math.floor(4.0 * min(*gains, 0.5)) / 4.0
    chart = Chart(
        f"pareto-{view.board.layout}",
        f"Comfort gain without delay against critical delay, {layout_words(view.board.layout)}; "
        "the numbers are in the leaderboard.",
        "critical delay [ms], nominal vehicle, 300 km/h",
        "comfort gain without delay [1]",
        (-0.03 * last, last * (1.18 if beyond else 1.04)),
        (low - 0.05, 1.08),
        height=1.2 * HEIGHT,
    )
    drawn = {e: (last * 1.1 if d > last else d, gain) for e, (d, gain) in points.items()}
    if beyond:
        at = chart.x(1.03 * last)
        chart.add(Markup('<path class="base" d="M{} {}V{}"/>').format(
            f"{at:.1f}", f"{chart.top:.1f}", f"{chart.bottom:.1f}"))  # fmt: skip
        chart.text((chart.x(1.1 * last), chart.bottom + 16), f"> {last:g}", "tick middle")
    chart.line(_front(list(drawn.values())), "front", "", "nobody is better in both")
    taken: list[Point] = [(chart.x(x), chart.y(y)) for x, y in drawn.values()]
    for entrant, point in drawn.items():
        delay, known = critical_words(entrant.standing.stability)
        title = (
            f"{entrant.rank}. {entrant.name}: gain {number(point[1])} without delay, critical "
            f"delay {delay} ({known})"
        )
        chart.mark(entrant.shape, point, f"mark {entrant.classes}", entrant.place, title)
        at = _free((chart.x(point[0]), chart.y(point[1])), taken)
        taken.append((at[0], at[1] - 4.0))
        chart.text(at, str(entrant.rank), "rank", entrant.place)
    marks = ticks(0.0, last)
    return chart.markup(marks[:-1] if beyond else marks), missing


def score_bar(interval: Interval) -> Markup:
    """Draw a score from -1 to 1 with its interval, for a row of a table."""
    low, middle, high = (
        round(60.0 + 56.0 * (interval.estimate if math.isnan(end) else end), 1)
        for end in (interval.low, interval.estimate, interval.high)
    )
    return Markup(
        '<svg class="bar" viewBox="0 0 120 10" width="120" height="10" aria-hidden="true">'
        '<path class="grid" d="M4 5H116"/><path class="axis" d="M60 0V10"/>'
        '<path class="reach" d="M{} 5H{}"/><circle cx="{}" cy="5" r="3.2"/></svg>'
    ).format(low, high, middle)


def profile_chart(view: BoardView) -> Markup | None:
    """Draw the share of runs above each comfort gain; None if nobody is scored."""
    chart = Chart(
        f"profile-{view.board.layout}",
        "Performance profiles: share of runs whose comfort gain, mean over the delays, is above a "
        f"threshold, {layout_words(view.board.layout)}.",
        "comfort gain, mean over delays [1]",
        "share of runs above it [1]",
        (-1.0, 1.0),
        (0.0, 1.02),
    )
    scored = False
    for entrant in sorted(view.entrants, key=lambda e: (e.colour is not None, -e.rank)):
        if entrant.standing.score is None:
            continue
        scored = True
        scores = track_scores(entrant.standing.score.gains).values()
        # A track is drawn in all its conditions at once, as in the score's interval.
        drawn = entrant.colour is not None and any(len(tracks) > 1 for tracks in scores)
        profile = performance_profile(
            [list(tracks.values()) for tracks in scores],
            _THRESHOLDS,
            Resampling(_PROFILE_DRAWS) if drawn else None,
            tracks=[list(tracks) for tracks in scores],
        )
        if drawn:
            chart.area(
                _pairs(profile.low), _pairs(profile.high), f"band {entrant.classes}", entrant.place
            )
        title = f"{entrant.rank}. {entrant.name}"
        chart.line(_pairs(profile.estimate), f"line {entrant.classes}", entrant.place, title)
    return chart.markup() if scored else None


def _pairs(shares: Iterable[float]) -> list[Point]:
    return [(float(x), float(y)) for x, y in zip(_THRESHOLDS, shares, strict=True)]


def _pieces(found: dict[float, list[float | None]]) -> list[list[tuple[float, list[float]]]]:
    """Return delays [ms] with their indices, in pieces without a run that has none."""
    pieces: list[list[tuple[float, list[float]]]] = [[]]
    for delay, values in found.items():
        known = [value for value in values if value is not None]
        if len(known) == len(values):
            pieces[-1].append((1000.0 * delay, known))
        elif pieces[-1]:
            pieces.append([])
    return [piece for piece in pieces if piece]


def _means(found: dict[float, list[float | None]]) -> list[Point]:
    """Return delay [ms] and mean index wherever all runs have one."""
    return [(delay, float(np.mean(known))) for piece in _pieces(found) for delay, known in piece]


def _bands(found: dict[float, list[float | None]]) -> list[tuple[list[Point], list[Point]]]:
    """Return smallest and largest track of each piece."""
    return [
        ([(d, min(known)) for d, known in piece], [(d, max(known)) for d, known in piece])
        for piece in _pieces(found)
    ]


def _above(found: dict[float, list[float | None]], top: float) -> list[tuple[float, str]]:
    """Return delays [ms] that the axis does not show, and why."""
    points: list[tuple[float, str]] = []
    for delay, values in found.items():
        known = [value for value in values if value is not None]
        if len(known) < len(values):
            words = f"{len(values) - len(known)} of {len(values)} runs diverged or were lost"
            points.append((1000.0 * delay, words))
        elif np.mean(known) > top:
            points.append((1000.0 * delay, f"{np.mean(known):.2f}"))
    return points


def _room(delays: Sequence[float]) -> tuple[float, float]:
    width = max(delays) - min(delays) or 100.0
    return min(delays) - 0.03 * width, max(delays) + 0.04 * width


def _front(points: Sequence[Point]) -> list[Point]:
    """Return the steps that no point is right of and above."""
    steps: list[Point] = []
    best = -math.inf
    for x, y in sorted(set(points), reverse=True):
        if y > best:
            if steps:
                steps.append((x, steps[-1][1]))
            steps.append((x, y))
            best = y
    return steps


def _free(at: Point, taken: Sequence[Point]) -> Point:
    """Return the place beside a mark that is farthest from what stands there, or free."""

    def room(step: Point) -> float:
        x, y = at[0] + step[0], at[1] + step[1] - 4.0
        return min((max(abs(x - u) / 12.0, abs(y - v) / 9.0) for u, v in taken), default=9.0)

    for step in _AROUND:
        if room(step) >= 0.99:
            return at[0] + step[0], at[1] + step[1]
    step = max(_AROUND, key=room)
    return at[0] + step[0], at[1] + step[1]
