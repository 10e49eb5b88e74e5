"""Opening `records.sqlite`, and SQLite's errors in this project's words.

A reader opens the file without the right to change it, also in a folder without write permission
and while another process writes. A file of an older version is then brought to this version in
memory; on disk only a writer does so, in one transaction.
"""

import shutil
import sqlite3
import tempfile
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from eval.store.schema import RECORDS_FILE, SCHEMA, get_meta, migrate
from railenv.errors import ArgumentError, InputFileError, OutputError, RailenvError

WAITED = 30.0
"""How long a lock of another process is waited for [s]; nobody here holds one that long."""

_DISK = {
    sqlite3.SQLITE_FULL,
    sqlite3.SQLITE_IOERR,
    sqlite3.SQLITE_READONLY,
    sqlite3.SQLITE_CANTOPEN,
    sqlite3.SQLITE_PERM,
    sqlite3.SQLITE_BUSY,
    sqlite3.SQLITE_LOCKED,
}


_NEEDS_MORE = {sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY}


@contextmanager
def translated(path: Path, writing: bool) -> Generator[None, None, None]:
    """Turn SQLite's errors inside the block into this project's.

    Raises:
        OutputError: Writing, and the disk or a lock is in the way.
        InputFileError: The file is damaged, not in the format, or cannot be read.
    """
    try:
        yield
    except sqlite3.Error as error:
        code = getattr(error, "sqlite_errorcode", None)
        if code is None and isinstance(error, sqlite3.OperationalError):
            raise _damaged(path, error) from None  # a text that is not in UTF-8
        if code is None:  # a misuse of the module, no fault of the file
            raise
        # The low byte is the kind, the rest says more.
        kind = code & 0xFF
        if writing and kind in _DISK:
            raise OutputError(
                f"cannot write {path}: {error}; what was written before is kept: see to the disk "
                "and its rights, then resume"
            ) from None
        if kind in _DISK:
            raise InputFileError(f"cannot read {path}: {error}") from None
        raise _damaged(path, error) from None
    except (ValueError, RecursionError) as error:
        if isinstance(error, RailenvError):
            raise
        raise _damaged(path, error) from None


def _damaged(path: Path, why: object) -> InputFileError:
    return InputFileError(
        f"{path} is damaged or no benchmark's records: {why}; give another folder, or run the "
        "benchmark again"
    )


@contextmanager
def transaction(connection: sqlite3.Connection, path: Path) -> Generator[None, None, None]:
    """Write all of the block or nothing of it.

    Raises:
        OutputError: The disk is full or the like; nothing of the block is written.
        InputFileError: The file is damaged.
    """
    with translated(path, writing=True):
        connection.execute("BEGIN IMMEDIATE")
        try:
            yield
            connection.execute("COMMIT")
        except BaseException:  # an interruption too
            if connection.in_transaction:
                connection.execute("ROLLBACK")
            raise


def records_path(folder: Path) -> Path:
    """Return where a folder's records are.

    Raises:
        InputFileError: There are none.
    """
    path = folder / RECORDS_FILE
    if not path.is_file():
        why = "it is a folder" if path.is_dir() else "it does not exist"
        raise InputFileError(f"cannot read {path}: {why}; give the folder of a benchmark")
    return path


def open_reading(path: Path) -> sqlite3.Connection:
    """Open the records without the right to change them.

    Raises:
        InputFileError: The file is damaged, of a newer version, or cannot be read.
    """
    with translated(path, writing=False):
        try:
            connection = _checked(_connect(path, "ro"), path)
        except sqlite3.OperationalError as error:
            if (error.sqlite_errorcode & 0xFF) not in _NEEDS_MORE:
                raise
            # What a killed writer has left beside the file must be read too, and for that SQLite
            # wants to write beside it. Where it may not, a copy is read.
            connection = _checked(_copied(path), path)
        if _schema(connection, path) < SCHEMA:
            connection = _brought_up(connection, path)
        return connection


def open_writing(path: Path) -> sqlite3.Connection:
    """Open the records for writing, brought to this version; the caller holds the folder's lock.

    Raises:
        InputFileError: The file is damaged or of a newer version.
        OutputError: It cannot be written.
    """
    with translated(path, writing=True):
        connection = _checked(_connect(path, "rw"), path)
        try:
            found = _schema(connection, path)
            # Where a file system cannot do it, SQLite keeps its rollback journal: as safe, but
            # readers and the writer then wait for each other.
            connection.execute("PRAGMA journal_mode = WAL")
            connection.execute("PRAGMA foreign_keys = OFF")
            if found < SCHEMA:
                _migrate_file(connection, path, found)
            connection.execute("PRAGMA foreign_keys = ON")
        except BaseException:
            connection.close()
            raise
        return connection


