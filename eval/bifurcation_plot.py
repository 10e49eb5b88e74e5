"""The picture of a bifurcation: amplitude against speed, both ways, with the critical speeds.

`python -m eval.bifurcation_plot FILE` draws Cooperrider's bogie with the published numbers.
"""

import argparse
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from railenv.errors import RailenvError
from railenv.files import replacing
from railenv.simulation.bifurcation import BifurcationDiagram, bifurcation_diagram
from railenv.simulation.linear_speed import linear_critical_speed
from railenv.simulation.periodic_orbits import OrbitBranch, follow_orbits
from railenv.simulation.settling import Settling
from railenv.vehicle.cooperrider import CooperriderBogie

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_CYCLE, _UNSTABLE, _UP, _DOWN, _REST = "#0072B2", "#999999", "#D55E00", "#009E73", "#000000"


def plot_bifurcation(
    diagram: BifurcationDiagram,
    path: Path,
    *,
    branch: OrbitBranch | None = None,
    title: str = "",
    output: str = "wheelset lateral amplitude",
    kmh: bool = False,
) -> None:
    """Draw a diagram into a file.

    Args:
        diagram: Both ramps and the critical speeds; outputs in metres.
        path: Target; its ending chooses the format.
        branch: Limit cycles, for the lines; without them the ramps' points are joined.
        title: Line above the picture.
        output: What the amplitude is of.
        kmh: Draw speeds in km/h instead of m/s.

    Raises:
        RailenvError: matplotlib is not installed.
        OutputError: The file cannot be written.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ModuleNotFoundError:
        raise RailenvError(
            'a plot needs matplotlib, which is not installed: pip install "railenv[plot]"'
        ) from None
    figure = Figure(figsize=(8.0, 5.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    unit = (3.6, "km/h", 1) if kmh else (1.0, "m/s", 2)
    _rest(axes, diagram, unit)
    if branch is not None:
        _branch(axes, branch, unit)
    for ramp, marker, colour, label in (
        (diagram.up, "^", _UP, "speed stepped up from rest"),
        (diagram.down, "v", _DOWN, "speed stepped down from the large cycle"),
    ):
        style = "none" if branch is not None else ":"
        seen = np.where(np.isfinite(ramp.amplitudes), ramp.amplitudes, np.nan)
        axes.plot(
            unit[0] * ramp.speeds, 1000 * seen, marker=marker, color=colour, ls=style, ms=6,
            mfc="none", label=label, zorder=3,
        )  # fmt: skip
        loose = ramp.hunting & ~ramp.settled
        if np.any(loose):
            label = f"not settled on the way {'up' if marker == '^' else 'down'}"
            axes.plot(
                unit[0] * ramp.speeds[loose], 1000 * seen[loose], "x", color=colour, label=label
            )
    _critical_speeds(axes, diagram, branch, unit)
    axes.set_xlabel(f"speed [{unit[1]}]")
    axes.set_ylabel(f"{output} [mm]")
    axes.set_ylim(bottom=-0.3)
    axes.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=2, fontsize=8, frameon=False)
    verdict = textwrap.fill(f"{diagram.kind.value}: {diagram.reason}", 100)
    axes.set_title(f"{title}\n{verdict}" if title else verdict, fontsize=9)
    with replacing(path) as stream:
        figure.savefig(stream, format=path.suffix[1:], dpi=120)


_Unit = tuple[float, str, int]  # factor on m/s, its name, digits after the point


def _rest(axes: "Axes", diagram: BifurcationDiagram, unit: _Unit) -> None:
    """Draw the straight run, stable up to the linear critical speed and unstable beyond it."""
    if diagram.linear is None:
        return
    low, high = unit[0] * float(diagram.up.speeds[0]), unit[0] * float(diagram.up.speeds[-1])
    edge = min(max(unit[0] * diagram.linear.speed, low), high)
    axes.plot([low, edge], [0, 0], color=_REST, lw=1.8, label="straight run, stable")
    axes.plot([edge, high], [0, 0], color=_UNSTABLE, lw=1.2, ls="--")


def _branch(axes: "Axes", branch: OrbitBranch, unit: _Unit) -> None:
    """Draw limit cycles: stable ones as a line, unstable ones dashed, folds between them."""
    points = [(unit[0] * o.speed, 1000 * o.amplitude, o.stable) for o in branch.orbits]
    start = 0
    named: set[bool] = set()
    for end in range(1, len(points) + 1):
        if end < len(points) and points[end][2] == points[start][2]:
            continue
        stable = points[start][2]
        piece = points[start : min(end + 1, len(points))]  # up to the next piece, without a gap
        axes.plot(
            [p[0] for p in piece],
            [p[1] for p in piece],
            color=_CYCLE if stable else _UNSTABLE,
            lw=1.8 if stable else 1.2,
            ls="-" if stable else "--",
            label=None if stable in named else f"limit cycle, {'' if stable else 'un'}stable",
        )
        named.add(stable)
        start = end


def _critical_speeds(
    axes: "Axes", diagram: BifurcationDiagram, branch: OrbitBranch | None, unit: _Unit
) -> None:
    """Mark the Hopf point, the lowest speed of hunting and, where known, the folds."""
    factor, name, digits = unit
    if diagram.linear is not None:
        point = "Hopf point" if diagram.linear.frequency > 0.0 else "divergence"
        speed = factor * diagram.linear.speed
        axes.plot(
            [speed], [0.0], "o", color=_REST, ms=7, zorder=4,
            label=f"{point} {speed:.{digits}f} {name}",
        )  # fmt: skip
    if np.isfinite(diagram.hunting_speed) and diagram.rest_speed > 0.0:
        speed = factor * diagram.hunting_speed
        axes.axvline(
            speed, color=_DOWN, lw=0.8, ls=":",
            label=f"lowest speed of hunting on the way down {speed:.{digits}f} {name}",
        )  # fmt: skip
    for fold in () if branch is None else branch.folds:
        speed = factor * fold.speed
        axes.plot(
            [speed], [1000 * fold.amplitude], "s", color=_CYCLE, ms=7, mfc="white", zorder=4,
            label=f"fold {speed:.{digits}f} {name}",
        )  # fmt: skip


def cooperrider_diagram() -> tuple[BifurcationDiagram, OrbitBranch]:
    """Return what is drawn for Cooperrider's bogie: ramps, critical speeds and limit cycles."""
    bogie = CooperriderBogie()
    small, large = np.zeros(bogie.state_size), np.zeros(bogie.state_size)
    small[0], large[0] = 1e-5, 0.01
    linear = linear_critical_speed(bogie.linearisation, 20.0, 120.0)
    diagram = bifurcation_diagram(
        bogie, np.arange(62.0, 75.5, 0.5), small, large, Settling(samples=2000),
        linear=linear, tolerance=0.01,
    )  # fmt: skip
    down = diagram.down
    branch = follow_orbits(
        bogie, down.states[0], 1.0 / float(down.frequencies[0]), float(down.speeds[0]),
        lowest=55.0, highest=76.0, least_amplitude=1e-4,
    )  # fmt: skip
    return diagram, branch


def main() -> None:
    """Draw Cooperrider's bogie into the file named on the command line."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("file", type=Path, help="picture to write; its ending chooses the format")
    path = parser.parse_args().file
    diagram, branch = cooperrider_diagram()
    plot_bifurcation(
        diagram, path, branch=branch, title="Cooperrider's bogie on straight track",
        output="leading wheelset's lateral amplitude",
    )  # fmt: skip


if __name__ == "__main__":
    main()
