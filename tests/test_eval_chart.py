"""`railenv chart`: axes of every kind, table, JSON, data and picture, and one line per mistake."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from eval.chart_contours import colour_scale
from eval.chart_plot import AxisText, plot_chart
from eval.cli import main
from railenv.stability import DelaySystem
from railenv.stability.chart import stability_chart

CHART = ("chart", "--controller", "skyhook", "--max-delay", "0.5")
PNG = b"\x89PNG\r\n\x1a\n"


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    status = main(list(arguments))
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def answer(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict:
    status, out, err = run(capsys, *arguments, "--json")
    assert status == 0, err
    return json.loads(out)


def alone(capsys: pytest.CaptureFixture[str], *arguments: str) -> float:
    """The same question to `critical-delay`."""
    return answer(capsys, "critical-delay", *arguments, "--max-delay", "0.5")["critical_delay_s"]


def test_gain_and_speed_make_a_chart_of_the_papers_vehicle(capsys) -> None:
    found = answer(capsys, *CHART, "--x", "gain=35e3:60e3:2", "--y", "speed_kmh=300")
    assert found["critical_delay_s"] == [pytest.approx([0.202026, 0.141884], abs=1e-6)]
    assert found["status"] == [["critical", "critical"]]
    assert found["failures"] == []
    assert found["frequency_hz"][0][0] == pytest.approx(1.323, abs=1e-3)


def test_the_actuators_lag_and_a_layout_reach_the_loop(capsys) -> None:
    axes = ("--x", "actuator_lag=0.02", "--y", "speed_kmh=200")
    found = answer(capsys, *CHART, *axes, "--layout", "2")
    loop = ("--controller", "skyhook", "--layout", "2", "--speed-kmh", "200")
    assert found["critical_delay_s"][0][0] == alone(capsys, *loop, "--actuator-lag", "0.02")


def test_a_multiple_of_a_parameter_is_that_multiple_of_the_catalogues_value(capsys) -> None:
    times = answer(capsys, *CHART, "--x", "carbody_mass*=0.9", "--y", "conicity=0.1")
    value = answer(capsys, *CHART, "--x", f"carbody_mass={0.9 * 40390}", "--y", "conicity=0.1")
    assert times["critical_delay_s"] == value["critical_delay_s"]
    usual = answer(capsys, *CHART, "--x", "carbody_mass*=1", "--y", "conicity*=1")
    assert usual["critical_delay_s"][0][0] == pytest.approx(0.202026, abs=1e-6)
    assert times["critical_delay_s"] != usual["critical_delay_s"]


def test_several_parameters_are_multiplied_together(capsys) -> None:
    together = "carbody_mass+carbody_yaw_inertia+carbody_roll_inertia*=1.2"
    loaded = answer(capsys, *CHART, "--x", together, "--y", "speed_kmh=300")
    heavy = answer(capsys, *CHART, "--x", "carbody_mass*=1.2", "--y", "speed_kmh=300")
    assert loaded["critical_delay_s"][0][0] > 0.202026
    assert loaded["critical_delay_s"] != heavy["critical_delay_s"]


def test_a_logarithmic_axis_has_equal_ratios(capsys) -> None:
    found = answer(capsys, *CHART, "--x", "gain=10e3:90e3:3:log", "--y", "speed_kmh=300")
    assert found["x_values"] == pytest.approx([10e3, 30e3, 90e3])


def test_points_that_are_refused_are_counted_and_do_not_stop_the_chart(
    capsys, tmp_path: Path
) -> None:
    axes = ("--x", "gain=30e3:60e3:2", "--y", "actuator_lag=-0.01:0.01:2")
    status, out, _ = run(capsys, *CHART, *axes, "--plot", str(tmp_path / "chart.png"))
    assert status == 0
    assert "2 without answer" in out
    assert "must not be negative" in out
    assert (tmp_path / "chart.png").read_bytes()[:8] == PNG


def test_data_and_picture_are_written(capsys, tmp_path: Path) -> None:
    axes = ("--x", "gain=20e3:60e3:3", "--y", "speed_kmh=200:400:2")
    out, plot = tmp_path / "deep" / "chart.npz", tmp_path / "chart.svg"
    found = answer(capsys, *CHART, *axes, "--out", str(out), "--plot", str(plot))
    with np.load(out, allow_pickle=False) as archive:
        finite = np.where(np.isfinite(archive["critical_delay"]), archive["critical_delay"], -1.0)
        listed = [[-1.0 if v is None else v for v in row] for row in found["critical_delay_s"]]
        assert finite.tolist() == listed
        assert archive["status"].tolist() == found["status"]
        settings = json.loads(str(archive["settings"]))
    assert settings["x"] == "gain=20e3:60e3:3"
    assert settings["layout"] == "4"
    assert "<svg" in plot.read_text()


def test_the_table_shows_the_largest_y_on_top(capsys) -> None:
    out = run(capsys, *CHART, "--x", "gain=35e3", "--y", "speed_kmh=300:400:2")[1]
    lines = out.splitlines()
    assert lines[3].split() == ["400", "unstable"]
    assert lines[4].split() == ["300", "202.0"]


def test_a_loop_without_actuators_has_a_chart_of_its_own_stability(capsys, tmp_path: Path) -> None:
    plot = ("--plot", str(tmp_path / "passive.png"))
    axes = ("--x", "conicity=0.1:0.6:2", "--y", "speed_kmh=100:400:2")
    found = answer(capsys, "chart", "--controller", "passive", *axes, *plot)
    assert found["status"] == [["always", "always"], ["always", "unstable"]]
    assert found["settings"]["layout"] == "passive"


USUAL = ("--y", "speed_kmh=300")
BAD_INPUT = [
    (*CHART, *USUAL),
    (*CHART, "--x", "gain", *USUAL),
    (*CHART, "--x", "gain=1:2", *USUAL),
    (*CHART, "--x", "gain=1:2:1", *USUAL),
    (*CHART, "--x", "gain=2:1:3", *USUAL),
    (*CHART, "--x", "gain=1:nan:3", *USUAL),
    (*CHART, "--x", "gain=1:2:3:lin", *USUAL),
    (*CHART, "--x", "gain=1:2:3:log:log", *USUAL),
    (*CHART, "--x", "gain=0:2:3:log", *USUAL),
    (*CHART, "--x", "gain=1:2:1000000000", *USUAL),
    (*CHART, "--x", "gain=1:2:1000", "--y", "speed_kmh=1:2:1000"),
    (*CHART, "--x", "gian=1:2:3", *USUAL),
    (*CHART, "--x", "speed_kmh*=1:2:3", "--y", "gain=1"),
    (*CHART, "--x", "speed_kmh=1:2:3", *USUAL),
    (*CHART, "--x", "carbody_mass*=1:2:3", "--y", "carbody_mass=1"),
    (*CHART, "--x", "speed_kmh=-2:-1:2", "--y", "gain=1"),
    (*CHART, "--x", "gain=1:2:3", *USUAL, "--jobs", "0"),
    (*CHART, "--x", "gain=1:2:3", *USUAL, "--max-delay", "0"),
    (*CHART, "--x", "gain=1:2:3", *USUAL, "--layout", "3"),
    (*CHART, "--x", "gain=1:2:3", *USUAL, "--actuator-lag", "-1"),
    (*CHART, "--x", "gain=1:2:3", *USUAL, "--plot", "chart.bmp"),
    ("chart", "--controller", "skyhook:gain=3", "--x", "gain=1:2:3", *USUAL),
    ("chart", "--controller", "skyhok", "--x", "conicity=0.1:0.2:2", *USUAL),
]


@pytest.mark.parametrize("arguments", BAD_INPUT, ids=" ".join)
def test_bad_input_gives_one_clear_line_and_status_two(
    capsys, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...]
) -> None:
    monkeypatch.chdir(tmp_path)
    status, out, err = run(capsys, *arguments)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert err.startswith("railenv chart: ")
    assert list(tmp_path.iterdir()) == []


def test_a_misspelt_axis_names_the_nearest_and_every_kind(capsys) -> None:
    err = run(capsys, *CHART, "--x", "conicty=0.1:0.2:2", *USUAL)[2]
    assert "'conicity'" in err
    for kind in ("speed_kmh", "actuator_lag", "setting of the controller (gain)", "NAME*"):
        assert kind in err


def test_without_matplotlib_a_plot_is_refused_before_the_work(
    capsys, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setattr("eval.command_chart.stability_chart", None)
    axes = ("--x", "gain=1:2:3", *USUAL)
    status, _, err = run(capsys, *CHART, *axes, "--plot", str(tmp_path / "chart.png"))
    assert status == 1
    assert 'pip install "railenv[plot]"' in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("unit", "values", "label", "shown"),
    [
        ("N s/m", [1e4, 1e5], "gain [kN s/m]", [10.0, 100.0]),
        ("N/m", [1e6, 8e6], "gain [MN/m]", [1.0, 8.0]),
        ("kg", [3e4, 5e4], "gain [t]", [30.0, 50.0]),
        ("kg m^2", [3e4, 5e4], "gain [t m^2]", [30.0, 50.0]),
        ("s", [0.0, 0.05], "gain [ms]", [0.0, 50.0]),
        ("N s/m", [0.0, 500.0], "gain [N s/m]", [0.0, 500.0]),
        ("km/h", [100.0, 4000.0], "gain [km/h]", [100.0, 4000.0]),
        ("1", [0.1, 0.2], "gain", [0.1, 0.2]),
    ],
)
def test_axes_have_units_of_fitting_size(
    unit: str, values: list[float], label: str, shown: list[float]
) -> None:
    found, scaled = AxisText("gain", unit).scaled(np.array(values))
    assert found == label
    assert scaled == pytest.approx(shown)


@pytest.mark.parametrize("high", [101.0, 130.0, 390.0, 410.0, 2e3, 5e5])
def test_contour_levels_are_few_rising_and_inside(high: float) -> None:
    scale = colour_scale(np.array([100.0, high]))
    assert 1 <= len(scale.levels) <= 10
    assert all(np.diff(scale.levels) > 0.0)
    assert scale.levels[0] > 100.0
    assert scale.levels[-1] < high


def oscillator(damping: float, gain: float) -> DelaySystem:
    A = np.array([[0.0, 1.0], [-40.0, -damping]])
    return DelaySystem(A, np.array([[0.0], [1.0]]), np.array([[0.0, gain]]))


@pytest.mark.parametrize(
    ("dampings", "gains"),
    [
        ([0.5], [1.0]),  # a single point
        ([0.5, 0.6], [0.1]),  # a row without crossings
        ([-0.5, 0.5, 0.7], [0.4]),  # a row with an unstable point
        ([0.5], [1.0, 2.0]),  # a column
        ([-0.5, -0.4], [0.1, 0.2]),  # unstable throughout: no colours
        ([-0.5, 0.6, 3.0], [0.1, 1.0, 2.0]),  # every region
    ],
)
@pytest.mark.slow
def test_a_chart_of_any_shape_is_drawn(
    tmp_path: Path, dampings: list[float], gains: list[float]
) -> None:
    chart = stability_chart(oscillator, "damping", dampings, "gain", gains)
    plot_chart(chart, tmp_path / "chart.png", y=AxisText("gain $x_1", log=True))
    assert (tmp_path / "chart.png").read_bytes()[:8] == PNG


@pytest.mark.slow
@pytest.mark.parametrize("jobs", ["1", "2"])
def test_an_interrupted_chart_leaves_neither_file_nor_worker(tmp_path: Path, jobs: str) -> None:
    command = [sys.executable, "-m", "eval.cli", *CHART, "--x", "gain=1e3:100e3:100"]
    command += ["--y", "speed_kmh=100:300:30", "--jobs", jobs, "--out", "a.npz", "--plot", "a.png"]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parent.parent)}
    process = subprocess.Popen(
        command, cwd=tmp_path, env=environment, start_new_session=True, stderr=subprocess.PIPE
    )
    time.sleep(6.0)  # imports are done and the work has begun, or on a busy machine nearly
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to the command and its workers
    _, err = process.communicate(timeout=20)
    assert process.returncode == 130
    assert err.decode().rstrip().endswith("railenv chart: interrupted")
    assert b"Traceback" not in err
    assert list(tmp_path.iterdir()) == []
    # what counts the workers' semaphores ends just after its parent
    end = time.monotonic() + 10.0
    while living(process.pid) and time.monotonic() < end:
        time.sleep(0.1)
    assert living(process.pid) == []


def living(group: int) -> list[str]:
    """Processes of a group, without dead ones that nobody has taken note of (Linux)."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            name, _, rest = path.read_text().rpartition(")")
        except OSError:  # it has just ended
            continue
        state, _, its_group, *_ = rest.split()
        if int(its_group) == group and state not in "ZX":
            found.append(name)
    return found
