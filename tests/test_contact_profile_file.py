"""Files of profiles: what is read, how it is smoothed, and what is refused with its cause."""

import pickle
from pathlib import Path

import numpy as np
import pytest

from railenv.contact import Profile, get_profile
from railenv.contact.profile_file import read_profile
from railenv.errors import ArgumentError, InputFileError

MM = 1e3


def points(name: str, every: int = 4) -> np.ndarray:
    profile = get_profile(name)
    return MM * np.stack([profile.y[::every], profile.z[::every]], axis=1)


def write(path: Path, table: np.ndarray, form: str = "%.4f", separator: str = " ") -> Path:
    np.savetxt(path, table, fmt=form, delimiter=separator)
    return path


def normal_distance(found: Profile, name: str, low: float, high: float) -> np.ndarray:
    true = get_profile(name).spline()
    y = np.linspace(low, high, 3000)
    return (found.spline()(y) - true(y)) / np.hypot(1.0, true(y, 1))


@pytest.mark.parametrize("name", ["s1002", "lma", "60e1"])
def test_a_clean_file_comes_back_within_the_smoothing_that_it_reports(name: str, tmp_path) -> None:
    kind = get_profile(name).kind
    found = read_profile(write(tmp_path / "p.txt", points(name)), kind)
    assert (found.kind, found.name) == (kind, "p.txt")
    reach = (-0.045, 0.055) if kind == "wheel" else (-0.033, 0.033)
    off = normal_distance(found, name, *reach)
    # The default of 3 um root mean square, the largest where curvature jumps.
    assert np.abs(off).max() <= found.smoothing
    assert found.smoothing < 5e-5
    assert float(np.sqrt(np.mean(off**2))) < 3e-6


def test_without_smoothing_every_point_is_kept(tmp_path) -> None:
    table = points("s1002")
    found = read_profile(write(tmp_path / "p.txt", table, "%.9f"), "wheel", tolerance=0.0)
    # Upright ends aside, where linear interpolation over y says little; 1e-9 mm are printed.
    inside = np.abs(table[:, 0]) < 45.0
    spline = found.spline()(table[inside, 0] / MM) * MM
    assert np.abs(spline - table[inside, 1]).max() < 2e-5  # resampling at 0.05 mm
    assert found.smoothing < 1e-12


def test_smoothing_takes_most_of_the_noise_away(tmp_path) -> None:
    rng = np.random.default_rng(11)
    table = points("s1002")
    along = np.gradient(table, axis=0)
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.hypot(*along.T)[:, None]
    table += 0.005 * rng.standard_normal(len(table))[:, None] * normal
    found = read_profile(write(tmp_path / "p.txt", table), "wheel", tolerance=5e-6)
    off = normal_distance(found, "s1002", -0.045, 0.055)
    assert float(np.sqrt(np.mean(off**2))) < 0.5 * 5e-6
    # Curvature is what contact needs: 5 um on points 0.2 mm apart are 0.3 /mm without smoothing.
    y = np.linspace(-0.02, 0.05, 500)
    error = found.spline()(y, 2) - get_profile("s1002").spline()(y, 2)
    assert float(np.sqrt(np.mean(error**2))) / MM < 0.01


@pytest.mark.parametrize("separator", [",", ";", "\t", " , "])
@pytest.mark.slow
def test_separators_comments_direction_and_unit_make_no_difference(
    separator: str, tmp_path
) -> None:
    table = points("60e1")
    plain = read_profile(write(tmp_path / "a.txt", table), "rail")
    other = tmp_path / "b.txt"
    rows = [f"{y / MM:.7f}{separator}{z / MM:.7f}  # mm" for y, z in table[::-1]]
    other.write_text("\n".join(["# y z", "", *rows, rows[-1], ""]), encoding="utf-8-sig")
    found = read_profile(other, "rail", unit="m")
    # The same points from the other end: sums of lengths round differently, and the tolerance is
    # met to one part in 10^4.
    assert found.z.shape == plain.z.shape
    assert np.abs(found.spline()(plain.y) - plain.z)[50:-50].max() < 1e-8


def test_heights_are_counted_anew_from_tape_circle_and_crown(tmp_path) -> None:
    wheel = read_profile(write(tmp_path / "w.txt", moved(points("lma"), 0.0, 1.5)), "wheel")
    rail = read_profile(write(tmp_path / "r.txt", moved(points("cn60"), 0.0, -1.5)), "rail")
    assert abs(float(wheel.spline()(0.0))) < 1e-9
    assert float(rail.z.min()) == 0.0


def test_the_folded_back_of_a_flange_is_left_out(tmp_path) -> None:
    table = points("s1002")
    back = np.stack([np.full(40, -69.7), np.linspace(-2.0, 13.0, 40)], axis=1)
    back[:, 0] += 0.1 * (back[:, 1] < 10.0)  # leans back
    table = np.concatenate([back, table[table[:, 0] > -69.58]])
    found = read_profile(write(tmp_path / "w.txt", table), "wheel", tolerance=2e-5)
    assert MM * found.y[0] < -69.0
    assert np.all(np.diff(found.y) > 0.0)
    assert np.abs(normal_distance(found, "s1002", -0.06, 0.055)).max() < 1e-4


