"""The delay pipe: commands on their way from the controller to the actuators.

A command enters at the left with age zero and moves to the right as it ages. At its actuator's
delay it acts: bars left of that mark are still to come, bars right of it are history.
"""

import numpy as np

from railenv.rendering.scales import kilonewtons, round_steps, signed
from railenv.rendering.shapes import (
    COMMAND,
    FORCE,
    FRAME,
    GRID,
    STEEL,
    Line,
    Panel,
    Polygon,
    Shape,
    Text,
    rectangle,
)
from railenv.rendering.view import View
from railenv.units import FloatArray

_LABEL_WIDTH = 62.0  # left of the pipe, actuator's name [design pixels]
_VALUE_WIDTH = 92.0  # right of the pipe, numbers
_TITLE_HEIGHT = 33.0
_AXIS_HEIGHT = 30.0
_THINNEST_BAR = 2.0
_SHORTEST_AXIS = 1e-3
"""Axis of a pipe without delay [s]."""

_PLACE_NAMES = {1: "1 front", 2: "2 front", 3: "3 rear", 4: "4 rear"}


def pipe(view: View, panel: Panel, full_scale: float) -> list[Shape]:
    """Return the shapes of the delay pipe, one row per actuator.

    Args:
        view: What is shown.
        panel: Where; title, time axis and numbers are inside it.
        full_scale: Force whose bar has full height [N].
    """
    unit = panel.unit
    left, right = panel.left + _LABEL_WIDTH * unit, panel.right - _VALUE_WIDTH * unit
    top, bottom = panel.top + _TITLE_HEIGHT * unit, panel.bottom - _AXIS_HEIGHT * unit
    longest = axis_length(view)

    def at(age: float) -> float:
        return left + (right - left) * age / longest

    shapes = _axis(panel, top, bottom, longest, left, right)
    row_height = (bottom - top) / view.num_actuators
    age, command = _thinned(view, longest, right - left, unit)
    spacing = (right - left) * (float(np.min(np.diff(age))) / longest if len(age) > 1 else 0.05)
    half_bar = 0.5 * max(0.8 * spacing, unit)
    places = left + (right - left) * age / longest
    starts = np.maximum(places - half_bar, left).tolist()
    ends = np.minimum(places + half_bar, right).tolist()
    for channel, place in enumerate(view.places):
        middle = top + (channel + 0.5) * row_height
        reach = 0.42 * row_height
        delay = float(view.delay[channel])
        shapes.append(Line(((left, middle), (right, middle)), FRAME, unit))
        heights = reach * np.clip(command[:, channel] / full_scale, -1.0, 1.0)
        for start, end, y, waiting in zip(
            starts, ends, (middle - heights).tolist(), (age < delay).tolist(), strict=True
        ):
            colour = COMMAND if waiting else FRAME
            shapes.append(rectangle(start, y, end, middle, colour, name=f"bar_{place}"))
        shapes += _acting(at(min(delay, longest)), middle, reach, unit, f"acts_{place}")
        shapes += _numbers(view, channel, panel, middle, right)
        name = _PLACE_NAMES[place]
        shapes.append(Text((panel.left + 8.0 * unit, middle), name, 15.0 * unit, name="channel"))
    limit = "none" if view.force_limit is None else kilonewtons(view.force_limit)
    scale = f"full bar {kilonewtons(full_scale)}, up is right; limit {limit}"
    shapes.append(
        Text(
            (panel.right - 8.0 * unit, panel.top + 10.0 * unit), scale, 14.0 * unit, STEEL, "right"
        )
    )
    return shapes


def axis_length(view: View) -> float:
    """Return the length of the pipe's axis [s]: the longest delay, or a millisecond without any."""
    return max(view.max_delay, _SHORTEST_AXIS)


def _thinned(
    view: View, longest: float, width: float, unit: float
) -> tuple[FloatArray, FloatArray]:
    """Return the commands inside the pipe, every n-th if there are more than bars fit."""
    inside = view.pipe_age <= longest
    age, command = view.pipe_age[inside], view.pipe_command[inside]
    step = max(1, int(np.ceil(len(age) * _THINNEST_BAR * unit / width)))
    return age[::step], command[::step]


def _axis(
    panel: Panel, top: float, bottom: float, longest: float, left: float, right: float
) -> list[Shape]:
    unit = panel.unit
    shapes: list[Shape] = [
        Text((panel.left + 8.0 * unit, panel.top + 10.0 * unit), "Delay pipe", 16.0 * unit),
        Text((left, top - 8.0 * unit), "command now", 14.0 * unit, COMMAND),
    ]
    for time in round_steps(longest, 5):
        x = left + (right - left) * time / longest
        shapes.append(Line(((x, top), (x, bottom + 4.0 * unit)), GRID, unit))
        label = f"{1000.0 * time:g}"
        shapes.append(Text((x, bottom + 10.0 * unit), label, 14.0 * unit, STEEL, "centre", "age"))
    where = (0.5 * (left + right), bottom + 21.0 * unit)
    shapes.append(Text(where, "age of the command [ms]", 14.0 * unit, STEEL, "centre"))
    return shapes


def _acting(x: float, middle: float, reach: float, unit: float, name: str) -> list[Shape]:
    """Return the mark where a command becomes a force."""
    half, top = 4.5 * unit, middle - reach
    triangle = ((x - half, top - 2.0 * unit), (x + half, top - 2.0 * unit), (x, top + 5.0 * unit))
    return [
        Line(((x, top), (x, middle + reach)), FORCE, 2.0 * unit, name),
        Polygon(triangle, FORCE),
    ]


def _numbers(view: View, channel: int, panel: Panel, middle: float, left: float) -> list[Shape]:
    unit, edge = panel.unit, panel.right - 8.0 * panel.unit
    start, apart = left + 10.0 * unit, 6.0 * unit
    command = f"{signed(float(view.command[channel]) / 1000.0)}"
    force = f"{signed(float(view.force[channel]) / 1000.0)} kN"
    return [
        Text((start, middle - apart), "now", 14.0 * unit, COMMAND),
        Text(
            (edge, middle - apart), f"{command} kN", 14.0 * unit, COMMAND, "right", "command_text"
        ),
        Text((start, middle + apart), "acts", 14.0 * unit, FORCE),
        Text((edge, middle + apart), force, 14.0 * unit, FORCE, "right", "force_text"),
    ]
