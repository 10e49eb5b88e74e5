"""Cross-section at the front bogie, seen from behind: carbody, air springs, bogie, wheelset, rails.

The right side of the vehicle is the right side of the picture, z points down. Each body keeps its
shape and is moved and turned by its exaggerated displacement; springs are drawn between the moved
bodies. Heights come from the vehicle's parameters; outlines are schematic.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from railenv.rendering.scales import exaggerated, fraction_of, kilonewtons, signed
from railenv.rendering.shapes import (
    FORCE,
    FRAME,
    GLASS,
    INK,
    SHADE,
    SKY_BLUE,
    STEEL,
    WHITE,
    Arrow,
    Circle,
    Colour,
    Line,
    Panel,
    Point,
    Polygon,
    Shape,
    Text,
)
from railenv.rendering.view import View
from railenv.vehicle.coordinates import bogie_of_position

FACTOR = 60.0
"""Exaggeration of small lateral and roll motions [1]."""

_LATERAL_LIMIT = 1.0  # most that a body is drawn aside [m of the drawing]
_ROLL_LIMIT = 0.14  # most that a body is drawn turned [rad]; air springs stay longer than nothing
_LIFT_LIMIT = 0.3  # most that a wheelset is drawn above the rails [m of the drawing]
_ARROW_LENGTH = 34.0  # of a force at full scale [design pixels]; two of them act here
_TITLE_HEIGHT, _RULER_HEIGHT = 17.0, 33.0  # inside the panel [design pixels]
_FRAME_TOP, _FRAME_DEPTH = 0.16, 0.20  # bogie frame: above its centre of gravity, depth [m]
_TICKS_MM = (-100, -50, -20, -10, -5, 0, 5, 10, 20, 50, 100)
_LABELLED_MM = (0, 10, 100)

# Right half of the carbody's outline: y and height above rail [m], drawn for a centre of gravity at
# _OUTLINE_CENTRE; a high-speed coach, 3.3 m wide.
_OUTLINE_CENTRE = 1.629
_OUTLINE = (
    (0.0, 1.00),
    (1.40, 1.00),
    (1.56, 1.10),
    (1.63, 1.45),
    (1.65, 1.95),
    (1.59, 2.45),
    (1.46, 2.90),
    (1.22, 3.24),
    (0.85, 3.43),
    (0.45, 3.49),
    (0.0, 3.50),
)
_WINDOW = ((1.605, 1.85), (1.555, 2.50))
_ROOF = 3.50
_UNDERSIDE = 1.00
_HALF_WIDTH = 1.65

_Placing = Callable[[float, float], Point]


@dataclass(frozen=True)
class _Drawing:
    """Where the section stands and what is needed to put a body's point into the picture.

    Attributes:
        view: What is shown.
        panel: Where.
        scale: Pixels per metre.
        centre: The track's undisturbed centre line [pixels].
        ground: Top of the undisturbed rails [pixels].
    """

    view: View
    panel: Panel
    scale: float
    centre: float
    ground: float

    def placed(self, lateral: float, roll: float, pivot: float, lift: float = 0.0) -> _Placing:
        """Return how a body's points (y, height above rail) are drawn.

        Args:
            lateral: Displacement of the body's pivot to the right [m].
            roll: Turn about the pivot, right side down [rad].
            pivot: Height of the pivot above the rails [m].
            lift: Displacement of the pivot upwards [m].
        """
        aside = exaggerated(lateral, FACTOR, _LATERAL_LIMIT)
        turned = exaggerated(roll, FACTOR, _ROLL_LIMIT)
        raised = exaggerated(lift, FACTOR, _LIFT_LIMIT)
        cosine, sine = math.cos(turned), math.sin(turned)

        def place(y: float, height: float) -> Point:
            down = pivot - height
            right = aside + y * cosine - down * sine
            lower = y * sine + down * cosine - pivot - raised
            return self.centre + self.scale * right, self.ground + self.scale * lower

        return place

    def box(
        self,
        place: _Placing,
        corners: tuple[float, float, float, float],
        fill: Colour,
        outline: Colour | None = None,
        name: str = "",
    ) -> Polygon:
        """Return a body's rectangle from left, low, right and high [m]."""
        left, low, right, high = corners
        points = ((left, low), (right, low), (right, high), (left, high))
        return Polygon(_all(place, points), fill, outline, self.panel.unit, name)


