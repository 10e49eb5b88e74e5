"""The benchmark's report: one HTML page from the records alone.

The page needs no network: charts stand in it as SVG. Names in the records (a controller's SPEC can
be any text) are escaped by the template, which holds all HTML; `eval.charts` draws. Where records
hold several seeds, values are means over them, and a run counts as diverged if any seed has.
"""

import importlib.util
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from eval import charts
from eval.locus_chart import locus_chart
from eval.records import RECORDS_FILE, read_records, write_text
from eval.summary import (
    HIGHLIGHTED_GAIN,
    Group,
    Point,
    first_diverged,
    gain_of,
    groups_of,
    number_text,
    tables_of,
)
from railenv.errors import InputFileError, RailenvError

REPORT_FILE = "report.html"
_LAYOUTS = {"2": "two actuators", "4": "four actuators", "passive": "no actuators"}
_ENDS: tuple[tuple[str, Callable[["Point"], float | None]], ...] = (
    ("front floor", lambda p: p.front),
    ("rear floor", lambda p: p.rear),
)
_MARKER_PATHS = {
    "o": "M16 7a4 4 0 1 0 8 0a4 4 0 1 0 -8 0z",
    "s": "M16.5 3.5h7v7h-7z",
    "^": "M20 2.5l4.5 8h-9z",
    "D": "M20 2l5 5l-5 5l-5 -5z",
    "v": "M20 11.5l4.5 -8h-9z",
    "<": "M15 7l8 -4.5v9z",
    ">": "M25 7l-8 -4.5v9z",
    "p": "M20 2.5l4.5 3.3l-1.7 5.2h-5.6l-1.7 -5.2z",
}
"""Legend marks by matplotlib's marker letter, as SVG paths around (20, 7)."""


def missing_for_report() -> str | None:
    """Return the name of a package that the page needs and that is not installed, if any."""
    for name in ("matplotlib", "jinja2"):
        if importlib.util.find_spec(name) is None:
            return name
    return None


def write_report(folder: Path, progress: Callable[[str], None] | None = None) -> Path:
    """Write `report.html` beside a benchmark's records.

    Args:
        folder: Where `records.json` lies.
        progress: Called with a word on every chart that is drawn.

    Returns:
        The page's path.

    Raises:
        InputFileError: There are no usable records.
        OutputError: The page cannot be written; an older one is untouched.
        RailenvError: Matplotlib or Jinja is not installed.
    """
    records = read_records(folder)
    missing = missing_for_report()
    if missing:
        raise RailenvError(
            f'the report needs {missing}, which is not installed; run pip install "railenv[report]"'
        )
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).with_name("templates")),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    try:
        page = environment.get_template("report.html.j2").render(_page(records, progress))
    except (LookupError, TypeError, ValueError, AttributeError, jinja2.UndefinedError) as error:
        raise InputFileError(
            f"{folder / RECORDS_FILE} does not hold what a benchmark writes "
            f"({type(error).__name__}: {error}); run the benchmark again"
        ) from error
    path = folder / REPORT_FILE
    # JSON can hold half a surrogate pair, which no file can.
    write_text(path, page.encode("utf-8", "replace").decode("utf-8"))
    return path


def _page(records: dict[str, Any], progress: Callable[[str], None] | None = None) -> dict[str, Any]:
    """Return everything the template shows."""
    from eval.measures import GROWTH_LIMIT, SATURATION_LIMIT

    groups = groups_of(records)
    styles = _styles(groups)
    chosen = reference_groups(groups)
    tables = tables_of(groups)
    tell = progress or (lambda _: None)
    return {
        "records": records,
        "records_file": RECORDS_FILE,
        "groups": groups,
        "tables": tables,
        "answer": answer(groups, chosen),
        "evidence": _evidence(groups),
        "cards": [_card(g, groups) for g in chosen if g.stability],
        "chosen_rows": [(g.controller, g.layout, f"{g.speed:g}") for g in chosen],
        "legend_entries": [style for style in styles.values() if style["used"]],
        "marker_paths": _MARKER_PATHS,
        "comfort": _comfort_panels(groups, styles, tell),
        "loci": _locus_panels(groups, chosen, tell),
        "gains": _gain_panels(groups),
        "without_gain": sorted({g.controller for g in groups if g.gain is None}),
        "label": label,
        "layout_words": layout_words,
        "growth_limit": GROWTH_LIMIT,
        "saturation_limit": SATURATION_LIMIT,
    }


def label(spec: str) -> str:
    """Return a controller's name for readers."""
    gain = gain_of(spec)
    return spec if gain is None else f"sky-hook {gain / 1000:g} kN s/m"


def layout_words(layout: str) -> str:
    """Return a layout in words."""
    return _LAYOUTS.get(layout, f"layout {layout}")


