"""The tables of the page as plain cells: text, value to sort by, and colour."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from eval.report.charts import score_bar
from eval.report.view import BoardView, Entrant
from eval.report.words import (
    NONE,
    critical_ms,
    critical_words,
    lost_words,
    number,
    scenario_words,
    spread,
)
from eval.scoring.board import SHOWN, Standing
from eval.scoring.gain import Condition, ControllerScore, Gain, score_matrix
from eval.scoring.statistics import Interval

_GOOD, _BAD = (0, 90, 150), (200, 80, 0)
"""Blue and vermillion, which every reader tells apart, at gains of 1 and -1."""


@dataclass(frozen=True)
class Cell:
    """A cell of a table.

    Attributes:
        text: What it says.
        order: What its column is sorted by; a text or a number.
        small: A second, smaller line.
        style: Colours; "" for the page's.
        drawing: Stands between the two lines; "" for none.
    """

    text: str
    order: str = ""
    small: str = ""
    style: str = ""
    drawing: str = ""


@dataclass(frozen=True)
class Table:
    """A table.

    Attributes:
        title: What it shows.
        heads: Of its columns; the first one names the rows.
        rows: Cells of each row but the first.
        names: First cell of each row.
    """

    title: str
    heads: tuple[str, ...]
    names: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]


@dataclass(frozen=True)
class Column:
    """A column of the leaderboard: its head, what it means, and its cells."""

    head: str
    meaning: str
    cells: tuple[Cell, ...]


def plain_cell(value: float | None, digits: int = 2, small: str = "") -> Cell:
    """Return a cell with a number."""
    order = "" if value is None or math.isnan(value) else repr(float(value))
    return Cell(number(value, digits), order, small)


def gain_cell(gain: float | None) -> Cell:
    """Return a cell whose colour says the gain: blue is good, vermillion bad."""
    if gain is None:
        return Cell(NONE)
    return Cell(number(gain), repr(gain), style=gain_style(gain))


def gain_style(gain: float) -> str:
    """Return background and ink of a gain in [-1, 1]."""
    full = _GOOD if gain >= 0.0 else _BAD
    share = min(1.0, abs(gain))
    red, green, blue = (round(255 + share * (end - 255)) for end in full)
    # Relative luminance of WCAG 2, to choose the ink of the larger contrast.
    light = [
        c / 3294.6 if c <= 10 else ((c / 255 + 0.055) / 1.055) ** 2.4 for c in (red, green, blue)
    ]
    luminance = 0.2126 * light[0] + 0.7152 * light[1] + 0.0722 * light[2]
    ink = "#000" if (luminance + 0.05) ** 2 > 0.05 * 1.05 else "#fff"
    return f"background:#{red:02x}{green:02x}{blue:02x};color:{ink}"


def leaderboard(view: BoardView) -> list[Column]:
    """Return the columns of the leaderboard, a cell per entrant and one for passive at the end."""
    standings = [*(e.standing for e in view.entrants), view.board.passive]
    scores = [s.score for s in standings]

    columns = [
        Column(
            "score",
            "delay-robust score, with the 95 % interval of the mean over the tracks",
            tuple(_score_cell(s) for s in scores),
        ),
        Column(
            "middle half",
            "interquartile mean of the runs",
            tuple(_interval_cell(s and s.aggregates.interquartile_mean) for s in scores),
        ),
        Column(
            "beats sky-hook",
            "probability that a run is better than one of the best sky-hook",
            tuple(_interval_cell(s.improvement) for s in standings),
        ),
        Column(
            "critical delay",
            "shortest delay at which the loop grows (nominal vehicle, 300 km/h), how it is known",
            tuple(_critical_cell(s) for s in standings),
        ),
        Column(
            "worst cell",
            "smallest gain of a run",
            tuple(
                Cell(NONE)
                if s is None
                else plain_cell(s.worst.gain, 2, scenario_words(s.worst.key))
                for s in scores
            ),
        ),
        Column(
            "diverged, lost",
            "runs that diverged, and runs whose controller failed, hung, crashed or took too much "
            "memory, of all runs",
            tuple(_lost_cell(s) for s in standings),
        ),
        Column(
            "force [kN]",
            "root mean square over all runs that came to an end",
            tuple(plain_cell(_scaled(s.force_rms, 1e-3)) for s in standings),
        ),
        Column(
            "stroke [mm]",
            "largest deflection of the secondary suspension",
            tuple(plain_cell(_scaled(s.stroke_peak, 1e3), 1) for s in standings),
        ),
    ]
    safety = (
        ("Y/Q [1]", "derailment quotient, largest, nonlinear vehicle", "derailment_quotient"),
        ("unloading [1]", "largest share of a wheel's load that was gone", "wheel_unloading"),
    )
    for head, meaning, name in safety:
        values: list[float | None] = [getattr(s, name) for s in standings]
        if any(value is not None for value in values):
            columns.append(Column(head, meaning, tuple(plain_cell(value) for value in values)))
    return columns


def indices_table(view: BoardView) -> Table | None:
    """Return the ride indices by delay; None without any."""
    standings = [*(e.standing for e in view.entrants), view.board.passive]
    delays = sorted({delay for s in standings for delay in s.ride_index})
    if not delays:
        return None
    return Table(
        "Ride index of the worse floor end",
        ("controller", *(f"{1000 * delay:g} ms" for delay in delays)),
        tuple(s.controller for s in standings),
        tuple(
            tuple(
                Cell("div.", "99") if d in s.ride_index and s.ride_index[d] is None
                else plain_cell(s.ride_index.get(d))
                for d in delays
            )
            for s in standings
        ),
    )  # fmt: skip


def delays_table(view: BoardView) -> Table | None:
    """Return the mean gain of every controller by delay; None if nobody is scored."""
    scored = [e for e in view.entrants if e.standing.score is not None]
    by_delay = [e.standing.score.by_delay for e in scored if e.standing.score is not None]
    delays = sorted({delay for gains in by_delay for delay in gains})
    if not delays:
        return None
    return Table(
        "Comfort gain by delay, mean over all conditions that have it",
        ("controller", *(f"{1000 * delay:g} ms" for delay in delays)),
        tuple(e.name for e in scored),
        tuple(tuple(gain_cell(gains.get(delay)) for delay in delays) for gains in by_delay),
    )


def speed_table(entrant: Entrant, title: str) -> Table | None:
    """Return the mean gain by speed and delay, all else as drawn; None if nothing is scored."""
    score = entrant.standing.score
    found: dict[str, dict[float, list[float]]] = {}
    for gain in () if score is None else score.gains:
        if _only_speed_differs(gain.condition):
            found.setdefault(gain.condition[3], {}).setdefault(gain.delay, []).append(gain.gain)
    delays = sorted({delay for gains in found.values() for delay in gains})
    if not delays:
        return None
    speeds = sorted(found, key=float)
    return Table(
        title,
        ("delay [ms]", *(f"{1000 * delay:g}" for delay in delays)),
        tuple(f"{speed} km/h" for speed in speeds),
        tuple(tuple(gain_cell(_mean(found[s].get(delay))) for delay in delays) for s in speeds),
    )


def condition_gains(gains: Sequence[Gain]) -> list[tuple[Condition, float, float, int]]:
    """Return mean, smallest gain and number of runs of every condition, the lowest mean first.

    The mean of a condition is over its tracks and delays, as in the score.
    """
    found: dict[Condition, list[float]] = {}
    for gain in gains:
        found.setdefault(gain.condition, []).append(gain.gain)
    means = {condition: float(runs.mean()) for condition, runs in score_matrix(gains).items()}
    return sorted(
        ((c, means[c], min(runs), len(runs)) for c, runs in found.items()),
        key=lambda entry: (entry[1], entry[0]),
    )


def _only_speed_differs(condition: Condition) -> bool:
    model, vehicle, _, _, track, channel = condition
    names = ("model", "vehicle", "track", "channel")
    return (model, vehicle, track, channel) == tuple(SHOWN[name] for name in names)


def _mean(values: Iterable[float] | None) -> float | None:
    return None if values is None else float(np.mean(list(values)))


def _scaled(value: float | None, factor: float) -> float | None:
    return None if value is None else factor * value


def _interval_cell(interval: Interval | None) -> Cell:
    if interval is None:
        return Cell(NONE)
    return plain_cell(interval.estimate, 2, spread(interval))


def _score_cell(score: ControllerScore | None) -> Cell:
    if score is None:
        return Cell(NONE)
    return replace(_interval_cell(score.score), drawing=score_bar(score.score))


def _critical_cell(standing: Standing) -> Cell:
    text, known = critical_words(standing.stability)
    delay = critical_ms(standing.stability)
    order = "" if delay is None else "1e9" if math.isinf(delay) else repr(delay)
    return Cell(text, order, known[:80])


def _lost_cell(standing: Standing) -> Cell:
    lost = sum(standing.lost.values())
    text = f"{standing.diverged}, {lost}" if standing.diverged or lost else "0"
    small = f"of {standing.runs}" if not lost else f"{lost_words(standing)} of {standing.runs}"
    return Cell(text, str(standing.diverged + lost), small)
