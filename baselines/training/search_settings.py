"""What a search of hyper-parameters varies; the table [search].

[search]
trials = 30
steps = 2_000_000

[search.ranges]
"method.learning_rate" = {low = 1e-4, high = 1e-2, log = true}
"policy.base" = {choices = ["", "skyhook:gain=4e3"]}
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, cast

from railenv.config import from_mapping, to_dict
from railenv.errors import ArgumentError, check_count, check_finite, check_positive

SEARCHED_TABLES = ("environment", "policy", "method")
"""Tables whose entries may vary from trial to trial; what judges them stays the same."""


@dataclass(frozen=True)
class SearchRange:
    """The values that one entry may have.

    Attributes:
        low: Smallest value; a whole number together with `high` means whole numbers only.
        high: Largest value.
        log: Whether values are drawn evenly over their logarithm.
        choices: A list of values instead of a range.
    """

    low: int | float | None = None
    high: int | float | None = None
    log: bool = False
    choices: tuple[Any, ...] = ()

    def __post_init__(self) -> None:
        if self.choices:
            if self.low is not None or self.high is not None or self.log:
                raise ArgumentError("choices stand beside low, high or log; give one or the other")
            return
        if self.low is None or self.high is None:
            raise ArgumentError("a range needs low and high, or choices; give them")
        low, high = check_finite("low", self.low), check_finite("high", self.high)
        if low >= high:
            raise ArgumentError(f"low = {low:g} must be below high = {high:g}")
        if self.log:
            check_positive("low", low)

    @property
    def whole(self) -> bool:
        """Whether whole numbers are meant."""
        return isinstance(self.low, int) and isinstance(self.high, int)


@dataclass(frozen=True)
class SearchSettings:
    """A search of hyper-parameters.

    Attributes:
        trials: How many settings are tried.
        steps: Lane-steps of each trial.
        ranges: What varies: "table.entry" and its values.
    """

    trials: int
    steps: int
    ranges: tuple[tuple[str, SearchRange], ...]

    def __post_init__(self) -> None:
        check_count("trials", self.trials)
        check_count("steps", self.steps)
        if not self.ranges:
            raise ArgumentError("ranges is empty; a search needs one entry to vary at least")
        for path, _ in self.ranges:
            table, _, entry = path.partition(".")
            if table not in SEARCHED_TABLES or not entry or path == "method.name":
                raise ArgumentError(
                    f"ranges: {path!r} is nothing to search over; write table.entry with one of "
                    f"the tables {', '.join(SEARCHED_TABLES)}"
                )

    @staticmethod
    def of(table: Mapping[str, Any], where: str) -> "SearchSettings":
        """Read the table [search].

        Raises:
            ArgumentError: A key is unknown, missing or of the wrong type.
        """
        values = dict(table)
        given = values.pop("ranges", {})
        if not isinstance(given, Mapping):
            raise ArgumentError(f"{where}: [search] ranges = {given!r} must be a table")
        ranges: list[tuple[str, SearchRange]] = []
        for path, entry in cast("Mapping[str, Any]", given).items():
            origin = f"{where}: [search.ranges] {path}"
            if not isinstance(entry, Mapping):
                raise ArgumentError(f"{origin} = {entry!r} must be {{low, high}} or {{choices}}")
            ranges.append((path, _range(cast("Mapping[str, Any]", entry), origin)))
        counts = from_mapping(_Counts, values, f"{where}: [search]")
        return SearchSettings(counts.trials, counts.steps, tuple(ranges))

    def to_plain(self) -> dict[str, Any]:
        """Return the table as `of` reads it."""
        ranges = {
            path: {key: value for key, value in to_dict(entry).items() if value not in (None, [])}
            for path, entry in self.ranges
        }
        return {"trials": self.trials, "steps": self.steps, "ranges": ranges}


@dataclass(frozen=True)
class _Counts:
    """The plain entries of the table."""

    trials: int
    steps: int


def _range(entry: Mapping[str, Any], origin: str) -> SearchRange:
    known = ("low", "high", "log", "choices")
    for key in entry:
        if key not in known:
            raise ArgumentError(f"{origin}: {key!r} is unknown; known: {', '.join(known)}")
    values = dict(entry)
    choices = values.pop("choices", ())
    if not isinstance(choices, list | tuple):
        raise ArgumentError(f"{origin}: choices = {choices!r} must be a list")
    try:
        return SearchRange(**values, choices=tuple(cast("list[Any]", choices)))
    except ArgumentError as error:
        raise ArgumentError(f"{origin}: {error}") from None
