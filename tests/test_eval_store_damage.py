"""Records that are damaged or of a newer version, and disks that are full."""

import resource
import sqlite3
from pathlib import Path

import pytest
from store_examples import SETTINGS, SPEC, go_on, package, write

from eval.store.digest import digest
from eval.store.reader import Reader
from eval.store.schema import RECORDS_FILE, SCHEMA, set_meta
from eval.store.store import Store
from railenv.errors import ArgumentError, InputFileError, OutputError


def damage(path: Path, how: str) -> None:
    content = path.read_bytes()
    if how == "no SQLite":
        path.write_text("seven speeds\n" * 1000)
    elif how == "empty":
        path.write_bytes(b"")
    elif how == "a program's database":
        path.unlink()
        with sqlite3.connect(path) as connection:
            connection.execute("CREATE TABLE meta (a, b)")
        connection.close()
    elif how.startswith("cut"):
        path.write_bytes(content[: len(content) * int(how[4:]) // 100])
    else:  # pages of zeros in the middle
        third = len(content) // 3
        path.write_bytes(content[:third] + bytes(third) + content[2 * third :])


@pytest.mark.parametrize(
    "how", ["no SQLite", "empty", "a program's database", "cut 1", "cut 40", "cut 99", "zeros"]
)
def test_a_damaged_file_is_refused_and_left_alone(tmp_path: Path, how: str) -> None:
    write(tmp_path, range(4))
    path = tmp_path / RECORDS_FILE
    damage(path, how)
    before = path.read_bytes()
    for opened in (Reader.open, lambda folder: Store.resume(folder, SETTINGS)):
        with pytest.raises(InputFileError, match="is damaged or no benchmark's records"):
            opened(tmp_path)
    assert path.read_bytes() == before
    with pytest.raises(ArgumentError, match="exists already"):
        Store.create(tmp_path, SETTINGS)


@pytest.mark.parametrize("name", ["suite", "limits", "created", "schema"])
def test_a_file_without_an_entry_is_refused(tmp_path: Path, name: str) -> None:
    write(tmp_path, range(1))
    with sqlite3.connect(tmp_path / RECORDS_FILE) as connection:
        connection.execute("DELETE FROM meta WHERE name = ?", (name,))
    connection.close()
    with pytest.raises(InputFileError, match=f"meta has no entry '{name}'"):
        Reader.open(tmp_path)


@pytest.mark.parametrize("value", ['"quick', "7", "[]"])
def test_a_file_with_an_entry_of_another_kind_is_refused(tmp_path: Path, value: str) -> None:
    write(tmp_path, range(1))
    with sqlite3.connect(tmp_path / RECORDS_FILE) as connection:
        connection.execute("UPDATE meta SET value = ? WHERE name = 'suite'", (value,))
    connection.close()
    with pytest.raises(InputFileError, match="is damaged or no benchmark's records"):
        Reader.open(tmp_path)


def test_a_folder_in_place_of_the_file_or_none_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match="it does not exist; give the folder of a benchmark"):
        Reader.open(tmp_path)
    with pytest.raises(InputFileError, match="it does not exist"):
        Store.resume(tmp_path, SETTINGS)
    assert list(tmp_path.iterdir()) == []
    (tmp_path / RECORDS_FILE).mkdir()
    with pytest.raises(InputFileError, match="it is a folder"):
        Reader.open(tmp_path)
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="cannot write to"):
        Store.create(tmp_path / "file", SETTINGS)


def test_a_file_of_a_newer_version_is_refused_with_the_way_out(tmp_path: Path) -> None:
    write(tmp_path, range(1))
    with sqlite3.connect(tmp_path / RECORDS_FILE) as connection:
        set_meta(connection, "schema", SCHEMA + 1)
    connection.close()
    words = rf"has schema {SCHEMA + 1}, .* reads up to {SCHEMA}; .*pip install -U railenv"
    for opened in (Reader.open, lambda folder: Store.resume(folder, SETTINGS)):
        with pytest.raises(InputFileError, match=words):
            opened(tmp_path)


def test_a_full_disk_costs_the_package_and_nothing_else(tmp_path: Path) -> None:
    with Store.create(tmp_path, SETTINGS) as store:
        go_on(store, range(2))
        used = store._connection.execute("PRAGMA page_count").fetchone()[0]
        store._connection.execute(f"PRAGMA max_page_count = {used + 1}")
        with pytest.raises(OutputError, match="disk is full; what was written before is kept"):
            store.add_package(SPEC, "p2", package(2), 1.0)
        assert len(store.done()) == 2
        store._connection.execute("PRAGMA max_page_count = 1000000")
        store.add_package(SPEC, "p2", package(2), 1.0)
    write(tmp_path / "b", range(3))
    assert digest(tmp_path) == digest(tmp_path / "b")


def test_a_file_that_may_not_grow_costs_the_package_and_nothing_else(tmp_path: Path) -> None:
    with Store.create(tmp_path, SETTINGS) as store:
        go_on(store, range(2))
        grown = (tmp_path / f"{RECORDS_FILE}-wal").stat().st_size
        limits = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (grown + 5000, limits[1]))
        try:
            with pytest.raises(OutputError, match=r"cannot write .*; what was written before"):
                store.add_package(SPEC, "p2", package(2), 1.0)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        assert len(store.done()) == 2
    with Store.resume(tmp_path, SETTINGS) as store:
        go_on(store, range(3))
    write(tmp_path / "b", range(3))
    assert digest(tmp_path) == digest(tmp_path / "b")


def test_a_new_run_on_a_full_disk_leaves_no_records(tmp_path: Path) -> None:
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, limits[1]))
    try:
        with pytest.raises(OutputError, match="cannot write"):
            Store.create(tmp_path, SETTINGS)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert [path.name for path in tmp_path.iterdir()] == [".lock"]
