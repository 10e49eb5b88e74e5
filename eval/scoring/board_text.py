"""Leaderboards as plain text for a terminal."""

import textwrap
import unicodedata
from typing import Any

from eval.scoring.board import Board, Standing

WIDTH = 120
_SHOWN_MS = (0.0, 100.0, 200.0, 300.0)
_HEADS = ("controller", "division", "score", "interval", "better", "critical", "lost")


def boards_text(boards: list[Board]) -> str:
    """Return the leaderboards as lines of at most `WIDTH` columns."""
    lines: list[str] = []
    for board in boards:
        lines += _board_lines(board)
        lines.append("")
    lines += textwrap.wrap(
        "score: mean comfort gain over delays and conditions, 1 is the reference without delay, 0 "
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
    for number, row in enumerate([heads, *rows]):
        row[0] = _shortened(row[0], widths[0])
        parts = [
            cell.ljust(width) if k < 2 else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append("  ".join(parts).rstrip()[:WIDTH])
        if number == 0:
            lines.append("-" * min(WIDTH, sum(widths) + 2 * (len(widths) - 1)))
    for standing in board.standings:
        said = [standing.message] if standing.message else []
        if standing.missing:
            said.append(f"no result in {standing.missing} runs that others are scored by")
        for words in said:
            text = printable(f"{standing.controller}: {words}")
            lines += textwrap.wrap(text, WIDTH, subsequent_indent="  ")
    return lines


def _row(standing: Standing, delays: list[float]) -> list[str]:
    score, better = standing.score, standing.improvement
    interval = "-"
    if score is not None and score.score.low == score.score.low:  # not NaN
        interval = f"{score.score.low:.2f} to {score.score.high:.2f}"
    lost = sum(standing.lost.values())
    indices = [standing.ride_index.get(delay) for delay in delays]
    return [
        printable(standing.controller),
        standing.division,
        "-" if score is None else f"{score.score.estimate:.3f}",
        interval,
        "-" if better is None else f"{better.estimate:.2f}",
        critical_text(standing.stability),
        f"{standing.diverged}+{lost}" if standing.diverged + lost else "0",
        *("-" if index is None else f"{index:.2f}" for index in indices),
        "-" if standing.force_rms is None else f"{standing.force_rms / 1e3:.2f}",
    ]


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