def close_writing(connection: sqlite3.Connection) -> None:
    """Close the file, as one plain file if nobody reads it now."""
    try:
        connection.execute("PRAGMA busy_timeout = 0")
        connection.execute("PRAGMA journal_mode = DELETE")
    except sqlite3.OperationalError:
        # Somebody reads, or the disk is full: the file stays in WAL mode, which loses nothing.
        pass
    finally:
        connection.close()


def _connect(path: Path, mode: str) -> sqlite3.Connection:
    # As a URI every character of a path is itself.
    uri = f"{path.absolute().as_uri()}?mode={mode}"
    return sqlite3.connect(uri, uri=True, timeout=WAITED, isolation_level=None)


def _checked(connection: sqlite3.Connection, path: Path) -> sqlite3.Connection:
    """Return the connection if the file's structure is whole, or close it."""
    try:
        (found,) = connection.execute("PRAGMA quick_check(1)").fetchone()
        if found != "ok":
            raise _damaged(path, found)
    except BaseException:
        connection.close()
        raise
    return connection


def _copied(path: Path) -> sqlite3.Connection:
    with tempfile.TemporaryDirectory() as folder:
        try:
            for ending in ("", "-wal", "-journal"):
                source = path.with_name(path.name + ending)
                if source.exists():
                    shutil.copyfile(source, Path(folder) / source.name)
        except OSError as error:
            raise InputFileError(f"cannot read {path}: {error.strerror}") from None
        connection = _connect(Path(folder) / path.name, "rw")
        try:
            return _in_memory(connection)
        finally:
            connection.close()


def _in_memory(connection: sqlite3.Connection) -> sqlite3.Connection:
    memory = sqlite3.connect(":memory:", isolation_level=None)
    try:
        connection.backup(memory)
    except BaseException:
        memory.close()
        raise
    return memory


def _schema(connection: sqlite3.Connection, path: Path) -> int:
    try:
        found = get_meta(connection, "schema")
        if type(found) is not int or found < 1:
            raise ValueError(f"its schema is {found!r}")
        if found > SCHEMA:
            raise InputFileError(
                f"{path} has schema {found}, and this version of railenv reads up to {SCHEMA}; "
                "read it with a newer railenv (pip install -U railenv)"
            )
    except BaseException:
        connection.close()
        raise
    return found


def _brought_up(connection: sqlite3.Connection, path: Path) -> sqlite3.Connection:
    try:
        memory = _in_memory(connection)
    finally:
        connection.close()
    try:
        # Asked again: a writer may have brought the file up in between.
        migrate(memory, _schema(memory, path))
    except BaseException:
        memory.close()
        raise
    return memory


def _migrate_file(connection: sqlite3.Connection, path: Path, found: int) -> None:
    kept = path.with_name(f"{path.name}.v{found}")
    kept.unlink(missing_ok=True)  # perhaps half a copy, of a process that was killed
    copy = sqlite3.connect(kept)
    try:
        connection.backup(copy)
    except BaseException:
        copy.close()
        kept.unlink()
        raise
    copy.close()
    try:
        with transaction(connection, path):
            migrate(connection, found)
            if connection.execute("PRAGMA foreign_key_check").fetchone() is not None:
                raise ValueError("its tables do not fit together")
    except RailenvError as error:
        raise type(error)(f"{error}; the file is unchanged, and {kept} is a copy of it") from None
    kept.unlink()


def check_free(folder: Path) -> Path:
    """Return where a folder's records will be.

    Raises:
        ArgumentError: There are some already, or a part of some.
    """
    path = folder / RECORDS_FILE
    # SQLite would play what a killed writer has left into the new file.
    for left in (path.with_name(path.name + ending) for ending in ("-wal", "-journal")):
        if left.exists() and not path.exists():
            raise ArgumentError(
                f"{left} is left of records that were removed; remove it too, or give another "
                "folder by --out"
            )
    if path.exists() or path.is_symlink():
        raise ArgumentError(
            f"{path} exists already; go on with that run by --resume, or give another folder by "
            "--out"
        )
    return path
