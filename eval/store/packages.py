"""Writing one package: its cells and the mark that it is done or has failed."""

import sqlite3
from collections.abc import Sequence

from eval.store.schema import COLUMNS
from railenv.errors import ArgumentError

_INSERT = (
    f"INSERT INTO cells ({', '.join(COLUMNS)}) "  # noqa: S608 (known names)
    f"VALUES ({', '.join('?' * len(COLUMNS))})"
)
_KEY = list(COLUMNS).index("key")


def write_package(
    connection: sqlite3.Connection,
    mark: tuple[str, str, str, float, int],
    rows: Sequence[tuple[object, ...]],
) -> None:
    """Write a package inside the caller's transaction; one that has failed is replaced.

    Args:
        connection: The open records.
        mark: Controller, package, "done" or "failed", seconds [s] and session.
        rows: The cells' values, in the order of `eval.store.schema.COLUMNS`.

    Raises:
        ArgumentError: The package is done already, or a cell belongs to another one.
    """
    controller, package = mark[:2]
    _forget_failed(connection, controller, package)
    _check_new(connection, [str(row[_KEY]) for row in rows], controller, package)
    connection.execute("INSERT INTO packages VALUES (?, ?, ?, ?, ?)", mark)
    connection.executemany(_INSERT, rows)


def _forget_failed(connection: sqlite3.Connection, controller: str, package: str) -> None:
    which = (controller, package)
    found = connection.execute(
        "SELECT status FROM packages WHERE controller = ? AND package = ?", which
    ).fetchone()
    if found is None:
        return
    if found[0] != "failed":
        raise ArgumentError(
            f"package {package} of {controller} is done already; leave out what done() names"
        )
    connection.execute("DELETE FROM cells WHERE controller = ? AND package = ?", which)
    connection.execute("DELETE FROM packages WHERE controller = ? AND package = ?", which)


def _check_new(
    connection: sqlite3.Connection, keys: Sequence[str], controller: str, package: str
) -> None:
    seen: set[str] = set()
    for key in keys:
        there = connection.execute(
            "SELECT package FROM cells WHERE controller = ? AND key = ?", (controller, key)
        ).fetchone()
        if key in seen or there is not None:
            other = package if there is None else there[0]
            raise ArgumentError(
                f"cell {key} of {controller} is in package {other} already; a cell belongs to "
                "one package, once"
            )
        seen.add(key)
