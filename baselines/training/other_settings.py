"""In which entries two configurations differ, in words."""

import json
from collections.abc import Mapping
from typing import Any, cast

MOST_SHOWN = 8
"""Most entries that a message names."""

_LONGEST = 24  # characters of a value: a list of sensors fills a page

_ABSENT = object()


def words_of_difference(old: Mapping[str, Any], new: Mapping[str, Any]) -> str:
    """Return the entries that differ, each with both values: "seed: 1 there, 2 here".

    Args:
        old: What is there, tables of JSON values.
        new: What was given now.
    """
    found = _differences(old, new, "")
    shown = [
        f"{name}: {_shown(mine)} there, {_shown(theirs)} here"
        for name, mine, theirs in found[:MOST_SHOWN]
    ]
    more = [f"and {len(found) - MOST_SHOWN} more"] if len(found) > MOST_SHOWN else []
    return "; ".join([*shown, *more])


def _differences(
    old: Mapping[str, Any], new: Mapping[str, Any], path: str
) -> list[tuple[str, Any, Any]]:
    """Return name, old and new value of the entries that differ, tables gone into."""
    found: list[tuple[str, Any, Any]] = []
    for key in sorted({*old, *new}):
        mine, theirs = old.get(key, _ABSENT), new.get(key, _ABSENT)
        if isinstance(mine, dict) and isinstance(theirs, dict):
            found += _differences(
                cast("dict[str, Any]", mine), cast("dict[str, Any]", theirs), f"{path}{key}."
            )
        elif mine != theirs:
            found.append((f"{path}{key}", mine, theirs))
    return found


def _shown(value: Any) -> str:
    if value is _ABSENT:
        return "nothing"
    text = json.dumps(value)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."
