"""Contour lines of a stability chart: round levels, labels kept apart."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from railenv.units import FloatArray

# Critical delays that differ by more than this factor get a logarithmic colour scale.
_WIDE = 4.0
_MOST_LEVELS = 9
# Shortest line that is labelled, length of a label, distance between the middles of labels [pt].
_LINE_LENGTH, _LABEL_LENGTH, _LABEL_GAP = 55.0, 46.0, 48.0
# A label stands where the line under it is this much of its length and bends less than this [pt].
_STRAIGHT, _BULGE = 0.93, 5.0
_DARK = "#222222"
_CONTOURS = "_contours"


@dataclass(frozen=True)
class Scale:
    """Range of the colours and round levels for contour lines [ms]."""

    low: float
    high: float
    levels: tuple[float, ...]
    log: bool


def colour_scale(values: FloatArray) -> Scale:
    """Return the scale that suits critical delays [ms]."""
    from matplotlib.ticker import MaxNLocator

    low, high = float(values.min()), float(values.max())
    if low == high:
        return Scale(0.9 * low, 1.1 * high, (low,), log=False)
    if high <= _WIDE * low:
        places = MaxNLocator(_MOST_LEVELS, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high)
        return Scale(low, high, tuple(float(v) for v in places if low < v < high), log=False)
    decades = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    levels: list[float] = []
    for factors in ((1, 1.5, 2, 3, 4, 5, 7), (1, 2, 3, 5), (1, 2, 5), (1, 3), (1,)):
        levels = [f * 10.0**d for d in decades for f in factors if low < f * 10.0**d < high]
        if len(levels) <= _MOST_LEVELS:
            break
    return Scale(low, high, tuple(levels), log=True)


def draw_contours(axes: Any, xs: FloatArray, ys: FloatArray, values: Any, scale: Scale) -> None:
    """Draw contour lines of masked values [ms] where all points around have one."""
    from matplotlib.patheffects import withStroke

    if not scale.levels or values.min() == values.max():
        return
    # Between points the values are interpolated as the colours are spaced.
    heights, levels = (
        (np.ma.log(values), np.log(scale.levels)) if scale.log else (values, scale.levels)
    )
    lines = axes.contour(xs, ys, heights, levels=levels, colors="white", linewidths=1.1)
    lines.set_path_effects([withStroke(linewidth=2.2, foreground=_DARK, alpha=0.6)])
    lines.set_label(_CONTOURS)


def label_contours(figure: Any, scale: Scale) -> None:
    """Label contour lines where there is room; the colour bar's ticks name every level."""
    from matplotlib.patheffects import withStroke

    axes = figure.axes[0]
    found = [c for c in axes.collections if c.get_label() == _CONTOURS]
    if not found:
        return
    figure.draw_without_rendering()  # places the axes, so that distances on paper are known
    taken: list[FloatArray] = []
    chosen: list[tuple[float, float]] = []
    for lines in found[0].allsegs:
        for line in sorted(lines, key=len, reverse=True):
            paper = axes.transData.transform(line) * 72.0 / figure.dpi
            place = _room(paper, taken)
            if place is not None:
                taken.append(place)
                chosen.append(tuple(axes.transData.inverted().transform(place * figure.dpi / 72.0)))
    heights = np.log(scale.levels) if scale.log else scale.levels
    words = {h: f"{level:g} ms" for h, level in zip(heights, scale.levels, strict=True)}
    labels = axes.clabel(
        found[0], fmt=words, fontsize=8.5, inline_spacing=4, manual=chosen, zorder=5
    )
    for label in labels or ():
        label.set_path_effects([withStroke(linewidth=2.0, foreground=_DARK)])
        if 180.0 < label.get_rotation() % 360.0 < 300.0:
            label.set_rotation(label.get_rotation() + 180.0)  # steep labels all read upwards


def _room(line: FloatArray, taken: list[FloatArray]) -> FloatArray | None:
    """Return a place on a line [pt] where a label fits: straight, and away from other labels."""
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])

    def at(along: float) -> FloatArray:
        return np.array([np.interp(along, length, line[:, k]) for k in (0, 1)])

    if length[-1] >= _LINE_LENGTH:
        for share in (0.5, 0.4, 0.6, 0.3, 0.7, 0.2, 0.8):
            middle = share * length[-1]
            start, end = middle - _LABEL_LENGTH / 2, middle + _LABEL_LENGTH / 2
            if start < 0.0 or end > length[-1]:
                continue
            place = at(middle)
            straight = np.hypot(*(at(end) - at(start))) > _STRAIGHT * _LABEL_LENGTH
            bulge = np.hypot(*(place - (at(start) + at(end)) / 2)) < _BULGE
            if straight and bulge and all(np.hypot(*(place - t)) > _LABEL_GAP for t in taken):
                return place
    return None