def section(view: View, panel: Panel, full_scale: float) -> list[Shape]:
    """Return the shapes of the cross-section.

    Args:
        view: What is shown.
        panel: Where; title and ruler are inside it.
        full_scale: Force whose arrow has full length [N].
    """
    p, unit = view.parameters, panel.unit
    bogie_height = p.wheel_radius + p.bogie_to_primary_height
    damper_height = bogie_height - p.bogie_to_damper_height
    carbody_height = damper_height + p.carbody_to_damper_height
    lift = carbody_height - _OUTLINE_CENTRE
    room = panel.height - (_TITLE_HEIGHT + _RULER_HEIGHT) * unit
    half_width = _LATERAL_LIMIT + _HALF_WIDTH + 1.6 * _ROLL_LIMIT
    scale = min(room / (_ROOF + lift + 0.15), 0.5 * panel.width / half_width)
    centre = panel.left + 0.5 * panel.width
    drawing = _Drawing(view, panel, scale, centre, panel.bottom - _RULER_HEIGHT * unit)

    sway = view.lateral("carbody", p.half_bogie_spacing)
    bogie = drawing.placed(
        view.coordinate("bogie1_lateral"), view.coordinate("bogie1_roll"), bogie_height
    )
    carbody = drawing.placed(sway, view.coordinate("carbody_roll"), carbody_height)
    top, underside = bogie_height + _FRAME_TOP, _UNDERSIDE + lift
    lug = 0.5 * (top + underside)
    places = zip(view.places, view.force, strict=True)
    total = float(sum(f for place, f in places if bogie_of_position(place) == 1))
    frame = bogie(0.0, top - 0.5 * _FRAME_DEPTH)
    return [
        *_track_and_wheelset(drawing),
        *_bogie(drawing, bogie, carbody, top, underside),
        *_carbody(drawing, carbody, carbody_height, lift),
        drawing.box(carbody, (-0.09, lug - 0.06, 0.09, underside), SHADE, INK),
        *_forces(panel, carbody(0.0, lug), frame, total, full_scale),
        *_ruler(drawing, sway),
        *_readings(view, unit, carbody(0.0, 2.45 + lift), sway, total),
    ]


def _track_and_wheelset(drawing: _Drawing) -> list[Shape]:
    """Return sleeper, rails and the mean of the bogie's two wheelsets, turned with the track.

    A wheelset whose own roll and height are known is drawn with these.
    """
    view, box = drawing.view, drawing.box
    p = view.parameters
    alignment, cross_level = view.track_at(p.half_bogie_spacing)
    roll = cross_level / (2.0 * p.half_contact_spacing)
    lateral = 0.5 * (view.coordinate("wheelset1_lateral") + view.coordinate("wheelset2_lateral"))
    track = drawing.placed(alignment, roll, 0.0)
    if view.wheelset_roll is not None:
        roll = float(view.wheelset_roll[:2].mean())
    lift = 0.0 if view.wheelset_lift is None else float(view.wheelset_lift[:2].mean())
    wheelset = drawing.placed(lateral, roll, 0.0, lift)
    b, r = p.half_contact_spacing, p.wheel_radius
    shapes: list[Shape] = [box(track, (-1.3, -0.20, 1.3, -0.10), FRAME, name="sleeper")]
    shapes.append(box(wheelset, (-b, r - 0.08, b, r + 0.08), STEEL, INK))
    for side, name in ((-1.0, "left"), (1.0, "right")):
        y = side * b
        inner = y - side * 0.10  # the flange is on the inside
        flange = (inner - 0.03, -0.04, inner + 0.03, 2.0 * r)
        shapes += [
            box(track, (y - 0.06, -0.10, y + 0.06, 0.0), INK, name=f"rail_{name}"),
            box(wheelset, (y - 0.08, 0.0, y + 0.08, 2.0 * r), STEEL, INK),
            box(wheelset, flange, STEEL, INK, f"wheel_{name}"),
        ]
    return shapes


def _bogie(
    drawing: _Drawing, bogie: _Placing, carbody: _Placing, top: float, underside: float
) -> list[Shape]:
    """Return the bogie frame and the air springs between it and the carbody."""
    p = drawing.view.parameters
    reach = max(1.15, p.half_primary_spacing + 0.15)
    frame = (-reach, top - _FRAME_DEPTH, reach, top)
    shapes: list[Shape] = [drawing.box(bogie, frame, FRAME, INK, "bogie")]
    for side, name in ((-1.0, "air_spring_left"), (1.0, "air_spring_right")):
        y = side * p.half_secondary_spacing
        foot, head = bogie(y, top), carbody(y, underside)
        shapes.append(_bellows(foot, head, 0.24 * drawing.scale, drawing.panel.unit, name))
    return shapes


def _carbody(drawing: _Drawing, place: _Placing, height: float, lift: float) -> list[Shape]:
    """Return shell, windows, floor and centre of gravity."""
    unit = drawing.panel.unit
    half = [(y, z + lift) for y, z in _OUTLINE]
    shell = _all(place, [*half, *((-y, z) for y, z in reversed(half[1:-1]))])
    shapes: list[Shape] = [Polygon(shell, GLASS, INK, 2.0 * unit, "carbody")]
    for side in (-1.0, 1.0):
        ends = _all(place, [(side * y, z + lift) for y, z in _WINDOW])
        shapes.append(Line(ends, SKY_BLUE, 4.0 * unit, "window"))
    floor = height - drawing.view.parameters.carbody_to_floor_height
    shapes.append(Line(_all(place, [(-1.5, floor), (1.5, floor)]), INK, 1.5 * unit, "floor"))
    shapes.append(Circle(place(0.0, height), 2.5 * unit, INK, "carbody_centre"))
    return shapes


