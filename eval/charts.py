"""The report's charts: plain numbers in, SVG with text as text out.

Every chart is one panel, so that a page can lay panels out beside or below each other. Names that
users chose stay out of the charts; the page around them holds those. Matplotlib is imported when a
chart is drawn, without pyplot, and none of its global settings changes.
"""

import io
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

BLUE, VERMILLION, GREEN, PURPLE, ORANGE, GREY = (
    "#0072b2", "#d55e00", "#009e73", "#b0578f", "#b87d00", "#555555",
)  # fmt: skip
"""Okabe and Ito's palette for readers with any colour vision, the light ones darkened."""

MARKERS = "os^Dv<>p"
PUBLISHED = {"gain": 35e3, "delay": 0.202, "delay_time_domain": 0.197, "frequency": 1.323}
"""Chen, Shi, Yu, J. Vib. Control, doi 10.1177/10775463261463161: 4 actuators, 300 km/h."""

_STRIP_STEP = 6.5
"""Distance between rows of triangles [pt]."""

_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "railenv",
    "text.parse_math": False,
    "font.size": 10.0,
    "axes.labelsize": 10.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#555555",
    "axes.grid": True,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.7,
    "lines.linewidth": 1.5,
}


@dataclass(frozen=True)
class Line:
    """One controller's line in a chart over delay; None where runs blew up."""

    color: str
    marker: str
    dash: str
    width: float
    delays_ms: Sequence[float]
    values: Sequence[float | None]
    diverged: Sequence[bool]
    critical_ms: float | None


@dataclass(frozen=True)
class GainCurve:
    """Critical delays of one layout over the sky-hook gain; None where no crossing was found.

    Attributes:
        label: The layout in words.
        color: Of line and markers.
        marker: Shape of the markers.
        gains: Gains [N s/m].
        continuous: Critical delays of the continuous loop [s].
        sampled: Critical delays of the sampled loop [s].
        frequencies: Crossing frequencies [Hz].
    """

    label: str
    color: str
    marker: str
    gains: Sequence[float]
    continuous: Sequence[float | None]
    sampled: Sequence[float | None]
    frequencies: Sequence[float | None]


def gain_colors(count: int) -> list[str]:
    """Return `count` colours of viridis from its lighter part to its dark end."""
    import matplotlib as mpl
    from matplotlib.colors import to_hex

    place = [0.76 * (1 - k / max(1, count - 1)) for k in range(count)]
    return [to_hex(mpl.colormaps["viridis"](p)) for p in place]


def _above(line: Line, high: float) -> list[float]:
    points = zip(line.delays_ms, line.values, line.diverged, strict=True)
    return [d for d, v, bad in points if (v is None and bad) or (v is not None and v > high)]


def rows_above(lines: Sequence[Line], high: float) -> int:
    """Return how many lines have something above the range's upper end."""
    return sum(bool(_above(line, high)) for line in lines)


def delay_chart(
    name: str,
    lines: Sequence[Line],
    ylabel: str,
    limits: tuple[float, float],
    size: tuple[float, float],
    strip_rows: int,
) -> str:
    """Draw a measure against delay.

    Hollow markers are diverged runs. What lies above the range stands in a strip over the axes,
    one row of triangles per controller. Ticks at the bottom are critical delays.

    Args:
        name: Unique in the page.
        lines: One per controller.
        ylabel: Measure and unit.
        limits: Range shown.
        size: Width and height of the chart [in].
        strip_rows: Rows to keep free above the axes, at least `rows_above`.

    Returns:
        The SVG element.
    """

    def draw(figure: Any) -> None:
        # Fixed margins in points: panels beside each other have axes of one size.
        width, height = 72.0 * size[0], 72.0 * size[1]
        strip = 6.0 + _STRIP_STEP * strip_rows
        place = (46 / width, 40 / height, 1 - 54 / width, 1 - (40 + strip) / height)
        figure.set_layout_engine("none")
        axes = figure.add_axes(place)
        row = 0
        for k, line in enumerate(lines):
            _draw_line(axes, line, limits[1], stagger=k % 3)
            above = _above(line, limits[1])
            if above:
                _strip(axes, above, line, 5.0 + _STRIP_STEP * row)
                row += 1
        if row:
            axes.annotate(
                "above the range:", (0.0, 1.0), (2, 3), xycoords="axes fraction",
                textcoords="offset points", fontsize=8.5, color="#444444",
            )  # fmt: skip
        longest = max((d for line in lines for d in line.delays_ms), default=1.0)
        axes.set(xlim=(-0.01 * longest, 1.02 * longest or 1.0), ylim=limits)
        axes.set(xlabel="delay [ms]", ylabel=ylabel)

    return svg(name, size, draw)


