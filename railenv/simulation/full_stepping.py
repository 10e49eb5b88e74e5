"""The compiled physics loop of the nonlinear vehicle: rails, Runge-Kutta steps, late commands.

One physics step is one step of the classical Runge-Kutta method of fourth order. Where a command
takes over inside a step, the step is cut there, so that no delay is rounded and the force is
constant over every part. Rails are sampled at the beginning, the middle and the end of a part.

Every lane is computed on its own, as in the linear model (`railenv.simulation.stepping`). A lane
whose vehicle derails or whose numbers leave all bounds stops where it is and says so.
"""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from railenv.actuation.delay_line import QueueArrays
from railenv.contact import creep_laws, creep_table, fastsim, table
from railenv.contact.creep_table import CreepTable
from railenv.contact.table import ContactArrays
from railenv.simulation.excitation import Places
from railenv.track.table import TrackArrays
from railenv.units import FloatArray
from railenv.vehicle.nonlinear import curve
from railenv.vehicle.nonlinear import rates as equations
from railenv.vehicle.nonlinear.coordinates import FIRST_WHEELSET, NUM_COORDINATES
from railenv.vehicle.nonlinear.curve import CurveArrays, curve_frame
from railenv.vehicle.nonlinear.rates import WHEEL_COLUMNS, FrameArrays, FullArrays, rates

IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

RUNNING, DERAILED, DIVERGED = 0, 1, 2

DERAILMENT_SHIFT = 0.025
"""Shift of a wheelset on a rail beyond which it counts as derailed [m]: a flange that touches at
some 6 mm has its tip on the rail's top by then."""

DERAILMENT_LIFT = 0.028
"""Height of both wheels of a wheelset above the rails beyond which it has derailed [m]: a
flange."""

_LARGEST = 1e3  # of any state; a carbody that is a kilometre away has no physics left


class FullLanes(NamedTuple):
    """What every lane carries from one call to the next.

    Attributes:
        vehicle: Number of its vehicle, shape (lanes,).
        state: Shape (lanes, n).
        step: Physics steps since its start, shape (lanes,).
        force: Command in effect, shape (lanes, m) [N].
        ended: `RUNNING`, `DERAILED` or `DIVERGED`, shape (lanes,).
        wheels: What is told of every wheel, its forces averaged over the last control period, shape
            (lanes, 8, 5); see `railenv.vehicle.nonlinear.rates.WHEEL_COLUMNS`.
    """

    vehicle: IntArray
    state: FloatArray
    step: IntArray
    force: FloatArray
    ended: IntArray
    wheels: FloatArray


class OutputRows(NamedTuple):
    """Outputs as sparse rows on (q, v, a, forces, rails), for every vehicle.

    Attributes:
        start: Where each row begins, shape (outputs + 1,).
        column: Shape (entries,).
        value: Shape (vehicles, entries).
        recorded: Leading outputs that are recorded inside a control period.
        every: Physics steps between two records.
        time_step: Physics step [s].
    """

    start: IntArray
    column: IntArray
    value: FloatArray
    recorded: int
    every: int
    time_step: float


class RunningGear(NamedTuple):
    """Where the wheelsets of every vehicle are.

    Attributes:
        speed: Shape (vehicles,) [m/s].
        setback: Distance of wheelsets 1 to 4 behind the first, shape (vehicles, 4) [m].
    """

    speed: FloatArray
    setback: FloatArray


