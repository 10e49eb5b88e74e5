"""How every controller of a benchmark moves the vehicle: time histories, and the loop's roots.

One place for all: nominal vehicle, 300 km/h, spectrum German low, each layout. What is drawn on a
controller's card comes from here; nothing of it counts for the score. The track is the public test
track 0 also where a run has a private salt: a picture must not give a private track away.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from eval.benchmark_roots import root_motion
from eval.benchmark_stability import SPEED_KMH, VEHICLE
from eval.cells import controller_for, draws_name
from eval.packages import PASSIVE
from eval.rollout import ACCELERATIONS, force_names, rollout
from eval.scenarios import Channel, Scenario, Suite, TestTracks
from eval.scenarios.scenario import lateral_of
from railenv.metrics import rms
from railenv.simulation import Trajectory, required_length
from railenv.track import make_track
from railenv.units import FloatArray, Second

MODEL, TRACK, TRACK_NUMBER = "lateral17", "german_low", 0

DELAYS: tuple[Second, ...] = (0.0, 0.1, 0.3)
"""Constant delays of the time histories [s]."""

LONGEST_WINDOW: Second = 10.0
"""How much of a run is shown at most, from where measuring begins [s]."""

BIN: Second = 0.04
"""Width of the bins that a signal is thinned by [s]; see `envelope`."""

ACCELERATION_STEP, FORCE_STEP = 1e-4, 1.0
"""What the numbers of thinned signals count in [m/s^2], [N]."""

ENDS = ("front", "rear")


@dataclass(frozen=True)
class MotionWork:
    """The question for one controller's motion; small, and can be pickled.

    Attributes:
        suite: The suite; says how runs are stepped and how long they are.
        controller: SPEC.
        layout: "2" or "4".
    """

    suite: Suite
    controller: str
    layout: str

    @property
    def place(self) -> tuple[str, str, str, float]:
        """What the answer is kept by: controller, layout, vehicle, speed [km/h]."""
        return self.controller, self.layout, VEHICLE, SPEED_KMH


def motion_answer(work: MotionWork) -> dict[str, Any]:
    """Return a controller's time histories and roots in plain values.

    The runs are those of the suite's cells on this place and track, in the same bits, as far as
    they are shown.

    Returns:
        `window_s`, first and last time shown; `bin_s`, width of a bin; `runs`, one per delay with
        `delay_s`, the signals `front` and `rear` (floor accelerations), `force` (of the first
        actuator; None without actuators), and `force_rms` over all actuators [N]. A signal has its
        `rms` as it was before thinning (None where the run blew up), and `low` and `high` of every
        bin, whole numbers of `ACCELERATION_STEP` or `FORCE_STEP`, None where there is no number.
        `roots`: see `eval.benchmark_roots.root_motion`.

    Raises:
        ArgumentError: The controller does not run on this layout.
        ControllerError: It failed.
    """
    place = (MODEL, VEHICLE, work.layout, SPEED_KMH)
    controller = controller_for(work.controller, place)
    vehicle = lateral_of(place, "passive" if work.controller == PASSIVE else work.layout)
    suite, tests = work.suite, TestTracks(work.suite.version)
    channels = vehicle.num_actuators
    delays = DELAYS if channels else DELAYS[:1]
    length = required_length(vehicle, suite.duration(MODEL))
    window = min(LONGEST_WINDOW, suite.seconds)
    stepping = suite.stepping(getattr(controller, "control_period", None))
    trajectory = rollout(
        controller,
        vehicle,
        np.repeat(delays, channels).reshape(len(delays), channels),
        suite.skip + window,
        tracks=[make_track(TRACK, length, tests.seed(TRACK_NUMBER))],
        track_of_lane=np.zeros(len(delays), dtype=np.int64),
        record=(*ACCELERATIONS, *force_names(vehicle)),
        stepping=stepping,
        noise_seeds=[tests.stream(draws_name(_scenario(work, delay))) for delay in delays],
    )
    return {
        "window_s": [suite.skip, suite.skip + window],
        "bin_s": BIN,
        "runs": _runs(trajectory, delays, suite.skip, force_names(vehicle)),
        "roots": root_motion(controller, vehicle),
    }


def envelope(signal: FloatArray, per_bin: int, step: float) -> dict[str, list[int | None]]:
    """Thin a signal to the smallest and the largest value of every bin.

    Picking every tenth sample would fold fast motion into slow motion that is not there, and a
    low-pass would take the peaks. Here no value of the signal lies outside: a bin reaches to the
    next one's first sample, and ends are rounded outwards.

    Args:
        signal: Shape (samples,); NaN where there is no number.
        per_bin: Samples that a bin is long.
        step: What the numbers count in, in the signal's unit.

    Returns:
        `low` and `high`, one whole number per bin; None where a bin has no number throughout.
    """
    found: dict[str, list[int | None]] = {"low": [], "high": []}
    for first in range(0, len(signal), per_bin):
        here = signal[first : first + per_bin + 1]
        known = bool(np.all(np.isfinite(here)))
        found["low"].append(int(np.floor(here.min() / step)) if known else None)
        found["high"].append(int(np.ceil(here.max() / step)) if known else None)
    return found


def _scenario(work: MotionWork, delay: Second) -> Scenario:
    channel = Channel("constant", 1000.0 * delay)
    version, layout = work.suite.version, work.layout
    return Scenario(version, MODEL, VEHICLE, layout, SPEED_KMH, TRACK, channel, TRACK_NUMBER)


def _runs(
    trajectory: Trajectory, delays: tuple[Second, ...], skip: Second, forces: tuple[str, ...]
) -> list[dict[str, Any]]:
    start = int(np.searchsorted(trajectory.time, skip * (1 + 1e-12), side="right"))
    per_bin = max(1, round(BIN * trajectory.sample_rate))
    runs: list[dict[str, Any]] = []
    for lane, delay in enumerate(delays):
        run: dict[str, Any] = {"delay_s": delay, "force": None, "force_rms": None}
        for end, name in zip(ENDS, ACCELERATIONS[:2], strict=True):
            signal = trajectory.signal(name)[lane, start:]
            run[end] = _signal(signal, per_bin, ACCELERATION_STEP)
        if forces:
            all_forces = np.stack([trajectory.signal(name)[lane, start:] for name in forces])
            run["force"] = _signal(all_forces[0], per_bin, FORCE_STEP)
            run["force_rms"] = _number(np.sqrt(np.mean(all_forces**2)))
        runs.append(run)
    return runs


def _signal(signal: FloatArray, per_bin: int, step: float) -> dict[str, Any]:
    finite = bool(np.all(np.isfinite(signal)))
    return {"rms": _number(rms(signal)) if finite else None, **envelope(signal, per_bin, step)}


def _number(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None
