"""Reading a benchmark's records."""

import json
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from eval.store.check import check_ended, check_tables
from eval.store.connection import open_reading, records_path, translated
from eval.store.schema import COLUMNS, PLANNED, RECORDS_FILE, get_meta
from eval.store.settings import RunSettings
from eval.store.shapes import wrong_field
from railenv.errors import unknown_name

Value = str | float | int | bool | None


class Reader:
    """The records in a folder; also a context manager that closes them.

    Every question is answered from the file as it is then: while another process writes, a later
    answer may hold more packages, and no answer holds a part of one. Rows that are iterated are
    those of the first one's moment.

    Attributes:
        folder: The run's folder.
        settings: What the run was started with.
        created: When, in ISO 8601.
        planned: Number of runs that there are to be, by controller and layout; empty in a file of
            a version that did not say so.
    """

    def __init__(self, folder: Path, connection: sqlite3.Connection) -> None:
        self.folder = folder
        self.path = folder / RECORDS_FILE
        self._connection = connection
        with translated(self.path, writing=False):
            check_tables(connection)
            self.settings = _settings(connection)
            self.created = str(get_meta(connection, "created"))
            self.planned = _planned(connection)

    @classmethod
    def open(cls, folder: Path) -> "Reader":
        """Open a folder's records for reading; nothing in it needs to be writable.

        Raises:
            InputFileError: There are none, or they are damaged or of a newer version.
        """
        connection = open_reading(records_path(folder))
        try:
            return Reader(folder, connection)
        except BaseException:
            connection.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    def done(self, with_failed: bool = True) -> set[tuple[str, str]]:
        """Return every (controller, package) that is recorded.

        Args:
            with_failed: Count a failed package too: that it failed is its result.
        """
        where = "" if with_failed else " WHERE status = 'done'"
        return set(self._ask(f"SELECT controller, package FROM packages{where}"))  # noqa: S608

    def rows(self, **where: Value) -> Iterator[dict[str, Value]]:
        """Yield cells, by controller and key in their order as text.

        Args:
            where: Columns and the value that they shall have, e.g. `status="ok"`.

        Yields:
            The columns of `eval.store.schema.COLUMNS`; None where NULL.

        Raises:
            ArgumentError: A column is unknown.
        """
        return _dicts(self._cells(tuple(COLUMNS), where))

    def arrays(self, *names: str, **where: Value) -> dict[str, NDArray[Any]]:
        """Return columns of the cells as arrays, in the order of `rows`.

        Args:
            names: Columns; all of them if none is named.
            where: As in `rows`.

        Returns:
            Arrays of shape (cells,): numbers as float with NaN for NULL (`unstable` too), the seed
            as int64, texts as objects.

        Raises:
            ArgumentError: A column is unknown.
        """
        wanted = names or tuple(COLUMNS)
        found = list(self._cells(wanted, where))
        columns = zip(*found, strict=True) if found else [()] * len(wanted)
        return {
            name: np.array(column, dtype=_dtype(name))
            for name, column in zip(wanted, columns, strict=True)
        }

    def sessions(self) -> list[dict[str, Any]]:
        """Return every session that wrote; `ended` is None for one that was killed."""
        found = self._table("sessions", "id")
        with translated(self.path, writing=False):
            return [{**row, "versions": _versions(row)} for row in found]

    def controllers(self) -> list[dict[str, Any]]:
        """Return every controller: `spec`, `division`, `sha256` of the file behind it or None."""
        return self._table("controllers", "spec")

    def packages(self) -> list[dict[str, Any]]:
        """Return every recorded package with its status, seconds [s] and session."""
        return self._table("packages", "controller, package")

    def stability(self) -> list[dict[str, Any]]:
        """Return every answer on stability, with the controller, layout, vehicle and speed."""
        return self._answers("stability")

    def motion(self) -> list[dict[str, Any]]:
        """Return every controller's time histories and roots, with its place as of `stability`."""
        return self._answers("motion")

    def check_shown(self) -> None:
        """Check that scores, tables and pictures can be made from what is there.

        That every value is one of its column has been checked when the file was opened.

        Raises:
            InputFileError: They cannot; the row is said.
        """
        with translated(self.path, writing=False):
            check_ended(self._connection)
            for table in ("stability", "motion"):
                for row in self._answers(table):
                    if wrong := wrong_field(table, row["answer"]):
                        raise ValueError(f"{_place(table, row)} has an answer with a wrong {wrong}")

    def _answers(self, table: str) -> list[dict[str, Any]]:
        found = self._table(table, "controller, layout, vehicle, speed_kmh")
        with translated(self.path, writing=False):
            return [{**row, "answer": _answer(table, row)} for row in found]

    def _cells(
        self, names: tuple[str, ...], where: dict[str, Value]
    ) -> Iterator[tuple[Value, ...]]:
        for name in (*names, *where):
            if name not in COLUMNS:
                raise unknown_name("column of the cells", name, COLUMNS)
        condition = " AND ".join(f"{name} IS ?" for name in where) or "TRUE"
        return self._ask(
            f"SELECT {', '.join(names)} FROM cells WHERE {condition} "  # noqa: S608 (known names)
            "ORDER BY controller, key",
            tuple(where.values()),
        )

    def _table(self, name: str, order: str) -> list[dict[str, Any]]:
        with translated(self.path, writing=False), closing(self._connection.cursor()) as cursor:
            cursor.execute(f"SELECT * FROM {name} ORDER BY {order}")  # noqa: S608 (known names)
            names = [column[0] for column in cursor.description]
            return [dict(zip(names, row, strict=True)) for row in cursor]

    def _ask(self, question: str, values: tuple[Value, ...] = ()) -> Iterator[tuple[Any, ...]]:
        with translated(self.path, writing=False), closing(self._connection.cursor()) as cursor:
            yield from cursor.execute(question, values)