def test_a_rails_head_may_curl_in_below_its_sides(tmp_path) -> None:
    table = points("60e1")
    depth = np.linspace(0.3, 12.0, 50)
    curl = np.stack([table[-1, 0] - 0.02 * depth**2, table[-1, 1] + depth], axis=1)
    left = curl[::-1] * [-1.0, 1.0]
    table = np.concatenate([left, table, curl])
    found = read_profile(write(tmp_path / "r.txt", table), "rail")
    assert MM * found.y[-1] == pytest.approx(36.54, abs=0.1)
    assert np.abs(normal_distance(found, "60e1", -0.033, 0.033)).max() < 2e-5


def moved(table: np.ndarray, across: float, down: float) -> np.ndarray:
    return table + np.array([across, down])


def step(table: np.ndarray) -> np.ndarray:
    return table + np.where(table[:, :1] > 10.0, [[0.0, 0.3]], 0.0)


def spike(table: np.ndarray) -> np.ndarray:
    table = table.copy()
    table[len(table) // 2, 1] += 0.4
    return table


def hole(table: np.ndarray) -> np.ndarray:
    return table[np.abs(table[:, 0] - 5.0) > 3.0]


def noisy(table: np.ndarray) -> np.ndarray:
    return table + 0.02 * np.random.default_rng(5).standard_normal(table.shape)


def folded(table: np.ndarray) -> np.ndarray:
    # A loop of 1 mm radius in the tread.
    k = int(np.searchsorted(table[:, 0], 20.0))
    angle = np.linspace(0.0, 2.0 * np.pi, 60)
    loop = table[k] + np.stack([np.sin(angle), np.cos(angle) - 1.0], axis=1)
    return np.concatenate([table[:k], loop, table[k + 1 :]])


@pytest.mark.parametrize(
    ("name", "kind", "change", "words"),
    [
        ("s1002", "wheel", lambda t: t / MM, "look like metres: read it with unit m"),
        ("60e1", "rail", lambda t: t / MM, "look like metres"),
        ("s1002", "wheel", lambda t: t * [1, -1], "z looks flipped"),
        ("60e1", "rail", lambda t: t * [1, -1], "z looks flipped"),
        ("s1002", "wheel", lambda t: (t * [-1, 1])[::-1], "y looks flipped"),
        ("s1002", "wheel", lambda t: moved(t, 70.0, 0.0), "y looks flipped|count y from the tape"),
        ("s1002", "wheel", lambda t: moved(t, 0.0, 460.0), "count both from there"),
        ("60e1", "rail", lambda t: moved(t, 0.0, 176.0), "at the crown"),
        ("60e1", "rail", lambda t: moved(t, 36.0, 0.0), "count y from the symmetry line"),
        ("60e1", "wheel", lambda t: t, "a wheel's is"),
        ("s1002", "rail", lambda t: t, "rail"),
        ("s1002", "wheel", lambda t: t[t[:, 0] > -30.0], "flange|wide"),
        ("s1002", "wheel", lambda t: t * [1.0, 2.0], "mm high"),
        ("s1002", "wheel", lambda t: t[:20], "20 different points"),
        ("s1002", "wheel", hole, "line .*the next point is 6"),
        ("s1002", "wheel", spike, "line .* off the curve through its neighbours"),
        ("60e1", "rail", step, "off the curve through its neighbours"),
        ("s1002", "wheel", noisy, "scatter by about .* micrometres"),
        ("s1002", "wheel", folded, "folds back"),
        ("s1002", "wheel", lambda t: np.random.default_rng(1).permutation(t), "apart or closer"),
    ],
)
def test_an_implausible_outline_is_refused_with_its_cause(
    name: str, kind: str, change, words: str, tmp_path
) -> None:
    path = write(tmp_path / "p.txt", change(points(name)), "%.7f")
    with pytest.raises(InputFileError, match=words) as caught:
        read_profile(path, kind)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"1 2\n3\n", "line 2: 1 values"),
        (b"1 2 3\n", "3 values"),
        (b"1,5;2,5\n", "4 values.*decimal points"),
        (b"y,z\n", "line 1: y = 'y' is not a finite number"),
        (b"1,,2\n", "3 values"),
        (b"1 nan\n", "z = 'nan' is not a finite number"),
        (b"1_0 2\n", "not a finite number"),
        (b"\xff\xfe1 2\n", "line 1: not UTF-8"),
        (pickle.dumps({"y": 1.0}, protocol=0), "line 1"),
        (b"# nothing\n", "0 different points"),
        (b"1 2\n" * 1_100_000, "larger than 4 MB"),
    ],
)
def test_a_file_that_holds_no_points_is_refused(content: bytes, words: str, tmp_path) -> None:
    path = tmp_path / "p.txt"
    path.write_bytes(content)
    with pytest.raises(InputFileError, match=words):
        read_profile(path, "wheel")


def test_what_is_no_file_is_refused(tmp_path) -> None:
    with pytest.raises(
        InputFileError, match=r"^\S* is no ordinary file; give a text file of points$"
    ):
        read_profile(tmp_path, "wheel")
    with pytest.raises(InputFileError, match="cannot read"):
        read_profile(tmp_path / "none.txt", "wheel")
    for settings_ in ({"unit": "inch"}, {"tolerance": -1.0}, {"tolerance": 0.01}):
        with pytest.raises(ArgumentError):
            read_profile(tmp_path / "none.txt", "wheel", **settings_)
