"""`certify`: is a linear loop stable for these delays? Answered with a proof or not at all."""

import time
from collections.abc import Callable, Sequence
from typing import Any, cast

import numpy as np

from railenv.errors import ArgumentError, check_count
from railenv.stability.certificate import UNDECIDED, UNSTABLE, Certificate
from railenv.stability.delay_system import DelaySystem, as_delay_system
from railenv.stability.proof.contour import Box
from railenv.stability.proof.delay_box import Proof, prove_box
from railenv.stability.proof.neutral import difference_part_is_unstable
from railenv.stability.proof.region import Region

MOST_TESTS = 200_000
"""Tests of pieces and boxes after which a proof is given up; some minutes."""

Delay = float | tuple[float, float] | Sequence[float | tuple[float, float]]


def certify(
    system: Any,
    delay: Delay = 0.0,
    *,
    decay_rate: float = 0.0,
    damping_ratio: float | None = None,
    max_frequency_hz: float | None = None,
    most_tests: int = MOST_TESTS,
    progress: Callable[[float], None] | None = None,
) -> Certificate:
    """Prove a loop stable or unstable for constant delays.

    STABLE means that every characteristic root has negative real part (or lies outside the region
    that `decay_rate` or `damping_ratio` describes) at every delay asked for; UNSTABLE that at one
    of them some root does not. All bounds are exact or outward rounded; every double of the system
    is taken as the exact number it is.

    The "damping ratio of at least 5 %" of vehicle dynamics is ill-posed for a delay system: it has
    infinitely many roots, and their damping ratios tend to zero with growing frequency. The wedge
    offered here therefore ends at a frequency.

    Args:
        system: A `DelaySystem`, or an object with `to_delay_system()`.
        delay: A number: one delay for all channels. A tuple (low, high): every common delay in the
            interval. A list with one entry per channel, each a number or a tuple: every combination
            of independent delays (equal numbers are taken as one delay) [s].
        decay_rate: Ask for Re s < -decay_rate instead [1/s].
        damping_ratio: Ask for at least this damping ratio [1] ...
        max_frequency_hz: ... of all roots up to this damped frequency [Hz].
        most_tests: Give up after so many tests.
        progress: Called now and then with the place on the contour reached.

    Returns:
        The certificate; `save` it, re-check it with `railenv.stability.verifier`.

    Raises:
        ArgumentError: A bad delay or region.
    """
    start = time.perf_counter()
    loop = as_delay_system(system)
    region = Region(decay_rate, damping_ratio, max_frequency_hz)
    tests = check_count("most_tests", most_tests)
    groups, box = delay_box(loop, delay)
    claim = {
        "kind": "delay box",
        "common": len(groups) == 1,
        "groups": [list(group) for group in groups],
        "low": list(box.low),
        "high": list(box.high),
        "region": region.to_plain(),
    }
    proof = _proved(loop, groups, box, region, tests, progress)
    return Certificate(
        proof.verdict,
        proof.roots,
        proof.reason,
        claim,
        plain_system(loop),
        proof.evidence,
        time.perf_counter() - start,
    )


def _proved(
    loop: DelaySystem,
    groups: list[tuple[int, ...]],
    box: Box,
    region: Region,
    tests: int,
    progress: Callable[[float], None] | None,
) -> Proof:
    if loop.neutral and any(high > 0.0 for high in box.high):
        shared = next((g for g, high in zip(groups, box.high, strict=True) if high > 0.0), ())
        if len(groups) == 1 and difference_part_is_unstable(loop.feedthrough):
            return Proof(
                UNSTABLE,
                None,
                "the loop is neutral and its difference part unstable: infinitely many roots to "
                f"the right of the axis at delay {box.high[0]:.6g} s, and at any other above zero",
                {"method": "neutral", "group": list(shared), "delays": [box.high[0]]},
            )
    try:
        return prove_box(loop, groups, box, region, tests, progress)
    except ArgumentError as error:
        return Proof(UNDECIDED, None, str(error), {})


def delay_box(system: DelaySystem, delay: Any) -> tuple[list[tuple[int, ...]], Box]:
    """Return groups of channels that share a delay, and the box of their delays.

    Args:
        system: The loop.
        delay: See `certify`.

    Raises:
        ArgumentError: A delay is no number, negative or not finite, an interval is reversed, or
            there are more or fewer entries than channels.
    """
    everything = tuple(range(system.num_channels))
    if isinstance(delay, tuple) or np.ndim(delay) == 0:
        low, high = _interval(system, delay)
        return [everything], Box((low,), (high,))
    entries = list(delay)
    if len(entries) == 1:
        return delay_box(system, entries[0])
    if len(entries) != system.num_channels:
        raise ArgumentError(
            f"delay has {len(entries)} entries; give one or {system.num_channels}, one per channel"
        )
    intervals = [_interval(system, entry) for entry in entries]
    groups: list[tuple[int, ...]] = []
    ends: list[tuple[float, float]] = []
    for channel, (low, high) in enumerate(intervals):
        if low == high and (low, high) in ends:
            k = ends.index((low, high))
            groups[k] = (*groups[k], channel)
        else:
            groups.append((channel,))
            ends.append((low, high))
    return groups, Box(tuple(a for a, _ in ends), tuple(b for _, b in ends))


def _interval(system: DelaySystem, entry: Any) -> tuple[float, float]:
    ends: tuple[Any, ...] = (entry, entry)
    if isinstance(entry, tuple | list):
        ends = tuple(cast(Sequence[Any], entry))
    if len(ends) != 2:
        raise ArgumentError(f"delay = {entry!r} is no number and no (low, high) interval")
    low, high = (float(system.delays(end).max(initial=0.0)) for end in ends)
    if low > high:
        raise ArgumentError(f"delay = {entry!r} is reversed; give (low, high) with low <= high")
    return low, high


def plain_system(system: DelaySystem) -> dict[str, Any]:
    """Return a system's numbers as lists."""
    return {
        "kind": "delay system",
        "A": system.A.tolist(),
        "B": system.B.tolist(),
        "K": system.K.tolist(),
        "feedthrough": system.feedthrough.tolist(),
    }