def _draw_line(axes: Any, line: Line, high: float, stagger: int) -> None:
    values = [float("nan") if v is None else v for v in line.values]
    axes.plot(line.delays_ms, values, color=line.color, ls=line.dash, lw=line.width)
    points = list(zip(line.delays_ms, values, line.diverged, strict=True))
    every = 1 if len(points) <= 10 else 3
    good = [
        (d, v) for k, (d, v, bad) in enumerate(points) if not bad and k % every == stagger % every
    ]
    bad = [(d, v) for d, v, diverged in points if diverged and v <= high]
    style: dict[str, Any] = {"color": line.color, "marker": line.marker, "ls": "none", "ms": 4.2}
    if line.dash == "-" or every == 1:
        axes.plot(*columns(good), **style)
    axes.plot(*columns(bad), **{**style, "ms": 6.5}, mfc="white", mew=1.4, zorder=5)
    if line.critical_ms is not None and line.critical_ms <= max(line.delays_ms):
        place = axes.get_xaxis_transform()
        at = [line.critical_ms] * 2
        axes.plot(at, [0, 0.09], color=line.color, lw=2.4, transform=place, solid_capstyle="butt")


def _strip(axes: Any, delays: Sequence[float], line: Line, height: float) -> None:
    """Draw a row of triangles at a height in points over the axes."""
    from matplotlib.transforms import ScaledTranslation

    figure = axes.get_figure()
    lifted = ScaledTranslation(0.0, height / 72.0, figure.dpi_scale_trans)
    axes.plot(
        delays, [1.0] * len(delays), marker="^", ls="none", ms=4.4, color=line.color, mfc="white",
        mew=1.1, transform=axes.get_xaxis_transform() + lifted, clip_on=False,
    )  # fmt: skip


def columns(points: Sequence[tuple[float, float]]) -> tuple[list[float], list[float]]:
    """Return the first and the second entries of points as two lists."""
    return [p[0] for p in points], [p[1] for p in points]


