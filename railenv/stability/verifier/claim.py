"""What a certificate for constant delays claims, read strictly.

Whatever is not checked must not be in a claim: an entry that is not known is a reason to reject,
since somebody may take it for proved.
"""

from dataclasses import dataclass
from typing import Any, cast

from railenv.stability.verifier.quasipolynomial import RejectedError, rational

_CLAIM = {"kind", "common", "groups", "low", "high", "region"}
_REGION = {"decay_rate", "damping_ratio", "max_frequency_hz"}


@dataclass(frozen=True)
class Region:
    """Roots with Re s > -decay_rate; or those of too low damping up to a damped frequency.

    Attributes:
        decay_rate: [1/s].
        damping_ratio: In [0, 1), then decay_rate is zero; None for a half-plane.
        max_frequency_hz: Above zero [Hz]; None for a half-plane.
    """

    decay_rate: Any
    damping_ratio: Any
    max_frequency_hz: Any


@dataclass(frozen=True)
class Claim:
    """One interval of delays for each group of channels, and a region.

    Attributes:
        groups: Channels of each group.
        low, high: Ends of the intervals as they stand in the file [s].
        region: Where no root may be.
    """

    groups: list[list[int]]
    low: list[float]
    high: list[float]
    region: Region

    @property
    def is_point(self) -> bool:
        """Whether every delay is a single number."""
        return self.low == self.high

    def holds(self, delays: Any) -> bool:
        """Whether there is one delay per group, each in its interval."""
        values = [rational(tau) for tau in listed("delays", delays)]
        return len(values) == len(self.low) and all(
            rational(a) <= tau <= rational(b)
            for a, tau, b in zip(self.low, values, self.high, strict=True)
        )


def read_claim(plain: Any, channels: int) -> Claim:
    """Read a claim of the kind "delay box" about a system with so many channels.

    Raises:
        RejectedError: It is not well formed, or claims something else besides.
    """
    entries("claim", plain, _CLAIM)
    groups = [listed("a group", group) for group in listed("groups", plain["groups"])]
    held = [k for group in groups for k in group]
    if any(type(k) is not int for k in held) or sorted(held) != list(range(channels)):
        raise RejectedError("the groups do not hold every channel once")
    if not groups or (channels and not all(groups)):
        raise RejectedError("a group holds no channel")
    low, high = listed("low", plain["low"]), listed("high", plain["high"])
    if not len(groups) == len(low) == len(high):
        raise RejectedError("the claim has not one interval of delays per group of channels")
    for group, a, b in zip(groups, low, high, strict=True):
        if not 0 <= rational(a) <= rational(b):
            raise RejectedError(f"[{a}, {b}] is no interval of delays")
        if len(group) > 1 and len(groups) > 1 and a != b:
            raise RejectedError("channels with intervals of their own are held together")
    if plain["common"] is not (len(groups) == 1):
        raise RejectedError("the claim does not say whether all channels share one delay")
    return Claim(groups, low, high, read_region(plain["region"]))


def read_region(plain: Any) -> Region:
    """Read a region of the complex plane.

    Raises:
        RejectedError: It is none.
    """
    entries("region", plain, _REGION)
    decay_rate = rational(plain["decay_rate"])
    if plain["damping_ratio"] is None:
        if plain["max_frequency_hz"] is not None:
            raise RejectedError("a frequency caps a damping ratio, and there is none")
        return Region(decay_rate, None, None)
    ratio, cap = rational(plain["damping_ratio"]), rational(plain["max_frequency_hz"])
    if decay_rate != 0:
        raise RejectedError("a region has a decay rate or a damping ratio, not both")
    if not (0 <= ratio < 1 and cap > 0):
        raise RejectedError("the damping ratio is not in [0, 1), or its frequency not above zero")
    return Region(decay_rate, ratio, cap)


def entries(name: str, plain: Any, known: set[str]) -> None:
    """Require that a part of a certificate has these entries and no others.

    Raises:
        RejectedError: One is missing or not known.
    """
    if not isinstance(plain, dict):
        raise RejectedError(f"{name} is not a table of entries")
    there = set(cast(dict[str, Any], plain))
    if there != known:
        wrong = sorted(there ^ known)[0]
        what = "is missing" if wrong in known else "is not known"
        raise RejectedError(f"{name}: the entry {wrong[:40]!r} {what}")


def listed(name: str, value: Any) -> list[Any]:
    """Return a value that must be a list.

    Raises:
        RejectedError: It is none.
    """
    if not isinstance(value, list):
        raise RejectedError(f"{name} is not a list")
    return cast(list[Any], value)
