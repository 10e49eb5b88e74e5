"""Leaderboards from records: one per layout, controllers ranked by their delay-robust score."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from eval.packages import PASSIVE, REFERENCE
from eval.scoring.baseline import Baseline, Condition, Row, baselines_of, lost_baselines, worse_end
from eval.scoring.finished import planned_rows, progress_of
from eval.scoring.gain import ControllerScore, delays_of, improvement, score_of
from eval.scoring.statistics import RESAMPLING, Interval, Resampling
from eval.store.reader import Reader
from eval.store.schema import LOST
from eval.told_designs import PLACE

SKYHOOK = "skyhook"
UNTOLD = "untold"

SHOWN: dict[str, Any] = {
    "model": "lateral17",
    "vehicle": "nominal",
    "speed_kmh": 300.0,
    "track": "german_low",
    "channel": "constant",
}
"""Where ride indices are shown by delay: the condition that all suites have with every delay."""


@dataclass(frozen=True, eq=False)
class Standing:
    """One controller on a leaderboard.

    Attributes:
        controller: SPEC.
        division: "told" or "untold".
        score: Its score; None if no run is scored.
        improvement: Probability that it is better than the best sky-hook of the board; None for
            that one itself and where there is none.
        stability: Answer on its critical delay; see `eval.benchmark_stability`.
        lost: Runs that came to no end, by status.
        diverged: Number of runs that diverged.
        runs: Number of runs.
        ride_index: Mean ride index of the worse end by delay [s], on `SHOWN`; None where a run
            diverged.
        force_rms: Root mean square force over all runs that came to an end [N].
        stroke_peak: Largest stroke [m].
        derailment_quotient: Largest Y/Q on the nonlinear vehicle; None without it [1].
        wheel_unloading: Largest share of a wheel's load that was gone [1].
        message: Why runs were lost, the first reason.
        missing: Number of scored runs that others on the board have and this one has not: it does
            not act on that vehicle, or the benchmark is not finished. Its score is then of fewer
            conditions than theirs, and it stands below them.
    """

    controller: str
    division: str
    score: ControllerScore | None
    improvement: Interval | None
    stability: dict[str, Any]
    lost: dict[str, int]
    diverged: int
    runs: int
    ride_index: dict[float, float | None]
    force_rms: float | None
    stroke_peak: float | None
    derailment_quotient: float | None
    wheel_unloading: float | None
    message: str
    missing: int = 0


@dataclass(frozen=True, eq=False)
class Board:
    """The leaderboard of one layout.

    Attributes:
        layout: "2" or "4".
        standings: The best first, then those that lack runs, then those without a score.
        passive: Row of the passive vehicle, likewise.
        baselines: Passive and reference by vehicle, track and seed.
        reference_force: Root mean square force of the reference [N].
        progress: Runs that are there and runs that there are to be, by controller, passive and
            reference too; empty where the records do not say.
    """

    layout: str
    standings: tuple[Standing, ...]
    passive: Standing
    baselines: dict[Condition, Baseline]
    reference_force: float | None
    progress: dict[str, tuple[int, int]] = field(default_factory=dict)

    @property
    def unfinished(self) -> dict[str, tuple[int, int]]:
        """Controllers that lack runs: those that are there, and those that there are to be."""
        return {spec: runs for spec, runs in self.progress.items() if runs[0] < runs[1]}

    @property
    def lost_baselines(self) -> Counter[str]:
        """Why runs of passive or reference were lost: nothing is scored there."""
        return lost_baselines(self.baselines)


def boards_of(reader: Reader, resampling: Resampling | None = RESAMPLING) -> list[Board]:
    """Return the leaderboards of a benchmark's records.

    Args:
        reader: The records.
        resampling: Of the intervals; None for none.

    Raises:
        InputFileError: They hold what no score can be made from.
    """
    reader.check_shown()
    rows = list(reader.rows())
    progress = progress_of(reader, rows)
    layouts = sorted({str(row["layout"]) for row in rows} | progress.keys(), reverse=True)
    return [
        replace(_board(reader, rows, layout, resampling), progress=progress.get(layout, {}))
        for layout in layouts
    ]


def plain_board(board: Board) -> dict[str, Any]:
    """Return a board's numbers for JSON, without the single runs."""
    return {
        "layout": board.layout,
        "reference_force_rms": board.reference_force,
        "runs": sum(there for there, _ in board.progress.values()),
        "planned_runs": sum(planned for _, planned in board.progress.values()),
        "unfinished": {
            spec: {"runs": there, "planned_runs": planned}
            for spec, (there, planned) in board.unfinished.items()
        },
        "lost_baselines": dict(board.lost_baselines),
        "standings": [_plain(standing) for standing in (*board.standings, board.passive)],
    }


