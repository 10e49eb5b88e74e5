"""Pictures of the running vehicle: as pixels, as text, and in a window.

`View` holds what is shown. `scene` turns it into shapes without any drawing package, `draw` shapes
into pixels with pygame (`pip install "railenv[render]"`, loaded at the first picture), `ansi` the
view into text.
"""

from railenv.rendering.ansi import draw_text
from railenv.rendering.draw import Window, draw_frame
from railenv.rendering.scene import build_scene
from railenv.rendering.view import View

__all__ = ["View", "Window", "build_scene", "draw_frame", "draw_text"]
