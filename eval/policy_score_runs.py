"""Runs on the scoring tracks: which they are, and the comfort of any controller on them.

Every controller of a score meets the same tracks and, where it reads the same sensors, the same
noise: lane for lane the draws are those of the scoring seed, so that differences between two
controllers are paired. The linear vehicle's tracks are sampled once.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.controller import Controller
from baselines.design.model import DESIGN_NOISE
from eval.measures import RunMeasures, measure
from eval.rollout import ACCELERATIONS, Stepping, force_names, rollout
from eval.simulations import Vehicle
from eval.zoo import DELAYS, weighted_acceleration
from railenv.errors import ArgumentError, check_count, check_not_negative, check_positive
from railenv.simulation import wheelset_inputs, whole_multiple
from railenv.track import Track, make_track
from railenv.track.seed_domains import FIRST_TEST_SEED
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle, VehicleParameters, lateral17
from railenv.vehicle.nonlinear import full50

SCORING_SEEDS = FIRST_TEST_SEED
"""Seed of the first scoring track; the others follow it."""

_MOST_TRACKS = 100
_SEGMENT = 5.0


@dataclass(frozen=True)
class Trial:
    """What is run: vehicle, track, delays, noise, and for how long.

    Attributes:
        parameters: Name of a catalogued vehicle, or parameters of its lateral model.
        speed_kmh: Running speed [km/h].
        track: Spectrum of the scoring tracks.
        tracks: Number of scoring tracks.
        seconds: Time that is measured [s].
        skip: Time left out before it [s].
        delays: Delays, the same for all channels [s].
        sensor_noise: Standard deviation of the noise of the readings, in units of the controlled
            response [1].
        model: "lateral17" or "full50".

    Raises:
        ArgumentError: A value is out of range.
    """

    parameters: str | VehicleParameters = "paper_fit"
    speed_kmh: float = 300.0
    track: str = "german_low"
    tracks: int = 20
    seconds: float = 60.0
    skip: float = 10.0
    delays: tuple[float, ...] = DELAYS
    sensor_noise: float = DESIGN_NOISE
    model: str = "lateral17"

    def __post_init__(self) -> None:
        check_positive("speed_kmh", self.speed_kmh, "km/h")
        if check_count("tracks", self.tracks) > _MOST_TRACKS:
            raise ArgumentError(f"tracks = {self.tracks} is too large; give {_MOST_TRACKS} or less")
        check_not_negative("skip", self.skip, "seconds")
        if check_positive("seconds", self.seconds, "seconds") < _SEGMENT:
            raise ArgumentError(
                f"seconds = {self.seconds:g} is less than one segment of the ride index; "
                f"give {_SEGMENT:g} s or more"
            )
        if not self.delays:
            raise ArgumentError("delays is empty; give at least one")
        for delay in self.delays:
            check_not_negative("delays", delay, "seconds")
        check_not_negative("sensor_noise", self.sensor_noise)
        if self.model not in ("lateral17", "full50"):
            raise ArgumentError(
                f"model = {self.model!r} does not exist; choose lateral17 or full50"
            )

    @property
    def duration(self) -> float:
        """Length of a run [s]."""
        return self.skip + self.seconds

    def vehicle(self, layout: object) -> Vehicle:
        """Return the vehicle with a layout of actuators."""
        if self.model == "full50":
            return full50(self.parameters, layout, self.speed_kmh)
        return self.lateral(layout)

    def lateral(self, layout: object) -> LateralVehicle:
        """Return the linear vehicle with the same lateral numbers, for the oracle."""
        return lateral17(self.parameters, layout, self.speed_kmh)

    @cached_property
    def irregularity(self) -> tuple[Track, ...]:
        """The scoring tracks."""
        length = self.duration * self.speed_kmh / 3.6
        seeds = range(SCORING_SEEDS, SCORING_SEEDS + self.tracks)
        return tuple(make_track(self.track, length, seed) for seed in seeds)

    @cached_property
    def track_inputs(self) -> FloatArray:
        """The scoring tracks as sampled for the linear vehicle, shape (tracks, steps + 1, 8)."""
        step = Stepping().time_step
        steps = whole_multiple("duration", self.duration, "time_step", step)
        vehicle = self.lateral("passive")
        return np.stack([wheelset_inputs(vehicle, t, step, steps) for t in self.irregularity])


@dataclass(frozen=True, eq=False)
class Comfort:
    """Comfort and force of a controller at some delays on some tracks, shape (delays, tracks).

    Attributes:
        front: Sperling Wz of the front floor; NaN where the vehicle left every bound [1].
        rear: The same of the rear floor [1].
        force: RMS force over the actuators [N].
        weighted: RMS ride-filtered acceleration over both floor ends [m/s^2].
        diverged: See `eval.measures.RunMeasures`.
    """

    front: FloatArray
    rear: FloatArray
    force: FloatArray
    weighted: FloatArray
    diverged: NDArray[np.bool_]

    @property
    def worse(self) -> FloatArray:
        """Mean ride index over the tracks of the worse floor end, shape (delays,) [1]."""
        return np.maximum(self.front.mean(axis=1), self.rear.mean(axis=1))

    @property
    def lost(self) -> NDArray[np.bool_]:
        """Delays at which a track diverged, shape (delays,)."""
        return np.any(self.diverged | np.isnan(self.front), axis=1)

    def at(self, chosen: Sequence[int]) -> "Comfort":
        """Return the same at some of the delays, by index."""
        rows = np.asarray(chosen)
        return Comfort(
            self.front[rows],
            self.rear[rows],
            self.force[rows],
            self.weighted[rows],
            self.diverged[rows],
        )


def comfort_of(
    controller: Controller,
    trial: Trial,
    *,
    told_error: float = 0.0,
    sensor_noise: float | None = None,
    progress: Callable[[int], None] | None = None,
) -> Comfort:
    """Run a controller at every delay on every track.

    Args:
        controller: The controller, with its layout (4 actuators if it says none).
        trial: What is run.
        told_error: Error of the delay that it is told [s].
        sensor_noise: In the place of the trial's own [1].
        progress: Called with the number of control periods just done.

    Returns:
        Its comfort; that of a layout without actuators is run at one delay and repeated.
    """
    layout = getattr(controller, "layout", "4")
    vehicle = trial.vehicle(layout)
    delays = np.array(trial.delays if vehicle.num_actuators else trial.delays[:1])
    noise = trial.sensor_noise if sensor_noise is None else sensor_noise
    period = getattr(controller, "control_period", None) or Stepping().control_period
    stepping = replace(Stepping(), control_period=period, sensor_noise=noise, told_error=told_error)
    linear = isinstance(vehicle, LateralVehicle)
    lanes = np.repeat(delays, trial.tracks)[:, None] * np.ones(vehicle.num_actuators)
    run = rollout(
        controller,
        vehicle,
        lanes,
        trial.duration,
        tracks=() if linear else trial.irregularity,
        track_inputs=trial.track_inputs if linear else None,
        track_of_lane=np.tile(np.arange(trial.tracks), len(delays)),
        record=(*ACCELERATIONS, *force_names(vehicle)),
        stepping=stepping,
        seed=SCORING_SEEDS,
        progress=progress,
    )
    values = measure(run, trial.skip, stepping.actuator.force_limit)
    return _by_delay(values, weighted_acceleration(run, trial.skip), trial)


def _by_delay(values: RunMeasures, weighted: FloatArray, trial: Trial) -> Comfort:
    """Arrange lanes by delay and track; a row without delay stands for all of them."""

    def rows(lanes: NDArray[Any]) -> NDArray[Any]:
        shaped = lanes.reshape(-1, trial.tracks)
        return np.repeat(shaped, len(trial.delays), axis=0) if len(shaped) == 1 else shaped

    return Comfort(
        front=rows(values.ride_index_front),
        rear=rows(values.ride_index_rear),
        force=rows(values.force_rms),
        weighted=rows(weighted),
        diverged=rows(values.diverged),
    )
