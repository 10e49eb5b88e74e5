"""The score as a table for the terminal or a page."""

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

from eval.policy_score_references import LQG, PASSIVE, SINGLE, SKYHOOK

WIDTH = 120
_SHORT = {PASSIVE: "passive", SKYHOOK: "best sky-hook", SINGLE: "best single gain", LQG: "LQG"}
_WRITTEN = 0.005  # ride indices are printed with two decimals


def lines_of(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table with columns of even width, for the terminal."""
    widths = [max(len(row[k]) for row in (header, *rows)) for k in range(len(header))]

    def line(row: Sequence[str]) -> str:
        first = row[0].ljust(widths[0])
        rest = (cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True))
        return "  ".join([first, *rest]).rstrip()

    return "\n".join(line(row) for row in (header, *rows))


def markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    lines = ["| " + " | ".join(header) + " |", "|" + " --- |" * len(header)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)])


def delay_columns(delays: Sequence[float]) -> list[str]:
    """Return headings of delays [s] in milliseconds."""
    return [f"{1000 * delay:g} ms" for delay in delays]


def index_cell(row: Mapping[str, Any], k: int, *, interval: bool = False) -> str:
    """Return a ride index with a star where a run diverged.

    Args:
        row: With `worse`, `low`, `high` and `diverged`.
        k: Which delay.
        interval: Whether the interval is written too.
    """
    value = row["worse"][k]
    if value is None:
        return "diverges"
    star = " *" if row["diverged"][k] else ""
    ends = f" [{row['low'][k]:.2f}, {row['high'][k]:.2f}]" if interval else ""
    return f"{value:.2f}{ends}{star}"


def half_width(row: Mapping[str, Any], k: int) -> str:
    """Return the larger half of a ride index's interval, for the terminal."""
    value, low, high = row["worse"][k], row["low"][k], row["high"][k]
    return "-" if value is None else f"+-{max(value - low, high - value, _WRITTEN):.2f}"


def margin_cell(margin: Mapping[str, Any], k: int, *, interval: bool = False) -> str:
    """Return by how much a ride index is better than a reference's; a sign always."""
    value = margin["value"][k]
    if value is None:
        return "-"
    ends = f" [{margin['low'][k]:+.2f}, {margin['high'][k]:+.2f}]" if interval else ""
    return f"{value:+.2f}{ends}"


def critical_word(answer: Mapping[str, Any]) -> str:
    """Return a critical delay in words."""
    value = answer["critical_delay_s"]
    if value is None:
        return f"none to {1000 * answer['longest_s']:g} ms"
    return "unstable without delay" if value == 0.0 else f"{1000 * value:.0f} ms"


def screen(answer: Mapping[str, Any], show: str = "") -> str:
    """Return what `railenv score` prints.

    Args:
        answer: What the command computed.
        show: The next command to try.
    """
    trial = answer["trial"]
    columns = delay_columns(trial["delays"])
    parts = [
        _wrapped(
            f"Ride index of the worse floor end, mean over {trial['tracks']} tracks "
            f"({trial['track']}, seeds from {trial['first_track_seed']}, never trained on), "
            f"{trial['speed_kmh']:g} km/h, layout {answer['layout']}, "
            f"{trial['seconds']:g} s after {trial['skip']:g} s, "
            f"sensor noise {trial['sensor_noise']:g}. Lower is better; +- is the larger half of a "
            "95 % interval; a star: a run diverged."
        )
    ]
    rows: list[list[str]] = []
    delays = range(len(columns))
    for name, own in answer["policies"].items():
        for word, row in own.items():
            rows.append([f"{name}, {word}", *(index_cell(row, k) for k in delays)])
            rows.append(["", *(half_width(row, k) for k in delays)])
    rows += [
        [name, *(index_cell(row, k) for k in delays)] for name, row in answer["references"].items()
    ]
    parts.append(lines_of(["controller", *columns], rows))
    if answer["references"]:
        parts.append(_margins(answer, columns))
    if answer["gains"]:
        gains = ", ".join("none" if g is None else f"{g / 1e3:g}" for g in answer["gains"])
        parts.append(_wrapped(f"Best sky-hook gains [kN s/m]: {gains}."))
    parts.append("\n".join(_oracle_lines(answer)))
    if show:
        parts.append(f"next: {show}")
    return "\n\n".join(part for part in parts if part)


def _margins(answer: Mapping[str, Any], columns: Sequence[str]) -> str:
    rows: list[list[str]] = []
    for name, own in answer["policies"].items():
        row = next(iter(own.values()))
        for reference in _SHORT:
            if reference in row["margins"]:
                margin = row["margins"][reference]
                cells = [margin_cell(margin, k) for k in range(len(columns))]
                rows.append([f"{name} than {_SHORT[reference]}", *cells])
    return lines_of(["better by (negative: worse)", *columns], rows)


def _oracle_lines(answer: Mapping[str, Any]) -> list[str]:
    lines: list[str] = []
    for name, found in answer["stability"].items():
        local = "" if found.get("linear", True) else " (motion near rest)"
        if "critical_delay_s" in found:
            lines.append(
                f"{name}: critical delay {critical_word(found)} by eigenvalues{local}, not proved"
            )
        for model, simulated in found["simulated"].items():
            lines.append(f"{name}: critical delay {critical_word(simulated)} simulated on {model}")
        for word, rates in found.get("growth", {}).items():
            lines.append(
                f"{name}, {word}: largest growth rate {rates['worst']:+.3f} 1/s at "
                f"{len(rates['delays_s'])} delays from {1000 * rates['delays_s'][0]:g} to "
                f"{1000 * rates['delays_s'][-1]:g} ms, not proved"
            )
    return lines


def _wrapped(text: str) -> str:
    return textwrap.fill(text, WIDTH)
