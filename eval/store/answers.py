"""Writing one answer on a controller in one place: on its stability, or on its motion."""

import json
import sqlite3
from collections.abc import Mapping
from typing import Any

from eval.store.cell import check_name
from railenv.errors import ArgumentError, check_positive

Place = tuple[str, str, str, float]
"""Controller, layout, vehicle and speed [km/h]."""


def answer_row(place: Place, answer: Mapping[str, Any]) -> tuple[object, ...]:
    """Return the values of a row of `stability` or `motion`.

    Raises:
        ArgumentError: The answer holds something that JSON has not, or a name is unusable.
    """
    controller, layout, vehicle, speed_kmh = place
    for name, value in (("layout", layout), ("vehicle", vehicle)):
        check_name(name, value)
    speed = check_positive("speed_kmh", speed_kmh, "km/h")
    try:
        # Without blanks: a time history is some thousand numbers.
        text = json.dumps(dict(answer), allow_nan=False, separators=(",", ":"))
    except (TypeError, ValueError) as error:
        raise ArgumentError(
            f"the answer on {controller} cannot be kept as JSON: {error}; give None for what "
            "is not known"
        ) from None
    return (controller, layout, vehicle, speed, text)


def write_answer(connection: sqlite3.Connection, table: str, row: tuple[object, ...]) -> None:
    """Write a row inside the caller's transaction; one that is there is replaced."""
    connection.execute(
        f"INSERT OR REPLACE INTO {table} VALUES (?, ?, ?, ?, ?)",  # noqa: S608 (known names)
        row,
    )
