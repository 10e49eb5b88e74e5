"""Plan view: the running vehicle from above, the track's irregularity scrolling by beneath it.

Running direction is to the right of the picture, so the vehicle's right is below. Only lateral
motions are exaggerated: bodies are sheared, not turned, and a positive yaw moves the nose down.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from railenv.rendering.scales import exaggerated, fraction_of, kilonewtons, plain, round_limit
from railenv.rendering.shapes import (
    FORCE,
    FRAME,
    GLASS,
    GRID,
    INK,
    SHADE,
    SKY_BLUE,
    STEEL,
    WHITE,
    Arrow,
    Line,
    Panel,
    Point,
    Polygon,
    Shape,
    Text,
)
from railenv.rendering.view import View
from railenv.vehicle.coordinates import (
    BOGIES,
    WHEELSETS,
    bogie_of_position,
    bogie_of_wheelset,
    bogie_sign,
    end_sign,
)

FACTOR = 200.0
"""Exaggeration of small lateral motions [1]."""

_OVERHANG = 4.0  # carbody beyond the bogie's centre [m]
_NOSE = 3.0  # length of the tapered front [m]
_HALF_WIDTH = 1.65
_ARROW_LENGTH = 22.0  # of a force at full scale [design pixels]
_MARK_SPACING = 10.0  # of the marks along the track [m]
_LEAST_CROSS_LEVEL = 1e-3  # smallest full scale of the cross level [m]
_SHORTEST_REACH = 1.0  # of the carbody's guiding points, for a vehicle without bogie spacing [m]
_YAW_LIMIT = 0.35  # most that a wheelset is drawn turned [rad]

_Lateral = Callable[[float], float]
_Putting = Callable[[float, float], Point]


@dataclass(frozen=True)
class _Drawing:
    """Where the plan stands and how places along and across the vehicle come into the picture.

    Attributes:
        view: What is shown.
        panel: Where.
        scale: Pixels per metre along the track.
        across: Pixels per metre across it, bodies only.
        limit: Most that a body's guiding point is drawn aside [pixels].
        top: Upper end of the area for bodies [pixels].
        bottom: Lower end of it [pixels].
    """

    view: View
    panel: Panel
    scale: float
    across: float
    limit: float
    top: float
    bottom: float

    @property
    def middle(self) -> float:
        """The track's undisturbed centre line [pixels]."""
        return 0.5 * (self.top + self.bottom)

    def along(self, x: float) -> float:
        """Return where a place ahead of the carbody's centre is drawn [pixels]."""
        return self.panel.left + 0.5 * self.panel.width + self.scale * x

    def aside(self, lateral: float) -> float:
        """Return how far down a displacement to the right is drawn [pixels]."""
        return exaggerated(lateral * self.scale, FACTOR, self.limit)

    def body(self, place: float, reach: float, lateral: _Lateral) -> _Putting:
        """Return how a point of a body is drawn whose two guiding points lie at +-reach [m]."""
        front, rear = self.aside(lateral(reach)), self.aside(lateral(-reach))
        mean, slope = 0.5 * (front + rear), 0.5 * (front - rear) / reach

        def put(x: float, y: float) -> Point:
            return self.along(place + x), self.middle + mean + slope * x + self.across * y

        return put


def plan(view: View, panel: Panel, full_scale: float) -> list[Shape]:
    """Return the shapes of the plan view.

    Args:
        view: What is shown.
        panel: Where; title, cross level and distance marks are inside it.
        full_scale: Force whose arrow has full length [N].
    """
    p, unit = view.parameters, panel.unit
    half_length = p.half_bogie_spacing + _OVERHANG
    seen = min(-float(view.track_distance[0]), float(view.track_distance[-1]))
    scale = 0.5 * panel.width / max(seen, 1.05 * half_length)
    top, bottom = panel.top + 18.0 * unit, panel.bottom - 30.0 * unit
    # Beyond the bogies, a swinging nose goes further aside than the bogies' centres.
    reach = max(p.half_bogie_spacing, _SHORTEST_REACH)
    half_width = min(scale * _HALF_WIDTH, 0.25 * (bottom - top))
    limit = max(2.0, (0.5 * (bottom - top) - half_width) * reach / half_length - 1.0)
    drawing = _Drawing(view, panel, scale, half_width / _HALF_WIDTH, limit, top, bottom)
    carbody = drawing.body(0.0, reach, lambda x: view.lateral("carbody", x))
    return [
        *_marks(drawing),
        _carbody(carbody, half_length, unit),
        *_rails(drawing),
        *_bogies(drawing),
        *_wheelsets(drawing),
        *_forces(drawing, carbody, full_scale),
        *_cross_level(drawing),
        *_legend(panel, full_scale),
    ]


