"""Whether an answer in JSON has the shape that tables and pictures are made from.

Fields that are not named here may be anything; so may a field that is not needed be missing.
"""

from collections.abc import Callable, Mapping
from typing import Any

Shape = Callable[[Any], bool]

_LARGEST = 1e12
"""Larger numbers are nobody's measurement; nor are axes drawn to them."""


def wrong_field(table: str, answer: Mapping[str, Any]) -> str:
    """Return the field of an answer in `stability` or `motion` that cannot be shown; "" if none."""
    if "error" in answer:
        return "" if _text(answer["error"]) else "error"
    needed, fields = _ANSWERS[table]
    missing = next((name for name in needed if name not in answer), "")
    return missing or next(
        (name for name, shape in fields.items() if name in answer and not shape(answer[name])), ""
    )


def _text(value: object) -> bool:
    return isinstance(value, str)


def _number(value: Any) -> bool:
    # Not a number compares false.
    return isinstance(value, int | float) and abs(value) <= _LARGEST


def _whole(value: object) -> bool:
    return isinstance(value, int) and _number(value)


def _or_none(shape: Shape) -> Shape:
    return lambda value: value is None or shape(value)


def _list_of(shape: Shape, length: int | None = None) -> Shape:
    return lambda value: (
        isinstance(value, list) and length in (None, len(value)) and all(map(shape, value))
    )


def _fields(shapes: Mapping[str, Shape]) -> Shape:
    """All fields, each of its shape."""
    return lambda value: (
        isinstance(value, dict)
        and all(name in value and shape(value[name]) for name, shape in shapes.items())
    )


_pair = _list_of(_number, 2)
_some_number, _some_text = _or_none(_number), _or_none(_text)
_some_windows = _or_none(_list_of(_pair))
_bins = _list_of(_or_none(_whole))
_signal_fields = _fields({"rms": _some_number, "low": _bins, "high": _bins})


def _signal(value: Any) -> bool:
    if not _signal_fields(value) or len(value["low"]) != len(value["high"]):
        return False
    # A bin without a number has neither end.
    return [end is None for end in value["low"]] == [end is None for end in value["high"]]


_run = _fields(
    {
        "delay_s": _number,
        "front": _signal,
        "rear": _signal,
        "force": _or_none(_signal),
        "force_rms": _some_number,
    }
)


def _runs(value: Any) -> bool:
    return _list_of(_run)(value) and bool(value)


def _window(value: Any) -> bool:
    return bool(_pair(value) and 0.0 <= value[0] < value[1] - 1e-3 and value[1] <= 1e6)


_locus = _fields(
    {
        "kind": lambda kind: kind in ("exact", "sampled", "designs", "passive"),
        "delays_s": _list_of(_number),
        "branches": _list_of(_fields({"first": _whole, "roots": _list_of(_pair)})),
    }
)


def _roots(value: Any) -> bool:
    if isinstance(value, dict) and "none" in value:
        return _text(value["none"])
    last = len(value["delays_s"]) if _locus(value) else -1
    return last >= 0 and all(
        0 <= branch["first"] <= last - len(branch["roots"]) for branch in value["branches"]
    )


_ANSWERS: dict[str, tuple[tuple[str, ...], dict[str, Shape]]] = {
    "stability": (
        (),
        {
            "method": _text,
            "critical_delay_s": _some_number,
            "longest_s": _some_number,
            "unstable_roots_without_delay": _or_none(_whole),
            "stable_windows_s": _some_windows,
            "windows_s": _some_windows,
            "bracket_s": _or_none(_pair),
            "frequency_hz": _some_number,
            "mode": _some_text,
        },
    ),
    "motion": (
        ("window_s", "runs", "roots"),
        {"window_s": _window, "runs": _runs, "roots": _roots},
    ),
}
"""By table the fields that an answer must have, and the shapes of those that are shown."""
