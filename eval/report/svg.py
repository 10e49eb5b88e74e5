"""Charts as SVG elements: plain numbers in, markup out, text as text.

Everything that is put in is escaped. Colours come from the page's style sheet by class, so that a
chart prints and a line can be picked out by a script; see `eval/templates/report.css`.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from markupsafe import Markup

WIDTH, HEIGHT = 460.0, 300.0
_MARKS = {
    "o": "M-4 0a4 4 0 1 0 8 0a4 4 0 1 0 -8 0z",
    "s": "M-3.6 -3.6h7.2v7.2h-7.2z",
    "^": "M0 -4.6l4.6 8.2h-9.2z",
    "D": "M0 -5l5 5l-5 5l-5 -5z",
    "v": "M0 4.6l4.6 -8.2h-9.2z",
    "p": "M0 -4.6l4.5 3.3l-1.7 5.3h-5.6l-1.7 -5.3z",
}
"""Marks around the origin [px]."""

MARKS = tuple(_MARKS)

Point = tuple[float, float]


def visible(text: str) -> str:
    """Keep what can be seen of a text; names in records must not turn the page's writing round."""
    return "".join(c if c.isprintable() else " " if c.isspace() else "?" for c in text)


def ticks(low: float, high: float, most: int = 7) -> list[float]:
    """Return at most `most` round numbers from low to high.

    Args:
        low: Lower end.
        high: Upper end.
        most: At least 2.
    """
    raw = (high - low) / most
    power = 10.0 ** math.floor(math.log10(raw))
    # A step that suits milliseconds and hundredths; ten always does.
    step = next(power * m for m in (1.0, 2.0, 2.5, 5.0, 10.0, 20.0) if power * m >= raw)
    first = math.ceil(low / step - 1e-9)
    count = math.floor(high / step + 1e-9) - first + 1
    return [round((first + k) * step, 12) + 0.0 for k in range(count)]


def mark(shape: str, place: str, at: Point, classes: str, title: str) -> Markup:
    """Return a mark with its tooltip.

    Args:
        shape: One of `MARKS`.
        place: Value of `data-c`, by which a script finds it.
        at: Where [px].
        classes: Of the style sheet.
        title: Tooltip; "" for none.
    """
    told = Markup("<title>{}</title>").format(visible(title)) if title else ""
    return Markup(
        '<path class="{}" data-c="{}" transform="translate({} {})" d="{}">{}</path>'
    ).format(classes, place, f"{at[0]:.1f}", f"{at[1]:.1f}", _MARKS[shape], told)


