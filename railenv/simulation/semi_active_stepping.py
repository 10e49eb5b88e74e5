"""The compiled step of linear vehicles on semi-active dampers, lane by lane.

Strang splitting: over an inner step of length h the vehicle moves on its own, exactly, under the
track's ramp (its modal blocks, as in `railenv.simulation.stepping`); in the halves of the step
before and after it the dampers alone act on the velocities. Theirs is a flow of the stroke rates v,

    v' = -S diag(c(t)) v,   S = H M^-1 H^T,

stepped by the implicit midpoint rule with the exact integral a of c over the interval, switches and
response included, in whatever instant they fall:

    v_mid = v - S diag(a) v_mid / 2,   impulse = -a v_mid.

The energy taken out is v_mid . a v_mid >= 0 for any c and h. The error falls with h^2. Blow-off
lowers a channel's a until its impulse is the limit's.

Every lane has a fixed order of operations; nothing is shared among lanes. Arrays are indexed in
full through names taken before, and functions that call each other stand in one file, for the
reasons given in the linear vehicle's stepping. There are always four channels here; those that a
layout lacks do nothing.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from railenv.actuation.delay_line import IntArray, QueueArrays
from railenv.simulation.stepping import LaneArrays, PlantArrays
from railenv.units import FloatArray

CHANNELS = 4
"""Channels that are stepped, whether the layout has them or not."""
# Passes that look for the channels that blow off; each takes energy out, whichever is the last.
_MOST_PASSES = 50
# A pass that changes nothing by more than this is the last one.
_SETTLED = 1e-13


class DamperArrays(NamedTuple):
    """The m dampers of a vehicle with n modes and k track inputs, filled up with zeros to four.

    Attributes:
        rate: Stroke rates from (z, w), transposed, shape (n + k, 4) [m/s].
        push: Change of the modes by an impulse, transposed, shape (4, n) [1/(N s)].
        mobility: S, shape (4, 4) [1/kg].
        coefficient: c of every lane, shape (lanes, m) [N s/m].
        command: Command in effect, shape (lanes, m) [N s/m].
        source: Column of each record: of the plant's outputs or, beyond them, of c, shape (p,).
        response_time: T_r [s].
        force_limit: Force at which a damper blows off [N]; infinite for never.
        inner_steps: Steps of the splitting in one record.
    """

    rate: FloatArray
    push: FloatArray
    mobility: FloatArray
    coefficient: FloatArray
    command: FloatArray
    source: IntArray
    response_time: float
    force_limit: float
    inner_steps: int


@njit(cache=True, nogil=True, error_model="numpy")
def _followed(duration: float, response_time: float) -> float:
    """Return the share of the way to its command that a coefficient goes in a time."""
    return 1.0 if response_time == 0.0 else -np.expm1(-duration / response_time)


@njit(cache=True, nogil=True, error_model="numpy")
def _record(
    plant: PlantArrays, dampers: DamperArrays, lane: int, v: FloatArray, y: FloatArray
) -> None:
    """Work out the plant's outputs of a lane.

    Args:
        plant: Its last m outputs are the stroke rates.
        dampers: The dampers.
        lane: Which lane.
        v: Modes, track input and room for the forces (z, w, F); the forces are overwritten.
        y: The outputs; overwritten.
    """
    rows, coefficient, limit = plant.record, dampers.coefficient, dampers.force_limit
    width, m, first = rows.shape[2], coefficient.shape[1], dampers.rate.shape[0]
    for i in range(width):
        y[i] = 0.0
    for j in range(first):
        for i in range(width):
            y[i] += rows[0, j, i] * v[j]
    # From the very rates that are recorded, so that F s' <= 0 holds to the last bit.
    for c in range(m):
        v[first + c] = min(max(-coefficient[lane, c] * y[width - m + c], -limit), limit)
    for c in range(m):
        for i in range(width):
            y[i] += rows[0, first + c, i] * v[first + c]


@njit(cache=True, nogil=True, error_model="numpy")
def begin_dampers(
    plant: PlantArrays, dampers: DamperArrays, lanes: LaneArrays, sampled: FloatArray
) -> None:
    """Write the outputs of every lane as it stands, before anything has moved.

    Args:
        plant: Matrices of the one vehicle.
        dampers: The dampers.
        lanes: States; the track input now is `track[:, -1]`.
        sampled: Shape (lanes, p); overwritten.
    """
    n, k, width = lanes.state.shape[1], lanes.track.shape[2], plant.record.shape[2]
    v, y = np.zeros(plant.record.shape[1]), np.zeros(width)
    for lane in range(len(sampled)):
        for i in range(n):
            v[i] = lanes.state[lane, i]
        for j in range(k):
            v[n + j] = lanes.track[lane, -1, j]
        _record(plant, dampers, lane, v, y)
        for i in range(sampled.shape[1]):
            column = dampers.source[i]
            if column < width:
                sampled[lane, i] = y[column]
            else:
                sampled[lane, i] = dampers.coefficient[lane, column - width]


@njit(cache=True, nogil=True, error_model="numpy")
def advance_dampers(
    plant: PlantArrays,
    dampers: DamperArrays,
    lanes: LaneArrays,
    queue: QueueArrays,
    first: int,
    end: int,
    recorded: FloatArray,
) -> None:
    """Advance lanes by one control period, in place.

    Args:
        plant: Matrices of the one vehicle over an inner step.
        dampers: Coefficients and commands in effect; changed.
        lanes: States and inner steps; changed. The track is linear between its rows.
        queue: Commanded coefficients on their way, by inner steps; changed.
        first: First lane.
        end: One past the last lane.
        recorded: Outputs at the end of each record step, just before any switch that falls on that
            instant, shape (lanes, steps, p); overwritten.
    """
    pairs, full, input_rows, h = plant.pairs, plant.full, plant.inputs, plant.time_step
    rate_rows, push, mobility = dampers.rate, dampers.push, dampers.mobility
    coefficient, command, source = dampers.coefficient, dampers.command, dampers.source
    response_time, force_limit = dampers.response_time, dampers.force_limit
    count = dampers.inner_steps
    state, track, step_of = lanes.state, lanes.track, lanes.step
    arrival_step, waiting, head, arrival_rest, arrival_command = (
        queue.arrival_step,
        queue.waiting,
        queue.head,
        queue.arrival_rest,
        queue.arrival_force,
    )
    n, k, m = state.shape[1], track.shape[2], coefficient.shape[1]
    steps, slots, width = track.shape[1] - 1, arrival_step.shape[1], plant.record.shape[2]
    half, whole = n // 2, len(full) > 0
    half_step, half_followed = 0.5 * h, _followed(0.5 * h, response_time)
    v, new = np.zeros(plant.record.shape[1]), np.empty(n)
    pulled, pull_change = np.empty(n), np.empty(n)
    y = np.zeros(width)
    area, used, wanted = np.zeros(CHANNELS), np.zeros(CHANNELS), np.zeros(CHANNELS)
    rate, rate_change, middle = np.zeros(CHANNELS), np.zeros(CHANNELS), np.zeros(CHANNELS)
    work = np.empty((CHANNELS, CHANNELS))
    for lane in range(first, end):
        for i in range(n):
            v[i] = state[lane, i]
        for substep in range(steps):
            # The track's part in modes and stroke rates, and its change in an inner step.
            for i in range(n):
                pulled[i] = 0.0
                pull_change[i] = 0.0
            for c in range(CHANNELS):
                wanted[c] = 0.0
                rate_change[c] = 0.0
            for j in range(k):
                w = track[lane, substep, j]
                change = (track[lane, substep + 1, j] - w) / count
                for i in range(n):
                    pulled[i] += input_rows[0, j, i] * w
                    pull_change[i] += input_rows[0, j, i] * change
                for c in range(CHANNELS):
                    wanted[c] += rate_rows[n + j, c] * w
                    rate_change[c] += rate_rows[n + j, c] * change
            from_track_0, from_track_1 = wanted[0], wanted[1]
            from_track_2, from_track_3 = wanted[2], wanted[3]
            for inner in range(count + 1):
                # The dampers act from the middle of the last inner step to that of the next.
                duration = 0.0
                for c in range(CHANNELS):
                    area[c] = 0.0
                for part in range(0 if inner > 0 else 1, 2 if inner < count else 1):
                    step = step_of[lane] + inner - 1 + part
                    begin = half_step if part == 0 else 0.0
                    until = begin + half_step
                    duration += half_step
                    for c in range(m):
                        now = begin
                        value, target = coefficient[lane, c], command[lane, c]
                        while waiting[lane, c] > 0:
                            slot = head[lane, c]
                            due, rest = arrival_step[lane, slot, c], arrival_rest[lane, slot, c]
                            # One that arrives at the end is left to what begins there.
                            if due > step or (due == step and rest >= until):
                                break
                            gap = target - value
                            share = _followed(rest - now, response_time)
                            area[c] += target * (rest - now) - gap * response_time * share
                            value = target - gap * (1.0 - share)
                            now, target = rest, arrival_command[lane, slot, c]
                            head[lane, c] = slot + 1 if slot + 1 < slots else 0
                            waiting[lane, c] -= 1
                        gap, share = target - value, half_followed
                        if now > begin:
                            share = _followed(until - now, response_time)
                        area[c] += target * (until - now) - gap * response_time * share
                        # In this form a damper without response time has its command exactly.
                        coefficient[lane, c] = target - gap * (1.0 - share)
                        command[lane, c] = target
                r0 = from_track_0 + inner * rate_change[0]
                r1 = from_track_1 + inner * rate_change[1]
                r2 = from_track_2 + inner * rate_change[2]
                r3 = from_track_3 + inner * rate_change[3]
                for j in range(n):
                    r0 += rate_rows[j, 0] * v[j]
                    r1 += rate_rows[j, 1] * v[j]
                    r2 += rate_rows[j, 2] * v[j]
                    r3 += rate_rows[j, 3] * v[j]
                rate[0], rate[1], rate[2], rate[3] = r0, r1, r2, r3
                reach = force_limit * duration
                for c in range(CHANNELS):
                    used[c] = area[c]
                for attempt in range(_MOST_PASSES):
                    # (1 + S diag(used) / 2) middle = rate; every leading minor is at least one.
                    for i in range(CHANNELS):
                        middle[i] = rate[i]
                        for j in range(CHANNELS):
                            work[i, j] = 0.5 * mobility[i, j] * used[j]
                        work[i, i] += 1.0
                    for j in range(CHANNELS):
                        for i in range(j + 1, CHANNELS):
                            factor = work[i, j] / work[j, j]
                            for column in range(j + 1, CHANNELS):
                                work[i, column] -= factor * work[j, column]
                            middle[i] -= factor * middle[j]
                    for i in range(CHANNELS - 1, -1, -1):
                        for j in range(i + 1, CHANNELS):
                            middle[i] -= work[i, j] * middle[j]
                        middle[i] /= work[i, i]
                    settled = True
                    for c in range(CHANNELS):
                        size = np.abs(middle[c])
                        wanted[c] = reach / size if area[c] * size > reach else area[c]
                        if np.abs(wanted[c] - used[c]) > _SETTLED * area[c]:
                            settled = False
                    # The impulse belongs to what the last pass has used, or it could put energy in.
                    if settled or attempt == _MOST_PASSES - 1:
                        break
                    for c in range(CHANNELS):
                        used[c] = wanted[c]
                r0, r1 = used[0] * middle[0], used[1] * middle[1]
                r2, r3 = used[2] * middle[2], used[3] * middle[3]
                for i in range(n):
                    v[i] -= push[0, i] * r0 + push[1, i] * r1 + push[2, i] * r2 + push[3, i] * r3
                if inner == count:
                    break
                if whole:
                    for i in range(n):
                        total = 0.0
                        for j in range(n):
                            total += full[0, i, j] * v[j]
                        new[i] = total
                else:
                    for i in range(half):
                        here, there = v[i], v[half + i]
                        new[i] = pairs[0, 0, i] * here + pairs[0, 1, i] * there
                        new[half + i] = pairs[0, 2, i] * here + pairs[0, 3, i] * there
                for i in range(n):
                    v[i] = new[i] + pulled[i] + inner * pull_change[i]
            step_of[lane] += count
            for j in range(k):
                v[n + j] = track[lane, substep + 1, j]
            _record(plant, dampers, lane, v, y)
            for i in range(recorded.shape[2]):
                column = source[i]
                if column < width:
                    recorded[lane, substep, i] = y[column]
                else:
                    recorded[lane, substep, i] = coefficient[lane, column - width]
        for i in range(n):
            state[lane, i] = v[i]
