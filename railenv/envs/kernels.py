"""The compiled part of the environment around the physics: commands, reward, observation.

Per lane with a fixed order of operations, as the physics (`railenv.simulation.stepping`), so that a
lane is the same in any batch.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from railenv.units import FloatArray

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
Float32Array = NDArray[np.float32]

NOT_ENDED, GAUGE, DIVERGENCE = 0, 1, 2


class RewardConstants(NamedTuple):
    """Numbers of the reward; see `railenv.envs.reward`."""

    comfort_reference: float
    comfort_cap: float
    effort_weight: float
    stroke_weight: float
    stroke_reference: float
    penalty: float
    gauge_limit: float
    acceleration_limit: float
    index_factor: float
    index_exponent: float


class RewardArrays(NamedTuple):
    """What the reward of every lane remembers and says.

    Attributes:
        sections: The ride filter, shape (sections, 6).
        memory: Its state for both floor ends, shape (lanes, 2, sections, 2).
        energy: Sum of the squares of the weighted accelerations, shape (lanes, 2) [m^2/s^4].
        comfort: Comfort term, shape (lanes,).
        effort: Effort term, shape (lanes,).
        stroke: Stroke term, shape (lanes,).
        divergence: Divergence term, shape (lanes,).
        weighted: Weighted acceleration of the last step, shape (lanes,) [m/s^2].
        ride_index: Running ride index at both floor ends, shape (lanes, 2).
        ended: 0, `GAUGE` or `DIVERGENCE`, shape (lanes,).
    """

    sections: FloatArray
    memory: FloatArray
    energy: FloatArray
    comfort: FloatArray
    effort: FloatArray
    stroke: FloatArray
    divergence: FloatArray
    weighted: FloatArray
    ride_index: FloatArray
    ended: IntArray


class ObservationArrays(NamedTuple):
    """What the observation of every lane is made of.

    Rings are doubled, newest first: the window of the newest entries is always in one piece, and
    is copied as such.

    Attributes:
        factor: What a reading is multiplied by, shape (measured,).
        bound: Largest value after that, shape (measured,).
        frames: Past and present measurements, shape (lanes, 2 (history + 1) measured).
        frame: Where the newest frame begins, shape (lanes,).
        actions: Past actions, shape (lanes, 2 length actions); length may be 0.
        action: Where the newest action begins, shape (lanes,).
        told: Told delays as observed, shape (lanes, told columns).
        noise: Noise of the coming measurements in units of the columns, shape (lanes, rows,
            measured); no rows for readings without noise.
        noise_row: Which row is the next measurement's, shape (lanes,).
        lost: Measurements that get lost, shape (lanes,).
        clipped: Whether a reading was cut to its bound, shape (lanes,).
        action_clipped: Whether an action was cut to the box, shape (lanes,).
    """

    factor: FloatArray
    bound: FloatArray
    frames: Float32Array
    frame: IntArray
    actions: Float32Array
    action: IntArray
    told: Float32Array
    noise: FloatArray
    noise_row: IntArray
    lost: BoolArray
    clipped: BoolArray
    action_clipped: BoolArray


@njit(cache=True, nogil=True, error_model="numpy")
def command(
    observation: ObservationArrays,
    effort: FloatArray,
    effort_weight: float,
    active: BoolArray,
    first: int,
    end: int,
    actions: FloatArray,
    scale: float,
    commands: FloatArray,
) -> None:
    """Cut actions to the box, note them, cost their effort and turn them into commands.

    Args:
        observation: Its past actions are extended.
        effort: Effort term of the reward, shape (lanes,); overwritten.
        effort_weight: Cost of every action at one.
        active: Lanes that take part, shape (lanes,).
        first: First lane.
        end: One past the last lane.
        actions: Shape (lanes, actions).
        scale: Force of an action of one [N].
        commands: Shape (lanes, channels) [N]; neighbouring channels share an action where there
            are more channels than actions; overwritten.
    """
    past, newest, action_clipped = (
        observation.actions,
        observation.action,
        observation.action_clipped,
    )
    channels, num = commands.shape[1], actions.shape[1]
    share = channels // num
    length = past.shape[1] // 2
    kept = length > 0
    for lane in range(first, end):
        if not active[lane]:
            continue
        square, cut = 0.0, False
        slot = newest[lane] - num
        if slot < 0:
            slot += length
        if kept:
            newest[lane] = slot
        for a in range(num):
            wanted = actions[lane, a]
            applied = min(max(wanted, -1.0), 1.0)
            cut = cut or applied != wanted
            square += applied * applied
            if kept:
                past[lane, slot + a] = applied
                past[lane, slot + length + a] = applied
            for c in range(a * share, (a + 1) * share):
                commands[lane, c] = scale * applied
        action_clipped[lane] = cut
        effort[lane] = -effort_weight * square / num


@njit(cache=True, nogil=True, error_model="numpy")
def assess(
    constants: RewardConstants,
    arrays: RewardArrays,
    active: BoolArray,
    first: int,
    end: int,
    recorded: FloatArray,
    step: IntArray,
    reward: FloatArray,
) -> None:
    """Cost the last control period of the lanes from `first` to before `end`.

    Args:
        constants: Numbers of the reward.
        arrays: Filters and terms; changed.
        active: Lanes that take part, shape (lanes,).
        first: First lane.
        end: One past the last lane.
        recorded: Floor accelerations (2) [m/s^2], floor displacements (2) and strokes (4) [m] after
            each physics step, shape (lanes, steps, 8).
        step: Physics steps since the start, shape (lanes,).
        reward: Shape (lanes,); overwritten.
    """
    sections, memory, energy = arrays.sections, arrays.memory, arrays.energy
    comfort, effort, stroke = arrays.comfort, arrays.effort, arrays.stroke
    divergence, weighted, ride_index = arrays.divergence, arrays.weighted, arrays.ride_index
    ended_of = arrays.ended
    steps = recorded.shape[1]
    for lane in range(first, end):
        if not active[lane]:
            continue
        ended = NOT_ENDED
        for s in range(steps):
            for e in range(2):
                if not abs(recorded[lane, s, e]) <= constants.acceleration_limit:
                    ended = DIVERGENCE
                if ended == NOT_ENDED and not (
                    abs(recorded[lane, s, 2 + e]) <= constants.gauge_limit
                ):
                    ended = GAUGE
        rms = constants.comfort_cap * constants.comfort_reference
        strokes = constants.stroke_reference**2
        if ended != DIVERGENCE:
            total = 0.0
            for e in range(2):
                squares = 0.0
                for s in range(steps):
                    value = recorded[lane, s, e]
                    for k in range(len(sections)):
                        out = sections[k, 0] * value + memory[lane, e, k, 0]
                        memory[lane, e, k, 0] = (
                            sections[k, 1] * value - sections[k, 4] * out + memory[lane, e, k, 1]
                        )
                        memory[lane, e, k, 1] = sections[k, 2] * value - sections[k, 5] * out
                        value = out
                    squares += value * value
                energy[lane, e] += squares
                mean = energy[lane, e] / step[lane]
                ride_index[lane, e] = constants.index_factor * mean**constants.index_exponent
                total += squares
            rms = np.sqrt(total / (2 * steps))
            strokes = 0.0
            for s in range(steps):
                for j in range(4, 8):
                    strokes += recorded[lane, s, j] ** 2
            strokes /= 4 * steps
        ended_of[lane] = ended
        weighted[lane] = rms
        comfort[lane] = -min(rms / constants.comfort_reference, constants.comfort_cap)
        stroke[lane] = -constants.stroke_weight * min(strokes / constants.stroke_reference**2, 1.0)
        divergence[lane] = -constants.penalty if ended != NOT_ENDED else 0.0
        reward[lane] = comfort[lane] + effort[lane] + stroke[lane] + divergence[lane]


@njit(cache=True, nogil=True, error_model="numpy")
def observe(
    arrays: ObservationArrays,
    active: BoolArray,
    first: int,
    end: int,
    sampled: FloatArray,
    out: Float32Array,
) -> None:
    """Write the observations of the lanes from `first` to before `end`.

    Args:
        arrays: Rings, told delays and noise; the newest measurement is added, a row of noise used.
        active: Lanes that take part, shape (lanes,).
        first: First lane.
        end: One past the last lane.
        sampled: Measured columns now, SI units, and perhaps more, shape (lanes, measured or more).
        out: Observations, shape (lanes, columns); overwritten.
    """
    factor, bound, told, lost, clipped = (
        arrays.factor,
        arrays.bound,
        arrays.told,
        arrays.lost,
        arrays.clipped,
    )
    frames, frame, actions, action = arrays.frames, arrays.frame, arrays.actions, arrays.action
    noise, row = arrays.noise, arrays.noise_row
    noisy = noise.shape[1] > 0
    for lane in range(first, end):
        if not active[lane]:
            continue
        # Unsigned, so that an index cannot be negative: a sign to be checked would keep the copies
        # from being done in one go.
        measured = np.uintp(len(factor))
        depth, length = np.uintp(frames.shape[1] // 2), np.uintp(actions.shape[1] // 2)
        newest = np.uintp(frame[lane])
        at = newest + depth - measured if newest < measured else newest - measured
        frame[lane] = at
        cut = False
        if lost[lane]:
            for j in range(measured):
                frames[lane, at + j] = frames[lane, newest + j]
        else:
            for j in range(measured):
                value = sampled[lane, j] * factor[j]
                if noisy:
                    value += noise[lane, row[lane], j]
                if not abs(value) <= bound[j]:
                    cut = True
                    # Zero stands for what is no number.
                    value = 0.0 if value != value else np.copysign(bound[j], value)
                frames[lane, at + j] = value
        if noisy:
            row[lane] += 1
        for j in range(measured):
            frames[lane, at + depth + j] = frames[lane, at + j]
        clipped[lane] = cut
        for j in range(depth):
            out[lane, j] = frames[lane, at + j]
        begin = np.uintp(action[lane])
        for j in range(length):
            out[lane, depth + j] = actions[lane, begin + j]
        for j in range(np.uintp(told.shape[1])):
            out[lane, depth + length + j] = told[lane, j]


@njit(cache=True, nogil=True, error_model="numpy")
def end_period(
    active: BoolArray,
    first: int,
    end: int,
    ended: IntArray,
    last_period: int,
    periods: IntArray,
    reward: FloatArray,
    terminated: BoolArray,
    truncated: BoolArray,
) -> None:
    """Count the period of the lanes from `first` to before `end` and say whose episode is over.

    Args:
        active: Lanes that take part, shape (lanes,); the others' episodes are not over.
        first: First lane.
        end: One past the last lane.
        ended: 0, `GAUGE` or `DIVERGENCE`, shape (lanes,).
        last_period: Control periods of an episode.
        periods: Control periods since the start, shape (lanes,); changed.
        reward: Shape (lanes,); zero for lanes that take no part.
        terminated: Lanes that left the gauge or diverged, shape (lanes,); overwritten.
        truncated: Lanes that have reached their length, shape (lanes,); overwritten.
    """
    for lane in range(first, end):
        if active[lane]:
            periods[lane] += 1
            terminated[lane] = ended[lane] != NOT_ENDED
            truncated[lane] = periods[lane] >= last_period
        else:
            reward[lane] = 0.0
            terminated[lane] = False
            truncated[lane] = False


@njit(cache=True, nogil=True, error_model="numpy")
def begin_episodes(reward: RewardArrays, arrays: ObservationArrays, which: IntArray) -> None:
    """Forget the past of some lanes.

    Args:
        reward: What the reward remembers; set to zero for these lanes.
        arrays: What the observation remembers; set to zero for these lanes.
        which: Lane numbers, shape (count,).
    """
    frames, actions, lost = arrays.frames, arrays.actions, arrays.lost
    for number in range(len(which)):
        lane = which[number]
        for e in range(2):
            for k in range(len(reward.sections)):
                reward.memory[lane, e, k, 0] = 0.0
                reward.memory[lane, e, k, 1] = 0.0
            reward.energy[lane, e] = 0.0
            reward.ride_index[lane, e] = 0.0
        reward.comfort[lane] = 0.0
        reward.effort[lane] = 0.0
        reward.stroke[lane] = 0.0
        reward.divergence[lane] = 0.0
        reward.weighted[lane] = 0.0
        reward.ended[lane] = NOT_ENDED
        for j in range(frames.shape[1]):
            frames[lane, j] = 0.0
        for j in range(actions.shape[1]):
            actions[lane, j] = 0.0
        lost[lane] = False
        arrays.action_clipped[lane] = False
