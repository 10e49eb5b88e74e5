"""Shapes of a picture and its colours: pure data, no drawing package.

A scene is a list of shapes in pixels, x to the right, y down, drawn in their order; texts come last
so that nothing crosses them. Each shape that stands for something carries its name, by which tests
and readers find it. Colours are those of Okabe and Ito, which colour-blind people tell apart.
"""

from dataclasses import dataclass

Point = tuple[float, float]
Colour = tuple[int, int, int]

# Okabe and Ito, "Color Universal Design", 2008.
BLACK: Colour = (0, 0, 0)
ORANGE: Colour = (230, 159, 0)
SKY_BLUE: Colour = (86, 180, 233)
GREEN: Colour = (0, 158, 115)
BLUE: Colour = (0, 114, 178)
VERMILLION: Colour = (213, 94, 0)
PURPLE: Colour = (204, 121, 167)

# Greys and tints for what is not data.
WHITE: Colour = (255, 255, 255)
PAPER: Colour = (232, 235, 239)
GRID: Colour = (214, 219, 225)
FRAME: Colour = (186, 193, 202)
STEEL: Colour = (120, 128, 138)
INK: Colour = (45, 52, 60)
SHADE: Colour = (150, 157, 166)
GLASS: Colour = (222, 238, 248)
"""Tint of the carbody."""

COMMAND = BLUE
"""Commands that are on their way."""
FORCE = VERMILLION
"""Forces that act."""
FLOORS: tuple[Colour, Colour] = (GREEN, PURPLE)
"""Floor front and floor rear."""


@dataclass(frozen=True, slots=True)
class Line:
    """A chain of straight lines, `width` pixels wide."""

    points: tuple[Point, ...]
    colour: Colour
    width: float = 1.0
    name: str = ""


@dataclass(frozen=True, slots=True)
class Polygon:
    """A closed area, filled, outlined or both."""

    points: tuple[Point, ...]
    fill: Colour | None
    outline: Colour | None = None
    width: float = 1.0
    name: str = ""


@dataclass(frozen=True, slots=True)
class Circle:
    """A filled disc."""

    centre: Point
    radius: float
    fill: Colour
    name: str = ""


@dataclass(frozen=True, slots=True)
class Arrow:
    """An arrow from tail to tip; of no length, it is not drawn. A halo sets it off from bodies."""

    tail: Point
    tip: Point
    colour: Colour
    width: float = 2.0
    name: str = ""
    halo: Colour | None = None


@dataclass(frozen=True, slots=True)
class Text:
    """A line of text; `anchor` says which part of it stands at `position`, at half its height."""

    position: Point
    text: str
    size: float
    colour: Colour = INK
    anchor: str = "left"
    name: str = ""


Shape = Line | Polygon | Circle | Arrow | Text


@dataclass(frozen=True, slots=True)
class Panel:
    """A rectangle of the picture in which one thing is shown.

    Attributes:
        left: Left edge [pixels].
        top: Upper edge [pixels].
        width: Width [pixels].
        height: Height [pixels].
        unit: Pixels per design pixel: 1 at 640 x 480; texts and line widths grow with it.
    """

    left: float
    top: float
    width: float
    height: float
    unit: float

    @property
    def right(self) -> float:
        """Right edge [pixels]."""
        return self.left + self.width

    @property
    def bottom(self) -> float:
        """Lower edge [pixels]."""
        return self.top + self.height


def rectangle(
    left: float,
    top: float,
    right: float,
    bottom: float,
    fill: Colour | None,
    outline: Colour | None = None,
    name: str = "",
) -> Polygon:
    """Return an upright rectangle."""
    corners = ((left, top), (right, top), (right, bottom), (left, bottom))
    return Polygon(corners, fill, outline, name=name)