@njit(cache=True, nogil=True, error_model="numpy")
def sample_rails(
    tracks: TrackArrays,
    places: Places,
    gear: RunningGear,
    lane: int,
    vehicle: int,
    lead: float,
    rails: FloatArray,
) -> None:
    """Write places and rates of the rails under the wheels of one lane.

    Args:
        tracks: Weights of alignment, cross level, vertical and gauge.
        places: Where the lanes run.
        gear: Speeds and wheelsets.
        lane: Lane number.
        vehicle: Its vehicle.
        lead: Distance of the leading wheelset from its start [m].
        rails: Shape (8, 4) [m, m/s]: right positive, down positive; overwritten.
    """
    weights, setback = tracks.weights, gear.setback
    speed, track = gear.speed[vehicle], places.track[lane]
    begin, intervals = tracks.first[track], tracks.intervals[track]
    per_metre, taper = tracks.per_metre[track], places.taper[lane]
    for w in range(4):
        travelled = lead - setback[vehicle, w]
        place = (places.start[lane] + travelled) * per_metre
        before = place < 0.0 and not tracks.periodic[track]
        if travelled < 0.0 and (not places.running[lane] or before):
            for j in range(4):
                rails[2 * w, j] = 0.0
                rails[2 * w + 1, j] = 0.0
            continue
        share, growth = places.amplitude[lane], 0.0
        if 0.0 <= travelled < taper:
            angle = np.pi * travelled / taper
            growth = 0.5 * share * np.sin(angle) * np.pi / taper
            share *= 0.5 - 0.5 * np.cos(angle)
        whole = int(np.floor(place))
        t = place - whole
        if whole >= intervals or whole < 0:
            whole %= intervals
        s, k = 1.0 - t, begin + whole
        # Cubic B-splines and their slopes.
        b0, b3 = s * s * s / 6.0, t * t * t / 6.0
        b1, b2 = (2.0 / 3.0) - t * t + 3.0 * b3, (2.0 / 3.0) - s * s + 3.0 * b0
        d0, d3 = -0.5 * s * s * per_metre, 0.5 * t * t * per_metre
        d1, d2 = -2.0 * t * per_metre + 3.0 * d3, 2.0 * s * per_metre + 3.0 * d0
        for half in range(2):
            # Columns 0 and 3: alignment, gauge. Columns 2 and 1: vertical, cross level.
            first, second = (0, 3) if half == 0 else (2, 1)
            one = (
                b0 * weights[k, first]
                + b1 * weights[k + 1, first]
                + b2 * weights[k + 2, first]
                + b3 * weights[k + 3, first]
            )
            one_slope = (
                d0 * weights[k, first]
                + d1 * weights[k + 1, first]
                + d2 * weights[k + 2, first]
                + d3 * weights[k + 3, first]
            )
            two = (
                b0 * weights[k, second]
                + b1 * weights[k + 1, second]
                + b2 * weights[k + 2, second]
                + b3 * weights[k + 3, second]
            )
            two_slope = (
                d0 * weights[k, second]
                + d1 * weights[k + 1, second]
                + d2 * weights[k + 2, second]
                + d3 * weights[k + 3, second]
            )
            if half == 1:
                one, one_slope = -one, -one_slope  # a height is up, the axis down
            one_rate = speed * (share * one_slope + growth * one)
            two_rate = 0.5 * speed * (share * two_slope + growth * two)
            one, two = share * one, 0.5 * share * two
            rails[2 * w, half] = one - two
            rails[2 * w + 1, half] = one + two
            rails[2 * w, 2 + half] = one_rate - two_rate
            rails[2 * w + 1, 2 + half] = one_rate + two_rate


