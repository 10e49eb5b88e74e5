"""Critical delay in the time domain, for any controller (section 5.3 of the source paper).

A section of irregular track excites the vehicle and ends; what is left decays or grows. The delay
is scanned coarsely (stability can return at longer delays) and every change between two delays of
the scan is then bracketed by repeated subdivision (two changes within one step stay unseen). The
excitation is scaled down until the command is below a fifth of the force limit when the track ends:
from large motion the limit would turn growth into a limit cycle, or even into decay. Stable is what
tends to zero; everything else is called unstable.

The answer includes the controller's sampling. It is a bracket, called an estimate.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.controller import Controller
from eval.rollout import ACCELERATIONS, ControlledBatch, Stepping, force_names
from railenv.errors import ArgumentError, check_positive
from railenv.simulation import required_length, wheelset_inputs
from railenv.track import make_track
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle, mode_name
from railenv.vehicle.coordinates import COORDINATES

EXCITATION = 10.0
"""Time on irregular track before it is removed [s], as in the paper."""

TAPER = 50.0
"""Distance over which the irregularity fades out [m]."""

FREE_RUN = 120.0
"""Time watched after the track has ended [s]."""

COARSE_STEP = 0.02
"""Spacing of the coarse scan [s]."""

MOST_COARSE = 500
"""Delays of the longest coarse scan."""

RESOLUTION = 0.0005
"""Width at which a bracket is narrow enough [s]."""

COMMAND_SHARE = 0.2
"""Largest command when the track ends, as a share of the force limit."""

_WINDOW = 5.0
_SUBDIVISION = 9
_RESCALINGS = 12
# Amplitudes below this share of the first window are rounding noise of a decayed motion.
_DECAYED = 1e-9
# A slower decay than this [1/s] counts as none; at the paper's loop it moves the answer by 0.01 ms.
_FLAT = 1e-4
# Two modes beating can raise a decaying amplitude for a while, but not this much.
_GROWN = 2.0


def simulated_critical_delay(
    controller: Controller,
    vehicle: LateralVehicle,
    *,
    stepping: Stepping | None = None,
    max_delay: float = 2.0,
    track: str = "tb3352",
    seed: int = 0,
    resolution: float = RESOLUTION,
    progress: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Estimate the critical delay of any controller by simulation.

    Args:
        controller: The controller.
        vehicle: The vehicle.
        stepping: Steps, limits and lag.
        max_delay: Longest delay searched [s].
        track: Irregularity that excites.
        seed: Seed of the irregularity, and given to the controller.
        resolution: Width of the final brackets [s].
        progress: Called with a word on every batch of runs that starts.

    Returns:
        Plain values under the keys of the command line's JSON. `critical_delay_sampled_s` is the
        middle of `bracket_s`; the continuous one is unknown to this method and None.

    Raises:
        ControllerError: The controller broke the protocol.
        ArgumentError: A setting is out of range.
    """
    steps = Stepping() if stepping is None else stepping
    longest = check_positive("max_delay", max_delay, "seconds")
    check_positive("resolution", resolution, "seconds")
    if longest > MOST_COARSE * COARSE_STEP:
        raise ArgumentError(
            f"max_delay = {longest:g} s is too long to simulate; "
            f"give {MOST_COARSE * COARSE_STEP:g} s or less"
        )
    probe = _Probe(controller, vehicle, steps, track, seed)
    tell = progress or (lambda _: None)
    tell("coarse scan")
    count = max(2, int(np.ceil(longest / COARSE_STEP)) + 1) if vehicle.num_actuators else 1
    delays = np.linspace(0.0, longest, count)
    stable = probe.stable(delays)
    brackets: list[dict[str, Any]] = []
    for k in np.flatnonzero(stable[1:] != stable[:-1]):
        low, high = float(delays[k]), float(delays[k + 1])
        while high - low > resolution:
            tell(f"{1000 * low:.1f} to {1000 * high:.1f} ms")
            inner = np.linspace(low, high, _SUBDIVISION + 2)
            verdicts = np.concatenate([[stable[k]], probe.stable(inner[1:-1]), [stable[k + 1]]])
            change = int(np.flatnonzero(verdicts[1:] != verdicts[:-1])[0])
            low, high = float(inner[change]), float(inner[change + 1])
        direction = "stable" if stable[k + 1] else "unstable"
        brackets.append({"bracket_s": [low, high], "direction": direction})
    answer: dict[str, Any] = {
        "critical_delay_s": None,
        "critical_delay_sampled_s": None,
        "control_period_s": steps.control_period,
        "frequency_hz": None,
        "mode": None,
        "crossings": [],
        "bracket_s": None,
        "limit_cycle": None,
        "max_delay_s": longest,
        "method": "simulation",
        "note": "the continuous critical delay is not computed by simulation",
        "proved": False,
    }
    for bracket in brackets:
        low, high = bracket["bracket_s"]
        unstable = high if bracket["direction"] == "unstable" else low
        tell("shape at the change")
        frequency, name = probe.oscillation(unstable)
        answer["crossings"].append(
            {"delay_s": (low + high) / 2, "frequency_hz": frequency, "mode": name, **bracket}
        )
    if not stable[0]:
        answer["critical_delay_sampled_s"] = 0.0
        return answer
    first = next((c for c in answer["crossings"] if c["direction"] == "unstable"), None)
    if first is not None:
        answer["critical_delay_sampled_s"] = first["delay_s"]
        answer["bracket_s"] = first["bracket_s"]
        answer["frequency_hz"], answer["mode"] = first["frequency_hz"], first["mode"]
        tell("limit cycle")
        beyond = float(delays[np.flatnonzero(~stable)[0]])
        answer["limit_cycle"] = probe.limit_cycle(beyond)
    return answer


