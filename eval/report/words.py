"""Numbers and places of the benchmark in words."""

import math
from typing import Any

from eval.scenarios import Scenario
from eval.scoring.board import SHOWN, Standing
from eval.scoring.board_text import critical_text
from eval.scoring.gain import Condition
from eval.scoring.statistics import Interval
from railenv.errors import ArgumentError

NONE = "\N{EN DASH}"
"""Stands where there is no number."""

_EVIDENCE = {"p": "proved", "e": "by eigenvalues", "s": "by simulation"}
_MODELS = {"full50": "nonlinear"}


def number(value: float | None, digits: int = 2) -> str:
    """Return a number with its minus sign; a dash where there is none."""
    if value is None or math.isnan(value):
        return NONE
    text = f"{value:.{digits}f}"
    # Of a small negative number nothing but the sign is left.
    return (text.lstrip("-") if not float(text) else text).replace("-", "\N{MINUS SIGN}")


def spread(interval: Interval | None, digits: int = 2) -> str:
    """Return the ends of an interval; "" where they were not drawn."""
    if interval is None or math.isnan(interval.low):
        return ""
    return f"{number(interval.low, digits)} to {number(interval.high, digits)}"


def layout_words(layout: str) -> str:
    """Return a layout in words."""
    return {"2": "two actuators", "4": "four actuators"}.get(layout, layout)


def critical_ms(answer: dict[str, Any]) -> float | None:
    """Return a critical delay [ms]; infinite where none was found, None where it is not known."""
    text = critical_text(answer)
    if text in ("-", "none"):
        return None
    if text.startswith(">"):
        return math.inf
    return 0.0 if text == "0" else 1000.0 * float(answer["critical_delay_s"])


def critical_words(answer: dict[str, Any]) -> tuple[str, str]:
    """Return a critical delay and how it is known."""
    text = critical_text(answer)
    if text == "-":
        return NONE, str(answer.get("error", "not known"))
    if text == "none":
        return NONE, "no actuator"
    if text.startswith(">"):
        known = {"simulation": "by simulation", "sampled": "by eigenvalues"}
        return f"> {text[1:]} ms", known.get(answer["method"], "exact")
    if text == "0":
        return "0 ms", "unstable without delay"
    delay, _, sign = text.partition(" ")
    return f"{delay} ms", _EVIDENCE.get(sign, "")


def scenario_words(key: str) -> str:
    """Return a cell's key in words: what differs from the condition drawn, and the delay."""
    try:
        here = Scenario.of(key)
    except ArgumentError:
        return key
    speed = f"{here.speed_kmh:g}"
    place = (here.model, here.vehicle, here.layout, speed, here.track, here.channel.kind)
    words = condition_words(place, short=True)
    return ", ".join(filter(None, (words, f"{here.channel.delay_ms:g} ms, track {here.seed}")))


def condition_words(condition: Condition, *, short: bool = False) -> str:
    """Return a condition in words.

    Args:
        condition: Model, vehicle, layout, speed, track, kind of channel.
        short: Leave out what is as in `SHOWN`.
    """
    model, vehicle, _, speed, track, channel = condition
    usual = {name: str(value) for name, value in SHOWN.items()}
    usual["speed_kmh"] = f"{SHOWN['speed_kmh']:g}"
    parts = [
        ("model", model, _MODELS.get(model, "linear")),
        ("vehicle", vehicle, vehicle),
        ("speed_kmh", speed, f"{speed} km/h"),
        ("track", track, track),
        ("channel", channel, channel),
    ]
    return ", ".join(word for name, value, word in parts if not short or value != usual[name])


def shown_words() -> str:
    """Return the condition that is drawn against delay in words."""
    place = tuple(str(SHOWN[name]) for name in ("model", "vehicle"))
    return condition_words(
        (*place, "", f"{SHOWN['speed_kmh']:g}", SHOWN["track"], SHOWN["channel"])
    )


def lost_words(standing: Standing) -> str:
    """Return how many runs diverged or came to no end."""
    parts = [f"{standing.diverged} diverged"] if standing.diverged else []
    parts += [f"{count} {status}" for status, count in standing.lost.items()]
    return ", ".join(parts) or "none"