def _compiled(sources: str) -> Callable[..., None]:
    @njit(cache=True, nogil=True, error_model="numpy")
    def advance_full(
        vehicles: FullArrays,
        contact: ContactArrays,
        creep: CreepTable,
        gear: RunningGear,
        curves: CurveArrays,
        lanes: FullLanes,
        queue: QueueArrays,
        tracks: TrackArrays,
        places: Places,
        rows: OutputRows,
        active: BoolArray,
        steps: int,
        first: int,
        end: int,
        recorded: FloatArray,
        sampled: FloatArray,
    ) -> None:
        len(sources)  # makes it a part of this function
        n, m = lanes.state.shape[1], lanes.force.shape[1]
        h = rows.time_step
        slots = queue.arrival_step.shape[1]
        K = np.empty((4, n))
        trial, state, before, force = np.empty(n), np.empty(n), np.empty(n), np.empty(m)
        rails = np.empty((3, 8, 4))
        wheels, unused = np.empty((8, len(WHEEL_COLUMNS))), np.empty((8, len(WHEEL_COLUMNS)))
        bends = NUM_COORDINATES if len(curves.place) > 0 else 0
        frame = FrameArrays(np.zeros(bends), np.zeros(bends), np.zeros(bends), np.zeros(4))
        vector = np.empty(3 * NUM_COORDINATES + m + 16)
        for lane in range(first, end):
            if not active[lane] or lanes.ended[lane] != RUNNING:
                continue
            car = lanes.vehicle[lane]
            speed = float(gear.speed[car])
            own = FullArrays(
                vehicles.mass[car],
                vehicles.load[car],
                vehicles.start,
                vehicles.column,
                vehicles.stiffness[car],
                vehicles.damping[car],
                vehicles.row_start,
                vehicles.row_column,
                vehicles.row_value[car],
                vehicles.damper[car],
                vehicles.stop[car],
                vehicles.counts,
                vehicles.scalars[car],
                vehicles.law,
            )
            for i in range(n):
                state[i] = lanes.state[lane, i]
            for c in range(m):
                force[c] = lanes.force[lane, c]
            for w in range(8):
                for j in range(4):
                    lanes.wheels[lane, w, j] = 0.0
            motions = n - m if own.scalars[6] > 0.0 else n
            step = lanes.step[lane]
            sample_rails(tracks, places, gear, lane, car, speed * h * step, rails[2])
            fresh = False
            for substep in range(steps):
                step = lanes.step[lane] + substep
                done = 0.0
                for i in range(n):
                    before[i] = state[i]
                while done < h:
                    # Commands that take over now, then the next that does inside this step.
                    until = h
                    for c in range(m):
                        while queue.waiting[lane, c] > 0:
                            slot = queue.head[lane, c]
                            if queue.arrival_step[lane, slot, c] > step:
                                break
                            rest = queue.arrival_rest[lane, slot, c]
                            if rest > done:
                                until = min(until, rest)
                                break
                            force[c] = queue.arrival_force[lane, slot, c]
                            fresh = False
                            queue.head[lane, c] = slot + 1 if slot + 1 < slots else 0
                            queue.waiting[lane, c] -= 1
                    part = until - done
                    begin = speed * (h * step + done)
                    for w in range(8):
                        for j in range(4):
                            rails[0, w, j] = rails[2, w, j]
                    sample_rails(
                        tracks, places, gear, lane, car, begin + 0.5 * speed * part, rails[1]
                    )
                    sample_rails(tracks, places, gear, lane, car, begin + speed * part, rails[2])
                    for stage in range(4):
                        at = (stage + 1) // 2
                        if stage == 0:
                            if fresh:
                                continue
                            if bends > 0:
                                curve_frame(curves, begin, speed, gear.setback[car], frame)
                            rates(own, contact, creep, state, rails[0], force, frame, K[0], unused)
                            continue
                        ahead = part if stage == 3 else 0.5 * part
                        for i in range(n):
                            trial[i] = state[i] + ahead * K[stage - 1, i]
                        if bends > 0:
                            curve_frame(
                                curves, begin + speed * ahead, speed, gear.setback[car], frame
                            )
                        rates(own, contact, creep, trial, rails[at], force, frame, K[stage], unused)
                    for i in range(n):
                        state[i] += part / 6.0 * (K[0, i] + 2.0 * (K[1, i] + K[2, i]) + K[3, i])
                    done = until
                    if bends > 0:
                        curve_frame(curves, begin + speed * part, speed, gear.setback[car], frame)
                    # What is the case at the end; the next part begins with it.
                    rates(own, contact, creep, state, rails[2], force, frame, K[0], wheels)
                    fresh = True
                ended = RUNNING
                for i in range(n):
                    # Behind a lag the last states are forces.
                    limit = np.inf if i >= motions or _turns(i) else _LARGEST
                    if not abs(state[i]) < limit:
                        ended = DIVERGED
                if ended == DIVERGED:
                    # The last state with a meaning stays, and what is told belongs to it.
                    for i in range(n):
                        state[i] = before[i]
                    rates(own, contact, creep, state, rails[2], force, frame, K[0], wheels)
                for i in range(4):
                    above = 0.0
                    for side in range(2):
                        w = 2 * i + side
                        if abs(wheels[w, 4]) > DERAILMENT_SHIFT and ended == RUNNING:
                            ended = DERAILED
                        lift = rails[2, w, 1] - state[FIRST_WHEELSET + 6 * i + 2]
                        above += 1.0 if lift > DERAILMENT_LIFT else 0.0
                    if above == 2.0 and ended == RUNNING:
                        ended = DERAILED
                lanes.ended[lane] = ended
                for w in range(8):
                    for j in range(4):
                        mean = lanes.wheels[lane, w, j] * substep + wheels[w, j]
                        lanes.wheels[lane, w, j] = mean / (substep + 1)
                    lanes.wheels[lane, w, 4] = wheels[w, 4]
                last = substep + 1 == steps
                if (substep + 1) % rows.every == 0 or last or ended != RUNNING:
                    for i in range(NUM_COORDINATES):
                        vector[i] = state[i]
                        vector[NUM_COORDINATES + i] = state[NUM_COORDINATES + i]
                        vector[2 * NUM_COORDINATES + i] = K[0, NUM_COORDINATES + i]
                    for c in range(m):
                        lagged = own.scalars[6] > 0.0
                        vector[3 * NUM_COORDINATES + c] = state[n - m + c] if lagged else force[c]
                    for w in range(8):
                        vector[3 * NUM_COORDINATES + m + w] = rails[2, w, 0]
                        vector[3 * NUM_COORDINATES + m + 8 + w] = rails[2, w, 1]
                    row = substep // rows.every
                    for o in range(len(rows.start) - 1):
                        if o >= rows.recorded and not last and ended == RUNNING:
                            break
                        total = 0.0
                        for k in range(rows.start[o], rows.start[o + 1]):
                            total += rows.value[car, k] * vector[rows.column[k]]
                        if o < rows.recorded:
                            for r in range(row, recorded.shape[1] if ended != RUNNING else row + 1):
                                recorded[lane, r, o] = total
                        else:
                            sampled[lane, o - rows.recorded] = total
                if ended != RUNNING:
                    break
            lanes.step[lane] += steps
            for i in range(n):
                lanes.state[lane, i] = state[i]
            for c in range(m):
                lanes.force[lane, c] = force[c]

    return advance_full


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _turns(i: int) -> bool:
    """Whether a state is a wheelset's angle of rotation, which may grow without end."""
    place = i - FIRST_WHEELSET
    return 0 <= place < 24 and place % 6 == 4


def _digest() -> str:
    parts = (creep_laws, creep_table, fastsim, table, equations, curve)
    texts = [Path(str(part.__file__)).read_bytes() for part in parts]
    return hashlib.sha256(b"".join(texts)).hexdigest()


advance_full = _compiled(_digest())
"""Advance lanes from `first` to before `end` by one control period of `steps` physics steps.

Args:
    vehicles: Vehicles side by side: every array that differs between them has them first.
    contact: Wheel on rail.
    creep: Table of creep forces.
    gear: Speeds and wheelsets by vehicle.
    curves: The line's curves; without points for straight track.
    lanes: States; changed.
    queue: Commands on their way; changed.
    tracks: Irregularity.
    places: Where the lanes run.
    rows: Outputs.
    active: Lanes that take part, shape (lanes,).
    steps: Physics steps.
    first: First lane.
    end: One past the last lane.
    recorded: Recorded outputs, shape (lanes, steps / every, recorded); overwritten. A lane that
        ends inside the period fills the rest with its last values.
    sampled: The other outputs at the end, shape (lanes, others); overwritten.
"""
