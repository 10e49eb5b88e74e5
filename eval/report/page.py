"""The page's text: what the templates show, from the records."""

import base64
import hashlib
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from eval import benchmark_motion, benchmark_roots
from eval.packages import PASSIVE
from eval.report.cards import cards_of
from eval.report.charts import pareto_chart, profile_chart, ride_chart
from eval.report.motion import Answer, passive_signals, scale_of
from eval.report.reproduce import cell_command, sessions_of, suite_argument, suite_lines
from eval.report.svg import MARKS, mark, visible
from eval.report.tables import delays_table, indices_table, leaderboard, speed_table
from eval.report.view import MOST_COLOURS, BoardView, Entrant, views_of
from eval.report.words import (
    condition_words,
    critical_words,
    layout_words,
    number,
    shown_words,
    spread,
)
from eval.scoring.baseline import LEAST_GAIN
from eval.scoring.board import Board
from eval.scoring.board_text import warnings_of
from eval.scoring.statistics import RESAMPLING
from eval.store.reader import Reader
from eval.store.schema import RECORDS_FILE

_TEMPLATES = Path(__file__).parents[1] / "templates"


def page_of(reader: Reader, boards: Sequence[Board]) -> str:
    """Return the page; see `eval.report.write_report`."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        finalize=_finished,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["breakable"] = _breakable
    return environment.get_template("report.html.j2").render(_content(reader, boards))


def _finished(value: object) -> object:
    return visible(value) if isinstance(value, str) and not isinstance(value, Markup) else value


def _breakable(name: str) -> Markup:
    """Let a long name go on in the next line where one of its parts ends."""
    return Markup("<wbr>").join(re.split(r"(?<=[:,._/=])", visible(name)))


def _content(reader: Reader, boards: Sequence[Board]) -> dict[str, Any]:
    rows = list(reader.rows())
    views = views_of(boards, rows)
    hashes = {row["spec"]: row["sha256"] for row in reader.controllers()}
    motion: dict[str, dict[str, Answer]] = {}
    for row in reader.motion():
        motion.setdefault(row["layout"], {})[row["controller"]] = row["answer"]
    sessions = sessions_of(reader)
    suite, salted = suite_argument(reader), bool(reader.settings.salt_commitment)
    script = (_TEMPLATES / "report.js").read_text(encoding="utf-8")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    everyone = {e.place: e.name for view in views for e in view.entrants}

    def cell(entrant: Entrant, key: str) -> str:
        return cell_command(suite, entrant.name, key, salted=salted)

    return {
        "settings": reader.settings,
        "created": reader.created,
        "records_file": RECORDS_FILE,
        "sessions": sessions,
        "unfinished": not sessions or sessions[-1]["ended"] is None,
        "runs": len(rows),
        "suite_lines": suite_lines(reader),
        "suite": suite,
        "boards": [_board(view, hashes, motion.get(view.board.layout, {})) for view in views],
        "everyone": sorted(everyone.items(), key=lambda entry: entry[1].lower()),
        "cell_command": cell,
        "legend_mark": _legend_mark,
        "hollow": mark("^", "", (0.0, 0.0), "mark hollow other", ""),
        "colours": [f"k{k}" for k in range(MOST_COLOURS)],
        "shown": shown_words(),
        "coverage": f"{100 * RESAMPLING.coverage:g} %",
        "draws": f"{RESAMPLING.draws:,}",
        "number": number,
        "motion": benchmark_motion,
        "roots": benchmark_roots,
        "motion_place": f"{benchmark_motion.VEHICLE} vehicle, {benchmark_motion.SPEED_KMH:g} km/h",
        "script": Markup(script),  # noqa: S704 (a file of this package)
        "script_hash": digest,
        "style": Markup((_TEMPLATES / "report.css").read_text(encoding="utf-8")),  # noqa: S704
    }


def _board(
    view: BoardView, hashes: dict[str, str | None], motion: dict[str, Answer]
) -> dict[str, Any]:
    board = view.board
    passive = motion.get(PASSIVE)
    scale = scale_of(board.layout, passive, list(motion.values()))
    cards = cards_of(view, hashes, motion, scale)
    pareto, missing = pareto_chart(view)
    force = board.reference_force
    unscored = {place: each for place, each in board.baselines.items() if not each.scored}
    return {
        "view": view,
        "layout": board.layout,
        "words": layout_words(board.layout),
        "warnings": warnings_of(board),
        "force": None if force is None else f"{number(force / 1000.0)} kN",
        "heads": _heads(view),
        "columns": leaderboard(view),
        "ride": ride_chart(view),
        "indices": indices_table(view),
        "pareto": pareto,
        "pareto_missing": missing,
        "profile": profile_chart(view),
        "by_delay": delays_table(view),
        "by_speed": [
            (e, table) for e in view.coloured if (table := speed_table(e, f"{e.rank}. {e.name}"))
        ],
        "cards": cards,
        "passive_signals": passive_signals(scale, passive),
        "without_motion": sum(e.name not in motion for e in view.entrants),
        "has_motion": any(card.pictures.histories for card in cards),
        "passive_locus": passive is not None and "roots" in passive,
        "unscored": _unscored(unscored),
    }


def _heads(view: BoardView) -> list[dict[str, Any]]:
    """Return who stands at the head of the page: the leader, the best untold, the best sky-hook."""
    scored = [e for e in view.entrants if e.standing.score is not None]
    chosen: list[tuple[str, Entrant | None]] = [
        ("Best", scored[0] if scored else None),
        ("Best that is told the delay", _first(scored, "told")),
        ("Best that is not told it", _first(scored, "untold")),
        ("Best sky-hook", view.best_skyhook),
    ]
    heads: dict[str, dict[str, Any]] = {}
    for words, entrant in chosen:
        if entrant is None or entrant.standing.score is None:
            continue
        if entrant.name in heads:
            heads[entrant.name]["words"] += f"; {words[0].lower()}{words[1:]}"
            continue
        score = entrant.standing.score.score
        heads[entrant.name] = {
            "words": words,
            "entrant": entrant,
            "score": number(score.estimate),
            "ends": spread(score),
            "critical": ", ".join(critical_words(entrant.standing.stability)),
        }
    return list(heads.values())


def _first(entrants: Sequence[Entrant], division: str) -> Entrant | None:
    return next((e for e in entrants if e.standing.division == division), None)


def _legend_mark(entrant: Entrant) -> Markup:
    shape = MARKS[0] if entrant.colour is None else entrant.shape
    return mark(shape, entrant.place, (20.0, 7.0), f"mark {entrant.classes}", "")


def _unscored(baselines: dict[tuple[str, ...], Any]) -> list[tuple[str, str]]:
    """Return where nothing is scored, and why, each place once."""
    found: dict[str, str] = {}
    for place, baseline in baselines.items():
        model, vehicle, layout, speed, track, _ = place
        words = condition_words((model, vehicle, layout, speed, track, ""))
        if baseline.lost:
            reason = f"nothing is known, since a run was lost ({baseline.lost})"
        elif baseline.passive is None:
            reason = "the passive vehicle diverges"
        elif baseline.reference is None:
            reason = "the reference diverged or has no run"
        else:
            reason = f"the reference is less than {LEAST_GAIN:g} better than passive"
        found[words.rstrip(", ")] = reason
    return sorted(found.items())
