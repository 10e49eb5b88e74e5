"""One card per controller: its gains by delay, speed and condition, and what went wrong."""

from collections import Counter
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from eval.packages import PASSIVE
from eval.report.locus import locus_chart, locus_sentence
from eval.report.motion import Answer, Scale, history_chart
from eval.report.tables import Table, condition_gains, gain_cell, speed_table
from eval.report.view import BoardView, Entrant
from eval.report.words import condition_words, critical_words, number, spread
from eval.scoring.gain import Condition, Row
from eval.store.schema import LOST

_MOST_CONDITIONS = 24
_MOST_REASONS = 6


@dataclass(frozen=True)
class Failure:
    """Runs that failed for one reason.

    Attributes:
        status: "failed", "timeout", "memory" or "crashed".
        message: The reason.
        count: Number of runs.
        key: One of them.
    """

    status: str
    message: str
    count: int
    key: str


@dataclass(frozen=True, eq=False)
class Card:
    """What a card shows.

    Attributes:
        entrant: The controller.
        name: Unique in the page.
        facts: Names and words.
        by_delay: Gain by delay; None if no run is scored.
        by_speed: Gain by speed and delay; None without such runs.
        conditions: Mean gain and smallest gain of every condition, the lowest first.
        left_out: Number of conditions that are not shown.
        diverged: Number of diverged runs by delay, in words; "" for none.
        failures: Reasons, the commonest first.
        other_failures: Number of reasons that are not shown.
        worst: Key of the worst cell, or of a failed one; "" if there is neither.
        pictures: Time histories and root locus, and why one is missing.
    """

    entrant: Entrant
    name: str
    facts: tuple[tuple[str, str], ...]
    by_delay: Table | None
    by_speed: Table | None
    conditions: Table | None
    left_out: int
    diverged: str
    failures: tuple[Failure, ...]
    other_failures: int
    worst: str
    pictures: "Pictures"


@dataclass(frozen=True, eq=False)
class Pictures:
    """How a controller moves the vehicle.

    Attributes:
        histories: Time histories; None where there are none.
        locus: Root locus; None where there is none.
        locus_words: What the locus shows.
        missing: Why something is missing; "" if nothing is, or if nothing is on record.
    """

    histories: Markup | None = None
    locus: Markup | None = None
    locus_words: str = ""
    missing: str = ""


def cards_of(
    view: BoardView, hashes: dict[str, str | None], motion: dict[str, Answer], scale: Scale
) -> list[Card]:
    """Return the cards of a board, the best controller's first.

    Args:
        view: The board.
        hashes: SHA-256 by SPEC of the file behind a controller, None if it needs none.
        motion: What `eval.benchmark_motion.motion_answer` has found, by SPEC, on this layout.
        scale: What the accelerations are drawn by.
    """
    return [_card(entrant, hashes.get(entrant.name), motion, scale) for entrant in view.entrants]


def _card(entrant: Entrant, sha256: str | None, motion: dict[str, Answer], scale: Scale) -> Card:
    score = entrant.standing.score
    gains = () if score is None else score.gains
    conditions = condition_gains(gains)
    failures = _failures(entrant.rows)
    worst = "" if score is None else score.worst.key
    return Card(
        entrant=entrant,
        name=f"card-{scale.layout}-{entrant.rank}",
        facts=tuple(_facts(entrant, sha256)),
        by_delay=_by_delay(entrant),
        by_speed=speed_table(entrant, "Gain by speed and delay"),
        conditions=_conditions(conditions[:_MOST_CONDITIONS]) if conditions else None,
        left_out=max(0, len(conditions) - _MOST_CONDITIONS),
        diverged=_diverged(entrant.rows),
        failures=tuple(failures[:_MOST_REASONS]),
        other_failures=max(0, len(failures) - _MOST_REASONS),
        worst=worst or (failures[0].key if failures else ""),
        pictures=_pictures(entrant, motion, scale),
    )


def _pictures(entrant: Entrant, motion: dict[str, Answer], scale: Scale) -> Pictures:
    answer = motion.get(entrant.name)
    if answer is None:
        return Pictures()
    if "error" in answer:
        return Pictures(missing=f"No time histories and no roots: {answer['error']}.")
    histories = history_chart(f"motion-{scale.layout}-{entrant.rank}", answer, scale)
    roots = answer["roots"]
    if "none" in roots:
        return Pictures(histories, missing=f"No root locus: {roots['none']}.")
    passive = motion.get(PASSIVE, {}).get("roots")
    locus = locus_chart(f"locus-{scale.layout}-{entrant.rank}", roots, passive)
    return Pictures(histories, locus, locus_sentence(roots))


def _facts(entrant: Entrant, sha256: str | None) -> list[tuple[str, str]]:
    standing = entrant.standing
    told = "told the delay" if standing.division == "told" else "not told the delay"
    facts = [("Division", told)]
    if standing.score is not None:
        whole = standing.score.aggregates
        for words, interval in (
            ("Score", whole.mean),
            ("Middle half", whole.interquartile_mean),
            ("Median condition", whole.median),
        ):
            ends = spread(interval)
            facts.append((words, number(interval.estimate, 3) + (f" ({ends})" if ends else "")))
        if standing.score.unscored:
            facts.append(("Not scored", f"{len(standing.score.unscored)} of {standing.runs} runs"))
    if standing.missing:
        facts.append(("Not run", f"{standing.missing} runs that others are scored by"))
    delay, known = critical_words(standing.stability)
    answer = standing.stability
    facts.append(("Critical delay", f"{delay}, {known}"))
    windows: Any = answer.get("stable_windows_s") or answer.get("windows_s")
    if windows and len(windows) > 1:
        ends = ", ".join(f"{1000 * low:.0f} to {1000 * high:.0f}" for low, high in windows)
        facts.append(("Stable delays [ms]", ends))
    if answer.get("bracket_s"):
        low, high = answer["bracket_s"]
        facts.append(("Bracket [ms]", f"{1000 * low:.1f} to {1000 * high:.1f}"))
    if answer.get("frequency_hz") is not None:
        facts.append(("Motion beyond it", f"{answer['frequency_hz']:.2f} Hz, {answer.get('mode')}"))
    if sha256:
        facts.append(("File's SHA-256", sha256))
    return facts


def _by_delay(entrant: Entrant) -> Table | None:
    if entrant.standing.score is None:
        return None
    gains = entrant.standing.score.by_delay
    return Table(
        "Gain by delay, mean over all conditions",
        ("delay [ms]", *(f"{1000 * delay:g}" for delay in gains)),
        ("gain",),
        (tuple(gain_cell(gain) for gain in gains.values()),),
    )


def _conditions(entries: list[tuple[Condition, float, float, int]]) -> Table:
    return Table(
        "Gain by condition",
        ("condition", "mean", "lowest run"),
        tuple(condition_words(condition) for condition, *_ in entries),
        tuple((gain_cell(mean), gain_cell(lowest)) for _, mean, lowest, _ in entries),
    )


def _diverged(rows: tuple[Row, ...]) -> str:
    counts = Counter(row["delay_s"] for row in rows if row["status"] == "diverged")
    return ", ".join(f"{count} at {1000 * d:g} ms" for d, count in sorted(counts.items()))


def _failures(rows: tuple[Row, ...]) -> list[Failure]:
    found: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        if row["status"] in LOST:
            found.setdefault((row["status"], row["message"]), []).append(row["key"])
    failures = [Failure(*reason, len(keys), min(keys)) for reason, keys in found.items()]
    return sorted(failures, key=lambda f: (-f.count, f.status, f.message))
