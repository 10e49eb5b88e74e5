"""Leaderboards as plain text for a terminal."""

import math
import textwrap
import unicodedata
from typing import Any

from eval.scoring.board import Board, Standing
from eval.scoring.statistics import Interval

WIDTH = 120
_SHOWN_MS = (0.0, 100.0, 200.0, 300.0)
_REASONS, _NAMES = 3, 6
"""Reasons and names that are told before the rest is a number."""

_HEADS = ("controller", "division", "score", "interval", "better", "critical", "lost")


def boards_text(boards: list[Board]) -> str:
    """Return the leaderboards as lines of at most `WIDTH` columns."""
    lines: list[str] = []
    for board in boards:
        lines += _board_lines(board)
        lines.append("")
    lines += textwrap.wrap(
        "score: mean comfort gain over delay and conditions, 1 is the reference without delay, 0 "
        "the passive vehicle, -1 diverged; better: probability that a run is better than one of "
        "the best sky-hook; critical: critical delay [ms] of the nominal vehicle at 300 km/h (p "
        "proved, e by eigenvalues, s by simulation); lost: runs that diverged + came to no end; "
        "Wz: ride index of the worse floor end, nominal vehicle, 300 km/h, German low.",
        WIDTH,
    )
    return "\n".join(lines)


def _board_lines(board: Board) -> list[str]:
    delays = _delays(board)
    heads = [*_HEADS, *(f"Wz {1000 * delay:g}" for delay in delays), "force"]
    rows = [_row(s, delays) for s in (*board.standings, board.passive)]
    widths = [max(len(row[k]) for row in [heads, *rows]) for k in range(len(heads))]
    widths[0] = max(12, min(widths[0], WIDTH - sum(widths[1:]) - 2 * (len(widths) - 1)))
    force = "" if board.reference_force is None else f"{board.reference_force / 1e3:.2f} kN"
    title = f"{board.layout} actuators (reference: force {force} RMS)"
    lines = [title, ""]
    for words in warnings_of(board):
        lines += [*textwrap.wrap(f"WARNING: {words}", WIDTH), ""]
    for number, row in enumerate([heads, *rows]):
        row[0] = _shortened(row[0], widths[0])
        parts = [
            cell.ljust(width) if k < 2 else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append("  ".join(parts).rstrip()[:WIDTH])
        if number == 0:
            lines.append("-" * min(WIDTH, sum(widths) + 2 * (len(widths) - 1)))
    lines += textwrap.wrap(single_note(board), WIDTH)
    for standing in board.standings:
        for words in standing_notes(standing):
            text = f"{printable(standing.controller)}: {words}"
            lines += textwrap.wrap(text, WIDTH, subsequent_indent="  ")
    return lines


def _row(standing: Standing, delays: list[float]) -> list[str]:
    cells = standing_cells(standing)
    indices = [standing.ride_index.get(delay) for delay in delays]
    return [
        *(cells[name] for name in _HEADS),
        *(decimals(index) for index in indices),
        cells["force"],
    ]


def standing_cells(standing: Standing) -> dict[str, str]:
    """Return what tables show of a standing by name, "-" where there is no number.

    Forces are in kN, strokes in mm, critical delays in ms; `worst` is the gain of the worst cell.
    """
    score = standing.score
    whole = None if score is None else score.aggregates
    lost = sum(standing.lost.values())
    force, stroke = standing.force_rms, standing.stroke_peak
    return {
        "controller": printable(standing.controller),
        "division": standing.division,
        "score": decimals(whole and whole.mean.estimate, 3),
        "interval": interval_text(whole and whole.mean),
        "interquartile mean": decimals(whole and whole.interquartile_mean.estimate),
        "better": decimals(standing.improvement and standing.improvement.estimate),
        "critical": critical_text(standing.stability),
        "worst": decimals(score and score.worst.gain),
        "lost": f"{standing.diverged}+{lost}" if standing.diverged + lost else "0",
        "force": decimals(None if force is None else force / 1e3),
        "stroke": decimals(None if stroke is None else 1e3 * stroke, 1),
        "derailment quotient": decimals(standing.derailment_quotient),
        "unloading": decimals(standing.wheel_unloading),
    }


def interval_text(interval: Interval | None) -> str:
    """Return the ends of an interval; "-" where none was drawn."""
    if interval is None or math.isnan(interval.low):
        return "-"
    return f"{interval.low:.2f} to {interval.high:.2f}"


def decimals(value: float | None, digits: int = 2) -> str:
    """Return a number with some decimals; "-" where there is none."""
    return "-" if value is None else f"{value:.{digits}f}"


def standing_notes(standing: Standing) -> list[str]:
    """Return what is to be said of a standing below a table."""
    said = [standing.message] if standing.message else []
    if standing.missing:
        said.append(f"no result in {standing.missing} runs that others are scored by")
    return [printable(words) for words in said]


def warnings_of(board: Board) -> list[str]:
    """Return what makes a board's numbers not those of its suite, in sentences.

    Runs of passive or reference that were lost, by the first reasons, and runs that are missing.
    """
    said: list[str] = []
    lost = board.lost_baselines
    if lost:
        tracks = f"{lost.total()} of {len(board.baselines)} tracks"
        reasons = "; ".join(f"{number} {why}" for why, number in lost.most_common(_REASONS))
        said.append(
            f"runs of passive or the reference were lost on {tracks}, where nothing is scored now, "
            f"so all scores are of the other tracks ({reasons}); run again with --resume, which "
            "tries these again"
        )
    if board.unfinished:
        there, planned = (sum(numbers) for numbers in zip(*board.progress.values(), strict=True))
        names = [f"{spec} {a} of {b}" for spec, (a, b) in board.unfinished.items()]
        more = f", {len(names) - _NAMES} more" if len(names) > _NAMES else ""
        said.append(
            f"not finished, {there} of {planned} runs: {', '.join(names[:_NAMES])}{more}; go on "
            "with --resume"
        )
    return [printable(words) for words in said]


def single_note(board: Board) -> str:
    """Return how many conditions have one track alone, on which intervals say nothing; "" if none.

    That a track is not scored follows from passive and reference, so the number is the same for all
    that have the conditions.
    """
    number = max((len(s.score.single) for s in board.standings if s.score), default=0)
    if not number:
        return ""
    what = "a condition has" if number == 1 else f"{number} conditions have"
    return f"{what} one scored track, of which intervals hold nothing"


def critical_text(answer: dict[str, Any]) -> str:
    """Return a critical delay in ms with the kind of its evidence; "-" where none is known."""
    if "error" in answer or "method" not in answer:
        return "-"
    delay = answer.get("critical_delay_s")
    longest = answer.get("longest_s")
    if delay is None:
        return "none" if longest is None else f">{1000 * longest:.0f}"
    if answer.get("unstable_roots_without_delay"):
        return "0"
    sign = {"simulation": "s", "sampled": "e"}.get(answer["method"], "p")
    return f"{1000 * delay:.0f} {sign if sign != 'p' or answer.get('proved') else 'e'}"


def _delays(board: Board) -> list[float]:
    known = sorted({delay for s in board.standings for delay in s.ride_index})
    wanted = [delay for delay in known if round(1000 * delay, 3) in _SHOWN_MS]
    return wanted or known[:4]


def _shortened(text: str, width: int) -> str:
    if len(text) <= width:
        return text
    half = (width - 3) // 2
    return f"{text[:half]}...{text[len(text) - (width - 3 - half) :]}"


def printable(text: str) -> str:
    """Keep what a terminal shows in one column each; names must not send it control sequences."""
    return "".join(
        " " if c.isspace() else c if c.isprintable() and _is_one_column(c) else "?" for c in text
    )


def _is_one_column(character: str) -> bool:
    """Whether a character takes one column: not two, as in Chinese, nor none, as an accent."""
    if unicodedata.category(character) in ("Mn", "Me"):
        return False
    return unicodedata.east_asian_width(character) not in ("W", "F")
