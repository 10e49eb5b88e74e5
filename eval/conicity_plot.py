"""The picture of a wheel on a rail: contact points, rolling-radius difference, conicity.

Matplotlib is imported when a picture is drawn, without pyplot, and none of its global settings
changes.
"""

import textwrap
from pathlib import Path
from typing import Any

import numpy as np

from railenv.contact.conicity import Conicity, conicity, harmonic_conicity
from railenv.contact.geometry import WheelRail, rolling_radius_difference, wheelset_contact
from railenv.files import replacing
from railenv.units import FloatArray

_DARK = "#222222"
_BLUE, _ORANGE = "#0072B2", "#D55E00"
_STYLE: dict[Any, Any] = {
    "font.size": 9.5,
    "axes.edgecolor": "#555555",
    "text.parse_math": False,
    "svg.hashsalt": "railenv",
}
_LIFT_MM = 14.0
"""How far wheels are drawn above rails, so that lines between contact points can be seen."""
_LARGEST_SHIFT_MM = 8.0
_LARGEST_DIFFERENCE_MM = 6.0
"""Beyond it the flange climbs; the curve leaves the picture there."""


def plot_conicity(pair: WheelRail, found: Conicity, path: Path, title: str) -> None:
    """Draw contact points, rolling-radius difference and equivalent conicity into a file.

    Args:
        pair: Wheel on rail.
        found: Its equivalent conicity.
        path: Target; its ending chooses the format.
        title: Stands over the picture.

    Raises:
        OutputError: The file cannot be written.
    """
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(11.0, 7.6), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(2, 2, height_ratios=(1.0, 1.25))
        _draw_contact(figure, axes[0], pair)
        _draw_difference(axes[1, 0], pair, found)
        _draw_conicity(axes[1, 1], pair, found)
        figure.suptitle(textwrap.fill(title, 125), fontsize=10.5, color=_DARK)
        with replacing(path) as stream:
            figure.savefig(stream, format=path.suffix[1:], dpi=130)


def _draw_contact(figure: Any, axes: Any, pair: WheelRail) -> None:
    """Draw both wheels above both rails, seen from behind, with lines between contact points."""
    import matplotlib as mpl
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    shifts = np.arange(-_LARGEST_SHIFT_MM, _LARGEST_SHIFT_MM + 0.5, 1.0)
    colours = mpl.colormaps["coolwarm"](np.linspace(0.0, 1.0, len(shifts)))
    contact = wheelset_contact(pair, 1e-3 * shifts)
    wheel, rail = _outlines(pair)
    scale = ScalarMappable(Normalize(shifts[0], shifts[-1]), "coolwarm")
    for axis, side, points, name in (
        (axes[0], -1.0, contact.left, "left"),
        (axes[1], 1.0, contact.right, "right"),
    ):
        bottom, top = float(rail[1].min()), _LIFT_MM + 11.0
        for outline, z, colour, base in (
            (wheel[0], wheel[1] + _LIFT_MM, "#dfe7ee", top),
            (rail[0], rail[1], "#e9e4dc", bottom),
        ):
            axis.fill_between(side * outline, z, base, color=colour, lw=0.0)
            axis.plot(side * outline, z, color=_DARK, lw=1.2)
        on_wheel = 1e3 * (points.on_wheel + pair.tape_circle)
        on_rail = 1e3 * points.on_rail
        high = np.interp(on_wheel, wheel[0], wheel[1]) + _LIFT_MM
        low = np.interp(on_rail, rail[0], rail[1])
        for k, shift in enumerate(shifts):
            ends = side * np.array([on_wheel[k], on_rail[k]]), np.array([high[k], low[k]])
            centred = shift == 0.0
            axis.plot(
                *ends,
                color=_DARK if centred else colours[k],
                lw=1.8 if centred else 1.3,
                marker="o",
                ms=3.0,
                zorder=4 if centred else 3,
            )
        axis.set_aspect("equal")
        centre = 1e3 * pair.tape_circle
        axis.set_xlim(*sorted((side * (centre - 66.0), side * (centre + 52.0))))
        axis.set_ylim(bottom, top)
        axis.set_xlabel("y from the track's centre [mm]")
        axis.set_ylabel("height over the rail's crown [mm]")
        axis.set_title(f"{name} wheel, drawn {_LIFT_MM:g} mm above its rail", fontsize=9.5)
    bar = figure.colorbar(scale, ax=list(axes), shrink=0.8, pad=0.01)
    bar.set_label("shift to the right [mm]; black: centred")


