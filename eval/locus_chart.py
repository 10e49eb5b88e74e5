"""The chart of a root locus: dots coloured by delay, crossings as diamonds, labels kept apart."""

import math
from collections.abc import Sequence
from typing import Any

from eval.charts import VERMILLION, columns, svg

LOCUS_REAL = (-6.0, 2.0)
LOCUS_HZ = (0.0, 5.0)


def locus_chart(
    name: str, locus: dict[str, Any], crossings: Sequence[dict[str, Any]], small: bool = False
) -> str:
    """Draw how characteristic roots move with the delay.

    Args:
        name: Unique in the page.
        locus: `root_locus` of a stability record.
        crossings: `crossings` of the same record.
        small: Fewer points, no labels of modes, no colour bar.

    Returns:
        The SVG element.
    """

    def draw(figure: Any) -> None:
        import matplotlib as mpl
        from matplotlib.colors import ListedColormap

        delays = [1000.0 * d for d in locus["delay_s"]]
        kept = range(0, len(delays), 2 if small else 1)
        viridis = mpl.colormaps["viridis"]
        shades = ListedColormap([viridis(0.93 * k / 255) for k in range(256)])
        axes = figure.add_subplot()
        axes.axvspan(0.0, LOCUS_REAL[1], color="#d55e00", alpha=0.08, lw=0)
        axes.axvline(0.0, color="#222222", lw=1.4)
        clouds, labels, points = None, [], []
        for mode in locus["modes"]:
            shown = [
                k
                for k in kept
                if mode["re"][k] is not None
                and _inside((mode["re"][k], mode["im"][k] / (2 * math.pi)))
            ]
            seen = [(mode["re"][k], mode["im"][k] / (2 * math.pi)) for k in shown]
            if not seen:
                continue
            clouds = axes.scatter(
                *columns(seen), c=[delays[k] for k in shown], cmap=shades,
                vmin=delays[0], vmax=delays[-1], s=9 if small else 16, zorder=3, lw=0,
            )  # fmt: skip
            points += seen
            if shown[0] == 0:
                axes.plot(*seen[0], "o", ms=5 if small else 7, mfc="none", mec="#222222", zorder=4)
            if shown[0] == 0 or max(real for real, _ in seen) > 0.0:
                labels.append((str(mode["name"]), seen[0], "#222222"))
        axes.set(xlim=LOCUS_REAL, ylim=LOCUS_HZ)
        axes.set(xlabel="real part [1/s]", ylabel="Im / 2\N{GREEK SMALL LETTER PI} [Hz]")
        if clouds is not None and not small:
            figure.colorbar(clouds, ax=axes, label="delay [ms]", pad=0.02, aspect=30)
        marks = []
        for crossing in crossings:
            place = (0.0, crossing["frequency_hz"])
            if crossing["delay_s"] <= locus["delay_s"][-1] and _inside(place):
                axes.plot(*place, "D", ms=7, mfc="white", mec=VERMILLION, mew=1.8, zorder=6)
                marks.append((f"{1000 * crossing['delay_s']:.0f} ms", place, "#a34700"))
        _place_labels(figure, axes, ([] if small else labels) + marks, points)
        for text, height in (("stable", "right"), ("unstable", "left")):
            shift = -5 if height == "right" else 5
            axes.annotate(
                text, (0.0, LOCUS_HZ[1]), (shift, -4), textcoords="offset points",
                ha=height, va="top", fontsize=9, color="#444444",
            )  # fmt: skip

    return svg(name, (3.5, 2.7) if small else (5.0, 4.0), draw)


def _inside(point: tuple[float, float]) -> bool:
    real, hertz = point
    return LOCUS_REAL[0] <= real <= LOCUS_REAL[1] and LOCUS_HZ[0] <= hertz <= LOCUS_HZ[1]


def _place_labels(
    figure: Any,
    axes: Any,
    labels: Sequence[tuple[str, tuple[float, float], str]],
    points: Sequence[tuple[float, float]],
) -> None:
    """Write each label near its point where it covers the fewest points and no other label."""
    import numpy as np

    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    dots = axes.transData.transform(points) if points else np.empty((0, 2))
    box = axes.get_window_extent()
    wall = axes.transData.transform((0.0, 0.0))[0]
    scale = figure.dpi / 72.0
    anchors = [tuple(axes.transData.transform(point)) for _, point, _ in labels]
    taken: list[tuple[float, float, float, float]] = []
    for (text, point, color), (x0, y0) in zip(labels, anchors, strict=True):
        note = axes.annotate(
            text, point, (0, 0), textcoords="offset points", ha="center", va="center",
            fontsize=9.5, color=color, zorder=7,
            arrowprops={"arrowstyle": "-", "color": color, "lw": 0.7, "shrinkA": 1, "shrinkB": 4},
        )  # fmt: skip
        extent = note.get_window_extent()
        # Readers' fonts may run wider than the one measured with.
        half_w, half_h = 0.55 * extent.width + 2 * scale, 0.5 * extent.height + 1 * scale
        best: tuple[float, float, float] | None = None
        for radius in (16, 26, 38, 52, 68, 90, 115):
            for angle in range(0, 360, 15):
                dx = radius * scale * np.cos(np.radians(angle)) * 1.6
                dy = radius * scale * np.sin(np.radians(angle))
                x, y = x0 + dx, y0 + dy
                edges = (x - half_w, y - half_h, x + half_w, y + half_h)
                covered = np.sum(
                    (np.abs(dots[:, 0] - x) < half_w + 2 * scale)
                    & (np.abs(dots[:, 1] - y) < half_h + 2 * scale)
                )
                clash = sum(_overlap(edges, other) for other in taken)
                outside = edges[0] < box.x0 or edges[2] > box.x1 or edges[1] < box.y0
                outside = outside or edges[3] > box.y1 - 14 * scale
                on_wall = edges[0] < wall < edges[2]
                crossed = sum(
                    o[0] < x0 + part * dx < o[2] and o[1] < y0 + part * dy < o[3]
                    for o in taken
                    for part in (0.2, 0.4, 0.6, 0.8)
                )
                cost = 3 * covered + 200 * clash + 500 * outside + 20 * on_wall + 0.3 * radius
                stray = min(
                    (float(np.hypot(x - a, y - b)) for a, b in anchors if (a, b) != (x0, y0)),
                    default=np.inf,
                )
                cost += 15 * crossed + 15 * (stray < np.hypot(dx, dy))
                if best is None or cost < best[0]:
                    best = (float(cost), dx, dy)
        assert best is not None
        _, dx, dy = best
        note.set_position((dx / scale, dy / scale))
        taken.append((x0 + dx - half_w, y0 + dy - half_h, x0 + dx + half_w, y0 + dy + half_h))
        for part in (0.2, 0.4, 0.6, 0.8):
            x, y = x0 + part * dx, y0 + part * dy
            taken.append((x - scale, y - scale, x + scale, y + scale))


def _overlap(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]
