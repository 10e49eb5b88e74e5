"""`railenv hunting`: its arguments, what it prints, and one short run."""

import json
from pathlib import Path

import numpy as np
import pytest

from eval import command_hunting
from eval.cli import main
from eval.hunting_table import unstable_stretches
from railenv.simulation.bifurcation import BifurcationDiagram, Kind, SpeedRamp
from railenv.simulation.linear_speed import LinearCriticalSpeed


def ramp(speeds_kmh: list[float], amplitudes: list[float]) -> SpeedRamp:
    seen = np.array(amplitudes)
    return SpeedRamp(
        np.array(speeds_kmh) / 3.6,
        seen,
        np.where(seen > 1e-4, 3.5, 0.0),
        np.isfinite(seen),
        seen > 1e-4,
        np.zeros((len(seen), 2)),
    )


UP = ramp([400.0, 500.0, 600.0], [0.0, 1e-6, 0.010])
DOWN = ramp([600.0, 500.0, 400.0], [0.010, 0.009, 0.0])
LINEAR = LinearCriticalSpeed(150.0, 3.7, 100.0, 2.0)


@pytest.fixture
def found(monkeypatch: pytest.MonkeyPatch) -> None:
    """A diagram instead of the work, so that what is printed can be looked at."""
    made = BifurcationDiagram(
        UP, DOWN, LINEAR, 120.0, 119.9, 0.0085, (500 / 3.6,), Kind.SUBCRITICAL, "seen"
    )
    monkeypatch.setattr(command_hunting, "bifurcation_diagram", lambda *_, **__: made)
    monkeypatch.setattr(command_hunting, "_linear", lambda *_: (False, LINEAR))


def test_the_table_shows_both_ways_side_by_side(
    found: None, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["hunting", "--wheel", "lmb10"]) == 0
    lines = capsys.readouterr().out.splitlines()
    row = next(line.split() for line in lines if line.split()[0] == "500")
    assert row == ["500", "rest", "9.00", "3.50"]
    assert any("nonlinear critical speed  432.0 km/h (amplitude 8.50 mm" in line for line in lines)
    assert any("linear critical speed     540.0 km/h, 3.70 Hz" in line for line in lines)
    assert lines[-1] == "  subcritical: seen"


def test_json_is_one_object_with_speeds_in_kmh_and_amplitudes_in_metres(
    found: None, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["hunting", "--wheel", "lmb10", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["kind"] == "subcritical"
    assert record["linear_critical_speed_kmh"] == pytest.approx(540.0)
    assert record["nonlinear_critical_speed_kmh"] == pytest.approx(432.0)
    assert record["down"]["amplitude_m"] == [0.010, 0.009, 0.0]
    assert record["hysteresis_kmh"] == pytest.approx([500.0])


def test_a_picture_is_written(found: None, tmp_path: Path) -> None:
    path = tmp_path / "hunting.png"
    assert main(["hunting", "--wheel", "lmb10", "--plot", str(path)]) == 0
    assert path.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--wheel", "lmb"], "lmb10"),
        (["--wheel", "cn60"], "wheel = 'cn60'"),
        (["--rail", "lma"], "rail = 'lma'"),
        (["--creep-law", "polak"], "polach"),
        (["--friction", "-0.1"], "friction"),
        (["--start-mm", "1000"], "off the rails"),
        (["--rest-mm", "7"], "must be below start_mm"),
        (["--from-kmh", "0"], "from_kmh"),
        (["--from-kmh", "600", "--to-kmh", "300"], "to_kmh"),
        (["--step-kmh", "0.01"], "step_kmh"),
        (["--step-kmh", "five"], "five"),
        (["--rest-mm", "nan"], "rest_mm"),
        (["--threads", "0"], "threads"),
        (["--layout", "3"], "layout"),
        (["--vehicle", "paper"], "paper_fit"),
        (["--plot", "hunting.exe"], "hunting.exe"),
    ],
)
def test_bad_input_is_one_line_and_status_2(
    arguments: list[str], named: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["hunting", *arguments]) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert len(shown.err.splitlines()) == 1
    assert named in shown.err


def test_stretches_of_instability_are_named_by_their_boundaries() -> None:
    # Growth (V - 155)(V - 250)(V - 650) in km/h at 2 Hz, with the sign that ends unstable.
    def matrix(speed: float) -> np.ndarray:
        v = 3.6 * speed
        s, w = 1e-6 * (v - 155.0) * (v - 250.0) * (v - 650.0), 4 * np.pi
        return np.array([[s, -w], [w, s]])

    assert (
        unstable_stretches(matrix) == "from 155.0 (2.00 Hz) to 250.0 (2.00 Hz) from 650.0 (2.00 Hz)"
    )


@pytest.mark.slow
def test_a_short_run_finds_hunting_at_both_speeds(capsys: pytest.CaptureFixture[str]) -> None:
    speeds = ["--from-kmh", "640", "--to-kmh", "680", "--step-kmh", "40"]
    assert main(["hunting", "--wheel", "lmb10", *speeds, "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["unstable_at_lowest_speed"] is True
    assert record["down"]["amplitude_m"] == pytest.approx([10.2e-3] * 2, rel=0.03)
    assert record["up"]["amplitude_m"] == pytest.approx([10.2e-3] * 2, rel=0.03)
