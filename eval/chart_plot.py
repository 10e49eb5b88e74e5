"""The picture of a stability chart: critical delay as colour and contour lines over two parameters.

Colours are per point of the grid, without interpolation; contour lines interpolate between points.
A chart with one row or one column is drawn as a curve. Matplotlib is imported when a chart is
drawn, without pyplot, and none of its global settings changes.
"""

import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from eval.chart_contours import Scale, colour_scale, draw_contours, label_contours
from railenv.errors import RailenvError
from railenv.files import replacing
from railenv.stability.chart import StabilityChart
from railenv.units import FloatArray

_UNSTABLE = {"facecolor": "#f3d9cc", "edgecolor": "#d39a80", "hatch": "xxx", "linewidth": 0.0}
_NONE = {"facecolor": "#ffffff", "edgecolor": "#a8a8a8", "hatch": "---", "linewidth": 0.0}
_ALWAYS = {"facecolor": "#ffffff", "edgecolor": "#555555", "linewidth": 0.0}
_FAILED = {"facecolor": "#d9d9d9", "edgecolor": "#333333", "hatch": "////", "linewidth": 0.0}
_DARK = "#222222"
_STYLE: dict[Any, Any] = {
    "font.size": 10.0,
    "axes.edgecolor": "#555555",
    "hatch.linewidth": 0.6,
    "text.parse_math": False,
    "svg.hashsalt": "railenv",
}

_PREFIXES = {"N": ((1e6, "M"), (1e3, "k")), "kg": ((1e3, "t"),), "s": ((1.0, ""), (1e-3, "m"))}


@dataclass(frozen=True)
class AxisText:
    """What stands at an axis.

    Attributes:
        words: What changes, without the unit.
        unit: SI unit of the values, or km/h; "1" for none.
        log: Whether the axis is logarithmic.
    """

    words: str
    unit: str = "1"
    log: bool = False

    def scaled(self, values: FloatArray) -> tuple[str, FloatArray]:
        """Return the label with a unit of fitting size, and the values in that unit."""
        base, *rest = self.unit.split(" ", 1)
        head, slash, below = base.partition("/")
        largest = float(np.abs(values).max())
        for size, prefix in _PREFIXES.get(head, ()):
            if largest >= 2.0 * size:
                named = "t" if head == "kg" else prefix + head
                unit = " ".join([named + slash + below, *rest])
                return f"{self.words} [{unit}]", values / size
        unit = "" if self.unit == "1" else f" [{self.unit}]"
        return f"{self.words}{unit}", values

    def value(self, values: FloatArray) -> str:
        """Return the words and the first value with its unit."""
        label, scaled = self.scaled(values)
        words, bracket, unit = label.partition(" [")
        return f"{words} = {scaled[0]:g}{' ' if bracket else ''}{unit.removesuffix(']')}"


def check_drawing() -> None:
    """Raise `RailenvError` if matplotlib is not installed."""
    try:
        import matplotlib as _  # noqa: F401
    except ModuleNotFoundError:
        raise RailenvError(
            'a plot needs matplotlib, which is not installed: pip install "railenv[plot]"'
        ) from None


def plot_chart(
    chart: StabilityChart,
    path: Path,
    x: AxisText | None = None,
    y: AxisText | None = None,
    title: str = "Critical delay",
) -> None:
    """Draw a chart into a file.

    Args:
        chart: What to draw.
        path: Target; its ending chooses the format.
        x: Words, unit and scale of the x axis; the chart's own name of it if None.
        y: The same for the y axis.
        title: Stands over the chart.

    Raises:
        RailenvError: matplotlib is not installed.
        OutputError: The file cannot be written.
    """
    check_drawing()
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    x, y = x or AxisText(chart.x_name), y or AxisText(chart.y_name)
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)
        figure = Figure(figsize=(7.2, 5.4), layout="constrained")
        FigureCanvasAgg(figure)
        scale, below = None, _evidence(chart)
        if 1 in chart.status.shape:
            fixed = y.value(chart.y_values) if len(chart.y_values) == 1 else x.value(chart.x_values)
            below = f"{fixed}; {below}"
            _curve(figure, chart, x, y)
        else:
            scale = _map(figure, chart, x, y)
        words = textwrap.fill(title, 70) + "\n"
        figure.axes[0].set_title(words, fontsize=11)
        figure.axes[0].annotate(
            below, (0.5, 1.0), (0, 6), xycoords="axes fraction", ha="center",
            textcoords="offset points", fontsize=9, color="#555555",
        )  # fmt: skip
        if scale is not None:
            label_contours(figure, scale)
        with replacing(path) as stream:
            figure.savefig(stream, format=path.suffix[1:], dpi=200)


