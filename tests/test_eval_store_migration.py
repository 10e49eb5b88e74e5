"""A file of version 1, written here in the SQL of version 1, becomes one of this version."""

import json
import os
import signal
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest
from store_examples import SETTINGS, SPEC, go_on, write

from eval.store import connection as opening
from eval.store import schema
from eval.store.reader import Reader
from eval.store.schema import RECORDS_FILE, SCHEMA
from eval.store.store import Store
from railenv.errors import InputFileError, OutputError

VERSION_1 = """
CREATE TABLE meta (name TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE controllers (
    spec TEXT PRIMARY KEY,
    division TEXT NOT NULL CHECK (division IN ('told', 'untold')),
    sha256 TEXT
);
CREATE TABLE packages (
    controller TEXT NOT NULL REFERENCES controllers (spec),
    package TEXT NOT NULL,
    status TEXT NOT NULL CHECK (status IN ('done', 'failed')),
    seconds REAL NOT NULL,
    PRIMARY KEY (controller, package)
);
CREATE TABLE cells (
    controller TEXT NOT NULL, key TEXT NOT NULL, model TEXT NOT NULL, vehicle TEXT NOT NULL,
    layout TEXT NOT NULL, speed_kmh REAL NOT NULL, track TEXT NOT NULL, channel TEXT NOT NULL,
    delay_s REAL NOT NULL, seed INTEGER NOT NULL, package TEXT NOT NULL, status TEXT NOT NULL,
    message TEXT NOT NULL,
    ride_index_front REAL, ride_index_rear REAL, ride_index_original_front REAL,
    ride_index_original_rear REAL, comfort_front REAL, comfort_rear REAL, mean_comfort_front REAL,
    mean_comfort_rear REAL, floor_rms_front REAL, floor_rms_rear REAL, bogie_rms REAL,
    force_rms REAL, force_peak REAL, saturated_share REAL, stroke_peak REAL,
    derailment_quotient REAL, wheel_unloading REAL,
    unstable INTEGER CHECK (unstable IN (0, 1)),
    PRIMARY KEY (controller, key),
    CHECK (status IN ('ok', 'diverged', 'failed', 'timeout', 'memory', 'crashed')),
    FOREIGN KEY (controller, package) REFERENCES packages (controller, package)
);
CREATE TABLE stability (
    controller TEXT NOT NULL REFERENCES controllers (spec),
    layout TEXT NOT NULL,
    vehicle TEXT NOT NULL,
    speed_kmh REAL NOT NULL,
    answer TEXT NOT NULL,
    PRIMARY KEY (controller, layout, vehicle, speed_kmh)
);
INSERT INTO controllers VALUES ('skyhook:gain=35e3', 'untold', NULL);
INSERT INTO packages VALUES ('skyhook:gain=35e3', 'a', 'done', 1.5);
INSERT INTO packages VALUES ('skyhook:gain=35e3', 'b', 'failed', 120.0);
INSERT INTO cells (controller, key, model, vehicle, layout, speed_kmh, track, channel, delay_s,
        seed, package, status, message, ride_index_rear, unstable)
    VALUES ('skyhook:gain=35e3', 'k1', 'lateral17', 'nominal', '4', 300.0, 'german_low',
        'constant:100', 0.1, 3, 'a', 'ok', '', 2.25, 0),
    ('skyhook:gain=35e3', 'k2', 'lateral17', 'nominal', '4', 300.0, 'german_low',
        'constant:100', 0.1, 4, 'b', 'timeout', 'after 120 s', NULL, NULL);
INSERT INTO stability VALUES ('skyhook:gain=35e3', '4', 'nominal', 300.0, '{"proved": true}');
"""
PROVENANCE = {
    "command": "railenv benchmark",
    "created": "2026-01-02T03:04:05+00:00",
    "seconds": 9.0,
    "python": "3.11.7",
    "platform": "Linux",
    "cores": 2,
    "byte_order": "little",
    "revision": "3752df1",
    "packages": {"railenv": "0.1.0", "numpy": "2.0.0"},
}


@pytest.fixture
def old(tmp_path: Path) -> Path:
    """A folder with records of version 1."""
    entries = {**SETTINGS.plain(), "created": PROVENANCE["created"], "provenance": PROVENANCE}
    made = sqlite3.connect(tmp_path / RECORDS_FILE)
    made.executescript(VERSION_1)
    with made:
        made.executemany(
            "INSERT INTO meta VALUES (?, ?)",
            [(name, json.dumps(value)) for name, value in {**entries, "schema": 1}.items()],
        )
    made.close()
    return tmp_path


def contents(folder: Path) -> list[object]:
    """Everything that a reader can say of a folder."""
    with Reader.open(folder) as records:
        tables = [records.sessions(), records.controllers(), records.packages()]
        return [*tables, records.stability(), list(records.rows()), records.settings.plain()]


def version(folder: Path) -> object:
    """The version that is in the file itself."""
    made = sqlite3.connect(f"{(folder / RECORDS_FILE).as_uri()}?mode=ro", uri=True)
    try:
        return schema.get_meta(made, "schema")
    finally:
        made.close()