def _forces(panel: Panel, lug: Point, frame: Point, total: float, full_scale: float) -> list[Shape]:
    """Return the sum of the front actuators on the carbody's lug, its reaction, and the scale."""
    unit = panel.unit
    length = 2.0 * _ARROW_LENGTH * unit * fraction_of(total, 2.0 * full_scale)
    shapes: list[Shape] = []
    for name, tail, reach in (("force_front", lug, length), ("reaction_front", frame, -length)):
        tip = (tail[0] + reach, tail[1])
        shapes.append(Arrow(tail, tip, FORCE, 3.5 * unit, name, WHITE))
    left, right = panel.left + 8.0 * unit, panel.right - 8.0 * unit
    title, low = panel.top + 10.0 * unit, panel.bottom - 19.0 * unit
    tip = (left + _ARROW_LENGTH * unit, low)
    label = f"{kilonewtons(full_scale)}"
    return [
        *shapes,
        Text((left, title), "Front bogie from behind", 16.0 * unit),
        Text((right, title), f"x{FACTOR:.0f}, compressed", 14.0 * unit, STEEL, "right"),
        Arrow((left, low), tip, FORCE, 3.5 * unit, "force_front_scale"),
        Text((left, low + 11.0 * unit), label, 14.0 * unit, STEEL),
    ]


def _all(place: _Placing, points: Iterable[Point]) -> tuple[Point, ...]:
    return tuple(place(y, z) for y, z in points)


def _bellows(foot: Point, head: Point, half_width: float, unit: float, name: str) -> Polygon:
    """Return an air spring between two points: three bulges on either side."""
    steps = 12
    right: list[Point] = []
    left: list[Point] = []
    for step in range(steps + 1):
        share = step / steps
        x = foot[0] + share * (head[0] - foot[0])
        y = foot[1] + share * (head[1] - foot[1])
        bulge = half_width * (0.82 + 0.18 * abs(math.sin(3.0 * math.pi * share)))
        right.append((x + bulge, y))
        left.append((x - bulge, y))
    return Polygon((*right, *reversed(left)), SKY_BLUE, INK, unit, name)


def _ruler(drawing: _Drawing, sway: float) -> list[Shape]:
    """Return the ruler that says how many true millimetres the drawn sway is."""
    panel, unit = drawing.panel, drawing.panel.unit
    top = panel.bottom - 18.0 * unit

    def at(lateral: float) -> float:
        return drawing.centre + drawing.scale * exaggerated(lateral, FACTOR, _LATERAL_LIMIT)

    shapes: list[Shape] = []
    for tick in _TICKS_MM:
        x = at(tick / 1000.0)
        shapes.append(Line(((x, top), (x, top + 4.0 * unit)), STEEL, unit))
        if abs(tick) in _LABELLED_MM:
            where = (x, top + 10.0 * unit)
            shapes.append(Text(where, f"{abs(tick)}", 14.0 * unit, STEEL, "centre"))
    ends = ((at(_TICKS_MM[0] / 1000.0), top), (at(_TICKS_MM[-1] / 1000.0), top))
    shapes.append(Line(ends, STEEL, unit, "ruler"))
    pointer, half, high = at(sway), 4.0 * unit, 6.0 * unit
    triangle = ((pointer, top), (pointer - half, top - high), (pointer + half, top - high))
    shapes.append(Polygon(triangle, INK, name="ruler_pointer"))
    where = (panel.right - 8.0 * unit, top + 10.0 * unit)
    return [*shapes, Text(where, "mm", 14.0 * unit, STEEL, "right")]


def _readings(view: View, unit: float, where: Point, sway: float, total: float) -> list[Shape]:
    roll = 1000.0 * view.coordinate("carbody_roll")
    lines = (
        ("sway", f"{signed(1000.0 * sway, 1)} mm", INK),
        ("roll", f"{signed(roll, 1)} mrad", INK),
        ("force", f"{signed(total / 1000.0)} kN", FORCE),
    )
    shapes: list[Shape] = []
    for row, (label, value, colour) in enumerate(lines):
        x, y = where[0] - 12.0 * unit, where[1] + 13.0 * row * unit
        name = f"{label}_text"
        shapes.append(Text((x - 3.0 * unit, y), label, 15.0 * unit, STEEL, "right"))
        shapes.append(Text((x + 3.0 * unit, y), value, 15.0 * unit, colour, "left", name))
    return shapes
