"""Strip charts of the floor's acceleration and the running ride index."""

import numpy as np

from railenv.rendering.scales import fraction_of, plain, round_limit, round_steps, signed
from railenv.rendering.shapes import (
    FLOORS,
    FRAME,
    GRID,
    INK,
    STEEL,
    Line,
    Panel,
    Point,
    Shape,
    Text,
    rectangle,
)
from railenv.rendering.view import View
from railenv.units import FloatArray

FLOOR_NAMES = ("front", "rear")

SHORTEST_HISTORY = 5.0
"""The strip charts' time axis is at least this long [s], so that it does not run at the start."""

LEAST_ACCELERATION = 0.2
"""Smallest limit of the strip charts' axis [m/s^2]: a quiet ride looks quiet."""

INDEX_LIMIT = 4.0
"""End of the ride index's axis [1]."""

INDEX_GRADES = (2.5, 3.0)
"""Grades marked on it: below 2.5 excellent, above 3.0 outside the grades (GB/T 5599)."""

_LABEL_WIDTH = 46.0  # axis numbers, left [design pixels]
_VALUE_WIDTH = 52.0  # present value, right


def strips(view: View, panel: Panel) -> list[Shape]:
    """Return the strip charts, floor front above floor rear, the present at the right edge."""
    unit = panel.unit
    left, right = panel.left + _LABEL_WIDTH * unit, panel.right - _VALUE_WIDTH * unit
    top, bottom = panel.top + 20.0 * unit, panel.bottom - 16.0 * unit
    span = max(-float(view.history_time[0]), SHORTEST_HISTORY)
    limit = round_limit(float(np.abs(view.history_acceleration).max()), LEAST_ACCELERATION)
    where = (panel.left + 8.0 * unit, panel.top + 10.0 * unit)
    shapes: list[Shape] = [Text(where, "Floor acceleration [m/s^2]", 16.0 * unit)]
    for time in round_steps(span, 6):
        x = right - (right - left) * time / span
        shapes.append(Line(((x, top), (x, bottom)), GRID, unit))
        label = "now" if time == 0.0 else f"-{time:g} s"
        place = (x, bottom + 8.0 * unit)
        name = "present" if time == 0.0 else ""
        shapes.append(Text(place, label, 14.0 * unit, STEEL, "centre", name))
    gap = 6.0 * unit
    high = 0.5 * (bottom - top - gap)
    for floor, name in enumerate(FLOOR_NAMES):
        upper = top + floor * (high + gap)
        middle = upper + 0.5 * high
        shapes.append(rectangle(left, upper, right, upper + high, None, FRAME))
        shapes.append(Line(((left, middle), (right, middle)), FRAME, unit))
        for sign in (1, -1):
            y = middle - sign * (0.5 * high - 5.0 * unit)
            text = f"{'+' if sign > 0 else '-'}{plain(limit, 1)}"
            shapes.append(Text((left - 4.0 * unit, y), text, 14.0 * unit, STEEL, "right", "limit"))
        past = view.history_acceleration[:, floor]
        x = right + (right - left) * view.history_time / span
        y = middle - 0.5 * high * np.clip(past / limit, -1.0, 1.0)
        shapes.append(Line(_envelope(x, y), FLOORS[floor], 1.5 * unit, f"floor_{name}"))
        edge = right + 6.0 * unit
        present = signed(float(past[-1]))
        text = Text((edge, middle - 6.0 * unit), name, 14.0 * unit, FLOORS[floor])
        number = Text((edge, middle + 6.0 * unit), present, 14.0 * unit, FLOORS[floor])
        shapes += [text, number]
    return shapes


def _envelope(x: FloatArray, y: FloatArray) -> tuple[Point, ...]:
    """Return the curve as points; of more than four per pixel, the extremes, so no peak is lost."""
    count = len(x)
    columns = max(1, int(x[-1] - x[0]))
    if count <= 4 * columns:
        return tuple(zip(x.tolist(), y.tolist(), strict=True))
    starts = np.unique(np.arange(columns) * count // columns)
    low, high = np.minimum.reduceat(y, starts), np.maximum.reduceat(y, starts)
    points = np.column_stack([np.repeat(x[starts], 2), np.column_stack([low, high]).ravel()])
    return (*((float(a), float(b)) for a, b in points), (float(x[-1]), float(y[-1])))


def ride_index(view: View, panel: Panel) -> list[Shape]:
    """Return the running ride index of both floor ends as bars with their numbers."""
    unit = panel.unit
    left, right = panel.left + 44.0 * unit, panel.right - 52.0 * unit
    top, bottom = panel.top + 24.0 * unit, panel.bottom - 30.0 * unit
    where = (panel.left + 8.0 * unit, panel.top + 10.0 * unit)
    shapes: list[Shape] = [Text(where, "Running ride index", 16.0 * unit)]
    high = 0.5 * (bottom - top)
    for floor, name in enumerate(FLOOR_NAMES):
        middle = top + (floor + 0.5) * high
        half = 0.3 * high
        value = float(view.ride_index[floor])
        known = not np.isnan(value)
        end = left + (right - left) * (fraction_of(value, INDEX_LIMIT) if known else 0.0)
        shapes.append(rectangle(left, middle - half, right, middle + half, GRID))
        bar = rectangle(
            left, middle - half, end, middle + half, FLOORS[floor], name=f"index_{name}"
        )
        shapes.append(bar)
        text = plain(value) if known else "--"
        shapes.append(Text((panel.left + 8.0 * unit, middle), name, 15.0 * unit, FLOORS[floor]))
        edge = (panel.right - 8.0 * unit, middle)
        shapes.append(Text(edge, text, 20.0 * unit, INK, "right", f"index_{name}_text"))
    for grade in INDEX_GRADES:
        x = left + (right - left) * grade / INDEX_LIMIT
        shapes.append(Line(((x, top), (x, bottom + 2.0 * unit)), INK, unit, "grade"))
        place = (x, bottom + 8.0 * unit)
        shapes.append(Text(place, f"{grade:g}", 14.0 * unit, STEEL, "centre"))
    for end, x in ((0.0, left), (INDEX_LIMIT, right)):
        place = (x, bottom + 8.0 * unit)
        shapes.append(Text(place, f"{end:g}", 14.0 * unit, STEEL, "centre"))
    place = (0.5 * (left + right), bottom + 20.0 * unit)
    shapes.append(Text(place, "excellent < 2.5, limit 3", 14.0 * unit, STEEL, "centre"))
    return shapes
