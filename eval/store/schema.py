"""The tables of `records.sqlite`, and how a file of an older version becomes one of this version.

Versions:
    1  One run wrote a file from start to end; its provenance was an entry of `meta`.
    2  A run is resumed after a kill, perhaps on another machine or by another version: each session
       has its row in `sessions`, and each package names the session that wrote it.
    3  Time histories and roots of every controller are kept in `motion`; an older file has none.

A step's SQL is that of its own version and is never changed; the next version gets its own step.
"""

import json
import sqlite3
from collections.abc import Callable, Mapping

SCHEMA = 3
"""The version that this code writes."""

RECORDS_FILE = "records.sqlite"

PLANNED = "planned"
"""Entry of `meta` with the number of runs that there are to be, by controller and layout."""

STATUSES = ("ok", "diverged", "failed", "timeout", "memory", "crashed")
"""How a cell ended: with numbers, blown up, or as its package's worker did."""

LOST = ("failed", "timeout", "memory", "crashed")
"""Statuses without numbers: the controller did not get to the end."""

DIVISIONS = ("told", "untold")
"""Whether a controller knows the delay."""

PLACES: dict[str, str] = {
    "controller": "TEXT",
    "key": "TEXT",
    "model": "TEXT",
    "vehicle": "TEXT",
    "layout": "TEXT",
    "speed_kmh": "REAL",
    "track": "TEXT",
    "channel": "TEXT",
    "delay_s": "REAL",
    "seed": "INTEGER",
    "package": "TEXT",
    "status": "TEXT",
    "message": "TEXT",
}
"""Columns of a cell that always hold a value, with their types."""

MEASURES = (
    "ride_index_front",
    "ride_index_rear",
    "ride_index_original_front",
    "ride_index_original_rear",
    "comfort_front",
    "comfort_rear",
    "mean_comfort_front",
    "mean_comfort_rear",
    "floor_rms_front",
    "floor_rms_rear",
    "bogie_rms",
    "force_rms",
    "force_peak",
    "saturated_share",
    "stroke_peak",
    "derailment_quotient",
    "wheel_unloading",
)
"""Columns of numbers, NULL where not measured: `eval.measures.RunMeasures`, stroke [m], safety."""

COLUMNS: dict[str, str] = {**PLACES, **dict.fromkeys(MEASURES, "REAL"), "unstable": "INTEGER"}
"""Every column of a cell with its type; `unstable` is the oracle's word, NULL where undecided."""

_SESSIONS_2 = """CREATE TABLE sessions (
    id INTEGER PRIMARY KEY,
    command TEXT NOT NULL,
    versions TEXT NOT NULL,
    revision TEXT,
    machine TEXT NOT NULL,
    cores INTEGER,
    started TEXT NOT NULL,
    ended TEXT
)"""

_PACKAGES_2 = """CREATE TABLE packages (
    controller TEXT NOT NULL REFERENCES controllers (spec),
    package TEXT NOT NULL,
    status TEXT NOT NULL CHECK (status IN ('done', 'failed')),
    seconds REAL NOT NULL,
    session INTEGER NOT NULL REFERENCES sessions (id),
    PRIMARY KEY (controller, package)
)"""

_META = "CREATE TABLE meta (name TEXT PRIMARY KEY, value TEXT NOT NULL)"

_CONTROLLERS = """CREATE TABLE controllers (
    spec TEXT PRIMARY KEY,
    division TEXT NOT NULL CHECK (division IN ('told', 'untold')),
    sha256 TEXT
)"""

_CELLS = f"""CREATE TABLE cells (
    {", ".join(f"{name} {kind} NOT NULL" for name, kind in PLACES.items())},
    {", ".join(f"{name} REAL" for name in MEASURES)},
    unstable INTEGER CHECK (unstable IN (0, 1)),
    PRIMARY KEY (controller, key),
    CHECK (status IN ({", ".join(f"'{status}'" for status in STATUSES)})),
    FOREIGN KEY (controller, package) REFERENCES packages (controller, package)
)"""

_STABILITY = """CREATE TABLE stability (
    controller TEXT NOT NULL REFERENCES controllers (spec),
    layout TEXT NOT NULL,
    vehicle TEXT NOT NULL,
    speed_kmh REAL NOT NULL,
    answer TEXT NOT NULL,
    PRIMARY KEY (controller, layout, vehicle, speed_kmh)
)"""

