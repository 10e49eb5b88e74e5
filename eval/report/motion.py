"""The time histories on a controller's card: floor acceleration and force, strip under strip.

Every strip shows a signal's smallest and largest value in bins (`eval.benchmark_motion.envelope`).
Accelerations have one scale on all cards of a board, so that cards can be compared, and the passive
vehicle's in grey behind; what leaves the scale is cut off, and is said.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from markupsafe import Markup

from eval.benchmark_motion import ACCELERATION_STEP, ENDS, FORCE_STEP
from eval.report.svg import WIDTH, Point, ticks, visible
from eval.report.words import NONE, layout_words, number

Answer = dict[str, Any]

_LEFT, _RIGHT = 56.0, WIDTH - 14.0
_STRIP, _GAP, _BETWEEN = 50.0, 20.0, 14.0
"""Height of a strip, room for words over it, and more room between the two quantities [px]."""

_FAR = 8.0
"""Where what is cut off goes to at most, in halves of a strip."""

_ROOM = 1.25
"""Room of the accelerations' scale over the passive vehicle's largest [1]."""

_WORST = 3.0
"""The strips of the force reach to at most so many times the smallest of their peaks."""


@dataclass(frozen=True)
class Scale:
    """What accelerations of one board are drawn by.

    Attributes:
        layout: The board's layout; part of the ids of the passive vehicle's signals.
        reach: Acceleration at a strip's edge [m/s^2].
        passive: The passive vehicle's run; None if it is not on record.
    """

    layout: str
    reach: float
    passive: dict[str, Any] | None

    def passive_id(self, end: str) -> str:
        """Return the id by which a strip refers to the passive vehicle's signal."""
        return f"passive-{self.layout}-{end}"


def scale_of(layout: str, passive: Answer | None, answers: Sequence[Answer]) -> Scale:
    """Return a board's scale: room for the passive vehicle, or for what there is."""
    runs = passive["runs"] if passive and "runs" in passive else []
    if not runs:
        runs = [run for answer in answers for run in answer.get("runs", [])[:1]]
    peaks = [_peak(run[end]) * ACCELERATION_STEP for run in runs for end in ENDS]
    known = runs[0] if passive and "runs" in passive else None
    return Scale(layout, _round_up(_ROOM * max(peaks, default=0.0) or 1.0), known)


def passive_signals(scale: Scale, answer: Answer | None) -> Markup:
    """Return the passive vehicle's signals for all cards to refer to; they are not seen here."""
    if scale.passive is None or answer is None:
        return Markup("")
    paths = Markup("").join(
        Markup('<path id="{}" d="{}"/>').format(
            scale.passive_id(end), _band(scale.passive[end], scale.reach / ACCELERATION_STEP)
        )
        for end in ENDS
    )
    return Markup('<svg class="unseen" width="0" height="0" aria-hidden="true">{}</svg>').format(
        paths
    )


def history_chart(name: str, answer: Answer, scale: Scale) -> Markup:
    """Draw a controller's time histories.

    Args:
        name: Unique in the page; ids begin with it.
        answer: What `eval.benchmark_motion.motion_answer` has found.
        scale: The board's.
    """
    runs: list[dict[str, Any]] = answer["runs"]
    start, stop = answer["window_s"]
    forces = [run for run in runs if run["force"] is not None]
    parts: list[Markup] = []
    top = 0.0
    for run in runs:
        end = worse_end(run)
        reach = scale.reach / ACCELERATION_STEP
        words = f"{_ms(run)}, {end} end: {_rms(run, end)} m/s\N{SUPERSCRIPT TWO} RMS"
        parts += _strip(top, _words(words, run[end], reach), scale.reach, start, stop)
        if scale.passive is not None:
            parts.append(
                Markup('<use class="was" href="#{}" y="{}"/>').format(
                    scale.passive_id(end), f"{_middle(top):.1f}"
                )
            )
        parts.append(_drawn(name, "history", run[end], reach, top))
        top += _GAP + _STRIP
    parts.append(_side(0.0, top, "acceleration [m/s\N{SUPERSCRIPT TWO}]"))
    if forces:
        top += _BETWEEN
        first = top
        limit = _force_reach([_peak(run["force"]) * FORCE_STEP for run in forces])
        for run in forces:
            total = "blown up" if run["force_rms"] is None else _kn(run["force_rms"])
            words = f"{_ms(run)}, first actuator; all: {total} RMS"
            reach = limit / FORCE_STEP
            parts += _strip(top, _words(words, run["force"], reach), limit / 1e3, start, stop)
            parts.append(_drawn(name, "history force", run["force"], reach, top))
            top += _GAP + _STRIP
        parts.append(_side(first, top, "force [kN]"))
    for value in ticks(start, stop, 6):
        x = _LEFT + (value - start) / (stop - start) * (_RIGHT - _LEFT)
        parts.append(_text("tick middle", x, top + 16.0, f"{value:g}"))
    parts.append(_text("tick middle", (_LEFT + _RIGHT) / 2, top + 34.0, "time [s]"))
    head = Markup(
        '<svg viewBox="0 0 {} {}" role="img" aria-labelledby="{}-title"><title id="{}-title">{}'
        '</title><clipPath id="{}-clip"><rect x="{}" y="{}" width="{}" height="{}"/></clipPath>'
    ).format(
        f"{WIDTH:g}", f"{top + 40.0:g}", name, name, visible(history_sentence(answer, scale)),
        name, f"{_LEFT:g}", f"{-0.5 * _STRIP - 1.0:g}", f"{_RIGHT - _LEFT:g}", f"{_STRIP + 2.0:g}",
    )  # fmt: skip
    return head + Markup("").join(parts) + Markup("</svg>")


