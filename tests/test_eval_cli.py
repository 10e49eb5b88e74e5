"""The command line: what it prints, its exit status, and one clear line for every mistake."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from eval.cli import main

SKYHOOK = ("--controller", "skyhook:gain=35e3")


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    status = main(list(arguments))
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def answer(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict:
    status, out, _ = run(capsys, *arguments, "--json")
    assert status == 0
    return json.loads(out)


def test_the_papers_question_is_answered_by_one_command(capsys) -> None:
    found = answer(
        capsys,
        "critical-delay",
        *SKYHOOK,
        "--layout",
        "4",
        "--speed-kmh",
        "300",
        "--vehicle",
        "paper_fit",
    )
    assert found["critical_delay_s"] == pytest.approx(0.2020, abs=1e-4)
    assert found["critical_delay_sampled_s"] == pytest.approx(0.19705, abs=1e-4)
    assert found["frequency_hz"] == pytest.approx(1.323, abs=0.002)
    assert found["mode"] == "upper centre roll"
    assert found["proved"] is True
    assert len(found["crossings"]) > 1
    assert {"delay_s", "frequency_hz", "direction"} <= set(found["crossings"][0])


def test_the_pade_method_agrees_to_a_millionth(capsys) -> None:
    exact = answer(capsys, "critical-delay", *SKYHOOK, "--max-delay", "0.3")
    pade = answer(capsys, "critical-delay", *SKYHOOK, "--max-delay", "0.3", "--method", "pade:8")
    assert pade["critical_delay_s"] == pytest.approx(exact["critical_delay_s"], rel=1e-6)
    assert pade["method"] == "pade:8"


def test_no_critical_delay_is_null(capsys) -> None:
    found = answer(capsys, "critical-delay", "--controller", "passive", "--max-delay", "0.5")
    assert found["critical_delay_s"] is None
    assert found["critical_delay_sampled_s"] is None


@pytest.mark.slow
def test_the_simulation_method_brackets_the_sampled_answer(capsys) -> None:
    found = answer(
        capsys, "critical-delay", *SKYHOOK, "--max-delay", "0.22", "--method", "simulation"
    )
    low, high = found["bracket_s"]
    assert low <= 0.19705 <= high


@pytest.mark.parametrize("method", ["exact", "pade:8"])
def test_roots_have_their_names_and_numbers(capsys, method: str) -> None:
    found = answer(capsys, "roots", *SKYHOOK, "--delay", "0.2", "--count", "3", "--method", method)
    first = found["roots"][0]
    assert (first["re"], first["im"]) == pytest.approx((-0.029471, 8.330153), abs=1e-6)
    assert first["mode"] == "upper centre roll"
    assert first["frequency_hz"] == pytest.approx(np.hypot(first["re"], first["im"]) / (2 * np.pi))


def test_roots_take_one_delay_per_channel(capsys) -> None:
    found = answer(capsys, "roots", *SKYHOOK, "--delay", "0.1,0.1,0.2,0.2", "--count", "2")
    assert len(found["roots"]) == 2


def test_simulate_prints_measures_and_writes_signals(capsys, tmp_path: Path) -> None:
    out = tmp_path / "deep" / "run.npz"
    found = answer(
        capsys, "simulate", *SKYHOOK, "--delay", "0.1", "--seconds", "10", "--out", str(out)
    )
    assert 1.0 < found["measures"]["ride_index_rear"] < 3.0
    with np.load(out, allow_pickle=False) as archive:
        assert archive["time"][-1] == pytest.approx(10.0)
        assert archive["floor_rear_lateral_acceleration"].shape == (1, 2000)
        assert json.loads(str(archive["settings"]))["delay_s"] == [0.1] * 4


def test_simulate_draws_the_run(capsys, tmp_path: Path) -> None:
    plot = tmp_path / "run.png"
    assert run(capsys, "simulate", *SKYHOOK, "--seconds", "5", "--plot", str(plot))[0] == 0
    assert plot.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def test_a_run_that_diverges_is_a_result(capsys) -> None:
    found = answer(capsys, "simulate", *SKYHOOK, "--delay", "0.25", "--seconds", "30")
    assert found["measures"]["diverged"] is True


def test_a_measured_track_is_a_track(capsys, tmp_path: Path) -> None:
    rows = [f"{0.25 * k},{np.sin(0.05 * k):.6f}" for k in range(4000)]
    path = tmp_path / "line.csv"
    path.write_text("distance_m,alignment_mm\n" + "\n".join(rows) + "\n")
    found = answer(capsys, "simulate", *SKYHOOK, "--track", str(path), "--seconds", "5")
    assert found["measures"]["floor_rms_front"] > 0.0


@pytest.mark.parametrize("kind", ["vehicles", "tracks", "controllers", "envs", "suites"])
def test_everything_that_can_be_named_is_listed(capsys, kind: str) -> None:
    found = answer(capsys, "list", kind)
    assert list(found) == [kind]
    assert found[kind]


@pytest.mark.slow
def test_benchmark_writes_table_records_and_page(capsys, tmp_path: Path) -> None:
    given = ("--suite", "smoke", "--out", str(tmp_path), "--jobs", "1")
    status, out, _ = run(capsys, "benchmark", *given)
    assert status == 0
    assert "skyhook:gain=15e3" in out
    assert (tmp_path / "records.sqlite").exists()
    page = (tmp_path / "report.html").read_text()
    (tmp_path / "report.html").unlink()
    assert run(capsys, "report", str(tmp_path))[0] == 0
    assert (tmp_path / "report.html").read_text() == page


def test_json_is_all_that_is_printed(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "eval.cli", "simulate", *SKYHOOK, "--seconds", "5", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=tmp_path)
    json.loads(done.stdout)


BAD_INPUT = [
    ("critical-delay",),
    ("critical-delay", "--controller", "skyhok"),
    ("critical-delay", "--controller", "skyhook:gian=3"),
    ("critical-delay", "--controller", "skyhook:gain=nan"),
    ("critical-delay", *SKYHOOK, "--layout", "3"),
    ("critical-delay", *SKYHOOK, "--speed-kmh", "0"),
    ("critical-delay", *SKYHOOK, "--speed-kmh", "fast"),
    ("critical-delay", *SKYHOOK, "--vehicle", "paperfit"),
    ("critical-delay", *SKYHOOK, "--method", "pade:0"),
    ("critical-delay", *SKYHOOK, "--method", "magic"),
    ("critical-delay", *SKYHOOK, "--max-delay", "-1"),
    ("critical-delay", *SKYHOOK, "--control-period", "0"),
    ("critical-delay", *SKYHOOK, "--control-period", "1e308"),
    ("critical-delay", *SKYHOOK, "--max-delay", "1e9"),
    ("critical-delay", *SKYHOOK, "--unknown", "1"),
    ("roots", *SKYHOOK),
    ("roots", *SKYHOOK, "--delay", "-0.1"),
    ("roots", *SKYHOOK, "--delay", "0.1,0.2"),
    ("roots", *SKYHOOK, "--delay", "0.1", "--count", "0"),
    ("roots", *SKYHOOK, "--delay", "0.1", "--count", "ten"),
    ("simulate", *SKYHOOK, "--delay", "nan"),
    ("simulate", *SKYHOOK, "--track", "tb3353"),
    ("simulate", *SKYHOOK, "--track", "missing.csv"),
    ("simulate", *SKYHOOK, "--seconds", "3"),
    ("simulate", *SKYHOOK, "--seconds", "10.005"),
    ("simulate", *SKYHOOK, "--seconds", "1e308"),
    ("simulate", *SKYHOOK, "--delay", "1e12"),
    ("simulate", *SKYHOOK, "--seed", "-1"),
    ("simulate", *SKYHOOK, "--model", "full"),
    ("simulate", *SKYHOOK, "--out", "run.txt"),
    ("benchmark", "--suite", "quik"),
    ("benchmark", "--suite", "smoke", "--controller", "skyhok"),
    ("benchmark", "--suite", "smoke", "--jobs", "0"),
    ("report", "no-such-folder"),
    ("list", "vehicle"),
    ("nonsense",),
    (),
]


@pytest.mark.parametrize("arguments", BAD_INPUT, ids=" ".join)
def test_bad_input_gives_one_clear_line_and_status_two(
    capsys, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...]
) -> None:
    monkeypatch.chdir(tmp_path)
    status, out, err = run(capsys, *arguments)
    assert status == 2
    assert out == ""
    assert err.count("\n") == 1
    assert err.startswith("railenv")
    assert list(tmp_path.iterdir()) == []


def test_a_broken_csv_is_named_with_its_line(capsys, tmp_path: Path) -> None:
    path = tmp_path / "line.csv"
    path.write_text("distance_m,alignment_mm\n0,0\n0.25,abc\n")
    status, _, err = run(capsys, "simulate", *SKYHOOK, "--track", str(path))
    assert status == 2
    assert "line.csv" in err
    assert "line 3" in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    "arguments",
    [
        ("simulate", *SKYHOOK, "--seconds", "5", "--out", "file/run.npz"),
        ("simulate", *SKYHOOK, "--seconds", "5", "--plot", "file/run.png"),
        ("benchmark", "--suite", "smoke", "--out", "file"),
    ],
    ids=" ".join,
)
def test_a_place_that_cannot_be_written_fails_before_the_work_with_status_one(
    capsys, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("kept")
    status, _, err = run(capsys, *arguments)
    assert status == 1
    assert "cannot write" in err
    assert err.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
    assert (tmp_path / "file").read_text() == "kept"


def test_an_interruption_has_its_own_status(capsys, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("eval.command_stability.critical_delay_answer", interrupted)
    status, _, err = run(capsys, "critical-delay", *SKYHOOK)
    assert status == 130
    assert "interrupted" in err


def test_a_loop_that_the_oracle_refuses_is_simulated_all_the_same(
    capsys, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "accelerometer_law.py").write_text(
        "import numpy as np\nfrom baselines import LinearFeedback\n"
        "from railenv.envs.observation import sensor_names\n"
        "def make(): return LinearFeedback(np.eye(4) * 100, sensor_names('4')[4:8], 4)\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    found = answer(
        capsys, "simulate", "--controller", "py:accelerometer_law:make", "--seconds", "5"
    )
    assert found["growth_rate"] is None
    assert found["measures"]["ride_index_front"] > 0.0