_MOTION_3 = """CREATE TABLE motion (
    controller TEXT NOT NULL REFERENCES controllers (spec),
    layout TEXT NOT NULL,
    vehicle TEXT NOT NULL,
    speed_kmh REAL NOT NULL,
    answer TEXT NOT NULL,
    PRIMARY KEY (controller, layout, vehicle, speed_kmh)
)"""

_TABLES = (_META, _SESSIONS_2, _CONTROLLERS, _PACKAGES_2, _CELLS, _STABILITY, _MOTION_3)


def create_tables(connection: sqlite3.Connection) -> None:
    """Make the tables of this version in an empty file."""
    for table in _TABLES:
        connection.execute(table)
    set_meta(connection, "schema", SCHEMA)


def blank_file(entries: Mapping[str, object]) -> bytes:
    """Return a file without rows, as a whole, so that no kill leaves half of one.

    Args:
        entries: Of `meta`.
    """
    connection = sqlite3.connect(":memory:", isolation_level=None)
    try:
        create_tables(connection)
        for name, value in entries.items():
            set_meta(connection, name, value)
        return connection.serialize()
    finally:
        connection.close()


def set_meta(connection: sqlite3.Connection, name: str, value: object) -> None:
    """Write an entry of `meta` as JSON.

    Raises:
        ValueError: The value holds a number that JSON has not.
    """
    text = json.dumps(value, allow_nan=False)
    connection.execute("INSERT OR REPLACE INTO meta VALUES (?, ?)", (name, text))


def get_meta(connection: sqlite3.Connection, name: str) -> object:
    """Read an entry of `meta`.

    Raises:
        ValueError: It is missing or not JSON.
    """
    found = connection.execute("SELECT value FROM meta WHERE name = ?", (name,)).fetchone()
    if found is None:
        raise ValueError(f"meta has no entry {name!r}")
    return json.loads(found[0])


def migrate(connection: sqlite3.Connection, found: int) -> None:
    """Bring a file of version `found` to this version, inside the caller's transaction.

    Foreign keys must be off, since tables are rebuilt.

    Raises:
        ValueError: The file lacks what its version has.
    """
    for version in range(found, SCHEMA):
        _STEPS[version](connection)
        set_meta(connection, "schema", version + 1)


def _add_sessions(connection: sqlite3.Connection) -> None:
    """Version 1 to 2: the one run's provenance becomes the session of every package."""
    provenance = get_meta(connection, "provenance")
    if not isinstance(provenance, dict):
        raise ValueError("the entry 'provenance' of meta is no mapping")
    connection.execute(_SESSIONS_2)
    connection.execute(
        "INSERT INTO sessions VALUES (1, ?, ?, ?, ?, ?, ?, NULL)", session_values(provenance)
    )
    connection.execute("DELETE FROM meta WHERE name = 'provenance'")
    # SQLite adds no column that is both a reference and never NULL, so the table is built anew. The
    # new one takes the old one's name last: the cells' references are by name and stay as they are.
    connection.execute(_PACKAGES_2.replace("TABLE packages", "TABLE packages_2"))
    connection.execute(
        "INSERT INTO packages_2 SELECT controller, package, status, seconds, 1 FROM packages"
    )
    connection.execute("DROP TABLE packages")
    connection.execute("ALTER TABLE packages_2 RENAME TO packages")


def session_values(provenance: dict[str, object]) -> tuple[object, ...]:
    """Return command, versions, revision, machine, cores and start of `eval.records.provenance`.

    Raises:
        ValueError: It lacks one of them.
    """
    named = ("command", "packages", "python", "byte_order", "revision", "platform", "cores")
    missing = [name for name in (*named, "created") if name not in provenance]
    if missing:
        raise ValueError(f"the provenance lacks {', '.join(missing)}")
    packages = provenance["packages"]
    if not isinstance(packages, dict):
        raise ValueError("the provenance's packages are no mapping")
    versions = json.dumps({"python": provenance["python"], **packages})
    machine = f"{provenance['platform']}, {provenance['byte_order']}-endian"
    where = (provenance["revision"], machine, provenance["cores"])
    return (provenance["command"], versions, *where, provenance["created"])


def _add_motion(connection: sqlite3.Connection) -> None:
    """Version 2 to 3: nothing is known of how the controllers move; what is missing can be run."""
    connection.execute(_MOTION_3)


_STEPS: dict[int, Callable[[sqlite3.Connection], None]] = {1: _add_sessions, 2: _add_motion}