def _plain(standing: Standing) -> dict[str, Any]:
    score = standing.score
    answer: dict[str, Any] = {
        name: getattr(standing, name)
        for name in (
            "controller",
            "division",
            "stability",
            "lost",
            "diverged",
            "runs",
            "force_rms",
            "stroke_peak",
            "derailment_quotient",
            "wheel_unloading",
            "message",
            "missing",
        )
    }
    answer["ride_index"] = {f"{d:g}": index for d, index in standing.ride_index.items()}
    answer["improvement"] = _interval(standing.improvement)
    answer["score"] = None
    if score is not None:
        whole = score.aggregates
        answer["score"] = _interval(whole.mean)
        answer["interquartile_mean"] = _interval(whole.interquartile_mean)
        answer["worst"] = {"key": score.worst.key, "gain": score.worst.gain}
        answer["gain_by_delay"] = {f"{delay:g}": gain for delay, gain in score.by_delay.items()}
        answer["unscored"] = len(score.unscored)
        answer["partial"] = len(score.partial)
        answer["single_track_conditions"] = len(score.single)
    return answer


def _interval(interval: Interval | None) -> dict[str, float | None] | None:
    if interval is None:
        return None
    ends = (interval.low, interval.high)
    low, high = (None if np.isnan(end) else end for end in ends)
    return {"estimate": interval.estimate, "low": low, "high": high}


def _board(
    reader: Reader, rows: Sequence[Row], layout: str, resampling: Resampling | None
) -> Board:
    here: dict[str, list[Row]] = {}
    for row in rows:
        if row["layout"] == layout:
            here.setdefault(str(row["controller"]), []).append(row)
    references = here.get(REFERENCE, [])
    baselines = baselines_of(here.get(PASSIVE, []), references)
    answers = {
        row["controller"]: row["answer"] for row in reader.stability() if row["layout"] == layout
    }
    divisions = {row["spec"]: row["division"] for row in reader.controllers()}
    running = {spec: own for spec, own in here.items() if spec not in (PASSIVE, REFERENCE)}
    delays = delays_of([*(row for own in running.values() for row in own), *planned_rows(reader)])
    scores = {spec: score_of(own, baselines, resampling, delays) for spec, own in running.items()}
    best = _best_skyhook(scores)
    rival = scores.get(best) if best is not None else None
    everywhere = {
        key
        for score in scores.values()
        if score
        for key in (*(each.key for each in score.gains), *score.partial)
    }
    made: dict[str, Standing] = {}
    for spec in (*here, *({PASSIVE} - {*here})):
        score, better = scores.get(spec), None
        if score is not None and rival is not None and spec != best:
            better = improvement(score, rival, resampling)
        own = here.get(spec, [])
        standing = _standing(
            spec, divisions.get(spec, UNTOLD), own, score, better, answers.get(spec, {})
        )
        if spec in running:
            missing = everywhere - {str(row["key"]) for row in own}
            standing = replace(standing, missing=len(missing))
        made[spec] = standing
    ranked = sorted(scores, key=lambda spec: (made[spec].missing > 0, _rank(scores[spec]), spec))
    force = made[REFERENCE].force_rms if REFERENCE in made else None
    return Board(layout, tuple(made[spec] for spec in ranked), made[PASSIVE], baselines, force)


def _rank(score: ControllerScore | None) -> float:
    return np.inf if score is None else -score.score.estimate


def _best_skyhook(scores: dict[str, ControllerScore | None]) -> str | None:
    """Return the sky-hook of a constant gain with the best score."""
    known = [
        (score.score.estimate, spec)
        for spec, score in scores.items()
        if score is not None and is_skyhook(spec)
    ]
    return max(known)[1] if known else None


def is_skyhook(spec: str) -> bool:
    """Whether a SPEC is a sky-hook of a constant gain."""
    return spec.partition(":")[0] == SKYHOOK and PLACE not in spec


def _standing(
    spec: str,
    division: str,
    rows: Sequence[Row],
    score: ControllerScore | None,
    better: Interval | None,
    stability: dict[str, Any],
) -> Standing:
    lost = {status: sum(row["status"] == status for row in rows) for status in LOST}
    ended = [row for row in rows if row["status"] == "ok"]
    reasons = [str(row["message"]) for row in rows if row["message"]]
    return Standing(
        controller=spec,
        division=division,
        score=score,
        improvement=better,
        stability=stability,
        lost={status: number for status, number in lost.items() if number},
        diverged=sum(row["status"] == "diverged" for row in rows),
        runs=len(rows),
        ride_index=_ride_index(rows),
        force_rms=_root_mean_square([row["force_rms"] for row in ended]),
        stroke_peak=_largest([row["stroke_peak"] for row in ended]),
        derailment_quotient=_largest([row["derailment_quotient"] for row in ended]),
        wheel_unloading=_largest([row["wheel_unloading"] for row in ended]),
        message=reasons[0] if reasons else "",
    )


def _ride_index(rows: Sequence[Row]) -> dict[float, float | None]:
    """Return the mean ride index by delay on `SHOWN`."""
    found: dict[float, list[float | None]] = {}
    for row in rows:
        if all(row[name] == value for name, value in SHOWN.items()):
            found.setdefault(float(row["delay_s"]), []).append(worse_end(row))
    means: dict[float, float | None] = {}
    for delay, values in sorted(found.items()):
        known = [value for value in values if value is not None]
        means[delay] = float(np.mean(known)) if len(known) == len(values) else None
    return means


def _root_mean_square(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.sqrt(np.mean(np.square(known)))) if known else None


def _largest(values: Sequence[float | None]) -> float | None:
    return max((value for value in values if value is not None), default=None)