def _outlines(pair: WheelRail) -> tuple[tuple[FloatArray, FloatArray], ...]:
    """Return y and height of the right wheel and the right rail in place [mm]."""
    length = np.hypot(1.0, pair.cant)
    y = (pair.rail.y + pair.cant * pair.rail.z) / length
    z = (pair.rail.z - pair.cant * pair.rail.y) / length
    curves = pair.placed.curves
    crown = curves.rail_start + curves.rail_step * int(np.argmin(curves.rail[:, 0]))
    place = crown - float(y[int(np.argmin(z))])
    # The rail counts from its own crown; the centred wheel touches it, its tape circle at the
    # height of the axle less its radius.
    lowest = pair.wheel_radius - pair.axle_height
    return (
        (1e3 * (pair.wheel.y + pair.tape_circle), -1e3 * (pair.wheel.z + lowest)),
        (1e3 * (y + place), -1e3 * (z - float(z.min()))),
    )


def _draw_difference(axis: Any, pair: WheelRail, found: Conicity) -> None:
    reach = 1e-3 * max(_LARGEST_SHIFT_MM, 1e3 * float(found.amplitude.max()) + 1.0)
    shift = np.arange(-reach, reach + 5e-6, 1e-5)
    difference = rolling_radius_difference(pair, shift)
    axis.plot(1e3 * shift, 1e3 * difference, color=_BLUE, lw=1.6)
    reached = 1.05e3 * float(np.abs(difference).max())
    largest = min(max(reached, 0.01), _LARGEST_DIFFERENCE_MM)
    axis.set_ylim(-largest, largest)
    axis.set_xlim(-1e3 * reach, 1e3 * reach)
    axis.set_xlabel("shift to the right [mm]")
    axis.set_ylabel("rolling radius, right minus left [mm]")
    axis.grid(alpha=0.3)


def _draw_conicity(axis: Any, pair: WheelRail, found: Conicity) -> None:
    last = float(found.amplitude.max())
    amplitudes = np.linspace(min(5e-4, 0.5 * last), last, 120)
    curve = conicity(pair, amplitudes.tolist())
    harmonic = [harmonic_conicity(curve.shift, curve.difference, a) for a in amplitudes.tolist()]
    axis.plot(1e3 * amplitudes, curve.conicity, color=_BLUE, lw=1.6, label="equivalent (EN 15302)")
    axis.plot(
        1e3 * amplitudes, harmonic, color=_ORANGE, lw=1.0, ls="--", label="harmonic linearisation"
    )
    axis.plot(1e3 * found.amplitude, found.conicity, "o", color=_BLUE, ms=4.5)
    for amplitude, value in zip(found.amplitude.tolist(), found.conicity.tolist(), strict=True):
        if np.isfinite(value) and len(found.amplitude) <= 10:
            axis.annotate(
                f"{value:.3f}",
                (1e3 * amplitude, value),
                xytext=(0, 8),
                textcoords="offset points",
                ha="center",
                fontsize=8,
                color=_DARK,
                bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.6},
            )
    known = [*np.extract(np.isfinite(curve.conicity), curve.conicity).tolist(), *harmonic, 1e-3]
    axis.set_ylim(0.0, 1.15 * max(known))
    axis.set_xlabel("amplitude [mm]")
    axis.set_ylabel("conicity")
    axis.grid(alpha=0.3)
    axis.legend(loc="upper left", fontsize=8.5, frameon=False)
