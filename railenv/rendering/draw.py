"""From shapes to pixels: the only importer of the drawing package, pygame.

Pictures are drawn on a plain surface in memory, so no display is needed. Everything but text is
drawn at twice the size and averaged down, which smooths every edge alike. pygame is loaded at the
first picture, not on import.
"""

import importlib
import os
import sys
import warnings
from collections.abc import Iterable
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from railenv.errors import ArgumentError, check_positive
from railenv.rendering.scene import DESIGN_SIZE, build_scene
from railenv.rendering.shapes import PAPER, Arrow, Circle, Line, Point, Polygon, Shape, Text
from railenv.rendering.view import View

if TYPE_CHECKING:
    import pygame

Frame = NDArray[np.uint8]

_OVERSAMPLING = 2
_GREETING = "PYGAME_HIDE_SUPPORT_PROMPT"
_MOST_TEXTS = 2000
"""Texts kept drawn; a run shows a few dozen that stay and many numbers that do not come again."""

_texts: dict[tuple[str, int, tuple[int, int, int]], "pygame.Surface"] = {}


def drawing_package() -> Any:
    """Return pygame, loaded without its greeting and with its fonts ready.

    Raises:
        ArgumentError: It is not installed.
    """
    package = sys.modules.get("pygame") or _import_package()
    if not package.font.get_init():
        package.font.init()
    return package


def _import_package() -> Any:
    before = os.environ.get(_GREETING)
    os.environ[_GREETING] = "1"
    try:
        with warnings.catch_warnings():
            # Not ours to mend: pygame 2.6 reads a deprecated package, and speaks of its build.
            warnings.filterwarnings("ignore", message=".*pkg_resources")
            warnings.filterwarnings("ignore", message=".*avx2", category=RuntimeWarning)
            package = importlib.import_module("pygame")
            importlib.import_module("pygame.pkgdata")
    except ImportError:
        raise ArgumentError(
            'rendering needs pygame, which is not installed; pip install "railenv[render]"'
        ) from None
    finally:
        if before is None:
            del os.environ[_GREETING]
        else:
            os.environ[_GREETING] = before
    return package


def draw_frame(view: View, size: tuple[int, int] = DESIGN_SIZE) -> Frame:
    """Return the picture of a view.

    Args:
        view: What is shown.
        size: Width and height [pixels], from 480 x 360.

    Returns:
        Red, green and blue, shape (height, width, 3), a new array.

    Raises:
        ArgumentError: The size is too small or too large, or pygame is not installed.
    """
    scene = build_scene(view, size)
    return draw_shapes(scene.shapes, scene.size)


def draw_shapes(shapes: Iterable[Shape], size: tuple[int, int]) -> Frame:
    """Return shapes as pixels, texts on top, shape (height, width, 3), a new array."""
    package = drawing_package()
    width, height = size
    large = package.Surface((_OVERSAMPLING * width, _OVERSAMPLING * height), 0, 32)
    large.fill(PAPER)
    texts: list[Text] = []
    for shape in shapes:
        if isinstance(shape, Text):
            texts.append(shape)
        else:
            _draw(package, large, shape)
    frame = np.empty((height, width, 3), dtype=np.uint8)
    surface = package.image.frombuffer(frame, size, "RGB")  # draws into the frame itself
    surface.blit(package.transform.smoothscale(large, size), (0, 0))
    fonts: dict[int, pygame.font.Font] = {}
    for text in texts:
        drawn = _drawn_text(package, text, fonts)
        surface.blit(drawn, _corner(text, drawn.get_size()))
    return frame


def text_box(text: Text) -> tuple[float, float, float, float]:
    """Return left, top, right and bottom of a text as it is drawn [pixels]."""
    width, height = _drawn_text(drawing_package(), text, {}).get_size()
    left, top = _corner(text, (width, height))
    return left, top, left + width, top + height


def _corner(text: Text, size: tuple[int, int]) -> tuple[int, int]:
    share = {"left": 0.0, "centre": 0.5, "right": 1.0}[text.anchor]
    x, y = text.position
    return round(x - share * size[0]), round(y - 0.5 * size[1])


def _drawn_text(package: Any, text: Text, fonts: dict[int, Any]) -> Any:
    height = round(text.size)
    key = (text.text, height, text.colour)
    if key not in _texts:
        if len(_texts) >= _MOST_TEXTS:
            _texts.clear()
        # Fonts are opened per picture: those kept die when somebody calls pygame.quit().
        if height not in fonts:
            fonts[height] = package.font.Font(None, height)
        _texts[key] = fonts[height].render(text.text, True, text.colour)
    return _texts[key]