def reference_groups(groups: Sequence[Group]) -> list[Group]:
    """Choose what the page's head speaks of.

    Per layout with actuators: every controller that is no sky-hook, and as a yardstick sky-hook at
    `HIGHLIGHTED_GAIN` if there is one, else at its middle gain.
    """
    chosen = []
    active = [g for g in groups if g.layout != "passive"]
    if active:
        active = [g for g in active if g.speed == active[0].speed]
    for layout in sorted({g.layout for g in active}, reverse=True):
        here = [g for g in active if g.layout == layout]
        hooks = sorted((g for g in here if g.gain is not None), key=lambda g: g.gain or 0.0)
        exact = [g for g in hooks if g.gain == HIGHLIGHTED_GAIN]
        chosen += [g for g in here if g.gain is None]
        chosen += (exact or hooks[len(hooks) // 2 :])[:1]
    return chosen


def answer(groups: Sequence[Group], chosen: Sequence[Group]) -> list[str]:
    """Answer in two sentences how much delay each layout stands, and what happens beyond it."""
    if not chosen:
        return ["No controller of this suite has an actuator, so no delay can act."]
    names = {g.controller for g in chosen}
    shared = f", with {label(chosen[0].controller)}," if len(names) == 1 else ","
    stands = ", ".join(_stands(g, named=len(names) > 1) for g in chosen)
    sentences = [f"At {chosen[0].speed:g} km/h{shared} {stands}."]
    moves = [clause for g in chosen if (clause := _beyond(g, len(names) > 1))]
    if moves:
        track = next(iter(chosen[0].tracks))
        passive = [g.tracks[track][0].worse for g in groups if g.layout == "passive" and g.tracks]
        against = (
            f", against {passive[0]:.2f} for the passive vehicle"
            if passive and passive[0] is not None
            else ""
        )
        grown = any(p.diverged for g in chosen for p in g.tracks.get(track, []))
        start = "Beyond that the motion grows" if grown else "None of these runs diverged"
        sentences.append(
            f"{start}: on {track}, Wz of the worse floor end goes {', '.join(moves)}{against}."
        )
    return sentences


def _stands(group: Group, named: bool) -> str:
    place = layout_words(group.layout) + (f" with {label(group.controller)}" if named else "")
    exact, sampled = group.ms("critical_delay_s"), group.ms("critical_delay_sampled_s")
    period = 1000 * group.stability.get("control_period_s", 0.0)
    if not group.stability:
        return f"{place} have no critical delay on record"
    if group.unstable_at_once:
        return f"{place} are unstable without any delay"
    if exact is not None and sampled is not None:
        return (
            f"{place} stand {exact:.0f} ms of delay "
            f"({sampled:.0f} ms when commanded every {period:g} ms)"
        )
    if sampled is not None:
        return f"{place} stand about {sampled:.0f} ms of delay (estimated by simulation)"
    longest = group.stability.get("max_delay_s", 0.0)
    return f"{place} stay stable up to {longest:g} s, the longest delay searched"


def _beyond(group: Group, named: bool) -> str:
    points = next(iter(group.tracks.values()), [])
    if not points or points[0].worse is None:
        return ""
    first, last = points[0], points[-1]
    end = "beyond any number" if last.worse is None else f"to {last.worse:.2f}"
    place = layout_words(group.layout) + (f" and {label(group.controller)}" if named else "")
    diverged = first_diverged(points)
    when = "not diverging" if diverged is None else f"diverging from {diverged:g} ms on"
    return (
        f"from {first.worse:.2f} at {first.delay_ms:g} ms {end} at {last.delay_ms:g} ms with "
        f"{place} ({when})"
    )


def _card(group: Group, groups: Sequence[Group]) -> dict[str, Any]:
    delay, mode = group.stands_ms, group.stability.get("mode")
    details = []
    if group.ms("critical_delay_s") is not None:
        details.append(f"sampled {number_text(group.ms('critical_delay_sampled_s'), 0)} ms")
    if group.estimated:
        details.append("estimated by simulation")
    if mode:
        details.append(f"{number_text(group.stability.get('frequency_hz'), 2)} Hz, {mode}")
    none = f"none up to {group.stability.get('max_delay_s', 0.0):g} s"
    place = (group.layout, group.speed)
    hooks = {g.gain: g.stands_ms for g in groups if g.gain is not None and g.stability
             and (g.layout, g.speed) == place}  # fmt: skip
    known = [delay for delay in hooks.values() if delay is not None]
    if group.gain is not None and len(hooks) > 1 and known:
        top = f"{max(known):.0f} ms" if len(known) == len(hooks) else none
        gains = f"{min(hooks) / 1000:g} to {max(hooks) / 1000:g} kN s/m"
        details.append(f"over gains of {gains}: {min(known):.0f} ms to {top}")
    return {
        "number": none if delay is None else f"{delay:.0f} ms",
        "title": f"{layout_words(group.layout)}, {label(group.controller)}",
        "details": details,
    }


def _evidence(groups: Sequence[Group]) -> str:
    known = [g for g in groups if g.stability]
    if not known:
        return "No critical delay was computed."
    parts = []
    exact = [g for g in known if not g.estimated]
    if exact:
        proved = sum(bool(g.stability.get("proved")) for g in exact)
        words = {0: "exact to rounding, not proved", len(exact): "proved"}
        some = f"exact to rounding, proved for {proved} of {len(exact)} loops"
        parts.append(f"Critical delays of linear controllers are {words.get(proved, some)}.")
    if len(exact) < len(known):
        parts.append("Those marked ~ are brackets from simulation, an estimate.")
    return " ".join([*parts, "Comfort numbers are measured in simulation."])


def _styles(groups: Sequence[Group]) -> dict[str, dict[str, Any]]:
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


def _comfort_panels(
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


def _locus_panels(
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


def _gain_panels(groups: Sequence[Group]) -> list[dict[str, Any]]:
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
