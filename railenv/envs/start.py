"""Start states of a vehicle that has been running for a while under a mild sky-hook.

Without its dampers and without control the 4-actuator car is all but undamped, and its own steady
response is far larger than any controlled one: an episode that begins there is dominated by its
beginning. A state under control belongs to the place on the track where it was taken.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from railenv.errors import ArgumentError
from railenv.simulation import PlantTable, VehicleBatch
from railenv.simulation.excitation import Places, Wheels, excite, excite_start
from railenv.track.table import PooledTrack, table_of
from railenv.units import FloatArray
from railenv.vehicle.coordinates import actuator_positions

if TYPE_CHECKING:
    from railenv.envs.settings import EnvSettings

GAIN = 10e3
"""Gain of the sky-hook, without delay: mild, and stable with every layout [N s/m]."""

RUN_IN = 8.0
"""Time after which the start at rest is forgotten [s]."""

MOMENTS, APART = 8, 1.0
"""States taken of each vehicle, and the time between them [s]."""


FEWEST_RUNS = 4
"""Runs of every vehicle, on different tracks as long as there are so many."""


@dataclass(frozen=True, eq=False)
class StartPool:
    """States under control.

    Attributes:
        states: States x, shape (vehicles, moments, n), at level 1 of the track.
        track: Number of the track on which each was taken, shape (vehicles, moments).
        place: Where on it, shape (vehicles, moments) [m].
    """

    states: FloatArray
    track: NDArray[np.int64]
    place: FloatArray

    @staticmethod
    def seconds(settings: EnvSettings) -> float:
        """Return how long the vehicles run before the last state is taken [s]."""
        return RUN_IN + MOMENTS * APART if settings.start == "controlled" else 0.0

    @staticmethod
    def of(
        settings: EnvSettings,
        table: PlantTable,
        wheels: Wheels,
        tracks: tuple[PooledTrack, ...],
    ) -> StartPool | None:
        """Run every vehicle on tracks of the pool and take its states; None for a start at rest.

        Raises:
            ArgumentError: A vehicle does not calm down under the sky-hook.
        """
        if settings.start != "controlled":
            return None
        cars, runs = len(table.vehicles), _runs_per_vehicle(len(table.vehicles), len(tracks))
        number = cars * runs
        everyone = np.arange(number, dtype=np.int64)
        car, run = everyone % cars, everyone // cars
        # A vehicle's runs are spread over the pool of tracks.
        track = (car + run * max(1, len(tracks) // runs)) % len(tracks)
        stream = np.random.Generator(np.random.PCG64([settings.pool_seed, 0x57A27]))
        share = stream.random(number) * np.array([t.length * t.periodic for t in tracks])[track]
        places = Places(
            track=track,
            start=share,
            taper=np.array([t.taper for t in tracks])[track],
            running=np.zeros(number, dtype=bool),
            amplitude=np.ones(number),
        )
        sky_hook = PlantTable(
            table.vehicles,
            (),
            tuple(
                f"carbody_lateral_velocity_{k}"
                for k in actuator_positions(table.vehicles[0].layout)
            ),
            settings.actuator(),
            settings.time_step,
        )
        steps = round(settings.control_period / settings.time_step)
        batch = VehicleBatch(sky_hook, number, steps, 0.0, settings.actuator())
        arrays, time_step = table_of(tracks), settings.time_step
        excite_start(arrays, places, wheels, car, everyone, batch.track)
        batch.start(everyone, car, np.zeros((number, sky_hook.num_channels)))
        per_moment = max(1, round(APART / settings.control_period))
        moments: list[FloatArray] = []
        travelled: list[FloatArray] = []
        for period in range(round(RUN_IN / settings.control_period) + MOMENTS * per_moment):
            batch.commands[:] = -GAIN * batch.sampled
            excite(
                arrays,
                places,
                wheels,
                car,
                batch.step,
                time_step,
                batch.active,
                0,
                number,
                batch.track,
            )
            batch.advance(0, number)
            left = round(RUN_IN / settings.control_period) + MOMENTS * per_moment - period - 1
            if left % per_moment == 0 and left // per_moment < MOMENTS:
                moments.append(batch.states())
                travelled.append(wheels.speed[car] * (time_step * batch.step))
        states = np.stack(moments, axis=1)
        # Behind the vehicle's own states come the forces of lagged actuators.
        own = table.systems[0].A.shape[0]
        calm = np.abs(states[..., :own]).max(axis=(1, 2)) < 1.0
        if not np.all(calm):
            raise ArgumentError(
                f"vehicle {int(car[np.argmin(calm)])} of the pool does not calm down under a "
                f"sky-hook of {GAIN:g} N s/m; narrow vehicle_ranges or start from rest"
            )
        place = places.start[:, None] + np.stack(travelled, axis=1)
        tracks_there = np.repeat(track[:, None], MOMENTS, axis=1)
        return StartPool(*(_by_vehicle(a, cars) for a in (states, tracks_there, place)))


def _runs_per_vehicle(vehicles: int, tracks: int) -> int:
    """Enough runs to use every track, and some for every vehicle."""
    return min(tracks, max(FEWEST_RUNS, -(-tracks // vehicles)))


def _by_vehicle(values: NDArray[Any], cars: int) -> NDArray[Any]:
    """Turn (runs times vehicles, moments, ...) into (vehicles, runs times moments, ...)."""
    apart = values.reshape(-1, cars, *values.shape[1:])
    return np.moveaxis(apart, 1, 0).reshape(cars, -1, *values.shape[2:])