@dataclass
class Chart:
    """One chart with linear axes.

    Attributes:
        name: Unique in the page; ids begin with it.
        title: What it shows, for those who do not see it.
        x_axis, y_axis: Words and unit.
        x_range, y_range: Ends of the axes.
        height: Of the whole chart [px].
        strip: Room over the axes, for what is above the range [px].
    """

    name: str
    title: str
    x_axis: str
    y_axis: str
    x_range: tuple[float, float]
    y_range: tuple[float, float]
    height: float = HEIGHT
    strip: float = 0.0
    _parts: list[Markup] = field(default_factory=list)

    @property
    def left(self) -> float:
        """Where the axes begin: right of the longest number beside them [px]."""
        longest = max(len(_minus(value)) for value in ticks(*self.y_range, 6))
        return max(56.0, 30.0 + 7.5 * longest)

    @property
    def right(self) -> float:
        """Where they end [px]."""
        return WIDTH - 14.0

    @property
    def top(self) -> float:
        """Where they begin from above [px]."""
        return 10.0 + self.strip

    @property
    def bottom(self) -> float:
        """Where they end [px]."""
        return self.height - 42.0

    def x(self, value: float) -> float:
        """Return the place of a value [px]."""
        low, high = self.x_range
        return self.left + (value - low) / (high - low) * (self.right - self.left)

    def y(self, value: float) -> float:
        """Return the place of a value [px]."""
        low, high = self.y_range
        return self.bottom - (value - low) / (high - low) * (self.bottom - self.top)

    def add(self, part: Markup) -> None:
        """Add an element that is in pixels already."""
        self._parts.append(part)

    def line(self, points: Sequence[Point], classes: str, place: str, title: str) -> None:
        """Add a line through points in the axes' units, cut at the axes' edges."""
        self._path(self._through(points), classes, place, title)

    def area(self, low: Sequence[Point], high: Sequence[Point], classes: str, place: str) -> None:
        """Fill what lies between two lines over the same places."""
        around = self._through([*low, *reversed(high)])
        self._path(f"{around}z" if around else "", classes, place, "")

    def mark(self, shape: str, point: Point, classes: str, place: str, title: str) -> None:
        """Add a mark at a point in the axes' units."""
        self.add(mark(shape, place, (self.x(point[0]), self.y(point[1])), classes, title))

    def text(self, at: Point, words: str, classes: str, place: str = "") -> None:
        """Write words at a place [px]."""
        self.add(
            Markup('<text class="{}" data-c="{}" x="{}" y="{}">{}</text>').format(
                classes, place, f"{at[0]:.1f}", f"{at[1]:.1f}", visible(words)
            )
        )

    def markup(self, x_ticks: Iterable[float] | None = None) -> Markup:
        """Return the element.

        Args:
            x_ticks: Places of the ticks of the x axis; round numbers if None.
        """
        clip = Markup(
            '<clipPath id="{}-clip"><rect x="{}" y="{}" width="{}" height="{}"/></clipPath>'
        ).format(self.name, self.left, self.top - 1, self.right - self.left + 1,
                 self.bottom - self.top + 2)  # fmt: skip
        head = Markup(
            '<svg viewBox="0 0 {} {}" role="img" aria-labelledby="{}-title"><title id="{}-title">'
            "{}</title>{}"
        ).format(f"{WIDTH:g}", f"{self.height:g}", self.name, self.name, self.title, clip)
        axes = self._axes(list(x_ticks) if x_ticks is not None else ticks(*self.x_range))
        return head + axes + Markup("").join(self._parts) + Markup("</svg>")

    def _through(self, points: Sequence[Point]) -> str:
        # Far outside is as good as outside, and keeps the numbers short.
        far = 4.0 * self.height
        return "".join(
            f"{'L' if k else 'M'}{self.x(x):.1f} {min(max(self.y(y), -far), far):.1f}"
            for k, (x, y) in enumerate(points)
        )

    def _path(self, drawn: str, classes: str, place: str, title: str) -> None:
        if drawn:
            told = Markup("<title>{}</title>").format(visible(title)) if title else ""
            self.add(
                Markup(
                    '<path class="{}" data-c="{}" clip-path="url(#{}-clip)" d="{}">{}</path>'
                ).format(classes, place, self.name, drawn, told)
            )

    def _axes(self, x_ticks: Sequence[float]) -> Markup:
        parts: list[Markup] = []
        rule = Markup('<path class="{}" d="M{} {}L{} {}"/>')
        word = Markup('<text class="{}" x="{}" y="{}">{}</text>')
        for value in ticks(*self.y_range, 6):
            at = f"{self.y(value):.1f}"
            parts.append(rule.format("grid", f"{self.left:.1f}", at, f"{self.right:.1f}", at))
            parts.append(
                word.format("tick end", f"{self.left - 6:.1f}", f"{self.y(value) + 4:.1f}",
                            _minus(value))
            )  # fmt: skip
        for value in x_ticks:
            at = f"{self.x(value):.1f}"
            parts.append(rule.format("grid", at, f"{self.top:.1f}", at, f"{self.bottom:.1f}"))
            parts.append(word.format("tick middle", at, f"{self.bottom + 16:.1f}", _minus(value)))
        ends = (f"{self.left:.1f}", f"{self.bottom:.1f}", f"{self.right:.1f}", f"{self.bottom:.1f}")
        parts.append(rule.format("axis", *ends))
        middle = (self.left + self.right) / 2
        parts.append(
            word.format("tick middle", f"{middle:.1f}", f"{self.height - 6:.1f}", self.x_axis)
        )
        height = (self.top + self.bottom) / 2
        parts.append(
            Markup(
                '<text class="tick middle" transform="translate(13 {}) rotate(-90)">{}</text>'
            ).format(f"{height:.1f}", self.y_axis)
        )
        return Markup("").join(parts)


def _minus(value: float) -> str:
    return f"{value:g}".replace("-", "\N{MINUS SIGN}")