def unstable_by_simulation(
    answer: dict[str, Any], delays: Sequence[float]
) -> dict[float, bool | None]:
    """Read from a simulated answer whether the loop is unstable at some delays.

    Args:
        answer: What `simulated_critical_delay` returned.
        delays: Delays up to the answer's longest one [s].

    Returns:
        For each delay, None inside a bracket.
    """
    verdicts: dict[float, bool | None] = {}
    for delay in delays:
        unstable: bool | None = answer["critical_delay_sampled_s"] == 0.0
        for crossing in answer["crossings"]:
            low, high = crossing["bracket_s"]
            if low < delay < high:
                unstable = None
            elif delay >= high:
                unstable = crossing["direction"] == "unstable"
        verdicts[delay] = unstable
    return verdicts


class _Probe:
    """Excites a batch of vehicles, takes the track away, and watches."""

    def __init__(
        self,
        controller: Controller,
        vehicle: LateralVehicle,
        stepping: Stepping,
        track: str,
        seed: int,
    ) -> None:
        self._vehicle, self._stepping, self._seed = vehicle, stepping, seed
        self._record = (*ACCELERATIONS, *force_names(vehicle), *COORDINATES)
        self._batch = ControlledBatch(controller, vehicle, self._record, stepping)
        # The rear wheelset leaves the irregularity last.
        clear = float(vehicle.wheelset_setback.max()) / vehicle.speed + 0.5
        self._excited = int(np.ceil((EXCITATION + clear) / stepping.control_period))
        duration = self._excited * stepping.control_period
        length = required_length(vehicle, duration) + TAPER
        irregular = make_track(track, length, seed)
        end = required_length(vehicle, EXCITATION) - TAPER
        if end <= 0.0:
            raise ArgumentError("the vehicle is too slow for the excitation; raise the speed")
        steps = self._excited * self._batch.simulation.steps_per_command
        faded = irregular.ended(end, TAPER)
        self._inputs = wheelset_inputs(vehicle, faded, stepping.time_step, steps)
        # About five seconds; windows only have to be alike.
        self._window = max(1, round(_WINDOW / stepping.control_period))

    def stable(self, delays: FloatArray) -> NDArray[np.bool_]:
        """Say for each delay whether the motion tends to zero."""
        self._excite(delays)
        amplitudes, saturated = self._watch(round(FREE_RUN / _WINDOW))
        return np.array([_tends_to_zero(lane) for lane in amplitudes]) & ~saturated

    def oscillation(self, delay: float) -> tuple[float, str]:
        """Return frequency [Hz] and mode name of the motion that is left after the free run."""
        self._excite(np.array([delay]))
        self._watch(round(FREE_RUN / _WINDOW) - 2)
        signals = np.concatenate([self._batch.advance()[0] for _ in range(2 * self._window)])
        step = self._stepping.time_step
        time = step * np.arange(len(signals))
        taper = np.hanning(len(signals))
        floor = signals[:, :2].sum(axis=1) * taper
        bins = np.fft.rfftfreq(16 * len(signals), step)
        frequency = float(bins[np.argmax(np.abs(np.fft.rfft(floor, 16 * len(signals))))])
        first = self._record.index(COORDINATES[0])
        q = signals[:, first : first + len(COORDINATES)]
        shape = (q * (taper * np.exp(-2j * np.pi * frequency * time))[:, None]).sum(axis=0)
        return frequency, mode_name(self._vehicle, 2j * np.pi * frequency, shape)

    def limit_cycle(self, delay: float) -> dict[str, Any]:
        """Return what the growing motion ends in: amplitudes over the last window."""
        self._excite(np.array([delay]))
        windows = 3 * round(FREE_RUN / _WINDOW)
        amplitudes = self._watch(windows)[0][0]
        last = np.concatenate([self._batch.advance()[0] for _ in range(self._window)])
        forces = last[:, len(ACCELERATIONS) : len(ACCELERATIONS) + self._vehicle.num_actuators]
        peak = np.abs(last[:, :2]).max(axis=0)
        settled = bool(np.isfinite(amplitudes[-1])) and bool(
            abs(amplitudes[-1] / amplitudes[-4] - 1.0) < 0.02
        )
        return {
            "delay_s": delay,
            "settled": settled,
            "floor_front_amplitude": _plain(peak[0]),
            "floor_rear_amplitude": _plain(peak[1]),
            "force_amplitude": _plain(np.abs(forces).max(initial=0.0)),
        }

    def _excite(self, delays: FloatArray) -> None:
        """Run the excitation, scaled down lane by lane until the commands are small at its end."""
        m = self._vehicle.num_actuators
        limit = self._stepping.actuator.force_limit
        lanes = np.repeat(delays[:, None], m, axis=1)
        scale = np.ones(len(delays))
        for _ in range(_RESCALINGS):
            inputs = scale[:, None, None] * self._inputs
            self._batch.reset(lanes, inputs, np.arange(len(delays)), self._seed)
            peak = np.zeros(len(delays))
            for k in range(self._excited):
                self._batch.advance()
                if k >= self._excited - self._window // 5 and m:
                    peak = np.maximum(peak, np.abs(self._batch.commands).max(axis=1))
            if limit is None or not m:
                break
            too_large = ~(peak <= COMMAND_SHARE * limit) | self._batch.blown_up
            if not np.any(too_large):
                break
            # A saturated run does not tell by how much: then go down by a fixed factor.
            factor = np.clip(0.5 * COMMAND_SHARE * limit / np.maximum(peak, 1.0), 0.02, 0.5)
            scale[too_large] *= factor[too_large]
        self._batch.simulation.end_track()

    def _watch(self, windows: int) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Watch the free motion.

        Returns:
            RMS acceleration of successive windows, shape (lanes, windows), and which lanes have
            reached the force limit: having started at a fifth of it, they have grown.
        """
        lanes = self._batch.simulation.num_lanes
        limit = self._stepping.actuator.force_limit
        amplitudes = np.empty((lanes, windows))
        saturated = np.zeros(lanes, dtype=bool)
        for w in range(windows):
            energy = np.zeros(lanes)
            for _ in range(self._window):
                outputs = self._batch.advance()[:, :, : len(ACCELERATIONS)]
                energy += np.mean(np.square(outputs), axis=(1, 2))
                if limit is not None:
                    saturated |= np.any(np.abs(self._batch.commands) >= limit, axis=1)
            amplitudes[:, w] = np.sqrt(energy / self._window)
        return amplitudes, saturated


def _tends_to_zero(amplitudes: FloatArray) -> bool:
    """Judge one lane from its windows.

    It tends to zero if it has decayed to nothing, or if it falls over the second half by more than
    `_FLAT` and has not grown since the start. A limit cycle is flat.
    """
    if not np.all(np.isfinite(amplitudes)):
        return False
    if amplitudes[-1] <= _DECAYED * amplitudes[0]:
        return True
    late = amplitudes[len(amplitudes) // 2 :]
    time = _WINDOW * np.arange(len(late))
    rate = np.polyfit(time, np.log(np.maximum(late, 1e-300)), 1)[0]
    return bool(rate < -_FLAT and amplitudes[-1] < _GROWN * amplitudes[0])


def _plain(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None
