"""`railenv chart`: the critical delay over any two parameters of a loop."""

import argparse
import time
from collections import Counter
from typing import Any

import numpy as np

from eval.arguments import parse_number, parse_output, parse_whole, print_json, progress_bar
from eval.chart_axes import VariedLoop, parse_chart
from eval.chart_plot import check_drawing, plot_chart
from railenv.errors import ArgumentError, check_count, check_positive
from railenv.stability.chart import StabilityChart, stability_chart

_WIDEST_TABLE = 12
_LONGEST_TABLE = 40
_REASONS_SHOWN = 3


def command_chart(options: argparse.Namespace) -> None:
    """Compute a stability chart, draw it and write its data."""
    loop = parse_chart(options)
    longest = check_positive("max_delay", parse_number("max_delay", options.max_delay), "seconds")
    jobs = check_count("jobs", parse_whole("jobs", options.jobs))
    plot = parse_output(options.plot, (".png", ".svg", ".pdf"))
    out = parse_output(options.out, (".npz",))
    if plot is not None:
        check_drawing()
    number = len(loop.axes[0].values) * len(loop.axes[1].values)
    started = time.perf_counter()
    with progress_bar(options, number, "point") as bar:
        chart = stability_chart(
            loop,
            loop.axes[0].name,
            loop.axes[0].values,
            loop.axes[1].name,
            loop.axes[1].values,
            max_delay=longest,
            jobs=jobs,
            progress=lambda *_: bar.update(),
        )
    seconds = time.perf_counter() - started
    if len(chart.failures) == number:
        raise ArgumentError(
            f"no point of the chart has an answer; {_reasons(chart, chart.failures)[0]}; "
            "change the axes or the loop"
        )
    settings = _settings(options, loop)
    if out is not None:
        chart.save(out, settings)
    title = _title(loop)
    if plot is not None:
        plot_chart(chart, plot, loop.axes[0].text, loop.axes[1].text, title)
    if options.json:
        print_json({**_record(chart), "settings": settings, "seconds": seconds})
        return
    print(title)
    _print_table(chart, loop)
    print(f"  {summary(chart)}; {seconds:.1f} s")
    for words, reasons in (("no answer", chart.failures), ("not proved", chart.unproved)):
        for reason in _reasons(chart, reasons)[:_REASONS_SHOWN]:
            print(f"  {words}: {reason}")
    for path in (plot, out):
        if path is not None:
            print(f"  written: {path}")


def _title(loop: VariedLoop) -> str:
    parts = [f"Critical delay of {loop.controller}", f"layout {loop.layout}", loop.vehicle]
    axes = (loop.axes[0].kind, loop.axes[1].kind)
    if "speed_kmh" not in axes:
        parts.append(f"{loop.speed_kmh:g} km/h")
    if "actuator_lag" not in axes and loop.actuator_lag > 0.0:
        parts.append(f"actuator lag {1000 * loop.actuator_lag:g} ms")
    return ", ".join(parts)


def summary(chart: StabilityChart) -> str:
    """Return the chart's counts in one line."""
    count = Counter(chart.status.ravel().tolist())
    parts = [f"{chart.status.size} points"]
    if count["critical"]:
        known = 1000 * chart.critical_delay[chart.status == "critical"]
        span = f"{known.min():.1f} to {known.max():.1f} ms"
        parts.append(f"{count['critical']} with a critical delay, {span}")
    parts.append(f"{count['unstable']} unstable without delay")
    parts.append(f"{count['none']} without crossing up to {chart.max_delay:g} s")
    if count["always"]:
        parts.append(f"{count['always']} stable for any delay")
    parts.append(f"{count['failed']} without answer")
    parts.append(f"{int(chart.proved.sum())} proved")
    return ", ".join(parts)


def _reasons(chart: StabilityChart, reasons: dict[tuple[int, int], str]) -> list[str]:
    """Return reasons, most frequent first, each with a count and a place."""
    places: dict[str, list[tuple[int, int]]] = {}
    for place, reason in sorted(reasons.items()):
        places.setdefault(reason, []).append(place)
    lines: list[str] = []
    for reason, found in sorted(places.items(), key=lambda item: -len(item[1])):
        row, column = found[0]
        x = f"{chart.x_name} = {chart.x_values[column]:g}"
        y = f"{chart.y_name} = {chart.y_values[row]:g}"
        lines.append(f"{reason} [{len(found)} x, first at {x}, {y}]")
    return lines


def _settings(options: argparse.Namespace, loop: VariedLoop) -> dict[str, Any]:
    return {
        "controller": loop.controller,
        "layout": loop.layout,
        "vehicle": loop.vehicle,
        "speed_kmh": loop.speed_kmh,
        "actuator_lag_s": loop.actuator_lag,
        "x": options.x,
        "y": options.y,
    }


def _record(chart: StabilityChart) -> dict[str, Any]:
    """Return the chart in plain values; a critical delay is null if none was found or answered."""
    status = chart.status.tolist()
    return {
        "x_name": chart.x_name,
        "x_values": chart.x_values.tolist(),
        "y_name": chart.y_name,
        "y_values": chart.y_values.tolist(),
        "max_delay_s": chart.max_delay,
        "critical_delay_s": [
            [tau if np.isfinite(tau) else None for tau in row]
            for row in chart.critical_delay.tolist()
        ],
        "frequency_hz": [[f or None for f in row] for row in chart.frequency_hz.tolist()],
        "status": status,
        "stable_windows": chart.stable_windows.tolist(),
        "proved": chart.proved.tolist(),
        "failures": _places(chart.failures),
        "unproved": _places(chart.unproved),
    }


def _places(reasons: dict[tuple[int, int], str]) -> list[dict[str, Any]]:
    return [
        {"row": row, "column": column, "reason": reason}
        for (row, column), reason in sorted(reasons.items())
    ]


def _print_table(chart: StabilityChart, loop: VariedLoop) -> None:
    """Print critical delays in milliseconds, the largest y on top, if they fit on a screen."""
    if chart.status.shape[1] > _WIDEST_TABLE or chart.status.shape[0] > _LONGEST_TABLE:
        return
    words = {
        "unstable": "unstable",
        "none": f"> {1000 * chart.max_delay:g}",
        "always": "any",
        "failed": "-",
    }
    print(f"  critical delay [ms]; down: {loop.axes[1].name}, across: {loop.axes[0].name}")
    print(" " * 12 + "".join(f"{value:10.6g}" for value in chart.x_values))
    for row in reversed(range(len(chart.y_values))):
        cells = zip(chart.status[row], chart.critical_delay[row], strict=True)
        shown = [words.get(str(word)) or f"{1000 * tau:.1f}" for word, tau in cells]
        print(f"  {chart.y_values[row]:10.6g}" + "".join(f"{text:>10}" for text in shown))
