"""The template of a controller: it passes the check as it is, and is written where nothing was."""

import ast
import sys
from pathlib import Path
from subprocess import run

import numpy as np
import pytest

from eval.check_controller import check_controller
from eval.controller_template import write_template
from eval.scenarios import load_suite
from eval.store.reader import Reader
from eval.store.schema import LOST
from railenv.errors import ArgumentError, OutputError

ROOT = Path(__file__).parents[1]


def railenv(folder: Path, *words: str) -> tuple[int, str]:
    """Run the command in a folder; return its exit status and all that it printed."""
    code = f"import sys; sys.path.insert(0, {str(ROOT)!r}); from eval.cli import main; main()"
    command = [sys.executable, "-I", "-c", code, *words]
    done = run(command, cwd=folder, capture_output=True, text=True, timeout=300, check=False)
    return done.returncode, done.stdout + done.stderr


def test_the_file_is_written_under_its_name(tmp_path: Path) -> None:
    path = tmp_path / "sky_law.py"
    assert write_template(path) == path
    text = path.read_text()
    ast.parse(text)
    assert "py:sky_law:controller" in text
    assert "my_controller" not in text


def test_what_is_there_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "sky_law.py"
    path.write_text("mine\n")
    with pytest.raises(ArgumentError, match="exists and is not overwritten"):
        write_template(path)
    assert path.read_text() == "mine\n"
    link = tmp_path / "link_law.py"
    link.symlink_to(tmp_path / "nothing_here.py")
    with pytest.raises(ArgumentError, match="exists and is not overwritten"):
        write_template(link)
    assert not (tmp_path / "nothing_here.py").exists()


@pytest.mark.parametrize(
    "name", ["my-law.py", "2law.py", "law", "law.txt", ".py", "class.py", "a b.py", "a.b.py"]
)
def test_a_name_that_no_module_can_have_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(ArgumentError, match="no name of a Python module"):
        write_template(tmp_path / name)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["numpy.py", "random.py", "eval.py", "sys.py"])
def test_a_name_that_would_hide_a_known_module_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(ArgumentError, match="that Python knows already"):
        write_template(tmp_path / name)


def test_a_folder_that_does_not_exist_is_said(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="cannot write"):
        write_template(tmp_path / "nowhere" / "sky_law.py")


@pytest.mark.slow
def test_it_passes_the_check_and_runs_from_a_fresh_folder(tmp_path: Path) -> None:
    write_template(tmp_path / "sky_law.py")
    spec = "py:sky_law:controller"
    status, printed = railenv(tmp_path, "benchmark", "--check", spec, "--suite", "quick")
    assert (status, "PROBLEM" in printed) == (0, False), printed
    words = ("--suite", "smoke", "--jobs", "1", "--controller", spec, "--out", "here")
    status, printed = railenv(tmp_path, "benchmark", *words)
    assert status == 0, printed
    with Reader.open(tmp_path / "here") as reader:
        rows = list(reader.rows(controller=spec))
        (entry,) = [c for c in reader.controllers() if c["spec"] == spec]
    assert {row["key"] for row in rows} == {s.key for s in load_suite("smoke").scenarios}
    assert not {row["status"] for row in rows} & {*LOST, "diverged"}
    assert entry["division"] == "told"


@pytest.mark.slow
def test_both_layouts_and_the_nonlinear_vehicle_take_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_template(tmp_path / "sky_law_of_test.py")
    found = list(check_controller(load_suite("quick"), "py:sky_law_of_test:controller"))
    assert [f for f in found if f.good is False] == []
    good = {f.name for f in found if f.good}
    for layout in ("2", "4"):
        assert {f"layout {layout}: {name}" for name in ("runs", "lanes", "whole run")} <= good
    assert "layout 4: nonlinear vehicle" in good


def test_its_gain_falls_with_the_told_delay_and_a_steady_velocity_leaves_no_force(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    write_template(tmp_path / "sky_law_in_test.py")
    law = __import__("sky_law_in_test").controller("4")
    law.reset(2, 0)
    law.tell(np.array([0.0, 0.15]))
    moved = np.zeros((2, 20))
    moved[:, :4] = 0.1
    first = law.act(moved)
    # 12 kN s/m without delay and half of it at 0.15 s, through a filter that has let one period by.
    kept = np.exp(-2.0 * np.pi * 0.1 * 0.01)
    np.testing.assert_allclose(first[:, 0] * 3e3, [-1200.0 * kept, -600.0 * kept], rtol=1e-12)
    for _ in range(3000):
        last = law.act(moved)
    # 30 s are 19 time constants of 1.6 s.
    assert np.abs(last).max() < 1e-8 * np.abs(first).max()
