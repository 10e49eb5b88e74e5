"""What a benchmark's records say, group by group, and the table for the terminal.

Where records hold several seeds, values are means over them. A run counts as diverged if it grew or
saturated (any seed), or if the loop is unstable at its delay: close to the critical delay growth is
too slow to see, and a controller that limits itself hides it.
"""

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

TABLE_DELAYS_MS = (0.0, 100.0, 200.0, 300.0)
HIGHLIGHTED_GAIN = 35e3
WIDTH = 120
_LAYOUTS = {"2": "two actuators", "4": "four actuators", "passive": "no actuators"}


@dataclass(frozen=True)
class Point:
    """Measures at one delay [ms], means over the seeds; None if a seed blew up."""

    delay_ms: float
    front: float | None
    rear: float | None
    bogie: float | None
    diverged: bool

    @property
    def worse(self) -> float | None:
        """Wz of the worse floor end."""
        return None if self.front is None or self.rear is None else max(self.front, self.rear)


@dataclass(frozen=True)
class Group:
    """A controller on a layout at a speed, with its stability record (empty if it has none)."""

    controller: str
    layout: str
    speed: float
    stability: dict[str, Any]
    tracks: dict[str, list[Point]]

    @property
    def gain(self) -> float | None:
        """Sky-hook gain [N s/m]; None for any other controller."""
        return gain_of(self.controller)

    @property
    def estimated(self) -> bool:
        """Whether the critical delay comes from simulation."""
        return self.stability.get("method") == "simulation"

    def ms(self, key: str) -> float | None:
        """Return a delay of the stability record [ms]."""
        value = self.stability.get(key)
        return None if value is None else 1000.0 * value

    @property
    def windows_text(self) -> str | None:
        """Delays at which a sampled law is stable, in words; None of any other law."""
        if self.stability.get("method") != "sampled":
            return None
        windows = self.stability.get("stable_windows_s", [])
        longest = f"searched to {1000 * self.stability.get('max_delay_s', 0.0):.0f} ms"
        if not windows:
            return f"stable at no delay ({longest})"
        parts = [f"{1000 * low:.0f} to {1000 * high:.0f} ms" for low, high in windows]
        return f"stable from {' and '.join(parts)} ({longest})"

    @property
    def unstable_at_once(self) -> bool:
        """Whether the loop is unstable without any delay."""
        known = bool(self.stability.get("unstable_roots_without_delay"))
        return known or self.stability.get("critical_delay_sampled_s") == 0.0

    @property
    def stands_ms(self) -> float | None:
        """Critical delay, the sampled one where the continuous one is unknown [ms]."""
        exact = 0.0 if self.unstable_at_once else self.ms("critical_delay_s")
        return self.ms("critical_delay_sampled_s") if exact is None else exact


def gain_of(spec: str) -> float | None:
    """Return the gain of a sky-hook SPEC [N s/m], None if it is none."""
    if spec == "skyhook":
        return HIGHLIGHTED_GAIN
    name, _, text = spec.partition(":gain=")
    try:
        gain = float(text) if name == "skyhook" else math.nan
    except ValueError:
        return None
    return gain if math.isfinite(gain) else None


def label(spec: str) -> str:
    """Return a controller's name for readers."""
    gain = gain_of(spec)
    return spec if gain is None else f"sky-hook {gain / 1000:g} kN s/m"


def layout_words(layout: str) -> str:
    """Return a layout in words."""
    return _LAYOUTS.get(layout, f"layout {layout}")


def groups_of(records: dict[str, Any]) -> list[Group]:
    """Sort cells and stability answers into groups, in the records' order."""
    cells: dict[tuple[str, str, float], dict[str, dict[float, list[dict[str, Any]]]]] = {}
    for cell in records["cells"]:
        tracks = cells.setdefault((cell["controller"], cell["layout"], cell["speed_kmh"]), {})
        tracks.setdefault(cell["track"], {}).setdefault(cell["delay_s"], []).append(cell)
    stability = {(s["controller"], s["layout"], s["speed_kmh"]): s for s in records["stability"]}
    groups = []
    for key in {**cells, **stability}:
        tracks = {
            track: [_point(delay, runs) for delay, runs in sorted(delays.items())]
            for track, delays in cells.get(key, {}).items()
        }
        groups.append(Group(key[0], key[1], key[2], stability.get(key, {}), tracks))
    return groups


def _point(delay: float, runs: Sequence[dict[str, Any]]) -> Point:
    def mean(key: str) -> float | None:
        values = [run[key] for run in runs]
        return None if None in values else sum(values) / len(values)

    return Point(
        # 1000 * 0.29 is not 290 in floating point; delays are given to the microsecond at most.
        delay_ms=round(1000.0 * delay, 3),
        front=mean("ride_index_front"),
        rear=mean("ride_index_rear"),
        bogie=mean("bogie_rms"),
        diverged=any(run["diverged"] or run.get("unstable") for run in runs),
    )


def tracks_of(groups: Sequence[Group]) -> list[str]:
    """Return the names of all tracks, in order."""
    return list(dict.fromkeys(track for group in groups for track in group.tracks))


def table_delays(groups: Sequence[Group]) -> list[float]:
    """Return the delays that tables show: the nearest existing ones to `TABLE_DELAYS_MS` [ms]."""
    known = sorted({p.delay_ms for g in groups for ps in g.tracks.values() for p in ps})
    if not known:
        return []
    return sorted({min(known, key=lambda d: abs(d - wanted)) for wanted in TABLE_DELAYS_MS})


