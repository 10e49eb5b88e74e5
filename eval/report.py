"""The benchmark's report: one HTML page from the records alone.

The page needs no network: charts stand in it as SVG. Names in the records (a controller's SPEC can
be any text) are escaped by the template, which holds all HTML; `eval.charts` draws. Where records
hold several seeds, values are means over them, and a run counts as diverged if any seed has.
"""

import importlib.util
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from eval.panels import comfort_panels, gain_panels, locus_panels, styles_of
from eval.records import RECORDS_FILE, read_records, write_text
from eval.summary import (
    HIGHLIGHTED_GAIN,
    Group,
    evidence_text,
    first_diverged,
    groups_of,
    label,
    layout_words,
    number_text,
    tables_of,
)
from railenv.errors import InputFileError, RailenvError

REPORT_FILE = "report.html"
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
    styles = styles_of(groups)
    chosen = reference_groups(groups)
    tables = tables_of(groups)
    tell = progress or (lambda _: None)
    return {
        "records": records,
        "records_file": RECORDS_FILE,
        "groups": groups,
        "tables": tables,
        "answer": answer(groups, chosen),
        "evidence": evidence_text(groups),
        "cards": [_card(g, groups) for g in chosen if g.stability],
        "chosen_rows": [(g.controller, g.layout, f"{g.speed:g}") for g in chosen],
        "legend_entries": [style for style in styles.values() if style["used"]],
        "marker_paths": _MARKER_PATHS,
        "comfort": comfort_panels(groups, styles, tell),
        "loci": locus_panels(groups, chosen, tell),
        "gains": gain_panels(groups),
        "without_gain": sorted({g.controller for g in groups if g.gain is None}),
        "label": label,
        "layout_words": layout_words,
        "growth_limit": GROWTH_LIMIT,
        "saturation_limit": SATURATION_LIMIT,
    }


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
    if group.windows_text is not None:
        return f"{place} are {group.windows_text}"
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
    if group.windows_text is not None:
        details.append(group.windows_text)
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
