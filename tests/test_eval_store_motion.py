"""Time histories and roots in the records: written whole, brought up from version 2, digested."""

import json
import sqlite3
from pathlib import Path

import pytest
from store_examples import SETTINGS, SPEC, go_on, write

from eval.store.digest import digest
from eval.store.reader import Reader
from eval.store.schema import RECORDS_FILE, SCHEMA, get_meta
from eval.store.store import Store
from railenv.errors import ArgumentError, InputFileError

ANSWER = {"runs": [{"delay_s": 0.1, "front": {"low": [-3, None], "high": [4, None]}}]}
PLACE = (SPEC, "4", "nominal", 300.0)

VERSION_2 = """
CREATE TABLE meta (name TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE sessions (id INTEGER PRIMARY KEY, command TEXT NOT NULL, versions TEXT NOT NULL,
    revision TEXT, machine TEXT NOT NULL, cores INTEGER, started TEXT NOT NULL, ended TEXT);
CREATE TABLE controllers (spec TEXT PRIMARY KEY,
    division TEXT NOT NULL CHECK (division IN ('told', 'untold')), sha256 TEXT);
CREATE TABLE packages (controller TEXT NOT NULL REFERENCES controllers (spec),
    package TEXT NOT NULL, status TEXT NOT NULL CHECK (status IN ('done', 'failed')),
    seconds REAL NOT NULL, session INTEGER NOT NULL REFERENCES sessions (id),
    PRIMARY KEY (controller, package));
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
    FOREIGN KEY (controller, package) REFERENCES packages (controller, package));
CREATE TABLE stability (controller TEXT NOT NULL REFERENCES controllers (spec),
    layout TEXT NOT NULL, vehicle TEXT NOT NULL, speed_kmh REAL NOT NULL, answer TEXT NOT NULL,
    PRIMARY KEY (controller, layout, vehicle, speed_kmh));
INSERT INTO sessions VALUES (1, 'railenv benchmark', '{"python": "3.12"}', NULL, 'Linux', 2,
    '2026-01-02T03:04:05+00:00', NULL);
INSERT INTO controllers VALUES ('skyhook:gain=35e3', 'untold', NULL);
INSERT INTO packages VALUES ('skyhook:gain=35e3', 'a', 'done', 1.5, 1);
INSERT INTO cells (controller, key, model, vehicle, layout, speed_kmh, track, channel, delay_s,
        seed, package, status, message, ride_index_rear, unstable)
    VALUES ('skyhook:gain=35e3', 'k1', 'lateral17', 'nominal', '4', 300.0, 'german_low',
        'constant:100', 0.1, 3, 'a', 'ok', '', 2.25, 0);
INSERT INTO stability VALUES ('skyhook:gain=35e3', '4', 'nominal', 300.0, '{"proved": true}');
"""


@pytest.fixture
def second(tmp_path: Path) -> Path:
    """A folder with records of version 2."""
    made = sqlite3.connect(tmp_path / RECORDS_FILE)
    made.executescript(VERSION_2)
    entries = {**SETTINGS.plain(), "created": "2026-01-02T03:04:05+00:00", "schema": 2}
    with made:
        made.executemany(
            "INSERT INTO meta VALUES (?, ?)",
            [(name, json.dumps(value)) for name, value in entries.items()],
        )
    made.close()
    return tmp_path


