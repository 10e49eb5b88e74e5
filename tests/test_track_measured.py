import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from railenv.errors import ArgumentError, InputFileError
from railenv.track import make_track, read_csv

HEADER = "distance_m,alignment_mm,cross_level_mm"
ROWS = [f"{100 + 0.25 * i:g},{0.5 * i:g},{-i:g}" for i in range(12)]


def write(folder: Path, *lines: str, name: str = "section.csv") -> Path:
    path = folder / name
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def changed(row: int, text: str) -> list[str]:
    """The rows with one of them replaced; row 0 stands in line 2 of the file."""
    return [*ROWS[:row], text, *ROWS[row + 1 :]]


def message(path: Path) -> str:
    with pytest.raises(InputFileError) as caught:
        read_csv(path)
    text = str(caught.value)
    assert "\n" not in text
    assert path.name in text
    return text


def test_millimetres_become_metres(tmp_path: Path) -> None:
    track = read_csv(write(tmp_path, HEADER, *ROWS))
    # rounding of the conversion
    np.testing.assert_allclose(track.channels["cross_level"], -1e-3 * np.arange(12), rtol=1e-15)


def test_the_first_row_becomes_distance_zero(tmp_path: Path) -> None:
    assert read_csv(write(tmp_path, HEADER, *ROWS)).length == 2.75


def test_columns_may_stand_in_any_order(tmp_path: Path) -> None:
    rows = [f"{i},{0.5 * i}" for i in range(8)]
    track = read_csv(write(tmp_path, "gauge_mm, distance_m", *rows))
    assert (track.spacing, track.channels["gauge"][3]) == (0.5, 0.003)


def test_a_channel_without_a_column_is_zero(tmp_path: Path) -> None:
    assert read_csv(write(tmp_path, HEADER, *ROWS)).sample("vertical", 1.0) == 0.0


def test_comments_blank_lines_and_a_byte_order_mark_are_skipped(tmp_path: Path) -> None:
    lines = ["\ufeff# measured in May", "", HEADER, *ROWS[:5], "# a bridge", *ROWS[5:], " "]
    assert read_csv(write(tmp_path, *lines)).points == 12


@given(
    values=st.lists(st.floats(-500.0, 500.0), min_size=8, max_size=40),
    start=st.integers(-(10**6), 10**6),
)
@settings(max_examples=30, deadline=None)
def test_what_is_written_is_what_is_read(tmp_path_factory, values, start) -> None:
    rows = [f"{start + 0.5 * i},{value!r}" for i, value in enumerate(values)]
    path = write(tmp_path_factory.mktemp("track"), "distance_m,gauge_mm", *rows)
    # text keeps every bit; one rounding in the conversion
    np.testing.assert_allclose(
        read_csv(path).channels["gauge"], 1e-3 * np.array(values), rtol=1e-15
    )


def test_distances_printed_with_two_digits_are_uniform_enough(tmp_path: Path) -> None:
    rows = [f"{i / 3:.2f},0,0" for i in range(31)]
    # exact, as the last row is a whole number of metres
    assert read_csv(write(tmp_path, HEADER, *rows)).spacing == pytest.approx(1.0 / 3.0, rel=1e-15)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    assert "cannot read" in message(tmp_path / "absent.csv")


def test_a_folder_is_no_file(tmp_path: Path) -> None:
    assert "cannot read" in message(tmp_path)


def test_a_name_with_a_null_character_is_refused() -> None:
    with pytest.raises(InputFileError, match="cannot read"):
        read_csv("a\0b.csv")


@pytest.mark.parametrize("lines", [[""], ["# only", "# comments"]])
def test_a_file_without_a_header_is_refused(tmp_path: Path, lines: list[str]) -> None:
    assert "holds no header line" in message(write(tmp_path, *lines))


def test_bytes_that_are_no_text_name_their_line(tmp_path: Path) -> None:
    path = tmp_path / "garbage.csv"
    path.write_bytes(HEADER.encode() + b"\n\xff\xfe\x00\x9c")
    assert "line 2: not UTF-8 text" in message(path)


@given(content=st.binary(max_size=200))
@settings(max_examples=50, deadline=None)
def test_any_garbage_is_an_input_file_error(tmp_path_factory, content: bytes) -> None:
    path = tmp_path_factory.mktemp("track") / "garbage.csv"
    path.write_bytes(content)
    message(path)


@given(row=st.integers(0, 11), text=st.text(max_size=30))
@settings(max_examples=50, deadline=None)
def test_any_text_in_a_row_is_read_or_refused_in_one_line(tmp_path_factory, row, text) -> None:
    path = tmp_path_factory.mktemp("track") / "section.csv"
    lines = [HEADER, *changed(row, f"{100 + 0.25 * row},{text},0")]
    path.write_text("\n".join(lines), encoding="utf-8", errors="surrogatepass")
    complaint = ""
    try:
        read_csv(path)
    except InputFileError as error:
        complaint = str(error)
    assert "\n" not in complaint