def history_sentence(answer: Answer, scale: Scale) -> str:
    """Say in words what the time histories show."""
    parts = [f"{_rms(run, worse_end(run))} at {_ms(run)} ({worse_end(run)})"
             for run in answer["runs"]]  # fmt: skip
    said = (
        "Time histories of floor acceleration and force. Acceleration of the worse floor end, "
        f"root mean square in m/s\N{SUPERSCRIPT TWO}, {layout_words(scale.layout)}: "
        + ", ".join(parts)
    )
    if scale.passive is not None:
        end = worse_end(scale.passive)
        said += f"; the passive vehicle {_rms(scale.passive, end)} ({end})"
    return f"{said}."


def worse_end(run: dict[str, Any]) -> str:
    """Return the floor end with the larger acceleration (root mean square); the rear if equal."""
    known = {end: run[end]["rms"] for end in ENDS}
    if None in known.values():
        return "rear"
    return "front" if known["front"] > known["rear"] else "rear"


def _strip(top: float, words: str, reach: float, start: float, stop: float) -> Iterator[Markup]:
    """Draw a strip's frame: words over it, grid, and a scale from -reach to reach."""
    yield _text("note", _LEFT, top + _GAP - 5.0, words)
    rule = Markup('<path class="grid" d="M{} {}H{}"/>')
    for value in (-reach, 0.0, reach):
        y = _middle(top) - 0.5 * _STRIP * value / reach
        yield rule.format(f"{_LEFT:g}", f"{y:.1f}", f"{_RIGHT:g}")
        yield _text("tick end", _LEFT - 6.0, y + 4.5, number_of(value))
    for value in ticks(start, stop, 6):
        x = _LEFT + (value - start) / (stop - start) * (_RIGHT - _LEFT)
        yield Markup('<path class="grid" d="M{} {}v{}"/>').format(
            f"{x:.1f}", f"{top + _GAP:.1f}", f"{_STRIP:g}"
        )


def _drawn(name: str, classes: str, signal: dict[str, Any], reach: float, top: float) -> Markup:
    return Markup(
        '<path class="{}" transform="translate(0 {})" clip-path="url(#{}-clip)" d="{}"/>'
    ).format(classes, f"{_middle(top):.1f}", name, _band(signal, reach))


def _band(signal: dict[str, Any], reach: float) -> str:
    """Return the band between a signal's smallest and largest values, around y = 0 [px].

    Args:
        signal: Its `low` and `high`.
        reach: Value at the strip's edge, in the signal's steps.
    """
    width = (_RIGHT - _LEFT) / max(len(signal["low"]), 1)

    def place(k: int, value: float) -> Point:
        # Far outside is as good as outside, and keeps the numbers short.
        y = -0.5 * _STRIP * min(max(value / reach, -_FAR), _FAR)
        return round(_LEFT + (k + 0.5) * width, 1), round(y, 1)

    pieces: list[list[tuple[int, float, float]]] = [[]]
    for k, (low, high) in enumerate(zip(signal["low"], signal["high"], strict=True)):
        if low is not None:
            pieces[-1].append((k, low, high))
        elif pieces[-1]:
            pieces.append([])
    return "".join(
        _closed([place(k, high) for k, _, high in piece], [place(k, low) for k, low, _ in piece])
        for piece in pieces
        if piece
    )


def _closed(upper: list[Point], lower: list[Point]) -> str:
    """Return a path around two lines, in steps from point to point: they are short to write."""
    points = [*upper, *reversed(lower)]
    words = [f"M{points[0][0]:g} {points[0][1]:g}"]
    for (x, y), (u, v) in pairwise(points):
        words.append(f"l{round(u - x, 1):g} {round(v - y, 1):g}")
    return "".join(words) + "z"


def _words(words: str, signal: dict[str, Any], reach: float) -> str:
    return words + (" (leaves the scale)" if _peak(signal) > reach else "")


def _force_reach(peaks: list[float]) -> float:
    """Return the force at a strip's edge [N]: for all, but not for a diverged run's alone."""
    most, least = max(peaks), min(peak or max(peaks) for peak in peaks)
    return _round_up(min(most, _WORST * least) or 1000.0)


def _round_up(value: float) -> float:
    power = 10.0 ** math.floor(math.log10(value))
    return next(power * m for m in (1.0, 2.0, 4.0, 5.0, 10.0) if power * m >= value)


def _peak(signal: dict[str, Any]) -> float:
    """Return the largest value that is known, in the signal's steps."""
    ends = [*signal["low"], *signal["high"]]
    return max((abs(value) for value in ends if value is not None), default=0.0)


def _rms(run: dict[str, Any], end: str) -> str:
    value = run[end]["rms"]
    return "blown up" if value is None else number(value, 3 if value < 1.0 else 1)


def _kn(value: float) -> str:
    return f"{number(value / 1e3)} kN"


def _ms(run: dict[str, Any]) -> str:
    return f"{1000.0 * run['delay_s']:g} ms"


def _middle(top: float) -> float:
    return top + _GAP + 0.5 * _STRIP


def number_of(value: float) -> str:
    """Return a tick's number."""
    return f"{value:g}".replace("-", "\N{MINUS SIGN}") if math.isfinite(value) else NONE


def _side(top: float, bottom: float, words: str) -> Markup:
    return Markup(
        '<text class="tick middle" transform="translate(13 {}) rotate(-90)">{}</text>'
    ).format(f"{(top + _GAP + bottom) / 2:.1f}", words)


def _text(classes: str, x: float, y: float, words: str) -> Markup:
    return Markup('<text class="{}" x="{}" y="{}">{}</text>').format(
        classes, f"{x:.1f}", f"{y:.1f}", visible(words)
    )
