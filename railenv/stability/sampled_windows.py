"""Delays at which a sampled loop is stable: every window, and each crossing between them.

A law that knows its delay (a predictor, a delay-augmented LQG) is often unstable without delay and
stable only around the delay that it was designed for, so that the first critical delay says
nothing. Here the eigenvalues z of the lifted one-period map that lie on or outside the unit circle
are counted at many common delays, and every loss and gain of stability between them is located.

With feedthrough from forces to measurements the map jumps at the whole multiples of the period T:
there a measurement begins to see the force one period older (`railenv.stability.sampled_loop`).
Between them it is continuous. Both sides of every multiple are looked at, so that a loss of
stability that happens in a jump is found at its exact place. Since the map is continuous from the
right, a window that begins in a jump contains that delay, and one that ends in a jump does not.

What can be missed: a window, or a gap in one, that lies between two looks. Floating point, counted
by looking: nothing here is proved. `certify` proves one delay, or an interval of them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from railenv.errors import ArgumentError, check_not_negative, check_positive
from railenv.stability.lifted_roots import (
    at_multiple,
    count_outside,
    eigen,
    just_before,
    lifted_mode,
    outward_rates,
)
from railenv.stability.modes import Mode
from railenv.stability.sampled_loop import SampledLoop
from railenv.units import Second

RESOLUTION: Second = 2.5e-3
"""Distance of the looks: a sharp predictor for 0.1 s is stable within a few milliseconds of it."""

# Rows of the largest map that is scanned: its eigenvalues take seconds.
_LARGEST_MAP = 1200


@dataclass(frozen=True, eq=False)
class SampledCrossing:
    """A delay at which stability is lost or regained.

    Attributes:
        delay: Delay at which it happens [s].
        mode: The mode on the unit circle, ln(z) / T with its shape over the plant's states; in a
            jump the fastest growing one of the unstable side.
        direction: +1 if the loop turns unstable as the delay grows, -1 if it turns stable.
        unstable_after: Number of eigenvalues on or outside the unit circle at the next look.
        jump: Whether the map jumps there: the eigenvalue passes the circle and is never on it.
    """

    delay: Second
    mode: Mode
    direction: int
    unstable_after: int
    jump: bool = False

    @property
    def frequency_hz(self) -> float:
        """Frequency of the oscillation, |Im ln z| / (2 pi T) [Hz]."""
        return self.mode.damped_frequency_hz


@dataclass(frozen=True, eq=False)
class SampledWindows:
    """Every stable window that was found and the crossings at their ends; not proved.

    Attributes:
        crossings: By rising delay.
        stable_windows: First and last delay of each window [s]; the first belongs to it, the last
            does not if the map jumps there.
        unstable_without_delay: Number of eigenvalues on or outside the unit circle without delay.
        max_delay: Longest delay searched [s].
        resolution: Largest distance between two looks [s].
        period: Control period T [s].
        looks: Number of delays looked at.
    """

    crossings: tuple[SampledCrossing, ...]
    stable_windows: tuple[tuple[Second, Second], ...]
    unstable_without_delay: int
    max_delay: Second
    resolution: Second
    period: Second
    looks: int

    @property
    def proved(self) -> bool:
        """False: a window between two looks would be missed."""
        return False

    @property
    def first(self) -> SampledCrossing | None:
        """The crossing at which stability is first lost, if the loop is stable without delay."""
        return None if self.unstable_without_delay or not self.crossings else self.crossings[0]

    @property
    def critical_delay(self) -> float | None:
        """First loss of stability from no delay on [s]; 0 if unstable there, None if none found."""
        if self.unstable_without_delay:
            return 0.0
        return None if self.first is None else self.first.delay


def sampled_windows(
    loop: SampledLoop,
    max_delay: float,
    resolution: float = RESOLUTION,
    also: Sequence[float] = (),
    progress: Callable[[float], None] | None = None,
) -> SampledWindows:
    """Look for the common delays at which a sampled loop is stable.

    The looks divide every control period into equal parts no longer than `resolution`. The work
    grows with the cube of states plus delay / period: a law of 190 states and 10 ms takes some ten
    seconds up to 0.6 s.

    Args:
        loop: The loop; a scheduled controller is told the true delay.
        max_delay: Longest common delay to look at [s].
        resolution: Largest distance between two looks [s]; a shorter window can be missed.
        also: Further delays to look at, such as the one a law was designed for [s].
        progress: Called with each delay looked at [s].

    Returns:
        The windows and crossings; not proved, see the module's text for what can be missed.

    Raises:
        ArgumentError: An argument is out of its range, or the delay spans too many periods.
    """
    longest = check_positive("max_delay", max_delay, "seconds")
    step = check_positive("resolution", resolution, "seconds")
    for delay in also:
        if check_not_negative("also", delay, "seconds") > longest:
            raise ArgumentError(
                f"also = {delay:g} s is beyond max_delay = {longest:g} s; give a longer max_delay"
            )
    if loop.num_channels == 0:
        # Nothing is ever delayed: one look serves all.
        longest_looked, extra = 0.0, ()
    else:
        longest_looked, extra = longest, tuple(also)
    _check_size(loop, longest_looked)
    spans = _spans(loop, longest_looked, step, extra)
    crossings: list[SampledCrossing] = []
    at_zero: int | None = None
    before = (0.0, 0)
    for span in spans:
        for place, delay in enumerate(span):
            if progress is not None:
                progress(delay)
            now = count_outside(outward_rates(loop, delay))
            if at_zero is None:
                at_zero = now
            elif (before[1] == 0) != (now == 0):
                # The first look of a stretch stands on the far side of a jump.
                locate = _jump if place == 0 else _crossing
                crossings.append(locate(loop, before[0], delay, (before[1], now)))
            before = (delay, now)
    unstable = at_zero or 0
    edges = [0.0] if unstable == 0 else []
    edges += [crossing.delay for crossing in crossings]
    windows = list(zip(edges[::2], [*edges[1::2], longest], strict=False))
    return SampledWindows(
        tuple(crossings),
        tuple(windows),
        unstable,
        longest,
        step,
        loop.period,
        sum(len(span) for span in spans),
    )


def _check_size(loop: SampledLoop, longest: float) -> None:
    states = loop.num_states + loop.Ac.shape[-1]
    rows = states + loop.num_channels * (longest / loop.period + 2.0)
    if rows > _LARGEST_MAP:
        room = max(0.0, ((_LARGEST_MAP - states) / max(loop.num_channels, 1) - 2.0) * loop.period)
        raise ArgumentError(
            f"max_delay = {longest:g} s is {rows:.0f} states with period = {loop.period:g} s, more "
            f"than {_LARGEST_MAP} to be scanned; give {room:.3g} s or less, or a longer period"
        )


def _spans(
    loop: SampledLoop, longest: float, step: float, also: tuple[float, ...]
) -> list[list[float]]:
    """Return the looks, one rising list for each stretch over which the map is continuous."""
    T = loop.period
    parts = int(np.ceil(T / step - 1e-9))
    periods = int(np.ceil(longest / T - 1e-9))
    edges = [at_multiple(k * T, T) for k in range(periods + 1)]
    inner = [edge + T * j / parts for edge in edges[:-1] for j in range(1, parts)]
    wanted = {at_multiple(delay, T) for delay in also}
    looks = sorted({*edges, *inner, *wanted, at_multiple(longest, T)})
    looks = [look for look in looks if look <= at_multiple(longest, T)]
    if not (np.any(loop.D) and np.any(loop.B)):
        return [looks]
    spans: list[list[float]] = [[]]
    for look in looks:
        if look in edges[1:]:
            spans[-1].append(just_before(look, T))
            spans.append([])
        spans[-1].append(look)
    return spans


def _crossing(
    loop: SampledLoop, low: float, high: float, counts: tuple[int, int]
) -> SampledCrossing:
    """Locate a gain or loss of stability between two looks of one stretch.

    The largest growth rate is continuous there and changes its sign; Brent's method follows it.
    """

    def rate(delay: float) -> float:
        return float(outward_rates(loop, delay)[0])

    delay = float(brentq(rate, low, high, xtol=1e-12 * high))
    return SampledCrossing(
        delay, _rightmost(loop, delay), _direction(counts), counts[1], jump=False
    )


def _jump(
    loop: SampledLoop, before: float, multiple: float, counts: tuple[int, int]
) -> SampledCrossing:
    """Return a gain or loss of stability at a whole multiple of the period."""
    direction = _direction(counts)
    mode = _rightmost(loop, multiple if direction > 0 else before)
    return SampledCrossing(multiple, mode, direction, counts[1], jump=True)


def _direction(counts: tuple[int, int]) -> int:
    return 1 if counts[1] > counts[0] else -1


def _rightmost(loop: SampledLoop, delay: float) -> Mode:
    z, vectors = eigen(loop, delay)
    k = int(np.argmax(np.abs(z)))
    return lifted_mode(loop, z[k], vectors[:, k])