def _carbody(put: _Putting, half_length: float, unit: float) -> Polygon:
    """Return the carbody's outline, nose to the right."""
    nose = half_length - _NOSE
    half = (
        (-half_length, 1.55),
        (-half_length + 0.3, _HALF_WIDTH),
        (nose, _HALF_WIDTH),
        (nose + 0.6 * _NOSE, 1.25),
        (half_length - 0.15, 0.6),
    )
    outline = [*half, (half_length, 0.0), *((x, -y) for x, y in reversed(half))]
    return Polygon(tuple(put(x, y) for x, y in outline), GLASS, INK, 1.5 * unit, "carbody_plan")


def _rails(drawing: _Drawing) -> list[Shape]:
    """Return both rails, moved aside by the track's alignment."""
    view, scale, limit = drawing.view, drawing.scale, drawing.limit
    shown = np.abs(view.track_distance) <= 0.5 * drawing.panel.width / scale
    places = (drawing.along(0.0) + scale * view.track_distance[shown]).tolist()
    x = FACTOR * scale / limit * view.track_alignment[shown]
    aside = limit * x / (1.0 + np.abs(x))  # as _Drawing.aside, for all places at once
    shapes: list[Shape] = []
    for side, name in ((-1.0, "rail_left_plan"), (1.0, "rail_right_plan")):
        line = drawing.middle + side * drawing.across * view.parameters.half_contact_spacing
        points = tuple(zip(places, (line + aside).tolist(), strict=True))
        shapes.append(Line(points, STEEL, 1.5 * drawing.panel.unit, name))
    return shapes


def _bogies(drawing: _Drawing) -> list[Shape]:
    """Return both bogie frames with their bolsters."""
    view, unit, p = drawing.view, drawing.panel.unit, drawing.view.parameters
    reach = p.half_wheelbase + 0.45
    shapes: list[Shape] = []
    for number in BOGIES:
        name = f"bogie{number}"
        put = drawing.body(
            bogie_sign(number) * p.half_bogie_spacing,
            max(p.half_wheelbase, 0.5),
            lambda x, name=name: view.lateral(name, x),
        )
        frame = ((-reach, -1.0), (reach, -1.0), (reach, 1.0), (-reach, 1.0))
        points = tuple(put(x, y) for x, y in frame)
        shapes.append(Polygon(points, None, INK, 1.5 * unit, f"{name}_plan"))
        shapes.append(Line((put(0.0, -1.0), put(0.0, 1.0)), SHADE, 3.0 * unit))
    return shapes


def _wheelsets(drawing: _Drawing) -> list[Shape]:
    """Return axles and wheels; a positive yaw moves the right wheel (below) to the rear."""
    view, unit, p = drawing.view, drawing.panel.unit, drawing.view.parameters
    half_gauge = drawing.across * p.half_contact_spacing
    half_wheel = 4.0 * unit
    shapes: list[Shape] = []
    for number in WHEELSETS:
        place = bogie_sign(bogie_of_wheelset(number)) * p.half_bogie_spacing
        place += end_sign(number) * p.half_wheelbase
        yaw = exaggerated(view.coordinate(f"wheelset{number}_yaw"), FACTOR, _YAW_LIMIT)
        x = drawing.along(place)
        y = drawing.middle + drawing.aside(view.coordinate(f"wheelset{number}_lateral"))
        left, right = (
            (x - side * yaw * 1.2 * half_gauge, y + side * 1.2 * half_gauge) for side in (-1.0, 1.0)
        )
        shapes.append(Line((left, right), INK, 1.5 * unit, f"wheelset{number}_plan"))
        for side in (-1.0, 1.0):
            wx, wy = x - side * yaw * half_gauge, y + side * half_gauge
            rear = (wx - half_wheel, wy - half_wheel * yaw)
            front = (wx + half_wheel, wy + half_wheel * yaw)
            shapes.append(Line((rear, front), INK, 3.5 * unit))
    return shapes


