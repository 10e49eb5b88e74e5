"""The picture of one run: floor accelerations, bogie accelerations and forces over time."""

from pathlib import Path

from railenv.errors import RailenvError
from railenv.files import replacing
from railenv.simulation import Trajectory


def plot_run(trajectory: Trajectory, path: Path) -> None:
    """Draw the first lane of a run into a file.

    Args:
        trajectory: Signals of `eval.rollout.rollout`.
        path: Target; its ending chooses the format.

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
    forces = [name for name in trajectory.names if name.startswith("actuator_force")]
    figure = Figure(figsize=(9.0, 7.5 if forces else 5.5), layout="constrained")
    FigureCanvasAgg(figure)
    rows = 3 if forces else 2
    axes = figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
    for end, colour in (("front", "#0072B2"), ("rear", "#D55E00")):
        signal = trajectory.signal(f"floor_{end}_lateral_acceleration")[0]
        axes[0].plot(trajectory.time, signal, color=colour, lw=0.8, label=f"{end} floor")
    for number, colour in ((1, "#0072B2"), (2, "#D55E00")):
        signal = trajectory.signal(f"bogie{number}_lateral_acceleration")[0]
        axes[1].plot(trajectory.time, signal, color=colour, lw=0.6, label=f"bogie {number}")
    for name, colour in zip(forces, ("#0072B2", "#56B4E9", "#E69F00", "#D55E00"), strict=False):
        label = "actuator " + name.rsplit("_", 1)[1]
        axes[2].plot(
            trajectory.time, trajectory.signal(name)[0] / 1e3, color=colour, lw=0.8, label=label
        )
    labels = (
        "floor\nlateral acceleration [m/s²]",
        "bogie frame\nlateral acceleration [m/s²]",
        "force [kN]",
    )
    for axis, label in zip(axes, labels, strict=False):
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
        axis.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=4, fontsize=8, frameon=False)
    axes[-1].set_xlabel("time [s]")
    s = trajectory.settings
    if s:
        delay = max(s["delay_s"], default=0.0)
        figure.suptitle(
            f"{s['controller']}, layout {s['layout']}, {s['speed_kmh']:g} km/h, {s['track']}, "
            f"delay {1000 * delay:g} ms",
            fontsize=10,
        )
    with replacing(path) as stream:
        figure.savefig(stream, format=path.suffix[1:], dpi=120)
