"""When an oscillation has come to a stand: amplitudes block by block, lane by lane.

The amplitude is half of peak to peak of an output over a block of time. Motion has settled when it
no longer drifts from block to block, or when it is so small that it counts as rest. A chaotic
motion does neither and is reported as not settled.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from railenv.errors import check_count, check_positive
from railenv.units import Dimensionless, FloatArray, Second

Advance = Callable[[FloatArray, FloatArray, FloatArray, int], tuple[FloatArray, FloatArray]]


@dataclass(frozen=True, kw_only=True)
class Settling:
    """How long to wait for a limit cycle, and what counts as one.

    Attributes:
        rest: Amplitude up to which the system counts as at rest, in units of the output.
        block: Length of a block; at least two periods of the slowest hunting expected.
        samples: Outputs in a block. With m of them in a period the amplitude is too small by up to
            (pi / m)^2 / 2 of itself.
        drift: Largest relative change of amplitude from one block to the next of a settled motion.
        least_blocks: Blocks to run in any case; the last three are compared.
        most_blocks: Blocks after which waiting ends.

    Raises:
        ArgumentError: A value is not above zero, or the most blocks are fewer than the least.
    """

    rest: Dimensionless = 1e-4
    block: Second = 2.0
    samples: int = 1000
    drift: Dimensionless = 1e-3
    least_blocks: int = 3
    most_blocks: int = 60

    def __post_init__(self) -> None:
        for name in ("rest", "block", "drift"):
            object.__setattr__(self, name, check_positive(name, getattr(self, name)))
        check_count("samples", self.samples, 10)
        check_count("least_blocks", self.least_blocks, 3)
        check_count("most_blocks", self.most_blocks, self.least_blocks)


@dataclass(frozen=True, eq=False)
class Settled:
    """Where lanes stood when waiting ended.

    Attributes:
        states: Shape (lanes, n).
        amplitudes: Of the last block, shape (lanes,).
        frequencies: Upward passages of the mean in the last block by the time between the first
            and the last, 0 at rest and with fewer than two, shape (lanes,) [Hz].
        settled: Whether the motion had come to a stand, shape (lanes,).
        hunting: Whether the amplitude is above the bound for rest, shape (lanes,).
    """

    states: FloatArray
    amplitudes: FloatArray
    frequencies: FloatArray
    settled: NDArray[np.bool_]
    hunting: NDArray[np.bool_]


def settle(advance: Advance, states: FloatArray, speeds: FloatArray, settling: Settling) -> Settled:
    """Run lanes at constant speeds until each has settled or waiting ends.

    A lane that has settled is not moved on, so that its result does not depend on the others.

    Args:
        advance: Moves lanes on, as `HuntingSystem.advance`.
        states: Where lanes begin, shape (lanes, n).
        speeds: Shape (lanes,) [m/s].
        settling: What counts as settled.

    Returns:
        The lanes' last states and amplitudes. A lane whose state is no longer finite has an
        infinite amplitude and counts as hunting and not settled.
    """
    lanes = len(states)
    states = states.copy()
    history = np.full((lanes, settling.most_blocks), np.nan)
    frequencies, settled = np.zeros(lanes), np.zeros(lanes, dtype=np.bool_)
    amplitudes = np.zeros(lanes)
    running = np.arange(lanes)
    for block in range(settling.most_blocks):
        moved, outputs = advance(
            states[running],
            speeds[running],
            np.full(len(running), settling.block),
            settling.samples,
        )
        states[running] = moved
        keep = np.ones(len(running), dtype=np.bool_)
        for place, lane in enumerate(running):
            output = outputs[place]
            if not (np.all(np.isfinite(output)) and np.all(np.isfinite(moved[place]))):
                amplitudes[lane], frequencies[lane], keep[place] = np.inf, 0.0, False
                continue
            amplitude = 0.5 * float(output.max() - output.min())
            amplitudes[lane] = history[lane, block] = amplitude
            frequencies[lane] = _frequency(output, settling.block / settling.samples)
            if block + 1 < settling.least_blocks:
                continue
            recent = history[lane, block - 2 : block + 1]
            at_rest = bool(np.all(recent <= settling.rest)) and recent[2] <= recent[1]
            # Fewer than two periods in a block say nothing about a steady oscillation.
            steady = recent.max() - recent.min() <= settling.drift * recent.max()
            settled[lane] = at_rest or (
                bool(steady) and amplitude > settling.rest and frequencies[lane] > 0.0
            )
            keep[place] = not settled[lane]
        running = running[keep]
        if not len(running):
            break
    hunting = amplitudes > settling.rest
    frequencies[~hunting] = 0.0
    return Settled(states, amplitudes, frequencies, settled, hunting)


def _frequency(output: FloatArray, interval: float) -> float:
    """Frequency of upward passages of the mean, passages placed by linear interpolation [Hz]."""
    shifted = output - 0.5 * (output.max() + output.min())
    ups = np.flatnonzero((shifted[:-1] < 0.0) & (shifted[1:] >= 0.0))
    if len(ups) < 3:
        return 0.0
    places = ups + shifted[ups] / (shifted[ups] - shifted[ups + 1])
    return (len(ups) - 1) / (float(places[-1] - places[0]) * interval)
