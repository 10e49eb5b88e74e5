"""`railenv conicity`: numbers, JSON, files of points, picture, and one line per mistake."""

import json
from pathlib import Path

import numpy as np
import pytest

from eval.cli import main
from railenv.contact import get_profile
from railenv.contact.conicity import conicity
from railenv.contact.geometry import WheelRail

EUROPE = ("--back-to-back-mm", "1360", "--gauge-depth-mm", "14")


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    status = main(["conicity", *arguments])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def answer(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict:
    status, out, err = run(capsys, *arguments, "--json")
    assert (status, err) == (0, "")
    return json.loads(out)


def write(path: Path, name: str, scale: float = 1e3) -> str:
    profile = get_profile(name)
    np.savetxt(path, scale * np.stack([profile.y[::4], profile.z[::4]], axis=1), fmt="%.7f")
    return str(path)


def test_the_command_gives_the_librarys_numbers(capsys) -> None:
    found = answer(capsys, "s1002", "60e1", *EUROPE)
    pair = WheelRail(
        get_profile("s1002"), get_profile("60e1"), back_to_back=1.36, gauge_depth=0.014
    )
    known = conicity(pair)
    assert found["conicity"] == known.conicity.tolist()
    assert found["wavelength_m"] == known.wavelength.tolist()
    assert found["amplitude_m"] == pytest.approx([1e-3 * k for k in range(1, 8)], rel=1e-12)
    at = found["shift_m"].index(pytest.approx(0.003, abs=1e-9))
    assert found["rolling_radius_difference_m"][at] == pytest.approx(0.994e-3, abs=5e-6)


def test_the_table_shows_conicity_and_radius_difference(capsys) -> None:
    status, out, _ = run(capsys, "lma", "cn60")
    assert status == 0
    lines = out.splitlines()
    assert lines[0].startswith("lma on cn60, gauge 1435 mm (16 mm below the crown), back to back")
    assert lines[1].split()[-7:] == ["1", "2", "3", "4", "5", "6", "7"]
    assert float(lines[2].split()[4]) == pytest.approx(0.035, abs=0.002)
    assert lines[4].split()[:3] == ["radius", "difference", "[mm]"]


def test_every_placing_option_reaches_the_geometry(capsys) -> None:
    usual = answer(capsys, "lmb10", "cn60", "--amplitudes", "3")["conicity"][0]
    for option, value in (
        ("--gauge-mm", "1433"),
        ("--gauge-depth-mm", "14"),
        ("--back-to-back-mm", "1355"),
        ("--cant", "1:30"),
        ("--cant", "0"),
        ("--radius-mm", "430"),
    ):
        found = answer(capsys, "lmb10", "cn60", "--amplitudes", "3", option, value)
        assert abs(found["conicity"][0] - usual) > 1e-4, option


def test_one_cant_may_be_written_in_two_ways(capsys) -> None:
    long = answer(capsys, "lma", "cn60", "--amplitudes", "3", "--cant", "1:40")
    assert long["conicity"] == answer(capsys, "lma", "cn60", "--amplitudes", "3")["conicity"]


@pytest.mark.slow
def test_files_of_points_give_the_catalogues_conicity(capsys, tmp_path: Path) -> None:
    wheel, rail = write(tmp_path / "w.txt", "lma"), write(tmp_path / "r.txt", "cn60")
    found = answer(capsys, wheel, rail)
    # Smoothing by 3 um root mean square moves curvature's steps; measured 0.0014 at most.
    assert found["conicity"] == pytest.approx(answer(capsys, "lma", "cn60")["conicity"], abs=0.003)
    assert 3e-6 < found["wheel_smoothing_m"] < 5e-5
    metres = write(tmp_path / "m.txt", "lma", 1.0), write(tmp_path / "n.txt", "cn60", 1.0)
    same = answer(capsys, *metres, "--unit", "m")
    # 1e-7 m are printed, and those digits show in the curvature.
    assert same["conicity"] == pytest.approx(found["conicity"], abs=0.001)


@pytest.mark.slow
def test_the_smoothing_of_a_file_is_told_and_can_be_set(capsys, tmp_path: Path) -> None:
    wheel = write(tmp_path / "w.txt", "lma")
    _, out, _ = run(capsys, wheel, "cn60", "--amplitudes", "3")
    assert "w.txt: smoothed, points at most" in out
    less = answer(capsys, wheel, "cn60", "--amplitudes", "3", "--tolerance-um", "1")
    more = answer(capsys, wheel, "cn60", "--amplitudes", "3", "--tolerance-um", "5")
    assert less["wheel_smoothing_m"] < more["wheel_smoothing_m"]


def test_a_motion_that_does_not_exist_is_a_null_and_a_dash(capsys) -> None:
    # Two cylinders: no difference of radii, nothing to come back.
    arguments = ("cone:angle=0", "arc:radius=0.3", "--amplitudes", "2")
    assert answer(capsys, *arguments)["conicity"] == [None]
    status, out, _ = run(capsys, *arguments)
    assert status == 0
    assert "no periodic motion" in out


@pytest.mark.parametrize(("ending", "start"), [(".png", b"\x89PNG\r\n\x1a\n"), (".svg", b"<?xml")])
@pytest.mark.slow
def test_the_picture_is_written(ending: str, start: bytes, capsys, tmp_path: Path) -> None:
    path = tmp_path / f"picture{ending}"
    status, out, err = run(capsys, "s1002", "60e1", *EUROPE, "--plot", str(path))
    assert (status, err) == (0, "")
    assert path.read_bytes().startswith(start)
    assert f"written: {path}" in out


@pytest.mark.slow
def test_a_picture_is_drawn_of_a_cylinder_too(capsys, tmp_path: Path) -> None:
    path = tmp_path / "picture.png"
    wheel = ("cone:angle=0", "arc:radius=0.3", "--amplitudes", "2", "--plot", str(path))
    assert run(capsys, *wheel)[0] == 0
    assert path.stat().st_size > 10_000


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("s1003", "60e1"), "unknown wheel 's1003'; did you mean 's1002'"),
        (("s1002", "uic"), "or give the path of a file of points"),
        (("60e1", "s1002"), "is a rail profile; give one of a wheel"),
        (("none.txt", "60e1"), "cannot read none.txt"),
        (("cone:angle=9", "60e1"), "out of range"),
        (("x" * 5000, "60e1"), "unknown wheel"),
        (("s1002", "60e1", "--amplitudes", "0"), "must be above zero"),
        (("s1002", "60e1", "--amplitudes", "1,,2"), "not a finite number"),
        (("s1002", "60e1", "--amplitudes", "99"), "0.015 m or less"),
        (("s1002", "60e1", "--gauge-mm", "nan"), "gauge_mm"),
        (("s1002", "60e1", "--cant", "2"), "steeper than 1:5"),
        (("s1002", "60e1", "--cant", "-40"), "must not be negative"),
        (("s1002", "60e1", "--gauge-depth-mm", "60"), "gauge_depth"),
        (("s1002", "60e1", "--plot", "picture.bmp"), "must end in .png"),
    ],
)
def test_a_mistake_is_one_line_and_status_two(
    arguments: tuple[str, ...], words: str, capsys, tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.chdir(tmp_path)
    status, out, err = run(capsys, *arguments)
    assert (status, out) == (2, "")
    assert words in err
    assert err.startswith("railenv conicity: ")
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--unit", "inch"), "unknown unit"),
        (("--unit", "m"), "look like millimetres"),
        (("--tolerance-um", "-1"), "must not be negative"),
        (("--tolerance-um", "1000"), "smooth the profile away"),
    ],
)
def test_a_mistake_about_a_file_is_one_line_too(
    options: tuple[str, ...], words: str, capsys, tmp_path: Path
) -> None:
    status, _, err = run(capsys, write(tmp_path / "w.txt", "lma"), "cn60", *options)
    assert status == 2
    assert words in err
