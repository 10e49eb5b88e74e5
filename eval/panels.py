"""The panels of the report: which lines stand in which chart, and their titles."""

from collections.abc import Callable, Sequence
from typing import Any

from eval import charts
from eval.locus_chart import locus_chart
from eval.summary import HIGHLIGHTED_GAIN, Group, Point, gain_of, label, layout_words

_ENDS: tuple[tuple[str, Callable[["Point"], float | None]], ...] = (
    ("front floor", lambda p: p.front),
    ("rear floor", lambda p: p.rear),
)


def styles_of(groups: Sequence[Group]) -> dict[str, dict[str, Any]]:
    """Return colour, marker and dash of each controller; gains run from light to dark."""
    specs = list(dict.fromkeys(g.controller for g in groups))
    gains = {spec: gain_of(spec) for spec in specs}
    hooks = sorted((s for s in specs if gains[s] is not None), key=lambda s: gains[s] or 0.0)
    shades = dict(zip(hooks, charts.gain_colors(len(hooks)), strict=True))
    okabe = (charts.VERMILLION, charts.BLUE, charts.PURPLE, charts.ORANGE, charts.GREEN)
    styles: dict[str, dict[str, Any]] = {}
    for k, spec in enumerate(sorted(specs, key=lambda s: (gains[s] is None, gains[s] or 0.0))):
        passive = spec == "passive"
        styles[spec] = {
            "label": label(spec),
            "color": charts.GREY if passive else shades.get(spec, okabe[k % len(okabe)]),
            "marker": charts.MARKERS[k % len(charts.MARKERS)],
            "dash": "--" if passive else "-" if spec in shades else "-.",
            "width": 2.6 if gains[spec] == HIGHLIGHTED_GAIN else 1.4,
            "used": any(g.tracks for g in groups if g.controller == spec),
            "passive": passive,
        }
    return styles


def comfort_panels(
    groups: Sequence[Group], styles: dict[str, dict[str, Any]], tell: Callable[[str], None]
) -> list[dict[str, Any]]:
    """Return per track and speed the panels of ride index and bogie acceleration."""
    places = dict.fromkeys((track, g.speed) for g in groups for track in g.tracks)
    rows = []
    for number, (track, speed) in enumerate(places):
        tell(f"ride index, {track}")
        here = [g for g in groups if track in g.tracks and g.speed == speed]
        layouts = sorted({g.layout for g in here} - {"passive"}, reverse=True) or ["passive"]
        points = [p for g in here for p in g.tracks[track]]
        wz, bogie = (
            _largest_good(points, lambda p: p.worse),
            _largest_good(points, lambda p: p.bogie),
        )
        row: dict[str, Any] = {"track": track, "speed": speed, "wz": [], "bogie": []}
        row["largest"] = max((p.worse for p in points if p.worse is not None), default=None)
        row["cut"] = row["largest"] is not None and row["largest"] > max(3.0, 1.15 * wz)
        row["blown_up"] = sum(p.worse is None for p in points)
        for layout in layouts:
            shown = [g for g in here if g.layout in (layout, "passive")]
            for end, value in _ENDS:
                lines = [_line(g, track, styles[g.controller], value) for g in shown]
                row["wz"].append({"title": f"{layout_words(layout)}, {end}", "lines": lines})
            lines = [_line(g, track, styles[g.controller], lambda p: p.bogie) for g in shown]
            row["bogie"].append({"title": f"{track}, {layout_words(layout)}", "lines": lines})
            if len({place[1] for place in places}) > 1:
                row["bogie"][-1]["title"] += f", {speed:g} km/h"
        top = max(3.0, 1.15 * wz)
        unit = "bogie RMS [m/s\N{SUPERSCRIPT TWO}]"
        _draw(row["wz"], f"wz-{number}", "Wz [1]", (1.0, top), (4.6, 2.8))
        _draw(row["bogie"], f"bogie-{number}", unit, (0.0, 1.3 * bogie or 1.0), (3.4, 2.4))
        rows.append(row)
    return rows


