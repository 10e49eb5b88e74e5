"""Short runs of one controller for its check, which note what it does to what it is given."""

from time import perf_counter
from typing import Any

import numpy as np

from baselines.controller import Controller
from eval.rollout import ACCELERATIONS, Stepping, force_names, rollout
from eval.scenarios import Suite, TestTracks
from railenv.simulation import required_length
from railenv.track import make_track
from railenv.units import FloatArray, Second
from railenv.vehicle import LateralVehicle

SECONDS: Second = 4.0
"""Length of a run [s]."""

DELAY: Second = 0.1
"""Delay of the second lane; the first one's is half of it, the third has none [s]."""

LANES = 3
MANY = 64
"""Lanes of the run that tells how a step's time grows with them."""

_START: Second = 1.0
"""Time left out of the floor's acceleration: the track rises [s]."""

_DELAYS = (0.5 * DELAY, DELAY, 0.0)
_BRIEF: Second = 0.2


class Watched:
    """A controller that behaves as another one, and notes whether that changes its arguments.

    Attributes:
        changed: Names of the arguments that it has written to.
    """

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self.changed: set[str] = set()

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._controller, name)
        return self._tell if name == "tell" and value is not None else value

    def reset(self, num_lanes: int, seed: int) -> None:
        """As the controller."""
        self._controller.reset(num_lanes, seed)

    def act(self, observations: FloatArray) -> FloatArray:
        """As the controller."""
        before = observations.copy()
        actions = self._controller.act(observations)
        if not np.array_equal(before, observations, equal_nan=True):
            self.changed.add("the observations")
        return actions

    def _tell(self, delays: FloatArray) -> None:
        tell: Any = getattr(self._controller, "tell")  # noqa: B009 (not of the protocol)
        before = delays.copy()
        tell(delays)
        if not np.array_equal(before, delays):
            self.changed.add("the delays that it is told")


class CheckRuns:
    """Runs on the linear vehicle.

    Args:
        suite: Says how runs are stepped.
        vehicle: The vehicle.
        stepping: Steps and limits.

    Attributes:
        changed: What a controller has written to, in words.
        numpy_errors: Whether a controller has changed how numpy takes errors; it is changed back.
    """

    def __init__(self, suite: Suite, vehicle: LateralVehicle, stepping: Stepping) -> None:
        self._suite, self._vehicle, self._stepping = suite, vehicle, stepping
        self.changed: set[str] = set()
        self.numpy_errors = False

    def forces(self, controller: Controller, lanes: list[int] | None = None) -> FloatArray:
        """Return the forces of some lanes of a run, shape (lanes, steps, channels) [N]."""
        chosen = list(range(LANES)) if lanes is None else lanes
        delays = [_DELAYS[lane] for lane in chosen]
        return self._run(controller, chosen, delays, force_names(self._vehicle))

    def free_forces(self, controller: Controller) -> FloatArray:
        """Return the forces of a run without delay, likewise [N]."""
        return self._run(controller, list(range(LANES)), [0.0] * LANES, force_names(self._vehicle))

    def floor(self, controller: Controller) -> float:
        """Return the root mean square of both floors' acceleration without delay [m/s^2]."""
        values = self._run(controller, list(range(LANES)), [0.0] * LANES, ACCELERATIONS[:2])
        start = round(_START / self._suite.time_step)
        return float(np.sqrt(np.mean(np.nan_to_num(values[:, start:], nan=np.inf) ** 2)))

    def to_the_end(self, controller: Controller, delay: Second) -> bool:
        """Run one lane as long as the suite does; return whether its vehicle stayed in bounds."""
        duration = self._suite.duration("lateral17")
        values = self._run(controller, [1], [delay], ACCELERATIONS[:2], duration)
        return bool(np.all(np.isfinite(values)))

    def step_seconds(self, controller: Controller, lanes: int) -> Second:
        """Return what a step takes with so many lanes, the vehicles' motion included [s]."""
        steps = max(1, round(_BRIEF / self._stepping.control_period))
        duration = steps * self._stepping.control_period
        numbers, names = list(range(lanes)), force_names(self._vehicle)
        started = perf_counter()
        self._run(controller, numbers, [DELAY] * lanes, names, duration, one_track=True)
        return (perf_counter() - started) / steps

    def _run(
        self,
        controller: Controller,
        lanes: list[int],
        delays: list[float],
        names: tuple[str, ...],
        seconds: Second = SECONDS,
        *,
        one_track: bool = False,
    ) -> FloatArray:
        """Return recorded signals, shape (lanes, steps, names)."""
        period = self._stepping.control_period
        duration = int(np.ceil(seconds / period - 1e-9)) * period
        test = TestTracks("check")
        length = required_length(self._vehicle, duration)
        seeds = lanes[:1] if one_track else lanes
        watched = Watched(controller)
        errors = np.geterr()
        try:
            trajectory = rollout(
                watched,
                self._vehicle,
                np.repeat(np.array(delays)[:, None], self._vehicle.num_actuators, axis=1),
                duration,
                tracks=[make_track("german_low", length, test.seed(lane)) for lane in seeds],
                track_of_lane=np.arange(len(lanes)) % len(seeds),
                record=names,
                stepping=self._stepping,
                noise_seeds=[test.stream(str(lane)) for lane in lanes],
            )
        finally:
            self.numpy_errors |= np.geterr() != errors
            np.seterr(**errors)
        self.changed |= watched.changed
        return trajectory.values
