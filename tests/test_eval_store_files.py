"""The records' file: settings, locks, readers beside a writer, rights."""

import os
import shutil
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from store_examples import CELLS, PACKAGES, SETTINGS, SPEC, go_on, package, write

from eval.store.connection import open_writing
from eval.store.digest import digest
from eval.store.reader import Reader
from eval.store.schema import RECORDS_FILE
from eval.store.settings import differences
from eval.store.store import Store
from railenv.errors import ArgumentError, InputFileError, OutputError

EXAMPLES = Path(__file__).with_name("store_examples.py")


def child(folder: Path) -> subprocess.Popen:
    """A process that writes the example's packages into the folder."""
    return subprocess.Popen(
        [sys.executable, str(EXAMPLES), str(folder)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(EXAMPLES.parent.parent)},
    )


def test_a_new_run_keeps_its_settings(tmp_path: Path) -> None:
    write(tmp_path, range(0))
    with Reader.open(tmp_path) as records:
        assert differences(records.settings, SETTINGS) == ""
        assert records.settings.content["speeds_kmh"] == [200.0, 300.0]
        assert records.created.endswith("+00:00")


def test_a_file_is_in_wal_mode_while_it_is_written_and_plain_afterwards(tmp_path: Path) -> None:
    with Store.create(tmp_path, SETTINGS) as store:
        assert store._connection.execute("PRAGMA journal_mode").fetchone() == ("wal",)
        go_on(store, range(1))
    with Reader.open(tmp_path) as records:
        assert len(records.done()) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == [".lock", RECORDS_FILE]


def test_a_folder_with_records_is_not_begun_again(tmp_path: Path) -> None:
    write(tmp_path, range(1))
    before = (tmp_path / RECORDS_FILE).read_bytes()
    with pytest.raises(ArgumentError, match="exists already; go on with that run by --resume"):
        Store.create(tmp_path, SETTINGS)
    assert (tmp_path / RECORDS_FILE).read_bytes() == before


def test_what_is_left_of_removed_records_does_not_get_into_new_ones(
    tmp_path: Path, killed: Path
) -> None:
    shutil.copytree(killed, tmp_path / "run")
    (tmp_path / "run" / RECORDS_FILE).unlink()
    with pytest.raises(ArgumentError, match="-wal is left of records that were removed; remove it"):
        Store.create(tmp_path / "run", SETTINGS)
    (tmp_path / "run" / f"{RECORDS_FILE}-wal").unlink()
    write(tmp_path / "run", range(1))
    with Reader.open(tmp_path / "run") as records:
        assert len(records.done()) == 1


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"salt_commitment": ""}, 'salt_commitment is "abab.* there and "" now'),
        ({"version": "v1"}, 'version is "v0" there and "v1" now'),
        ({"limits": {"seconds": 60.0, "memory_bytes": 2**31}}, "limits.seconds is 120.0 there and"),
        ({"content": {**SETTINGS.content, "seeds": [1]}}, r"content.seeds is missing there and \["),
        ({"content": {}}, "content.duration is 20.0 there and missing now; content.speeds_kmh is"),
    ],
)
def test_a_run_is_not_resumed_with_other_settings(
    tmp_path: Path, changes: dict, words: str
) -> None:
    write(tmp_path, range(1))
    with pytest.raises(ArgumentError, match=f"was written with other settings: .*{words}"):
        Store.resume(tmp_path, replace(SETTINGS, **changes))


def test_settings_that_differ_in_many_places_are_told_in_one_line() -> None:
    many = replace(SETTINGS, content={f"s{n}": "x" * 100 for n in range(20)})
    told = differences(SETTINGS, many)
    assert told.endswith("18 more differ")
    assert len(told) < 500


@pytest.mark.parametrize("value", [float("nan"), {1, 2}, object()])
def test_settings_that_json_cannot_keep_are_refused(value: object) -> None:
    with pytest.raises(ArgumentError, match="the run's settings cannot be kept as JSON"):
        replace(SETTINGS, content={"x": value})


def test_a_resumed_run_goes_on_where_it_was(tmp_path: Path) -> None:
    write(tmp_path / "a", range(2))
    with Store.resume(tmp_path / "a", SETTINGS) as store:
        assert store.done() == {(SPEC, "p0"), (SPEC, "p1")}
        go_on(store, range(4))
        assert [row["session"] for row in store.packages()] == [1, 1, 2, 2]
    write(tmp_path / "b", range(4))
    assert digest(tmp_path / "a") == digest(tmp_path / "b")


def test_a_folder_belongs_to_one_writer_until_it_is_gone(tmp_path: Path) -> None:
    place = tmp_path / "run"
    with Store.create(place, SETTINGS), pytest.raises(ArgumentError, match="another benchmark"):
        Store.resume(place, SETTINGS)
    with Store.resume(place, SETTINGS):
        pass


def test_a_failed_opening_gives_the_folder_back(tmp_path: Path) -> None:
    write(tmp_path, range(1))
    with pytest.raises(ArgumentError, match="other settings"):
        Store.resume(tmp_path, replace(SETTINGS, version="v1"))
    with Store.resume(tmp_path, SETTINGS):
        pass