def columns(folder: Path) -> dict[str, list[object]]:
    """Columns and references of every table."""
    made = sqlite3.connect(folder / RECORDS_FILE)
    tables = [row[0] for row in made.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
    found = {
        name: [
            *made.execute(f"PRAGMA table_info({name})"),
            *sorted(made.execute(f"PRAGMA foreign_key_list({name})")),
        ]
        for name in tables
    }
    made.close()
    return found


def test_a_file_of_version_2_is_read_without_motion_and_left_as_it_is(second: Path) -> None:
    before = (second / RECORDS_FILE).read_bytes()
    with Reader.open(second) as records:
        assert records.motion() == []
        assert [row["ride_index_rear"] for row in records.rows()] == [2.25]
        assert [row["answer"] for row in records.stability()] == [{"proved": True}]
        assert len(records.packages()) == len(records.sessions()) == 1
    assert (second / RECORDS_FILE).read_bytes() == before


def test_resuming_a_file_of_version_2_gives_it_the_table_and_keeps_the_rest(second: Path) -> None:
    before = digest(second)
    with Store.resume(second, SETTINGS) as store:
        assert get_meta(store._connection, "schema") == SCHEMA == 3
        store.add_motion(*PLACE, ANSWER)
    write(second / "new", range(0))
    assert columns(second) == columns(second / "new")
    with Reader.open(second) as records:
        assert [row["answer"] for row in records.motion()] == [ANSWER]
        assert [row["ride_index_rear"] for row in records.rows()] == [2.25]
    assert digest(second) != before


def test_a_motion_comes_back_as_it_was_written_and_the_last_one_holds(tmp_path: Path) -> None:
    with Store.create(tmp_path, SETTINGS) as store:
        store.begin_session("test")
        store.add_controller(SPEC, "untold")
        store.add_motion(*PLACE, {"error": "it hung"})
        store.add_motion(*PLACE, ANSWER)
        assert store.motion() == [
            {"controller": SPEC, "layout": "4", "vehicle": "nominal", "speed_kmh": 300.0,
             "answer": ANSWER}
        ]  # fmt: skip
        assert store.stability() == []


def test_what_json_has_not_and_unknown_controllers_are_refused(tmp_path: Path) -> None:
    with Store.create(tmp_path, SETTINGS) as store:
        store.begin_session("test")
        store.add_controller(SPEC, "untold")
        with pytest.raises(ArgumentError, match=r"cannot be kept as JSON.*give None"):
            store.add_motion(*PLACE, {"rms": float("nan")})
        with pytest.raises(ArgumentError, match="controller of this run"):
            store.add_motion("other", *PLACE[1:], ANSWER)
        assert store.motion() == []


def test_a_damaged_answer_is_said(tmp_path: Path) -> None:
    write(tmp_path, range(1))
    with Store.resume(tmp_path, SETTINGS) as store:
        store.add_motion(*PLACE, ANSWER)
    made = sqlite3.connect(tmp_path / RECORDS_FILE)
    with made:
        made.execute("UPDATE motion SET answer = substr(answer, 1, 9)")
    made.close()
    with Reader.open(tmp_path) as records, pytest.raises(InputFileError, match="damaged"):
        records.motion()


@pytest.mark.parametrize(
    ("answer", "same"),
    [
        ({"runs": [{"rms": 0.5}]}, True),
        ({"runs": [{"rms": 0.5000000000000001}]}, False),
        ({"runs": [{"rms": None}]}, False),
        ({"error": "stopped after 8 s"}, False),
    ],
)
def test_the_digest_sees_the_last_bit_of_a_motion(
    tmp_path: Path, answer: dict[str, object], same: bool
) -> None:
    found = []
    for name, each in (("a", {"runs": [{"rms": 0.5}]}), ("b", answer)):
        write(tmp_path / name, range(1))
        with Store.resume(tmp_path / name, SETTINGS) as store:
            store.add_motion(*PLACE, each)
        found.append(digest(tmp_path / name))
    assert (found[0] == found[1]) == same


def test_the_digest_does_not_see_why_there_is_no_motion(tmp_path: Path) -> None:
    found = []
    for name in ("stopped after 8 s", "stopped after 9 s"):
        folder = tmp_path / name
        with Store.create(folder, SETTINGS) as store:
            go_on(store, range(1))
            store.add_motion(*PLACE, {"error": name})
        found.append(digest(folder))
    assert found[0] == found[1]
