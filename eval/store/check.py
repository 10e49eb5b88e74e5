"""Whether what records hold is what their columns say.

SQLite takes a text in a column of numbers, and records are handed in by strangers. So a file is
asked once, when it is opened, and its answers in JSON when they are read (`eval.store.shapes`);
everybody else may take the values as they are.
"""

import sqlite3

from eval.store.schema import DIVISIONS, MEASURES, PLACES, STATUSES

_LARGEST = 1e12
"""Larger numbers are nobody's measurement, and squares of much larger ones have no number."""


def _text(name: str) -> str:
    return f"typeof({name}) IS NOT 'text'"


def _number(name: str, low: float = -_LARGEST) -> str:
    wrong = f"typeof({name}) NOT IN ('real', 'integer')"
    return f"{wrong} OR {name} NOT BETWEEN {low!r} AND {_LARGEST!r}"


def _count(name: str) -> str:
    return f"typeof({name}) IS NOT 'integer' OR {name} < 0"


def _or_null(name: str, rule: str) -> str:
    return f"{name} IS NOT NULL AND ({rule})"


def _one_of(name: str, words: tuple[str, ...]) -> str:
    return f"{_text(name)} OR {name} NOT IN ({', '.join(repr(word) for word in words)})"


def _names(*names: str) -> dict[str, str]:
    return {name: _text(name) for name in names}


_KINDS = {"TEXT": _text, "REAL": lambda name: _number(name, 0.0), "INTEGER": _count}
_CELLS = {
    **{name: _KINDS[kind](name) for name, kind in PLACES.items()},
    "status": _one_of("status", STATUSES),
    "speed_kmh": f"{_number('speed_kmh', 0.0)} OR speed_kmh = 0.0",
    **{name: _or_null(name, f"typeof({name}) NOT IN ('real', 'integer')") for name in MEASURES},
    "unstable": _or_null("unstable", "unstable NOT IN (0, 1)"),
}

_PLACE = ("controller", "layout", "vehicle")
_ANSWERS = {**_names(*_PLACE, "answer"), "speed_kmh": _number("speed_kmh", 0.0)}

_RULES: dict[str, dict[str, str]] = {
    "controllers": {
        "spec": _text("spec"),
        "division": _one_of("division", DIVISIONS),
        "sha256": _or_null("sha256", _text("sha256")),
    },
    "sessions": {
        "id": _count("id"),
        **_names("command", "versions", "machine", "started"),
        "revision": _or_null("revision", _text("revision")),
        "cores": _or_null("cores", _count("cores")),
        "ended": _or_null("ended", _text("ended")),
    },
    "packages": {
        **_names("controller", "package"),
        "status": _one_of("status", ("done", "failed")),
        "seconds": _number("seconds", 0.0),
        "session": _count("session"),
    },
    "cells": _CELLS,
    "stability": _ANSWERS,
    "motion": _ANSWERS,
}
"""By table and column the condition in SQL of a value that cannot be right."""

_NEEDED = ("ride_index_front", "ride_index_rear")
_ENDED = {
    "cells": {
        # A run that blew up may have any number, and none.
        name: f"status = 'ok' AND (({name} IS {'' if name in _NEEDED else 'NOT '}NULL "
        f"{'OR' if name in _NEEDED else 'AND'} ({_number(name)})))"
        for name in MEASURES
    }
}
"""What else no score can be made from."""

_NAMED = {"controllers": "spec", "sessions": "id", "cells": "controller, key"}
"""What names a row; of the other tables its first two columns."""


def check_tables(connection: sqlite3.Connection) -> None:
    """Raise `ValueError` that names a row and a column whose value cannot be right, if any."""
    _check(connection, _RULES)


def check_ended(connection: sqlite3.Connection) -> None:
    """Raise `ValueError` that names a run that came to an end without ride indices, if any."""
    _check(connection, _ENDED)


def _check(connection: sqlite3.Connection, rules: dict[str, dict[str, str]]) -> None:
    for table, columns in rules.items():
        wrong = " ".join(f"WHEN {rule} THEN '{name}'" for name, rule in columns.items())
        value = " ".join(f"WHEN {rule} THEN {name}" for name, rule in columns.items())
        names = _NAMED.get(table, ", ".join(list(columns)[:2]))
        found = connection.execute(
            f"SELECT CASE {wrong} END AS wrong, CASE {value} END, {names} "  # noqa: S608 (known)
            f"FROM {table} WHERE wrong IS NOT NULL LIMIT 1"
        ).fetchone()
        if found is not None:
            column, there, *named = found
            shown = ", ".join(_short(each) for each in named)
            raise ValueError(f"row {shown} of {table} has {column} = {_short(there)}")


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."
