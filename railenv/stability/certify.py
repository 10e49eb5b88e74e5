"""`certify`: is a linear loop stable for these delays? Answered with a proof or not at all."""

import time
from collections.abc import Callable, Sequence
from typing import Any, cast

from railenv.errors import ArgumentError, check_count, check_not_negative
from railenv.stability import claims as prove
from railenv.stability.certificate import Certificate
from railenv.stability.delay_system import DelaySystem, as_delay_system
from railenv.stability.history_loop import FiniteHistoryLoop
from railenv.stability.proof.contour import Box
from railenv.stability.proof.region import Region
from railenv.stability.sampled_loop import SampledLoop
from railenv.stability.uncertain import UncertainDelaySystem

Delay = float | tuple[float, float] | Sequence[float | tuple[float, float]]


def certify(
    system: Any,
    delay: Delay = 0.0,
    *,
    decay_rate: float = 0.0,
    damping_ratio: float | None = None,
    max_frequency_hz: float | None = None,
    jitter: float = 0.0,
    common_jitter: bool = False,
    control_period: float | None = None,
    told_error: float = 0.0,
    most_tests: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> Certificate:
    """Prove a loop stable or unstable.

    STABLE means that every characteristic root has negative real part (or lies outside the region
    that `decay_rate` or `damping_ratio` describes) at every delay asked for; UNSTABLE that at one
    of them some root does not. All bounds are exact or outward rounded; every double of the system
    is taken as the exact number it is.

    The "damping ratio of at least 5 %" of vehicle dynamics is ill-posed for a delay system: it has
    infinitely many roots, and their damping ratios tend to zero with growing frequency. The wedge
    offered here therefore ends at a frequency.

    Args:
        system: A `DelaySystem`, an object with `to_delay_system()`, an `UncertainDelaySystem` (the
            answer holds for every member), a `SampledLoop` or a `FiniteHistoryLoop` (one common
            delay or interval).
        delay: A number: one delay for all channels. A tuple (low, high): every common delay in the
            interval. A list with one entry per channel, each a number or a tuple: every combination
            of independent delays (equal numbers are taken as one delay) [s].
        decay_rate: Ask for Re s < -decay_rate instead [1/s].
        damping_ratio: Ask for at least this damping ratio [1] ...
        max_frequency_hz: ... of all roots up to this damped frequency [Hz].
        jitter: The delays vary in time, arbitrarily fast, in [delay, delay + jitter] [s].
        common_jitter: Whether all channels share the varying delay.
        control_period: The feedback is sampled and held with this period [s]; the delay then is the
            computational delay between sample and hold.
        told_error: A scheduled sampled controller is told the delay with at most this error [s].
        most_tests: Give up after so many tests (pieces, parts of a box, parts of a family, boxes).
        progress: Called now and then with the share that is done, 0 to 1.

    Returns:
        The certificate; `save` it, re-check it with `railenv.stability.verifier`.

    Raises:
        ArgumentError: A bad argument, or a combination that no proof is known for.
    """
    start = time.perf_counter()
    region = Region(decay_rate, damping_ratio, max_frequency_hz)
    if most_tests is not None:
        check_count("most_tests", most_tests)
    own = UncertainDelaySystem | SampledLoop | FiniteHistoryLoop
    loop = system if isinstance(system, own) else None
    if loop is None:
        loop = as_delay_system(system)
    if control_period is not None:
        if not isinstance(loop, DelaySystem):
            raise ArgumentError(
                "control_period is for a DelaySystem; a sampled loop has its own, and an uncertain "
                "one cannot be sampled"
            )
        loop = SampledLoop.from_delay_system(loop, control_period)
    _refuse_combinations(loop, region, jitter, told_error)
    if isinstance(loop, SampledLoop):
        claim, proof = prove.sampled(loop, delay, told_error, most_tests, progress)
        plain = {"kind": "sampled loop", **loop.to_plain()}
    elif isinstance(loop, FiniteHistoryLoop):
        error = check_not_negative("told_error", told_error, "seconds")
        claim, proof = prove.history(loop, _common(delay), error, most_tests, progress)
        plain = {"kind": "finite history loop", **loop.to_plain()}
    elif isinstance(loop, UncertainDelaySystem):
        groups, box = delay_box(loop.nominal, delay)
        claim, proof = prove.family(loop, groups, box, region, most_tests, progress)
        plain = prove.plain_family(loop)
    elif check_not_negative("jitter", jitter, "seconds") > 0.0:
        _, box = delay_box(loop, delay)
        if not box.is_point:
            raise ArgumentError(
                "jitter is added to one delay per channel, not to an interval; take the interval's "
                "low end as delay and its width plus the jitter as jitter"
            )
        delays = loop.delays(_point(delay))
        claim, proof = prove.jitter(loop, delays, jitter, common_jitter, most_tests)
        plain = prove.plain_system(loop)
    else:
        groups, box = delay_box(loop, delay)
        claim, proof = prove.box(loop, groups, box, region, most_tests, progress)
        plain = prove.plain_system(loop)
    return Certificate(
        proof.verdict,
        proof.roots,
        proof.reason,
        claim,
        plain,
        proof.evidence,
        time.perf_counter() - start,
    )


def _point(delay: Any) -> Any:
    """Return delays without intervals: (d, d) is d."""
    if isinstance(delay, tuple):
        return cast(Sequence[float], delay)[0]
    if _is_single(delay):
        return delay
    return [_point(entry) for entry in delay]


def _refuse_combinations(loop: Any, region: Region, jitter: Any, told_error: Any) -> None:
    plain = region == Region()
    if isinstance(loop, SampledLoop | FiniteHistoryLoop):
        if not plain or jitter:
            varying = "a proved one also stands for delays that vary from sample to sample"
            if isinstance(loop, FiniteHistoryLoop):
                varying = "a loop with a finite history is proved for constant delays"
            raise ArgumentError(
                "decay_rate, damping_ratio and jitter are for continuous feedback; for a sampled "
                f"loop give an interval of delays ({varying})"
            )
        return
    if told_error:
        raise ArgumentError("told_error is for a scheduled sampled controller; give control_period")
    if isinstance(loop, UncertainDelaySystem) and (jitter or region.damping_ratio is not None):
        raise ArgumentError(
            "an uncertain system is proved for constant delays and decay rates only"
        )
    if jitter and not plain:
        raise ArgumentError(
            "jitter is proved for stability alone; drop decay_rate and damping_ratio"
        )


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
    if isinstance(delay, tuple) or _is_single(delay):
        low, high = _interval(system, delay)
        return [everything], Box((low,), (high,))
    if getattr(delay, "ndim", 1) != 1:
        raise ArgumentError(f"delay = {delay!r} is no list with one entry per channel")
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


def _common(delay: Any) -> tuple[float, float]:
    """Return the interval of one common delay."""
    if not (isinstance(delay, tuple) or _is_single(delay)):
        raise ArgumentError(
            f"delay = {delay!r:.60} is a list; a loop with a finite history is proved for one "
            "common delay or one interval (low, high)"
        )
    low, high = cast(tuple[Any, Any], delay if isinstance(delay, tuple) else (delay, delay))
    ends = check_not_negative("delay", low, "seconds"), check_not_negative("delay", high, "seconds")
    if ends[0] > ends[1]:
        raise ArgumentError(f"delay = {delay!r} is reversed; give (low, high) with low <= high")
    return ends


def _one_delay(system: DelaySystem, value: Any) -> float:
    if system.num_channels == 0:
        return check_not_negative("delay", value, "seconds")
    return float(system.delays(value)[0])


def _is_single(delay: Any) -> bool:
    """Whether a delay is no list: a number, or what is refused as one later."""
    return (
        isinstance(delay, str) or getattr(delay, "ndim", None) == 0 or not hasattr(delay, "__len__")
    )


def _interval(system: DelaySystem, entry: Any) -> tuple[float, float]:
    ends: tuple[Any, ...] = (entry, entry)
    if isinstance(entry, tuple | list):
        ends = tuple(cast(Sequence[Any], entry))
    if len(ends) != 2:
        raise ArgumentError(f"delay = {entry!r} is no number and no (low, high) interval")
    if not all(_is_single(end) for end in ends):
        raise ArgumentError(f"delay = {entry!r} is no number and no (low, high) interval")
    low, high = (_one_delay(system, end) for end in ends)
    if low > high:
        raise ArgumentError(f"delay = {entry!r} is reversed; give (low, high) with low <= high")
    return low, high