def _draw(package: Any, surface: Any, shape: Line | Polygon | Circle | Arrow) -> None:
    if isinstance(shape, Polygon):
        points = _enlarged(shape.points)
        if shape.fill is not None:
            package.draw.polygon(surface, shape.fill, points)
        if shape.outline is not None:
            _draw_chain(package, surface, shape.outline, [*points, points[0]], shape.width)
    elif isinstance(shape, Line):
        _draw_chain(package, surface, shape.colour, _enlarged(shape.points), shape.width)
    elif isinstance(shape, Circle):
        (centre,) = _enlarged((shape.centre,))
        package.draw.circle(surface, shape.fill, centre, _OVERSAMPLING * shape.radius)
    else:
        _draw_arrow(package, surface, shape)


def _draw_chain(
    package: Any, surface: Any, colour: tuple[int, int, int], points: list[Point], width: float
) -> None:
    broad = max(1, round(_OVERSAMPLING * width))
    if len(points) > 1:
        package.draw.lines(surface, colour, False, points, broad)


def _draw_arrow(package: Any, surface: Any, arrow: Arrow) -> None:
    (x0, y0), (x1, y1) = _enlarged((arrow.tail, arrow.tip))
    length = float(np.hypot(x1 - x0, y1 - y0))
    if length < 1.0:
        return
    ux, uy = (x1 - x0) / length, (y1 - y0) / length
    half = 0.5 * _OVERSAMPLING * arrow.width
    head = min(length, 6.0 * half)
    wide = max(half, 0.55 * head)
    neck = length - head

    def at(along: float, across: float) -> Point:
        return x0 + along * ux - across * uy, y0 + along * uy + across * ux

    outline = [
        at(0.0, -half),
        at(neck, -half),
        at(neck, -wide),
        at(length, 0.0),
        at(neck, wide),
        at(neck, half),
        at(0.0, half),
    ]
    if arrow.halo is not None:
        package.draw.lines(surface, arrow.halo, True, outline, 2 * _OVERSAMPLING)
    package.draw.polygon(surface, arrow.colour, outline)


def _enlarged(points: tuple[Point, ...]) -> list[Point]:
    return [(_OVERSAMPLING * x, _OVERSAMPLING * y) for x, y in points]


class Window:
    """A window that shows frames at their pace, for people.

    pygame has one window per process: opening a second `Window` takes over the first one's.
    A window that its reader closed stays closed; further frames are not shown, and no error.

    Args:
        title: Text of the title bar.
        fps: Frames per second; `show` waits as long as that takes.

    Raises:
        ArgumentError: `fps` is not above zero, pygame is not installed, or (at the first frame)
            there is no display.
    """

    def __init__(self, title: str = "railenv", fps: float = 25.0) -> None:
        self.title = title
        self.fps = check_positive("fps", fps, "frames per second")
        self._package = drawing_package()
        self._clock: Any = None
        self._closed = False

    @property
    def is_open(self) -> bool:
        """Whether frames are still shown: not closed by `close` or by the reader."""
        return not self._closed

    def show(self, frame: Frame) -> None:
        """Show a frame, answer the window's events, and wait for the frame's time.

        Args:
            frame: Red, green and blue, shape (height, width, 3).
        """
        if self._closed:
            return
        package, size = self._package, (frame.shape[1], frame.shape[0])
        screen = self._screen(size)
        data = np.ascontiguousarray(frame).tobytes()
        screen.blit(package.image.frombuffer(data, size, "RGB"), (0, 0))
        package.display.flip()
        if any(event.type == package.QUIT for event in package.event.get()):
            self.close()
            return
        self._clock.tick(self.fps)

    def close(self) -> None:
        """Close the window; a second call does nothing."""
        if not self._closed and self._clock is not None:
            self._package.display.quit()
        self._closed = True

    def __enter__(self) -> "Window":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _screen(self, size: tuple[int, int]) -> Any:
        package = self._package
        shown = package.display.get_surface() if package.display.get_init() else None
        if self._clock is not None and shown is not None and shown.get_size() == size:
            return shown
        try:
            package.display.init()
            screen = package.display.set_mode(size)
        except package.error as error:
            raise ArgumentError(
                f"no window can be opened ({error}); use render_mode='rgb_array' without a display"
            ) from None
        package.display.set_caption(self.title)
        self._clock = package.time.Clock()
        return screen
