"""What every episode draws: vehicle, track, level, start, delays, and the pools they come from.

Vehicles and tracks come from pools that are made once and do not depend on the number of lanes. An
episode takes one block of uniform numbers from its lane's generator; fixing something by an option
does not change the rest.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from railenv.actuation import DelaySpec
from railenv.envs.delays import check_longest
from railenv.envs.draws import BEFORE_DELAYS, EpisodeArrays, Ranges, draw_episodes, tell_delays
from railenv.envs.observation import bound, measured_names
from railenv.envs.settings import EnvSettings
from railenv.envs.start import StartPool
from railenv.errors import ArgumentError, check_count, unknown_name
from railenv.simulation import PlantTable
from railenv.simulation.excitation import Places, wheels_of
from railenv.track import make_track
from railenv.track.seed_domains import check_no_test_seed
from railenv.track.table import (
    LATERAL_CHANNELS,
    PooledTrack,
    pool_of_tracks,
    single_track,
    table_of,
)
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle, get_vehicle, lateral17
from railenv.vehicle.coordinates import actuator_positions
from railenv.vehicle.randomisation import draw_vehicles, get_ranges

OPTIONS = ("delay", "track_seed", "vehicle")

IntArray = NDArray[np.int64]


class Episodes:
    """Pools, and the episode that every lane is in.

    Args:
        settings: The environment's.
        num_lanes: Number of lanes.
        recorded: Outputs recorded at every physics step.

    Attributes:
        vehicles: The pool of vehicles.
        measured: Measured columns.
        table: The same, ready for stepping.
        wheels: Their speeds and wheelset places.
        tracks: The pool of tracks.
        track_table: Pool and tracks given in person, ready for sampling.
        draw: From what delays are drawn.
        places: Where the lanes run.
        arrays: What else their episodes have drawn.
    """

    channels: tuple[str, ...] = LATERAL_CHANNELS
    """Channels of the tracks."""

    def __init__(self, settings: EnvSettings, num_lanes: int, recorded: Sequence[str]) -> None:
        self.settings = s = settings
        self._recorded = tuple(recorded)
        self.draw = s.delays()
        self._level = s.level_range()
        self.vehicles: tuple[LateralVehicle, ...] = _vehicles(s)
        self.wheels = wheels_of(self.vehicles)
        longest = float(self.wheels.speed.max()) * (s.episode_seconds + StartPool.seconds(s))
        self.tracks: tuple[PooledTrack, ...] = pool_of_tracks(
            s.tracks(), s.track_pool, longest, s.pool_seed, self.channels
        )
        self.track_table = table_of(self.tracks)
        self._given: dict[int, PooledTrack] = {}
        self.measured, self.start_pool = self._prepared()
        self._ranges = self._all_ranges()
        channels = self.num_channels
        self.places = Places(
            track=np.zeros(num_lanes, dtype=np.int64),
            start=np.zeros(num_lanes),
            taper=np.zeros(num_lanes),
            running=np.zeros(num_lanes, dtype=bool),
            amplitude=np.full(num_lanes, np.sqrt(self._level[0])),
        )
        self.arrays = EpisodeArrays(
            vehicle=np.zeros(num_lanes, dtype=np.int64),
            moment=np.zeros(num_lanes, dtype=np.int64),
            delay=np.zeros((num_lanes, channels)),
            sensor_delay=np.zeros(num_lanes),
            told=np.zeros((num_lanes, channels)),
        )

    @staticmethod
    def limits_of(name: str) -> tuple[float, str, float]:
        """Return the largest reading of a measured column, its unit, and its usual size."""
        return bound(name)

    def _prepared(self) -> tuple[tuple[str, ...], StartPool | None]:
        """Make the vehicles ready for stepping; return measured columns and start states."""
        s = self.settings
        measured = measured_names(self.vehicles[0], s.observation)
        positions = actuator_positions(self.vehicles[0].layout)
        # Behind a lag the force is no command any more: it has to be taken from the state.
        forces = tuple(f"actuator_force_{k}" for k in positions) if s.actuator_lag else ()
        self.table = PlantTable(
            self.vehicles, self._recorded, (*measured, *forces), s.actuator(), s.time_step
        )
        return measured, StartPool.of(s, self.table, self.wheels, self.tracks)

    @property
    def num_channels(self) -> int:
        """Actuator channels."""
        return len(actuator_positions(self.vehicles[0].layout))

    def _all_ranges(self) -> Ranges:
        draw, pool = self.draw, self.start_pool
        nowhere = np.zeros((len(self.vehicles), 0))
        return Ranges(
            vehicles=len(self.vehicles),
            # Where a run may start: anywhere on a periodic track, at the beginning of others.
            room=np.array([track.length * track.periodic for track in self.tracks]),
            taper=np.array([track.taper for track in self.tracks]),
            level=np.array(self._level, dtype=np.float64),
            low=np.array(draw.low, dtype=np.float64),
            high=np.array(draw.high, dtype=np.float64),
            sensor=np.array(draw.sensor, dtype=np.float64),
            per_channel=draw.per_channel,
            start_track=nowhere.astype(np.int64) if pool is None else pool.track.copy(),
            start_place=nowhere if pool is None else pool.place.copy(),
        )

    @property
    def vehicle(self) -> IntArray:
        """Vehicle of each lane, shape (lanes,); not a copy, as those below."""
        return self.arrays.vehicle

    @property
    def delay(self) -> FloatArray:
        """From measurement to force, without jitter, shape (lanes, channels) [s]."""
        return self.arrays.delay

    @property
    def sensor_delay(self) -> FloatArray:
        """The sensors' share of it, shape (lanes,) [s]."""
        return self.arrays.sensor_delay

    @property
    def told(self) -> FloatArray:
        """The told delays, shape (lanes, channels) [s]."""
        return self.arrays.told

    def start(
        self,
        lanes: IntArray,
        generators: Sequence[np.random.Generator],
        options: Sequence[dict[str, Any]] | None,
    ) -> FloatArray | None:
        """Draw a new episode for some lanes.

        Args:
            lanes: Lane numbers, shape (k,).
            generators: Their random streams.
            options: For each, what is fixed: "delay" (seconds, one per channel, or a DelaySpec),
                "track_seed" (the run begins where the track of that seed begins) and "vehicle"
                (number in the pool); checked before by `check`.

        Returns:
            States of the vehicles at the start, shape (k, n); None for rest.
        """
        size = BEFORE_DELAYS + self.num_channels + 1
        u = np.empty((len(lanes), size))
        for row, generator in zip(u, generators, strict=True):
            generator.random(out=row)
        draw_episodes(self._ranges, self.places, self.arrays, lanes, u)
        fixed_tracks: list[tuple[int, int]] = []
        for k, given in enumerate(options or ()):
            lane = lanes[k]
            if "vehicle" in given:
                self._fix_vehicle(lane, given["vehicle"])
            if "delay" in given:
                self.delay[lane], self.sensor_delay[lane] = self._fixed_delay(given["delay"])
            if "track_seed" in given:
                fixed_tracks.append((k, int(given["track_seed"])))
        if self.settings.delay_observed:
            tell_delays(self.arrays, self.draw.told_error, lanes, u)
        if fixed_tracks:
            self._put_on_given(lanes, fixed_tracks)
        if self.start_pool is None:
            return None
        # The vehicle is linear, the sky-hook far from its limits: the state grows with the track.
        states = self.start_pool.states[self.vehicle[lanes], self.arrays.moment[lanes]]
        return states * self.places.amplitude[lanes, None]

    def _fix_vehicle(self, lane: int, vehicle: int) -> None:
        self.vehicle[lane] = vehicle
        if self.start_pool is not None:
            # A state under control belongs to its vehicle and its place.
            moment = self.arrays.moment[lane]
            self.places.track[lane] = self.start_pool.track[vehicle, moment]
            self.places.start[lane] = self.start_pool.place[vehicle, moment]

    def check(self, given: dict[str, Any]) -> None:
        """Check what is to be fixed in one lane.

        Raises:
            ArgumentError: An option is unknown or out of its range.
        """
        for name in given:
            if name not in OPTIONS:
                raise unknown_name("reset option", str(name), OPTIONS)
        if "vehicle" in given:
            number = check_count("vehicle", given["vehicle"], minimum=0)
            if number >= len(self.vehicles):
                raise ArgumentError(
                    f"vehicle = {number} does not exist; the pool has {len(self.vehicles)}, "
                    "numbered from 0"
                )
        if "delay" in given:
            self._fixed_delay(given["delay"])
        if "track_seed" in given:
            check_no_test_seed("track_seed", given["track_seed"])
            if len(self.settings.tracks()) > 1 or self.start_pool is not None:
                raise ArgumentError(
                    "track_seed fixes a whole run from rest on one kind of track; it goes neither "
                    "with start='controlled' nor with several tracks"
                )

    def _fixed_delay(self, delay: Any) -> tuple[FloatArray, float]:
        if isinstance(delay, np.ndarray):
            delay = delay.tolist()
        spec = delay if isinstance(delay, DelaySpec) else DelaySpec(delay)
        if spec != DelaySpec(spec.delay, spec.sensor_delay):
            raise ArgumentError(
                "the option delay fixes an episode's delay; jitter and dropouts are settings of "
                "the environment"
            )
        check_longest(spec.longest + self.draw.varying.jitter, self.settings.max_delay)
        delays = spec.per_channel(self.num_channels)
        if self.settings.delay_observed and not self.draw.channels_differ and np.ptp(delays):
            raise ArgumentError(
                f"delay = {delay!r} differs between channels, but the observation has one told "
                "delay for all; make the environment with delay_per_channel=True"
            )
        return delays, spec.sensor_delay

    @property
    def given_seeds(self) -> list[int]:
        """Seeds of the tracks that stand behind the pool in the table."""
        return list(self._given)

    def give_tracks(self, seeds: Sequence[int]) -> None:
        """Put the tracks of these seeds behind the pool, in this order, in place of any others."""
        length = float(self.wheels.speed.max()) * self.settings.episode_seconds
        known = self._given
        self._given = {
            seed: known[seed] if seed in known else self._realised(length, seed) for seed in seeds
        }
        self.track_table = table_of([*self.tracks, *self._given.values()])

    def track_around(
        self, lane: int, time: float, distance: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the irregularity that a lane runs over.

        Args:
            lane: Lane number.
            time: Time since its start [s].
            distance: Distances from the carbody's centre, shape (k,) [m].

        Returns:
            Alignment and cross level there, shape (k,) [m]; zero before the start.
        """
        car, places = int(self.vehicle[lane]), self.places
        number = int(places.track[lane])
        pooled = [*self.tracks, *self._given.values()][number]
        # The carbody's centre is half of the last wheelset's distance behind the first one.
        centre = self.wheels.speed[car] * time - 0.5 * self.wheels.setback[car, -1]
        travelled = centre + distance
        taper = places.taper[lane]
        before = (travelled < 0.0) & ~places.running[lane]
        weight = np.where(before, 0.0, places.amplitude[lane])
        if taper > 0.0:
            rise = 0.5 - 0.5 * np.cos(np.pi * np.clip(travelled / taper, 0.0, 1.0))
            weight = weight * rise
        alignment, cross_level = pooled.heights(places.start[lane] + travelled)
        return weight * alignment, weight * cross_level

    def _put_on_given(self, lanes: IntArray, fixed: list[tuple[int, int]]) -> None:
        """Put lanes on the tracks of given seeds, from their beginning."""
        pool = len(self.tracks)
        others = np.setdiff1d(np.arange(len(self.vehicle)), lanes)
        before = self.given_seeds
        in_use = {
            int(lane): before[self.places.track[lane] - pool]
            for lane in others
            if self.places.track[lane] >= pool
        }
        seeds = sorted({*in_use.values(), *(seed for _, seed in fixed)})
        self.give_tracks(seeds)
        for lane, seed in in_use.items():
            self.places.track[lane] = pool + seeds.index(seed)
        for k, seed in fixed:
            self.places.track[lanes[k]] = pool + seeds.index(seed)
            self.places.start[lanes[k]] = 0.0
            self.places.taper[lanes[k]] = 0.0

    def _realised(self, length: float, seed: int) -> PooledTrack:
        return single_track(make_track(self.settings.tracks()[0], length, seed), self.channels)


def _vehicles(settings: EnvSettings) -> tuple[LateralVehicle, ...]:
    s = settings
    if s.ranges() == get_ranges("none"):
        # The one vehicle that was asked for, whatever it does: no pool to be kept in order.
        return (lateral17(s.vehicle, s.layout, s.speed_kmh),)
    base = get_vehicle(s.vehicle).parameters
    return tuple(
        draw_vehicles(base, s.layout, s.speed_kmh, s.ranges(), s.vehicle_pool, s.pool_seed)
    )