def _forces(drawing: _Drawing, carbody: _Putting, full_scale: float) -> list[Shape]:
    """Return the force on the carbody of each actuator, an arrow down for one to the right."""
    view, unit, p = drawing.view, drawing.panel.unit, drawing.view.parameters
    shapes: list[Shape] = []
    for channel, place in enumerate(view.places):
        # Drawn further apart than they are, so that two arrows do not cover each other.
        x = bogie_sign(bogie_of_position(place)) * p.half_bogie_spacing
        x += end_sign(place) * max(p.damper_offset, 0.62)
        tail = carbody(x, 0.0)
        share = fraction_of(float(view.force[channel]), full_scale)
        tip = (tail[0], tail[1] + _ARROW_LENGTH * unit * share)
        shapes.append(Arrow(tail, tip, FORCE, 2.5 * unit, f"force_{place}", WHITE))
    return shapes


def _marks(drawing: _Drawing) -> list[Shape]:
    """Return marks that stand still on the track, labelled with their distance from the start."""
    view, panel, unit = drawing.view, drawing.panel, drawing.panel.unit
    # The leading wheelset starts at distance zero.
    lead = view.parameters.half_bogie_spacing + view.parameters.half_wheelbase
    here = view.speed * view.time - lead
    reach = 0.5 * panel.width / drawing.scale
    first = math.ceil((here - reach) / _MARK_SPACING)
    last = math.floor((here + reach) / _MARK_SPACING)
    shapes: list[Shape] = []
    for number in range(first, last + 1):
        distance = number * _MARK_SPACING
        x = drawing.along(distance - here)
        ends = ((x, drawing.top), (x, drawing.bottom))
        shapes.append(Line(ends, GRID, 2.0 * unit, "mark"))
        if panel.left + 24.0 * unit <= x <= panel.right - 24.0 * unit:
            where = (x, panel.bottom - 7.0 * unit)
            label = f"{distance:.0f} m"
            shapes.append(Text(where, label, 14.0 * unit, STEEL, "centre", "mark_text"))
    return shapes


def _cross_level(drawing: _Drawing) -> list[Shape]:
    """Return the cross level along the track as a filled curve, right rail down drawn down."""
    view, panel, unit = drawing.view, drawing.panel, drawing.panel.unit
    reach, middle = 8.0 * unit, drawing.bottom + 10.0 * unit
    limit = round_limit(float(np.abs(view.track_cross_level).max()), _LEAST_CROSS_LEVEL)
    shown = np.abs(view.track_distance) <= 0.5 * panel.width / drawing.scale
    x = (drawing.along(0.0) + drawing.scale * view.track_distance[shown]).tolist()
    y = (middle + reach * np.clip(view.track_cross_level[shown] / limit, -1.0, 1.0)).tolist()
    shapes: list[Shape] = []
    if len(x) > 1:
        area = ((x[0], middle), *zip(x, y, strict=True), (x[-1], middle))
        shapes.append(Polygon(area, SKY_BLUE, name="cross_level"))
    shapes.append(Line(((panel.left, middle), (panel.right, middle)), FRAME, unit))
    text = f"cross level to {plain(1000.0 * limit, 0)} mm"
    where = (panel.left + 318.0 * unit, panel.top + 10.0 * unit)
    shapes.append(Text(where, text, 14.0 * unit, STEEL))
    return shapes


def _legend(panel: Panel, full_scale: float) -> list[Shape]:
    unit, y = panel.unit, panel.top + 10.0 * panel.unit
    end = panel.right - 58.0 * unit
    tail, tip = (end - _ARROW_LENGTH * unit, y), (end, y)
    return [
        Text((panel.left + 8.0 * unit, y), "Plan view, right is down", 16.0 * unit),
        Text(
            (panel.left + 158.0 * unit, y), f"lateral x{FACTOR:.0f}, compressed", 14.0 * unit, STEEL
        ),
        Text((tail[0] - 8.0 * unit, y), "force arrow", 14.0 * unit, STEEL, "right"),
        Arrow(tail, tip, FORCE, 2.5 * unit, "force_scale"),
        Text((end + 6.0 * unit, y), f"{kilonewtons(full_scale)}", 14.0 * unit, STEEL),
    ]