def _dicts(cells: Iterator[tuple[Value, ...]]) -> Iterator[dict[str, Value]]:
    for values in cells:
        row = dict(zip(COLUMNS, values, strict=True))
        if row["unstable"] is not None:
            row["unstable"] = bool(row["unstable"])
        yield row


def _settings(connection: sqlite3.Connection) -> RunSettings:
    names = ("suite", "version", "content", "limits", "salt_commitment")
    values: dict[str, Any] = {name: get_meta(connection, name) for name in names}
    for name, value in values.items():
        if not isinstance(value, dict if name in ("content", "limits") else str):
            raise ValueError(f"the entry {name!r} of meta is {value!r}")
    return RunSettings(**values)


def _planned(connection: sqlite3.Connection) -> dict[str, dict[str, int]]:
    if connection.execute("SELECT 1 FROM meta WHERE name = ?", (PLANNED,)).fetchone() is None:
        return {}
    found: Any = get_meta(connection, PLANNED)
    if not isinstance(found, dict) or not all(
        isinstance(layouts, dict) and all(isinstance(runs, int) for runs in layouts.values())
        for layouts in found.values()
    ):
        raise ValueError(f"the entry {PLANNED!r} of meta holds no numbers of runs")
    return found


def _versions(session: dict[str, Any]) -> dict[str, Any]:
    versions = json.loads(session["versions"])
    if not isinstance(versions, dict):
        raise ValueError(f"row {session['id']} of sessions has versions = {versions!r:.80}")
    return versions


def _answer(table: str, row: dict[str, Any]) -> dict[str, Any]:
    try:
        answer = json.loads(row["answer"])
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{_place(table, row)} has an answer that is not JSON: {error}") from None
    if not isinstance(answer, dict):
        raise ValueError(f"{_place(table, row)} has an answer that is no mapping")
    return answer


def _place(table: str, row: dict[str, Any]) -> str:
    return f"row {row['controller']!r}, {row['layout']!r}, {row['vehicle']!r} of {table}"


def _dtype(name: str) -> type:
    if COLUMNS[name] == "TEXT":
        return object
    return np.int64 if name == "seed" else np.float64
