"""One cell's row, checked before it reaches the file."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import SupportsFloat

from eval.store.schema import LOST, MEASURES, STATUSES
from railenv.errors import (
    ArgumentError,
    check_count,
    check_finite,
    check_not_negative,
    check_positive,
    unknown_name,
)
from railenv.units import KilometrePerHour, Second

_LARGEST = 2**63 - 1


@dataclass(frozen=True)
class Cell:
    """What one controller did in one scenario.

    Attributes:
        key: The scenario's stable name.
        model: Model of the vehicle.
        vehicle: Vehicle and its state.
        layout: The actuators' layout.
        speed_kmh: Running speed [km/h].
        track: Track description.
        channel: What the channel does to commands, in words of the key.
        delay_s: The delay that the cell is counted at [s].
        seed: Number of the track realisation.
        status: One of `eval.store.schema.STATUSES`.
        measures: Numbers by the names in `eval.store.schema.MEASURES`; None or NaN: not measured.
        message: Why there are no numbers; characters that UTF-8 has not are kept as escapes.
        unstable: The oracle's word on the loop; None where it has none.
    """

    key: str
    model: str
    vehicle: str
    layout: str
    speed_kmh: KilometrePerHour
    track: str
    channel: str
    delay_s: Second
    seed: int
    status: str
    measures: Mapping[str, SupportsFloat | None] = field(default_factory=dict)
    message: str = ""
    unstable: bool | None = None

    def row(self, controller: str, package: str) -> tuple[object, ...]:
        """Return the values of `eval.store.schema.COLUMNS`, in their order.

        Args:
            controller: The controller's SPEC.
            package: The package that the cell was run in.

        Raises:
            ArgumentError: A value is not of its column; the cell and the name are said.
        """
        key = check_name("key", self.key)
        where = f"cell {key} of {controller}: "
        if self.status not in STATUSES:
            raise unknown_name(f"status of cell {key} of {controller}", self.status, STATUSES)
        for name in self.measures:
            if name not in MEASURES:
                raise unknown_name(f"measure of cell {key} of {controller}", name, MEASURES)
        seed = check_count(f"{where}seed", self.seed, minimum=0)
        if seed > _LARGEST:
            raise ArgumentError(
                f"{where}seed = {seed} is above {_LARGEST}, the largest number that the records "
                "hold; give the realisation's number, not a hash"
            )
        if self.unstable not in (None, False, True):
            raise ArgumentError(f"{where}unstable = {self.unstable!r}; give True, False or None")
        numbers = [_number(f"{where}{name}", self.measures.get(name)) for name in MEASURES]
        if self.status in LOST and any(number is not None for number in numbers):
            raise ArgumentError(
                f"{where}status = {self.status!r} comes with measures; give none, or another status"
            )
        return (
            controller,
            key,
            check_name(f"{where}model", self.model),
            check_name(f"{where}vehicle", self.vehicle),
            check_name(f"{where}layout", self.layout),
            check_positive(f"{where}speed_kmh", self.speed_kmh, "km/h"),
            check_name(f"{where}track", self.track),
            check_name(f"{where}channel", self.channel),
            check_not_negative(f"{where}delay_s", self.delay_s, "seconds") + 0.0,
            seed,
            package,
            self.status,
            self.message.encode("utf-8", "backslashreplace").decode(),
            *numbers,
            None if self.unstable is None else int(self.unstable),
        )


def check_name(name: str, text: object) -> str:
    """Return a text that can be a key, or raise `ArgumentError`.

    It has characters, none of them NUL, and UTF-8 can spell it.
    """
    if isinstance(text, str) and text and "\0" not in text:
        try:
            text.encode()
        except UnicodeEncodeError:
            pass
        else:
            return text
    raise ArgumentError(
        f"{name} = {f'{text!r}'[:60]} is no usable name; give a text in UTF-8 that is not empty"
    )


def _number(name: str, value: SupportsFloat | None) -> float | None:
    if value is None or (isinstance(value, SupportsFloat) and math.isnan(value)):
        return None
    # SQLite has no minus zero; here it becomes zero where a reader can see it.
    return check_finite(name, value) + 0.0