def _map(figure: Any, chart: StabilityChart, x: AxisText, y: AxisText) -> Scale | None:
    """Draw the chart as coloured points with contour lines and return their scale."""
    from matplotlib.colors import LogNorm, Normalize

    axes = figure.add_subplot()
    (x_label, xs), (y_label, ys) = x.scaled(chart.x_values), y.scaled(chart.y_values)
    x_edges, y_edges = _edges(xs, x.log), _edges(ys, y.log)
    _dress(axes, "x", x_label, x.log)
    _dress(axes, "y", y_label, y.log)
    status = chart.status
    known, scale = status == "critical", None
    values = np.ma.masked_array(1000.0 * np.where(known, chart.critical_delay, 1.0), ~known)
    if known.any():
        scale = colour_scale(values.compressed())
        norm = (LogNorm if scale.log else Normalize)(scale.low, scale.high)
        mesh = axes.pcolormesh(x_edges, y_edges, values, cmap="viridis", norm=norm, rasterized=True)
        bar = figure.colorbar(mesh, ax=axes, label="critical delay [ms]", pad=0.02, aspect=28)
        _ticks(bar, scale)
        draw_contours(axes, xs, ys, values, scale)
    entries = _regions(axes, chart, x_edges, y_edges)
    again = chart.stable_again
    if again.any():
        rows, columns = np.nonzero(again)
        size = max(1.2, min(3.2, 80 / max(status.shape)))
        entries += axes.plot(
            xs[columns], ys[rows], "o", ms=size, mfc="white", mec=_DARK, mew=0.6,
            label="stable again at longer delays",
        )  # fmt: skip
    axes.set(xlim=(x_edges[0], x_edges[-1]), ylim=(y_edges[0], y_edges[-1]))
    _legend(figure, entries)
    return scale


def _regions(axes: Any, chart: StabilityChart, x_edges: FloatArray, y_edges: FloatArray) -> Any:
    """Mark points without a critical delay, and the borders of their regions."""
    from matplotlib.collections import LineCollection
    from matplotlib.patches import Patch, PathPatch
    from matplotlib.path import Path as Outline

    status = chart.status
    entries: list[Any] = []
    for word, (label, style) in _styles(chart).items():
        places = np.argwhere(status == word)
        if len(places) == 0:
            continue
        boxes = [
            Outline(
                [
                    (x_edges[column + right], y_edges[row + up])
                    for right, up in ((0, 0), (1, 0), (1, 1), (0, 1), (0, 0))
                ],
                closed=True,
            )
            for row, column in places
        ]
        axes.add_patch(PathPatch(Outline.make_compound_path(*boxes), **style))
        entries.append(Patch(label=label, **{**style, "linewidth": 0.6}))

    borders = [
        [(x_edges[column + 1], y_edges[row]), (x_edges[column + 1], y_edges[row + 1])]
        for row, column in np.argwhere(status[:, 1:] != status[:, :-1])
    ] + [
        [(x_edges[column], y_edges[row + 1]), (x_edges[column + 1], y_edges[row + 1])]
        for row, column in np.argwhere(status[1:] != status[:-1])
    ]
    axes.add_collection(LineCollection(borders, colors=_DARK, linewidths=1.2, capstyle="round"))
    return entries


