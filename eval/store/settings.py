"""What a run was started with, and what differs when it is resumed with something else."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields

from railenv.errors import ArgumentError

_SHOWN, _WIDTH = 5, 60


@dataclass(frozen=True)
class RunSettings:
    """Everything that the results of a run depend on, apart from the code.

    Attributes:
        suite: The suite's name.
        version: Its version.
        content: Its full settings, ready for JSON.
        limits: What a controller may use, e.g. `{"seconds": 120.0, "memory_bytes": 2147483648}`.
        salt_commitment: What the organisers have published of their salt; empty without one.

    Raises:
        ArgumentError: The settings hold something that JSON has not.
    """

    suite: str
    version: str
    content: Mapping[str, object]
    limits: Mapping[str, object]
    salt_commitment: str = ""

    def __post_init__(self) -> None:
        self.plain()

    def plain(self) -> dict[str, object]:
        """Return the settings as JSON gives them back: lists for tuples, keys as text."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        try:
            for name in ("content", "limits"):
                values[name] = dict(values[name])
            return json.loads(json.dumps(values, allow_nan=False))
        except (TypeError, ValueError) as error:
            raise ArgumentError(
                f"the run's settings cannot be kept as JSON: {error}; give finite numbers, texts, "
                "lists and mappings"
            ) from None


def differences(there: RunSettings, now: RunSettings) -> str:
    """Say in one line what differs between a folder's settings and those of now; empty if nothing.

    Args:
        there: The settings that the folder was written with.
        now: The settings asked for.

    Returns:
        E.g. "content.speeds_kmh is [200.0] there and [300.0] now; 2 more differ".
    """
    found = list(_differing("", there.plain(), now.plain()))
    if len(found) > _SHOWN:
        found[_SHOWN:] = [f"{len(found) - _SHOWN} more differ"]
    return "; ".join(found)


def _differing(where: str, there: object, now: object) -> Iterator[str]:
    if isinstance(there, dict) and isinstance(now, dict):
        for name in sorted({**there, **now}):
            inner = f"{where}.{name}" if where else name
            if name not in there:
                yield f"{inner} is missing there and {_short(now[name])} now"
            elif name not in now:
                yield f"{inner} is {_short(there[name])} there and missing now"
            else:
                yield from _differing(inner, there[name], now[name])
    elif there != now:
        yield f"{where} is {_short(there)} there and {_short(now)} now"


def _short(value: object) -> str:
    text = json.dumps(value)
    return text if len(text) <= _WIDTH else f"{text[: _WIDTH - 3]}..."