CASES = {
    "an unknown column names the nearest": (
        ["distance_m,alignmnt_mm", *ROWS], 1, "unknown column 'alignmnt_mm'; did you mean"),
    "numbers without a header": (ROWS, 1, "must be a header"),
    "semicolons instead of commas": (
        [HEADER.replace(",", ";"), *ROWS], 1, "comma separated"),
    "no distance": (["alignment_mm", *["1"] * 9], 1, "no column distance_m"),
    "no irregularity": (["distance_m", *map(str, range(9))], 1, "no column of irregularity"),
    "a column twice": (["distance_m,gauge_mm,gauge_mm", *ROWS], 1, "named twice"),
    "text where a number belongs": (
        [HEADER, *changed(3, "100.75,none,0")], 5, "alignment_mm = 'none' is not a number"),
    "an empty value": ([HEADER, *changed(3, "100.75,,0")], 5, "alignment_mm = '' is not"),
    "digits grouped as in Python": (
        [HEADER, *changed(3, "100.75,1_0,0")], 5, "'1_0' is not a number"),
    "a value that is not a number": ([HEADER, *changed(4, "101,0,nan")], 6, "cross_level_mm = nan"),
    "an infinite value": ([HEADER, *changed(4, "101,-inf,0")], 6, "alignment_mm = -inf is not"),
    "an overflowing value": ([HEADER, *changed(4, "101,1e400,0")], 6, "1e400 is not finite"),
    "a value above a metre": ([HEADER, *changed(4, "101,1500,0")], 6, "check the column's unit"),
    "a distance out of this world": ([HEADER, *changed(4, "1e300,0,0")], 6, "check the column's"),
    "a value too few": ([HEADER, *changed(0, "100,1")], 2, "2 values where the header names 3"),
    "a value too many": ([HEADER, *changed(0, "100,1,2,3")], 2, "4 values where the header"),
    "too few rows": ([HEADER, *ROWS[:7]], 8, "after 7 rows"),
    "a distance that repeats": ([HEADER, *changed(5, "101,0,0")], 7, "does not exceed 101"),
    "a distance that falls": ([HEADER, *changed(5, "99,0,0")], 7, "does not exceed 101"),
    "a gap": ([HEADER, *ROWS[:6], *ROWS[7:]], 8, "rises by 0.5 here, usually by 0.25"),
    "a row off the grid": ([HEADER, *changed(5, "101.26,0,0")], 7, "rises by 0.26 here"),
    "a line number that counts comments": (
        ["# one", "", HEADER, *changed(1, "100.25,x,0")], 5, "'x' is not a number"),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_a_faulty_file_is_refused_with_its_line(tmp_path: Path, case: str) -> None:
    lines, number, wording = CASES[case]
    text = message(write(tmp_path, *lines))
    assert f"line {number}: " in text
    assert wording in text


def test_a_step_that_drifts_is_refused(tmp_path: Path) -> None:
    # every step is within 1.2 % of the usual one, but the middle lies 15 % of a step off the grid
    distance = np.concatenate([[0.0], np.cumsum(np.linspace(0.99, 1.01, 60))])
    text = message(write(tmp_path, HEADER, *[f"{x!r},0,0" for x in distance.tolist()]))
    assert "line 32: distance_m = 29.8475 leaves the even grid" in text


def test_a_long_entry_is_shortened_in_the_message(tmp_path: Path) -> None:
    assert len(message(write(tmp_path, HEADER, *changed(2, f"100.5,{'x' * 9999},0")))) < 300


def test_make_track_reads_a_file(tmp_path: Path) -> None:
    path = write(tmp_path, HEADER, *ROWS)
    np.testing.assert_array_equal(
        make_track(str(path), 2.0, 0).channels["alignment"], read_csv(path).channels["alignment"]
    )


def test_make_track_refuses_a_file_that_is_too_short(tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match=r"is 2.75 m long and 3 m are needed"):
        make_track(str(write(tmp_path, HEADER, *ROWS)), 3.0, 0)


def test_level_scales_a_measured_track_by_its_square_root(tmp_path: Path) -> None:
    path = write(tmp_path, HEADER, *ROWS)
    louder = make_track(f"{path}:level=4", 2.0, 0)
    assert louder.channels["alignment"][4] == 2.0 * read_csv(path).channels["alignment"][4]


def test_a_measured_track_takes_a_taper_after_a_name_with_a_colon(tmp_path: Path) -> None:
    path = write(tmp_path, HEADER, *["%g,1,1" % (0.25 * i) for i in range(9)], name="a:b.CSV")
    track = make_track(f"{path}:taper=1", 2.0, 0)
    # half way up at 0.5 m, to the cosine's rounding
    assert track.channels["alignment"][[0, 2, 4]] == pytest.approx([0.0, 5e-4, 1e-3], rel=1e-12)


def test_level_multiplies_the_density_of_a_realised_track() -> None:
    mean, median = (make_track(spec, 300.0, 1) for spec in ("tb3352", "tb3352:level=0.25"))
    # one rounding of root and product
    np.testing.assert_allclose(
        median.channels["gauge"], 0.5 * mean.channels["gauge"], rtol=1e-12, atol=1e-18
    )


def test_a_made_track_bears_its_description() -> None:
    assert make_track("fra6:level=2,taper=0", 300.0, 1).name == "fra6:level=2,taper=0"


@pytest.mark.parametrize(
    ("spec", "named"),
    [("tb3325", "'tb3352'"), ("tb3352:levle=1", "unknown setting 'levle'; did you mean 'level'"),
     ("tb3352:", "must be a setting"), ("tb3352:level", "must be a setting"),
     ("tb3352:level=x", "'x' is not a number"), ("tb3352:level=-1", "level = -1 must not be"),
     ("tb3352:taper=nan", "must be finite"), ("tb3352:level=1,level=2", "given twice"),
     ("flat:level=1", "no settings"), ("", "unknown track")],
)  # fmt: skip
def test_a_description_that_is_not_understood_is_explained(spec: str, named: str) -> None:
    with pytest.raises(ArgumentError, match=named):
        make_track(spec, 300.0, 0)


@pytest.mark.parametrize("length", [0.0, -1.0, math.inf])
def test_make_track_refuses_a_length_out_of_range(length: float) -> None:
    with pytest.raises(ArgumentError, match="length"):
        make_track("tb3352", length, 0)