def structure(folder: Path) -> dict[str, list[object]]:
    """Columns and references of every table, as SQLite itself lists them."""
    made = sqlite3.connect(folder / RECORDS_FILE)
    names = [row[0] for row in made.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
    found = {
        name: [
            *made.execute(f"PRAGMA table_info({name})"),
            *sorted(made.execute(f"PRAGMA foreign_key_list({name})")),
        ]
        for name in names
    }
    made.close()
    return found


def test_an_old_file_is_read_as_a_new_one_and_left_as_it_is(old: Path) -> None:
    before = (old / RECORDS_FILE).read_bytes()
    sessions, controllers, packages, stability, rows, settings = contents(old)
    assert sessions == [
        {
            "id": 1,
            "command": "railenv benchmark",
            "versions": {"python": "3.11.7", "railenv": "0.1.0", "numpy": "2.0.0"},
            "revision": "3752df1",
            "machine": "Linux, little-endian",
            "cores": 2,
            "started": PROVENANCE["created"],
            "ended": None,
        }
    ]
    assert controllers == [{"spec": SPEC, "division": "untold", "sha256": None}]
    assert packages == [
        {"controller": SPEC, "package": "a", "status": "done", "seconds": 1.5, "session": 1},
        {"controller": SPEC, "package": "b", "status": "failed", "seconds": 120.0, "session": 1},
    ]
    assert [answer["answer"] for answer in stability] == [{"proved": True}]
    named = [(row["key"], row["ride_index_rear"], row["unstable"]) for row in rows]
    assert named == [("k1", 2.25, False), ("k2", None, None)]
    assert settings == SETTINGS.plain()
    assert (old / RECORDS_FILE).read_bytes() == before


def test_resuming_brings_the_file_itself_to_this_version(old: Path) -> None:
    read = contents(old)
    with Store.resume(old, SETTINGS):
        pass
    assert version(old) == SCHEMA
    assert contents(old) == read
    assert sorted(path.name for path in old.iterdir()) == [".lock", RECORDS_FILE]


def test_a_file_brought_up_has_the_tables_of_a_new_one(old: Path) -> None:
    with Store.resume(old, SETTINGS):
        pass
    write(old / "new", range(0))
    assert structure(old) == structure(old / "new")


def test_a_run_that_was_brought_up_goes_on(old: Path) -> None:
    with Store.resume(old, SETTINGS) as store:
        go_on(store, range(1))
        assert [row["session"] for row in store.packages()] == [1, 1, 2]
        with pytest.raises(sqlite3.IntegrityError, match="FOREIGN KEY"):
            store._connection.execute("DELETE FROM packages")


def test_a_copy_of_the_old_file_stands_beside_it_meanwhile(
    old: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = []

    def step(connection: sqlite3.Connection) -> None:
        copy = sqlite3.connect(old / f"{RECORDS_FILE}.v1")
        seen.append(schema.get_meta(copy, "schema"))
        seen.append(copy.execute("SELECT count(*) FROM cells").fetchone()[0])
        copy.close()
        schema._add_sessions(connection)

    monkeypatch.setitem(schema._STEPS, 1, step)
    opening.close_writing(opening.open_writing(old / RECORDS_FILE))
    assert seen == [1, 2]
    assert not (old / f"{RECORDS_FILE}.v1").exists()


def test_a_step_that_fails_leaves_the_old_file_and_its_copy(
    old: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def step(connection: sqlite3.Connection) -> None:
        schema._add_sessions(connection)
        connection.execute("PRAGMA max_page_count = 1")
        connection.execute("CREATE TABLE more AS SELECT zeroblob(1000000)")

    read = contents(old)
    with monkeypatch.context() as patch:
        patch.setitem(schema._STEPS, 1, step)
        words = r"disk is full; .*the file is unchanged, and .*\.v1 is a copy"
        with pytest.raises(OutputError, match=words):
            opening.open_writing(old / RECORDS_FILE)
    assert version(old) == 1
    assert (old / f"{RECORDS_FILE}.v1").is_file()
    assert contents(old) == read
    with Store.resume(old, SETTINGS):
        pass
    assert contents(old) == read
    assert not (old / f"{RECORDS_FILE}.v1").exists()


def test_an_old_file_that_lacks_its_provenance_is_refused(old: Path) -> None:
    with sqlite3.connect(old / RECORDS_FILE) as made:
        made.execute("UPDATE meta SET value = '{}' WHERE name = 'provenance'")
    made.close()
    for opened in (Reader.open, lambda folder: Store.resume(folder, SETTINGS)):
        with pytest.raises(InputFileError, match="the provenance lacks command, packages"):
            opened(old)
    assert version(old) == 1


def test_a_kill_in_the_middle_of_a_step_leaves_the_old_file(old: Path) -> None:
    read = contents(old)
    code = f"""
import os
from pathlib import Path
from eval.store import connection, schema

def step(file):
    schema._add_sessions(file)
    file.execute("PRAGMA cache_spill = 1")
    os.kill(os.getpid(), {int(signal.SIGKILL)})

schema._STEPS[1] = step
connection.open_writing(Path({str(old / RECORDS_FILE)!r}))
"""
    root = Path(__file__).parent.parent
    done = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, "PYTHONPATH": str(root)}, check=False
    )
    assert done.returncode == -signal.SIGKILL
    assert version(old) == 1
    assert contents(old) == read
    with Store.resume(old, SETTINGS):
        pass
    assert (version(old), contents(old)) == (SCHEMA, read)