def _draw(
    panels: list[dict[str, Any]],
    name: str,
    ylabel: str,
    limits: tuple[float, float],
    size: tuple[float, float],
) -> None:
    """Draw panels so that their axes are equally high."""
    rows = max(charts.rows_above(panel["lines"], limits[1]) for panel in panels)
    for k, panel in enumerate(panels):
        panel["svg"] = charts.delay_chart(f"{name}-{k}", panel["lines"], ylabel, limits, size, rows)


def _largest_good(points: Sequence[Point], value: Callable[[Point], float | None]) -> float:
    """Return the largest value that did not diverge; if all have, the smallest."""
    good = [v for p in points if not p.diverged and (v := value(p)) is not None]
    return max(good) if good else min((v for p in points if (v := value(p)) is not None), default=1)


def _line(
    group: Group,
    track: str,
    style: dict[str, Any],
    value: Callable[[Point], float | None],
) -> charts.Line:
    points = group.tracks[track]
    return charts.Line(
        **{key: style[key] for key in ("color", "marker", "dash", "width")},
        delays_ms=[p.delay_ms for p in points],
        values=[value(p) for p in points],
        diverged=[p.diverged for p in points],
        critical_ms=group.ms("critical_delay_sampled_s"),
    )


def locus_panels(
    groups: Sequence[Group], chosen: Sequence[Group], tell: Callable[[str], None]
) -> dict[str, list[Any]]:
    """Return the root loci, the chosen groups' large and the others' small."""
    panels: dict[str, list[Any]] = {"large": [], "small": []}
    for number, group in enumerate(groups):
        locus = group.stability.get("root_locus")
        if not locus or group.layout == "passive":
            continue
        tell(f"root locus, {group.controller}")
        small = group not in chosen
        crossings = group.stability.get("crossings") or []
        svg = locus_chart(f"locus-{number}", locus, crossings, small)
        within = [c for c in crossings if c["delay_s"] <= locus["delay_s"][-1]]
        later = group.ms("critical_delay_s") if not within else None
        end = f"{1000 * locus['delay_s'][-1]:g} ms"
        note = f"No crossing up to {end}." if not within else ""
        if later is not None:
            note = f"The first crossing, at {later:.0f} ms, lies beyond the {end} drawn."
        panel = {"group": group, "svg": svg, "note": note, "within": within}
        panels["small" if small else "large"].append(panel)
    panels["large"].sort(key=lambda panel: list(chosen).index(panel["group"]))
    return panels


def gain_panels(groups: Sequence[Group]) -> list[dict[str, Any]]:
    """Return critical delay, frequency and their product against the sky-hook gain."""
    panels = []
    hooks = [g for g in groups if g.gain is not None and g.stability]
    for number, speed in enumerate(dict.fromkeys(g.speed for g in hooks)):
        curves = []
        colors = (charts.BLUE, charts.VERMILLION, charts.GREEN)
        layouts = sorted({g.layout for g in hooks if g.speed == speed}, reverse=True)
        for k, layout in enumerate(layouts):
            here = [g for g in hooks if (g.layout, g.speed) == (layout, speed)]
            here.sort(key=lambda g: g.gain or 0.0)
            curves.append(
                charts.GainCurve(
                    layout_words(layout),
                    colors[k % len(colors)],
                    charts.MARKERS[k % len(charts.MARKERS)],
                    [g.gain or 0.0 for g in here],
                    *(
                        [g.stability.get(key) for g in here]
                        for key in ("critical_delay_s", "critical_delay_sampled_s", "frequency_hz")
                    ),
                )
            )
        longest = max(g.stability.get("max_delay_s") or 0.0 for g in hooks)
        vehicles = {g.stability.get("vehicle") for g in hooks}
        published = speed == 300.0 and vehicles == {"paper_fit"} and "4" in layouts
        svgs = charts.gain_charts(f"gain-{number}", curves, longest, published)
        panels.append({"speed": speed, "svgs": svgs, "published": published})
    return panels
