"""The picture of learning curves. Matplotlib is imported when it is drawn, without pyplot."""

from pathlib import Path
from typing import Any

from eval.chart_plot import check_drawing
from eval.palette import BLUE, GREEN, GREY, ORANGE, PURPLE, VERMILLION
from eval.policy_score_references import LQG, PASSIVE, PREVIEW, SKYHOOK, YARDSTICK
from railenv.files import replacing

_STYLE: dict[Any, Any] = {
    "font.size": 10.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#555555",
    "axes.grid": True,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.7,
    "text.parse_math": False,
    "svg.hashsalt": "railenv",
}
_LINES = {
    PASSIVE: (GREY, ":", "passive"),
    SKYHOOK: (VERMILLION, "--", "best sky-hook at each delay"),
    LQG: (PURPLE, "--", "LQG, told the delay"),
    PREVIEW: (GREEN, "--", "LQG with preview"),
    YARDSTICK: (ORANGE, "-.", "full information with preview"),
}
_ROOM = 0.3
_GAP = 0.035


def draw_curve(curve: dict[str, Any], path: Path) -> None:
    """Draw learning curves into a file.

    Checkpoints above the picture (unstable or untrained ones) are triangles at its upper edge;
    hollow markers are checkpoints that the judge found unstable.

    Args:
        curve: What `eval.policy_score_curve.learning_curve` returned.
        path: Target; its ending chooses the format.

    Raises:
        RailenvError: matplotlib is not installed.
        OutputError: The file cannot be written.
    """
    check_drawing()
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)
        figure = Figure(figsize=(7.6, 4.4), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.add_subplot()
        bottom, top = _range(curve)
        for number, run in enumerate(curve["runs"]):
            _draw_run(axes, run, top, first=number == 0)
        axes.set(ylim=(bottom, top))
        axes.set_xlim(left=0.0)
        _draw_lines(axes, curve["lines"], top - bottom)
        axes.set_xlabel("wall-clock time [min]")
        delays = curve["delays_s"]
        axes.set_ylabel("ride index, worse floor end")
        span = f"{1000 * delays[0]:g} to {1000 * delays[-1]:g} ms"
        axes.set_title(f"mean over delays of {span}, {curve['kind']}", fontsize=10)
        axes.legend(loc="upper right", frameon=False, fontsize=9)
        with replacing(path) as stream:
            metadata = {"Date": None} if path.suffix == ".svg" else None
            figure.savefig(stream, format=path.suffix[1:], dpi=160, metadata=metadata)


def _range(curve: dict[str, Any]) -> tuple[float, float]:
    """Return the ends of the ordinate: the lines and the best checkpoints with some room."""
    best = [min((v for v in run["index"] if v is not None), default=2.0) for run in curve["runs"]]
    known = [*curve["lines"].values(), *best]
    return min(known) - 0.1, max(known) + _ROOM


def _draw_run(axes: Any, run: dict[str, Any], top: float, *, first: bool) -> None:
    minutes = [s / 60.0 for s in run["seconds"]]
    points = list(zip(minutes, run["index"], run["stable"], strict=True))
    inside = [(x, y) for x, y, _ in points if y is not None]
    axes.plot(*zip(*inside, strict=True), "-", color=BLUE, lw=1.2, alpha=0.8, zorder=3)
    for stable, face in ((True, BLUE), (False, "white")):
        kept = [(x, y) for x, y, s in points if y is not None and y < top and s == stable]
        if kept:
            label = ("policy" if stable else "policy, unstable by eigenvalues") if first else None
            x, y = zip(*kept, strict=True)
            axes.plot(x, y, "o", ms=5, mfc=face, mec=BLUE, zorder=4, label=label)
    above = [x for x, y, _ in points if y is None or y >= top]
    if above:
        axes.plot(
            above, [top - 0.01 * _ROOM] * len(above), "^", ms=6, color=BLUE, zorder=5,
            clip_on=False, label="above the picture" if first else None,
        )  # fmt: skip


def _draw_lines(axes: Any, lines: dict[str, float], height: float) -> None:
    """Draw the references and write their names at the right, apart from each other."""
    taken: list[float] = []
    for name, value in sorted(lines.items(), key=lambda item: item[1]):
        color, dash, word = _LINES[name]
        axes.axhline(value, color=color, ls=dash, lw=1.4, zorder=2)
        place = value
        if taken and place - taken[-1] < _GAP * height:
            place = taken[-1] + _GAP * height
        taken.append(place)
        axes.annotate(
            f"{word} {value:.2f}", (1.0, place), (4, 0), xycoords=("axes fraction", "data"),
            textcoords="offset points", va="center", fontsize=9, color=color, annotation_clip=False,
        )  # fmt: skip
