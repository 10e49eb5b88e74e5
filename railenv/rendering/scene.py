"""The whole picture as shapes: where each panel stands, the heading, the banner at an ending.

Pure: a `View` and a size go in, shapes come out; the same view gives the same shapes. Panels are
laid out on 640 x 480 design pixels and stretched to the size asked for; texts and line widths grow
with the smaller of the two stretches.
"""

from dataclasses import dataclass

import numpy as np

from railenv.errors import ArgumentError, check_count
from railenv.rendering.charts import ride_index, strips
from railenv.rendering.pipe import pipe
from railenv.rendering.plan import plan
from railenv.rendering.scales import plain, round_limit, signed
from railenv.rendering.section import section
from railenv.rendering.shapes import FRAME, INK, VERMILLION, WHITE, Panel, Shape, Text, rectangle
from railenv.rendering.view import View

DESIGN_SIZE = (640, 480)
"""Size in which the picture is designed: width, height [pixels]."""

SMALLEST_SIZE = (480, 360)
"""Below, the texts cannot be read."""

LARGEST_SIZE = (3840, 2160)
"""Above, a frame takes longer and more memory than anyone looks at."""

LEAST_FULL_SCALE = 500.0
"""Smallest full scale of force arrows and bars [N]."""

ENDING_WORDS = {
    "gauge": "LEFT THE GAUGE",
    "divergence": "DIVERGED",
    "derailment": "DERAILED",
}
"""What the banner says."""

# Left, top, right, bottom [design pixels].
_HEADING = (0.0, 0.0, 640.0, 26.0)
_PANELS = {
    "section": (6.0, 32.0, 252.0, 242.0),
    "pipe": (258.0, 32.0, 634.0, 242.0),
    "plan": (6.0, 248.0, 634.0, 366.0),
    "strips": (6.0, 372.0, 436.0, 474.0),
    "ride_index": (442.0, 372.0, 634.0, 474.0),
}


@dataclass(frozen=True)
class Scene:
    """Shapes in the order in which they are drawn, and the size of the picture.

    Attributes:
        size: Width and height [pixels].
        shapes: All shapes; texts are drawn last whatever their place in the order.
        panels: The rectangles of the panels by name.
    """

    size: tuple[int, int]
    shapes: tuple[Shape, ...]
    panels: dict[str, Panel]


def check_size(size: tuple[int, int]) -> tuple[int, int]:
    """Return a picture's width and height, or raise `ArgumentError` if it cannot be read or held.

    Args:
        size: Width and height [pixels].
    """
    if len(size) != 2:
        raise ArgumentError(f"size = {size!r} must be (width, height) in pixels")
    width, height = check_count("width", size[0]), check_count("height", size[1])
    if width < SMALLEST_SIZE[0] or height < SMALLEST_SIZE[1]:
        raise ArgumentError(
            f"size = {width} x {height} is too small to be read; give "
            f"{SMALLEST_SIZE[0]} x {SMALLEST_SIZE[1]} or more"
        )
    if width > LARGEST_SIZE[0] or height > LARGEST_SIZE[1]:
        raise ArgumentError(
            f"size = {width} x {height} is too large; give "
            f"{LARGEST_SIZE[0]} x {LARGEST_SIZE[1]} or less"
        )
    return width, height


def full_scale_force(view: View) -> float:
    """Return the force whose arrow or bar has full length [N]: 0.5, 1, 2, 5, ... kN."""
    past = float(np.abs(view.pipe_command).max(initial=0.0))
    present = float(np.abs([view.force, view.command]).max())
    return round_limit(max(past, present), LEAST_FULL_SCALE)


def build_scene(view: View, size: tuple[int, int] = DESIGN_SIZE) -> Scene:
    """Return the picture of a view as shapes.

    Args:
        view: What is shown.
        size: Width and height [pixels].

    Raises:
        ArgumentError: The size is too small to be read or too large.
    """
    width, height = check_size(size)
    across, down = width / DESIGN_SIZE[0], height / DESIGN_SIZE[1]
    unit = min(across, down)
    panels = {
        name: Panel(across * left, down * top, across * (right - left), down * (bottom - top), unit)
        for name, (left, top, right, bottom) in _PANELS.items()
    }
    full_scale = full_scale_force(view)
    shapes: list[Shape] = [
        rectangle(q.left, q.top, q.right, q.bottom, WHITE, FRAME, name=f"panel_{name}")
        for name, q in panels.items()
    ]
    shapes += section(view, panels["section"], full_scale)
    shapes += pipe(view, panels["pipe"], full_scale)
    shapes += plan(view, panels["plan"], full_scale)
    shapes += strips(view, panels["strips"])
    shapes += ride_index(view, panels["ride_index"])
    shapes += _heading(view, across, down, unit)
    return Scene((width, height), tuple(shapes), panels)


def delay_words(view: View) -> str:
    """Return the delay as text: one number, or the range over the actuators [ms]."""
    low, high = 1000.0 * float(view.delay.min()), 1000.0 * float(view.delay.max())
    return f"{low:.4g} ms" if low == high else f"{low:.4g}-{high:.4g} ms"


def _heading(view: View, across: float, down: float, unit: float) -> list[Shape]:
    _, _, right, bottom = _HEADING
    colour = VERMILLION if view.ended_by else INK
    middle = 0.5 * bottom * down
    size = 17.0 * unit
    ahead = [
        (12.0, f"t = {view.time:.2f} s", "time"),
        (108.0, f"{plain(3.6 * view.speed, 0)} km/h", "speed"),
    ]
    ahead.append((192.0, f"delay {delay_words(view)}", "delay"))
    shapes: list[Shape] = [
        rectangle(0.0, 0.0, right * across, bottom * down, colour, name="heading")
    ]
    if view.ended_by:
        left, end = 318.0 * across, 510.0 * across
        inside = 4.0 * down
        box = rectangle(left, inside, end, bottom * down - inside, WHITE, name="banner_box")
        banner = f"{ENDING_WORDS[view.ended_by]}: episode over"
        place = (0.5 * (left + end), middle)
        shapes += [box, Text(place, banner, size, VERMILLION, "centre", "banner")]
    else:
        ahead.append((318.0, f"{view.num_actuators} actuators", "layout"))
    for left, text, name in ahead:
        shapes.append(Text((left * across, middle), text, size, WHITE, "left", name))
    if view.reward is not None:
        reward = f"reward {signed(view.reward)}"
        place = ((right - 12.0) * across, middle)
        shapes.append(Text(place, reward, size, WHITE, "right", "reward"))
    return shapes