@pytest.mark.slow
def test_another_process_reads_whole_packages_while_one_writes_and_cannot_write(
    tmp_path: Path,
) -> None:
    place = tmp_path / "run"
    writer = child(place)
    assert writer.stdout is not None
    counts = []
    try:
        assert writer.stdout.readline() == "open\n"
        with pytest.raises(ArgumentError, match="in use by another benchmark"):
            Store.resume(place, SETTINGS)
        with Reader.open(place) as records:
            for line in writer.stdout:
                rows = list(records.rows())
                assert len(rows) % CELLS == 0
                assert len(records.done()) > int(line)
                counts.append(len(rows))
    finally:
        writer.communicate(timeout=60)
    assert writer.returncode == 0
    assert counts == sorted(counts)
    assert counts[-1] == PACKAGES * CELLS
    with Reader.open(place) as records:
        assert len(list(records.rows())) == PACKAGES * CELLS


def test_rows_are_of_one_moment_though_a_writer_goes_on(tmp_path: Path) -> None:
    with Store.create(tmp_path, SETTINGS) as store, Reader.open(tmp_path) as records:
        go_on(store, range(2))
        rows = records.rows()
        next(rows)
        store.add_package(SPEC, "p2", package(2), 1.0)
        assert len(list(rows)) == 2 * CELLS - 1
        assert len(list(records.rows())) == 3 * CELLS


@contextmanager
def without_rights(folder: Path) -> Generator[None, None, None]:
    """Run the block as somebody who may read the folder and write nothing in it."""
    for path in folder.iterdir():
        path.chmod(0o444)
    folder.chmod(0o555)
    root = os.geteuid() == 0
    if root:  # rights do not bind the superuser
        os.seteuid(65534)
    try:
        yield
    finally:
        if root:
            os.seteuid(0)
        folder.chmod(0o755)


@pytest.fixture
def open_place() -> Generator[Path, None, None]:
    """A folder that other users can reach."""
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o755)
        yield Path(name)


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder whose writer was killed."""
    place = tmp_path_factory.mktemp("run")
    writer = child(place)
    assert writer.stdout is not None
    while writer.stdout.readline() != "1\n":
        pass
    writer.kill()
    writer.communicate()
    assert (place / f"{RECORDS_FILE}-wal").stat().st_size > 0
    return place


@pytest.mark.parametrize("left", ["closed", "killed", "killed, without the shared memory"])
def test_a_folder_without_write_permission_is_read_whole(
    open_place: Path, killed: Path, left: str
) -> None:
    if left == "closed":
        write(open_place, range(2))
    else:
        shutil.copytree(killed, open_place, dirs_exist_ok=True)
        open_place.chmod(0o755)
    if left.endswith("memory"):
        (open_place / f"{RECORDS_FILE}-shm").unlink()
    before = sorted((path.name, path.stat().st_size) for path in open_place.iterdir())
    with without_rights(open_place):
        with Reader.open(open_place) as records:
            done = len(records.done())
            assert done >= 2
            assert len(list(records.rows())) == done * CELLS
        with pytest.raises(OutputError, match="cannot write"):
            Store.resume(open_place, SETTINGS)
    assert sorted((path.name, path.stat().st_size) for path in open_place.iterdir()) == before


def test_a_file_that_may_not_be_read_is_said(open_place: Path) -> None:
    write(open_place, range(1))
    with without_rights(open_place):
        pass
    (open_place / RECORDS_FILE).chmod(0)
    root = os.geteuid() == 0
    os.seteuid(65534 if root else os.geteuid())
    try:
        with pytest.raises(InputFileError, match=r"cannot read .*: Permission denied"):
            Reader.open(open_place)
    finally:
        os.seteuid(0 if root else os.geteuid())


@pytest.mark.parametrize("name", ["a b#c?d%20e", "\u00fc;'\"&mode=memory"])
def test_every_character_of_a_folders_name_is_itself(tmp_path: Path, name: str) -> None:
    write(tmp_path / name, range(1))
    with Reader.open(tmp_path / name) as records:
        assert len(records.done()) == 1


def test_a_folder_can_be_copied_while_it_is_closed(tmp_path: Path) -> None:
    write(tmp_path / "a", range(2))
    (tmp_path / "b").mkdir()
    shutil.copy(tmp_path / "a" / RECORDS_FILE, tmp_path / "b" / RECORDS_FILE)
    assert digest(tmp_path / "a") == digest(tmp_path / "b")


def test_rows_cannot_refer_to_packages_that_are_not_there(tmp_path: Path) -> None:
    write(tmp_path, range(1))
    connection = open_writing(tmp_path / RECORDS_FILE)
    with pytest.raises(sqlite3.IntegrityError, match="FOREIGN KEY"):
        connection.execute("DELETE FROM packages")
    with pytest.raises(sqlite3.IntegrityError, match="CHECK"):
        connection.execute("UPDATE cells SET status = 'okay'")
    connection.close()