def _styles(chart: StabilityChart) -> dict[str, tuple[str, dict[str, Any]]]:
    """Words and looks of what a point can be instead of having a critical delay."""
    return {
        "unstable": ("unstable without delay", _UNSTABLE),
        "none": (f"no crossing up to {chart.max_delay:g} s", _NONE),
        "always": ("stable for any delay", _ALWAYS),
        "failed": ("no answer", _FAILED),
    }


def _legend(figure: Any, entries: list[Any]) -> None:
    if entries:
        figure.legend(
            handles=entries, ncols=3 if len(entries) == 3 else 2, loc="outside lower center",
            frameon=False, fontsize=9, handlelength=2.2, handleheight=1.3,
        )  # fmt: skip


def _dress(axes: Any, which: str, label: str, log: bool) -> None:
    """Give an axis its label and, if it is logarithmic, plain numbers at round places."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis = getattr(axes, f"{which}axis")
    axis.set_label_text(textwrap.fill(label, 70))
    if log:
        getattr(axes, f"set_{which}scale")("log")
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())


def _evidence(chart: StabilityChart) -> str:
    """Say how large the chart is and how much of it is proved."""
    rows, columns = chart.status.shape
    proved = int(chart.proved.sum())
    if proved == chart.proved.size:
        word = "all proved"
    else:
        word = f"{proved} proved" if proved else "exact to rounding, not proved"
    return f"{columns} \N{MULTIPLICATION SIGN} {rows} points, {word}"


def _edges(values: FloatArray, log: bool) -> FloatArray:
    """Return the borders between points, and beyond the first and the last."""
    places = np.log(values) if log else values
    middle = (places[1:] + places[:-1]) / 2
    edges = np.concatenate([[2 * places[0] - middle[0]], middle, [2 * places[-1] - middle[-1]]])
    return np.exp(edges) if log else edges


def _ticks(bar: Any, scale: Scale) -> None:
    """Put the contour levels on the colour bar."""
    bar.set_ticks(scale.levels, labels=[f"{level:g}" for level in scale.levels])
    bar.minorticks_off()
    bar.outline.set_linewidth(0.6)


def _curve(figure: Any, chart: StabilityChart, x: AxisText, y: AxisText) -> None:
    """Draw a chart with one row or one column as critical delay over the other parameter."""
    axes = figure.add_subplot()
    along, over = (x, chart.x_values) if len(chart.y_values) == 1 else (y, chart.y_values)
    label, places = along.scaled(over)
    _dress(axes, "x", label, along.log)
    axes.set_ylabel("critical delay [ms]")
    status, again = chart.status.ravel(), chart.stable_again.ravel()
    known = status == "critical"
    delays = 1000.0 * np.where(known, chart.critical_delay.ravel(), np.nan)
    axes.plot(places, delays, "-o", color="#0072b2", lw=1.5, ms=4.5, label="critical delay")
    top = 1.12 * float(np.max(delays[known], initial=0.0)) or 1000.0 * chart.max_delay
    axes.set_ylim(0.0, top)
    axes.grid(color="#e4e4e4", lw=0.7)
    axes.set_axisbelow(True)
    marks = {
        "unstable": (0.0, {"marker": "X", "color": "#b04a00"}),
        "none": (top, {"marker": "^", "color": _DARK, "mfc": "white"}),
        "always": (top, {"marker": "D", "color": _DARK, "mfc": "white"}),
        "failed": (0.0, {"marker": "s", "color": "#777777", "mfc": "white"}),
    }
    for word, (height, style) in marks.items():
        here = places[status == word]
        if len(here):
            axes.plot(
                here, np.full(len(here), height), ls="none", ms=7, clip_on=False, zorder=4,
                label=_styles(chart)[word][0], **style,
            )  # fmt: skip
    if again.any():
        heights = np.where(known, delays, 0.0)[again]
        axes.plot(
            places[again], heights, "o", ms=10, mfc="none", mec=_DARK, mew=0.9, clip_on=False,
            label="stable again at longer delays",
        )  # fmt: skip
    handles = axes.get_legend_handles_labels()[0]
    _legend(figure, handles if len(handles) > 1 else [])