def gain_charts(
    name: str, curves: Sequence[GainCurve], longest: float, published: bool
) -> tuple[str, str, str]:
    """Draw critical delay, crossing frequency and their product against the sky-hook gain.

    Args:
        name: Unique in the page.
        curves: One per layout.
        longest: Longest delay searched [s].
        published: Whether the published point belongs to these curves.

    Returns:
        Three SVG elements.
    """

    def delay(figure: Any) -> None:
        axes = figure.add_subplot()
        top = 1000 * max((v for c in curves for v in c.continuous if v is not None), default=0.1)
        arrows = 0
        top = 1.18 * max(top, 220.0 if published else 0.0)
        for c in curves:
            axes.plot(*_known(c, c.continuous, 1000), color=c.color, marker=c.marker, label=c.label)
            axes.plot(
                *_known(c, c.sampled, 1000), color=c.color, marker=c.marker, ls=":", mfc="white",
                ms=4, label=f"{c.label}, sampled",
            )  # fmt: skip
            for gain, value, sampled in zip(c.gains, c.continuous, c.sampled, strict=True):
                if value is None and sampled is None:
                    # Arrows of two layouts at one gain stand beside, their notes below each other.
                    place = gain / 1000 * (1 + 0.04 * curves.index(c))
                    axes.annotate(
                        "", (place, top), (place, 0.8 * top),
                        arrowprops={"arrowstyle": "-|>", "color": c.color, "lw": 2},
                    )  # fmt: skip
                    axes.annotate(
                        f"none up to {longest:g} s", (place, (0.95 - 0.05 * arrows) * top), (7, 0),
                        textcoords="offset points", va="center", fontsize=9, color=c.color,
                    )  # fmt: skip
                    arrows += 1
        if published:
            _published(axes, "delay", 1000.0, "Chen, Shi, Yu (published)")
            axes.plot(
                PUBLISHED["gain"] / 1000, 1000 * PUBLISHED["delay_time_domain"], "x", ms=8, mew=2,
                color="#222222", label="the same, time domain", zorder=6,
            )  # fmt: skip
        axes.set(ylim=(0.0, top), ylabel="critical delay [ms]")
        _finish(axes, curves, legend=True)

    def frequency(figure: Any) -> None:
        axes = figure.add_subplot()
        for c in curves:
            axes.plot(*_known(c, c.frequencies, 1), color=c.color, marker=c.marker)
        if published:
            _published(axes, "frequency", 1.0, "")
        axes.set(ylabel="crossing frequency [Hz]")
        axes.set_ylim(0.0, 1.08 * axes.get_ylim()[1])
        _finish(axes, curves)

    def product(figure: Any) -> None:
        axes = figure.add_subplot()
        for c in curves:
            pairs = zip(c.continuous, c.frequencies, strict=True)
            values = [None if t is None or f is None else t * f for t, f in pairs]
            axes.plot(*_known(c, values, 1), color=c.color, marker=c.marker)
        if published:
            gain, value = PUBLISHED["gain"] / 1000, PUBLISHED["delay"] * PUBLISHED["frequency"]
            axes.plot(gain, value, "*", ms=13, mfc="white", mec="#222222", mew=1.2, zorder=6)
        axes.set(ylabel="frequency \N{MULTIPLICATION SIGN} delay [1]")
        axes.set_ylim(0.0, 1.08 * axes.get_ylim()[1])
        _finish(axes, curves)

    parts: list[tuple[str, tuple[float, float], Callable[[Any], None]]] = [
        ("delay", (5.0, 4.9), delay),
        ("frequency", (5.0, 2.28), frequency),
        ("product", (5.0, 2.28), product),
    ]
    first, second, third = (svg(f"{name}-{part}", size, draw) for part, size, draw in parts)
    return first, second, third


def _known(
    curve: GainCurve, values: Sequence[float | None], scale: float
) -> tuple[list[float], list[float]]:
    pairs = zip(curve.gains, values, strict=True)
    return columns([(gain / 1000, scale * v) for gain, v in pairs if v is not None])


def _published(axes: Any, key: str, scale: float, label: str) -> None:
    axes.plot(
        PUBLISHED["gain"] / 1000, scale * PUBLISHED[key], "*", ms=13, mfc="white", mec="#222222",
        mew=1.2, ls="none", label=label, zorder=6,
    )  # fmt: skip


def _finish(axes: Any, curves: Sequence[GainCurve], legend: bool = False) -> None:
    largest = max((gain for c in curves for gain in c.gains), default=1.0) / 1000
    axes.set(xlim=(0.0, 1.06 * largest or 1.0), xlabel="sky-hook gain [kN s/m]")
    if legend:
        axes.get_figure().legend(frameon=False, fontsize=9, loc="outside lower center", ncols=2)


def svg(name: str, size: tuple[float, float], draw: Callable[[Any], None]) -> str:
    """Draw a figure and return an SVG element that can stand in a page beside others."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    stream = io.StringIO()
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)
        figure = Figure(figsize=size, layout="constrained")
        draw(figure)
        nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
        figure.savefig(stream, format="svg", transparent=True, metadata=nothing)
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    # Inside a page an SVG needs no name spaces, and its style sheet and ids would be the page's.
    text = re.sub(
        r"<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->", "", text, flags=re.DOTALL
    )
    text = re.sub(r' xmlns(:\w+)?="[^"]*"', "", text).replace("xlink:href=", "href=")
    text = re.sub(r'(<svg [^>]*?)width="[^"]*"', r"\1", text, count=1)
    text = re.sub(r'(<svg [^>]*?)height="[^"]*"', r"\1", text, count=1)
    text = re.sub(r' id="', f' id="{name}-', text)
    return text.replace('href="#', f'href="#{name}-').replace("url(#", f"url(#{name}-").strip()
