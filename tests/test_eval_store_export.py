"""The cells as CSV and Parquet hold what the records hold, bit for bit."""

import csv
import io
import json
import sys
from pathlib import Path

import pytest
from store_examples import CELLS, SETTINGS, SPEC, cell, package

from eval.store import export as exporting
from eval.store.export import export
from eval.store.reader import Reader
from eval.store.schema import COLUMNS
from eval.store.store import Store
from railenv.errors import ArgumentError, InputFileError, OutputError, RailenvError


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with every kind of value."""
    folder = tmp_path_factory.mktemp("run")
    said = 'ValueError: "a, b"\r\n\n\u00fc'
    with Store.create(folder, SETTINGS) as store:
        store.begin_session("railenv benchmark")
        store.add_controller(SPEC, "untold")
        store.add_controller("py:x, y:z", "told")
        store.add_package(SPEC, "p1", package(1), 1.0)
        extremes = {"force_rms": 5e-324, "force_peak": 1.7976931348623157e308, "bogie_rms": 1e16}
        store.add_package(
            "py:x, y:z",
            "p",
            [
                cell(0, measures=extremes, unstable=True, delay_s=0.1 + 0.2),
                cell(2**63 - 1, unstable=None, measures={}, status="diverged"),
                cell(1, status="crashed", measures={}, message=said),
            ],
            1.0,
        )
    return folder


@pytest.fixture(scope="module")
def rows(run: Path) -> list[dict]:
    with Reader.open(run) as records:
        return list(records.rows())


def from_csv(row: dict[str, str]) -> dict:
    """A row of text as values, by the columns' types alone."""
    read = {"TEXT": str, "REAL": float, "INTEGER": int}
    values = {}
    for name, kind in COLUMNS.items():
        empty = row[name] == "" and kind != "TEXT"
        values[name] = None if empty else read[kind](row[name])
    return values


def test_csv_is_read_back_bit_for_bit(run: Path, rows: list[dict], tmp_path: Path) -> None:
    path = tmp_path / "cells.csv"
    assert export(run, path) == CELLS + 3
    with path.open(encoding="utf-8", newline="") as stream:
        found = [from_csv(row) for row in csv.DictReader(stream)]
    assert repr(found) == repr(
        [{name: int(v) if isinstance(v, bool) else v for name, v in row.items()} for row in rows]
    )


@pytest.mark.parametrize("group", [7, 10_000])
def test_parquet_is_read_back_bit_for_bit(
    run: Path, rows: list[dict], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, group: int
) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    monkeypatch.setattr(exporting, "_GROUP", group)
    path = tmp_path / "cells.Parquet"
    assert export(run, path) == CELLS + 3
    table = parquet.read_table(path)
    assert repr(table.to_pylist()) == repr(rows)
    about = json.loads(table.schema.metadata[b"railenv"])
    assert {name: about[name] for name in SETTINGS.plain()} == SETTINGS.plain()


def test_a_run_without_cells_has_a_header_and_types(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    with Store.create(tmp_path, SETTINGS):
        pass
    assert export(tmp_path, tmp_path / "a.csv") == export(tmp_path, tmp_path / "a.parquet") == 0
    assert (tmp_path / "a.csv").read_text() == ",".join(COLUMNS) + "\n"
    schema = parquet.read_schema(tmp_path / "a.parquet")
    types = {"TEXT": "string", "REAL": "double", "INTEGER": "int64"}
    expected = {name: types[kind] for name, kind in COLUMNS.items()} | {"unstable": "bool"}
    assert {field.name: str(field.type) for field in schema} == expected


def test_another_ending_is_refused(run: Path, tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match=r"unknown format '.parq'; did you mean '.parquet'"):
        export(run, tmp_path / "cells.parq")
    with pytest.raises(ArgumentError, match=r"unknown format ''; known: .csv, .parquet"):
        export(run, tmp_path / "cells")


def test_without_pyarrow_it_says_what_to_install(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(RailenvError, match=r'pip install "railenv\[report\]", or export to .csv'):
        export(run, tmp_path / "cells.parquet")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_an_export_that_breaks_off_leaves_what_was_there(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: str
) -> None:
    def torn(records: Reader):
        yield next(whole(records))
        raise InputFileError("the file is damaged")

    whole = Reader.rows
    monkeypatch.setattr(Reader, "rows", torn)
    path = tmp_path / f"cells.{ending}"
    path.write_text("mine")
    with pytest.raises(InputFileError, match="the file is damaged"):
        export(run, path)
    assert path.read_text() == "mine"
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_that_is_not_there_is_said(run: Path, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="cannot write"):
        export(run, tmp_path / "none" / "cells.csv")
    with pytest.raises(InputFileError, match="it does not exist"):
        export(tmp_path, tmp_path / "cells.csv")
    assert not (tmp_path / "cells.csv").exists()


def test_csv_ends_its_lines_alike_everywhere(run: Path, tmp_path: Path) -> None:
    export(run, tmp_path / "cells.csv")
    first = io.BytesIO((tmp_path / "cells.csv").read_bytes()).readline()
    assert first == (",".join(COLUMNS) + "\n").encode()
