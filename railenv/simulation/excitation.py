"""What the wheelsets see of a track: its irregularity at their own places, in time.

Wheelset i sees the track delayed by its distance behind the leading one over the speed. Cross level
[m] becomes the roll of the track plane, over the spacing of the rolling circles.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from railenv.errors import check_count, check_positive
from railenv.track import Track
from railenv.track.table import TrackArrays
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle
from railenv.vehicle.suspension import NUM_TRACK


def required_length(vehicle: LateralVehicle, duration: float) -> float:
    """Return how much track a run needs [m]; the leading wheelset starts at distance 0."""
    return vehicle.speed * check_positive("duration", duration, "seconds")


def wheelset_inputs(
    vehicle: LateralVehicle, track: Track, time_step: float, num_steps: int
) -> FloatArray:
    """Sample a track at the four wheelsets.

    Args:
        vehicle: Gives speed, wheelset places and contact spacing.
        track: The irregularity; straight and level before distance 0.
        time_step: Physics step [s].
        num_steps: Number of physics steps.

    Returns:
        Alignment at wheelsets 1 to 4 [m] and track roll there [rad] at every step's start and the
        last one's end, shape (num_steps + 1, 8).

    Raises:
        ArgumentError: The track is shorter than the run.
    """
    steps = np.arange(check_count("num_steps", num_steps) + 1)
    lead = vehicle.speed * time_step * steps
    inputs = np.empty((len(steps), NUM_TRACK))
    for column, setback in enumerate(vehicle.wheelset_setback):
        inputs[:, column] = track.sample("alignment", lead - setback)
        roll = track.sample("cross_level", lead - setback)
        inputs[:, NUM_TRACK // 2 + column] = roll / (2 * vehicle.parameters.half_contact_spacing)
    return inputs


class Places(NamedTuple):
    """Where every lane runs.

    Attributes:
        track: Number of its track in the table, shape (lanes,).
        start: Where on the track its leading wheelset starts, shape (lanes,) [m].
        taper: Distance over which the irregularity grows from zero, shape (lanes,) [m].
        running: Whether the track behind the start is the same track, as of a vehicle that has been
            running on it, and not straight and level, shape (lanes,).
        amplitude: Factor on the irregularity, shape (lanes,) [1].
    """

    track: NDArray[np.int64]
    start: FloatArray
    taper: FloatArray
    running: NDArray[np.bool_]
    amplitude: FloatArray


class Wheels(NamedTuple):
    """Where the wheelsets of every vehicle are.

    Attributes:
        speed: Running speed, shape (vehicles,) [m/s].
        setback: Distance of wheelsets 1 to 4 behind the first, shape (vehicles, 4) [m].
        roll: Track roll per cross level, 1 / (2 b), shape (vehicles,) [rad/m].
    """

    speed: FloatArray
    setback: FloatArray
    roll: FloatArray


def wheels_of(vehicles: Sequence[LateralVehicle]) -> Wheels:
    """Return speeds and wheelset places of vehicles."""
    return Wheels(
        speed=np.array([vehicle.speed for vehicle in vehicles]),
        setback=np.array([vehicle.wheelset_setback for vehicle in vehicles]),
        roll=np.array([0.5 / vehicle.parameters.half_contact_spacing for vehicle in vehicles]),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def excite(
    table: TrackArrays,
    places: Places,
    wheels: Wheels,
    vehicle: NDArray[np.int64],
    step: NDArray[np.int64],
    time_step: float,
    active: NDArray[np.bool_],
    first: int,
    end: int,
    inputs: FloatArray,
) -> None:
    """Write what the wheelsets of the lanes from `first` to before `end` see in a coming period.

    A periodic track goes on with its beginning; others must be long enough, and are straight and
    level before their beginning.

    Args:
        table: The tracks.
        places: Where the lanes run.
        wheels: Speeds and wheelsets by vehicle.
        vehicle: Vehicle of each lane, shape (lanes,).
        step: Physics steps since each lane's start, shape (lanes,).
        time_step: Physics step [s].
        active: Lanes that take part, shape (lanes,).
        first: First lane.
        end: One past the last lane.
        inputs: Alignment [m] and track roll [rad] at the wheelsets at the start of the period,
            moved there from the end of the last, and after each step, (lanes, steps + 1, 8).
    """
    weights, setback = table.weights, wheels.setback
    speed, roll = wheels.speed, wheels.roll
    steps = inputs.shape[1] - 1
    for lane in range(first, end):
        if not active[lane]:
            continue
        for column in range(8):
            inputs[lane, 0, column] = inputs[lane, steps, column]
        car, track = vehicle[lane], places.track[lane]
        run = _run(table, places, lane, track)
        for substep in range(1, steps + 1):
            lead = speed[car] * (time_step * (step[lane] + substep))
            _sample(weights, setback, roll, run, car, lead, inputs, lane, substep)


@njit(cache=True, nogil=True, error_model="numpy")
def excite_start(
    table: TrackArrays,
    places: Places,
    wheels: Wheels,
    vehicle: NDArray[np.int64],
    which: NDArray[np.int64],
    inputs: FloatArray,
) -> None:
    """Write what the wheelsets of some lanes see at their start into the last row of `inputs`."""
    weights, setback, roll = table.weights, wheels.setback, wheels.roll
    for number in range(len(which)):
        lane = which[number]
        car, track = vehicle[lane], places.track[lane]
        run = _run(table, places, lane, track)
        _sample(weights, setback, roll, run, car, 0.0, inputs, lane, inputs.shape[1] - 1)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _run(
    table: TrackArrays, places: Places, lane: int, track: NDArray[np.int64]
) -> tuple[Any, ...]:
    """Return what is the same for a lane's whole run."""
    return (
        table.first[track],
        table.intervals[track],
        table.periodic[track],
        table.per_metre[track],
        places.start[lane],
        places.taper[lane],
        places.running[lane],
        places.amplitude[lane],
    )


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _sample(
    weights: FloatArray,
    setback: FloatArray,
    roll: FloatArray,
    run: tuple[Any, ...],
    car: NDArray[np.int64],
    lead: float,
    inputs: FloatArray,
    lane: int,
    row: int,
) -> None:
    """Write the inputs of one lane, its first wheelset `lead` after its start, into one row."""
    begin, intervals, periodic, per_metre, start, taper, running, amplitude = run
    for w in range(4):
        travelled = lead - setback[car, w]
        place = (start + travelled) * per_metre
        if travelled < 0.0 and (not running or (place < 0.0 and not periodic)):
            inputs[lane, row, w] = 0.0
            inputs[lane, row, 4 + w] = 0.0
            continue
        sixth = amplitude / 6.0
        if 0.0 <= travelled < taper:
            sixth *= 0.5 - 0.5 * np.cos(np.pi * travelled / taper)
        whole = int(np.floor(place))
        t = place - whole
        if whole >= intervals or whole < 0:
            whole %= intervals
        s = 1.0 - t
        # The four cubic B-splines that reach the interval, times six.
        a, d = s * s * s, t * t * t
        b, c = 4.0 - 6.0 * t * t + 3.0 * d, 4.0 - 6.0 * s * s + 3.0 * a
        k = begin + whole
        alignment = (
            a * weights[k, 0]
            + b * weights[k + 1, 0]
            + c * weights[k + 2, 0]
            + d * weights[k + 3, 0]
        )
        level = (
            a * weights[k, 1]
            + b * weights[k + 1, 1]
            + c * weights[k + 2, 1]
            + d * weights[k + 3, 1]
        )
        inputs[lane, row, w] = sixth * alignment
        inputs[lane, row, 4 + w] = sixth * level * roll[car]