def first_diverged(points: Sequence[Point]) -> float | None:
    """Return the shortest delay at which a run diverged [ms]."""
    return next((p.delay_ms for p in points if p.diverged), None)


def number_text(value: float | None, digits: int) -> str:
    """Return a number with so many digits after the point, "-" for None."""
    return "-" if value is None else f"{value:.{digits}f}"


def _stability_row(group: Group) -> list[str]:
    about = "~" if group.estimated and group.ms("critical_delay_sampled_s") is not None else ""
    return [
        group.controller,
        group.layout,
        f"{group.speed:g}",
        number_text(group.ms("critical_delay_s"), 1),
        about + number_text(group.ms("critical_delay_sampled_s"), 1),
        number_text(group.stability.get("frequency_hz"), 3),
        group.stability.get("mode") or "-",
    ]


def _comfort_row(group: Group, points: Sequence[Point], delays: Sequence[float]) -> list[str]:
    at = {p.delay_ms: p for p in points}
    found = [at.get(delay) for delay in delays]
    wz = ["-" if p is None else number_text(p.worse, 2) + "*" * p.diverged for p in found]
    ends = [None if p is None else p.bogie for p in (found[0], found[-1])]
    return [
        group.controller,
        group.layout,
        f"{group.speed:g}",
        *wz,
        number_text(first_diverged(points), 0),
        *(number_text(value, 2) for value in ends),
    ]


def tables_of(groups: Sequence[Group]) -> list[tuple[str, list[str], list[list[str]]]]:
    """Return title, headers and rows of the stability table and of one comfort table per track."""
    where = ["controller", "layout", "km/h"]
    heads = [*where, "critical [ms]", "sampled [ms]", "f [Hz]", "mode"]
    tables = [("Critical delay", heads, [_stability_row(g) for g in groups])]
    delays = table_delays(groups)
    for track in tracks_of(groups):
        heads = [
            *where,
            *(f"{delay:g} ms" for delay in delays),
            "diverges",
            f"bogie {delays[0]:g}",
            f"bogie {delays[-1]:g}",
        ]
        rows = [_comfort_row(g, g.tracks[track], delays) for g in groups if track in g.tracks]
        title = (
            f"Track {track}: Wz of the worse floor end, first delay that diverged [ms], bogie RMS "
            "[m/s^2]"
        )
        tables.append((title, heads, rows))
    return tables


def summary_table(records: dict[str, Any]) -> str:
    """Return the records' main numbers as plain text for a terminal.

    Args:
        records: What `eval.records.read_records` returns.

    Returns:
        Lines of at most `WIDTH` columns.
    """
    groups = groups_of(records)
    lines: list[str] = []
    for title, heads, rows in tables_of(groups):
        lines += [*textwrap.wrap(_printable(title), WIDTH), *_text_table(heads, rows), ""]
    lines += textwrap.wrap(
        "-: none found up to the longest delay searched, or not known; ~: estimated by simulation; "
        "*: diverged, or unstable at that delay. " + evidence_text(groups),
        WIDTH,
    )
    for failure in records["failures"]:
        text = (
            f"FAILED {failure['controller']}, layout {failure['layout']}, "
            f"{failure['speed_kmh']:g} km/h: {failure['error']}"
        )
        lines += textwrap.wrap(_printable(text), WIDTH, subsequent_indent="  ")
    return "\n".join(lines)


def _printable(text: str) -> str:
    """Keep what a terminal shows; names in records must not send it control sequences."""
    return "".join(c if c.isprintable() else " " if c.isspace() else "?" for c in text)


def _text_table(heads: list[str], rows: list[list[str]]) -> list[str]:
    cells = [[_printable(cell) for cell in row] for row in [heads, *rows]]
    widths = [max(len(row[k]) for row in cells) for k in range(len(heads))]
    widths[0] = max(12, min(widths[0], WIDTH - sum(widths[1:]) - 2 * (len(widths) - 1)))
    left = {0, 1, heads.index("mode") if "mode" in heads else 0}
    lines = []
    for row in cells:
        if len(row[0]) > widths[0]:
            half = (widths[0] - 3) // 2
            row[0] = f"{row[0][:half]}...{row[0][len(row[0]) - (widths[0] - 3 - half) :]}"
        parts = [
            cell.ljust(width) if k in left else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append("  ".join(parts).rstrip()[:WIDTH])
    return [lines[0], "-" * max(len(line) for line in lines), *lines[1:]]


def evidence_text(groups: Sequence[Group]) -> str:
    """Say which critical delays are proved and which are estimates."""
    known = [g for g in groups if g.stability]
    if not known:
        return "No critical delay was computed."
    parts = []
    exact = [g for g in known if not g.estimated]
    if exact:
        proved = sum(bool(g.stability.get("proved")) for g in exact)
        words = {0: "exact to rounding, not proved", len(exact): "proved"}
        some = f"exact to rounding, proved for {proved} of {len(exact)} loops"
        parts.append(
            f"Continuous critical delays of linear controllers are {words.get(proved, some)}; "
            "those with the hold are exact to rounding."
        )
    if len(exact) < len(known):
        parts.append("Those marked ~ are brackets from simulation, an estimate.")
    return " ".join([*parts, "Comfort numbers are measured in simulation."])
