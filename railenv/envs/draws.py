"""The compiled part of an episode's draw: uniform numbers into vehicle, track, place and delays."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from railenv.simulation.excitation import Places
from railenv.units import FloatArray

IntArray = NDArray[np.int64]

BEFORE_DELAYS = 6
"""Uniform numbers that an episode takes before those of its delays."""


class Ranges(NamedTuple):
    """From what an episode is drawn.

    Attributes:
        vehicles: Vehicles of the pool.
        room: Where on each track a run may start, from 0 to this, shape (tracks,) [m].
        taper: Over what distance its irregularity grows, shape (tracks,) [m].
        level: Lowest and highest level of the irregularity, shape (2,) [1].
        low: Shortest delay of each channel from controller to force, shape (channels,) [s].
        high: Longest one, shape (channels,) [s].
        sensor: Shortest and longest share of the sensors, shape (2,) [s].
        per_channel: Whether every channel has its own draw.
        start_track: Tracks of the pool's states under control, shape (vehicles, moments); no
            moments for a start at rest.
        start_place: Places on them, shape (vehicles, moments) [m].
    """

    vehicles: int
    room: FloatArray
    taper: FloatArray
    level: FloatArray
    low: FloatArray
    high: FloatArray
    sensor: FloatArray
    per_channel: bool
    start_track: IntArray
    start_place: FloatArray


class EpisodeArrays(NamedTuple):
    """What every lane's episode has drawn.

    Attributes:
        vehicle: Vehicle of each lane, shape (lanes,).
        moment: Number of the state that it starts from, shape (lanes,); 0 for a start at rest.
        delay: From measurement to force, without jitter, shape (lanes, channels) [s].
        sensor_delay: The sensors' share of it, shape (lanes,) [s].
        told: The told delays, shape (lanes, channels) [s].
    """

    vehicle: IntArray
    moment: IntArray
    delay: FloatArray
    sensor_delay: FloatArray
    told: FloatArray


@njit(cache=True, nogil=True, error_model="numpy")
def draw_episodes(
    ranges: Ranges, places: Places, episode: EpisodeArrays, lanes: IntArray, uniform: FloatArray
) -> None:
    """Draw a new episode for some lanes; told delays come after it, by `tell_delays`.

    Args:
        ranges: From what is drawn.
        places: Where the lanes run; changed.
        episode: What was drawn; changed.
        lanes: Lane numbers, shape (k,).
        uniform: Draws from [0, 1), shape (k, 7 + channels): vehicle, track, place, level, moment,
            told error, delay of each channel, sensors' delay.
    """
    low_level, high_level = ranges.level[0], ranges.level[1]
    moments = ranges.start_track.shape[1]
    channels = len(ranges.low)
    for number in range(len(lanes)):
        lane = lanes[number]
        car = min(int(uniform[number, 0] * ranges.vehicles), ranges.vehicles - 1)
        track = min(int(uniform[number, 1] * len(ranges.room)), len(ranges.room) - 1)
        episode.vehicle[lane] = car
        episode.moment[lane] = 0
        if high_level > low_level:
            level = low_level + (high_level - low_level) * uniform[number, 3]
            places.amplitude[lane] = np.sqrt(level)
        if moments > 0:
            moment = min(int(uniform[number, 4] * moments), moments - 1)
            episode.moment[lane] = moment
            places.track[lane] = ranges.start_track[car, moment]
            places.start[lane] = ranges.start_place[car, moment]
            places.taper[lane] = 0.0
            places.running[lane] = True
        else:
            places.track[lane] = track
            places.start[lane] = ranges.room[track] * uniform[number, 2]
            places.taper[lane] = ranges.taper[track]
        share = uniform[number, BEFORE_DELAYS + channels]
        sensor = ranges.sensor[0] + (ranges.sensor[1] - ranges.sensor[0]) * share
        episode.sensor_delay[lane] = sensor
        for c in range(channels):
            own = uniform[number, BEFORE_DELAYS + (c if ranges.per_channel else 0)]
            episode.delay[lane, c] = ranges.low[c] + (ranges.high[c] - ranges.low[c]) * own + sensor


@njit(cache=True, nogil=True, error_model="numpy")
def tell_delays(
    episode: EpisodeArrays, told_error: float, lanes: IntArray, uniform: FloatArray
) -> None:
    """Draw the delays that the observation tells, never below zero.

    The error is drawn from [-told_error, told_error], or from [-delay, told_error] where a delay
    is shorter than `told_error`.

    Args:
        episode: What was drawn; the told delays are changed.
        told_error: Largest error [s].
        lanes: Lane numbers, shape (k,).
        uniform: The draws of these lanes, as for `draw_episodes`.
    """
    for number in range(len(lanes)):
        lane = lanes[number]
        for c in range(episode.delay.shape[1]):
            delay = episode.delay[lane, c]
            lowest = -min(told_error, delay)
            share = (told_error - lowest) * uniform[number, BEFORE_DELAYS - 1]
            episode.told[lane, c] = delay + lowest + share
