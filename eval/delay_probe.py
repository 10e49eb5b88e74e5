"""One delay, or several, judged by simulation: excite, take the track away, watch what is left.

The excitation is scaled down, lane by lane, until the command is below a fifth of the force limit
when the track ends: from large motion the limit would turn growth into a limit cycle, or even into
decay. The commands of semi-active dampers are coefficients, which say nothing of the motion's size
and are at the ends of their range in the smallest motion: there the dampers' forces are judged in
their place, which end at the same limit.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.controller import Controller
from eval.rollout import ACCELERATIONS, ControlledBatch, Stepping, force_names
from eval.simulations import SemiActiveRuns, Vehicle, lateral_twin
from railenv.errors import ArgumentError
from railenv.track import make_track
from railenv.units import FloatArray
from railenv.vehicle import mode_name
from railenv.vehicle.coordinates import COORDINATES

EXCITATION = 10.0
"""Time on irregular track before it is removed [s], as in the paper."""

TAPER = 50.0
"""Distance over which the irregularity fades out [m]."""

FREE_RUN = 120.0
"""Time watched after the track has ended [s]."""

COMMAND_SHARE = 0.2
"""Largest command when the track ends, as a share of the force limit; of dampers, the force."""

WINDOW = 5.0
"""Length of the windows in which the free motion is measured [s]."""

_RESCALINGS = 12
# Amplitudes below this share of the first window are rounding noise of a decayed motion.
_DECAYED = 1e-9
# A slower decay than this [1/s] counts as none; at the paper's loop it moves the answer by 0.01 ms.
_FLAT = 1e-4
# Two modes beating can raise a decaying amplitude for a while, but not this much.
_GROWN = 2.0


class Probe:
    """Excites a batch of vehicles, takes the track away, and watches.

    Args:
        controller: The controller.
        vehicle: The vehicle.
        stepping: Steps, limits and lag.
        track: Irregularity that excites.
        seed: Seed of the irregularity, and given to the controller.

    Raises:
        ArgumentError: The vehicle is too slow, or a setting is out of range.
    """

    lost_factor = 0.5
    """A lane that was lost is excited again with this much less, or less still."""

    highest_frequency = np.inf
    """What oscillates faster is not taken for the loop's motion [Hz]."""

    def __init__(
        self,
        controller: Controller,
        vehicle: Vehicle,
        stepping: Stepping,
        track: str,
        seed: int,
    ) -> None:
        self._vehicle, self._stepping, self._seed = vehicle, stepping, seed
        self._record = (*ACCELERATIONS, *force_names(vehicle), *COORDINATES)
        self._batch = ControlledBatch(controller, vehicle, self._record, stepping)
        self._on_dampers = isinstance(self._batch.simulation, SemiActiveRuns)
        # The rear wheelset leaves the irregularity last.
        clear = float(max(vehicle.wheelset_setback)) / vehicle.speed + 0.5
        self._excited = int(np.ceil((EXCITATION + clear) / stepping.control_period))
        duration = self._excited * stepping.control_period
        length = vehicle.speed * duration + TAPER
        irregular = make_track(track, length, seed)
        end = vehicle.speed * EXCITATION - TAPER
        if end <= 0.0:
            raise ArgumentError("the vehicle is too slow for the excitation; raise the speed")
        self._track = irregular.ended(end, TAPER)
        # About five seconds; windows only have to be alike.
        self._window = max(1, round(WINDOW / stepping.control_period))

    def stable(self, delays: FloatArray) -> NDArray[np.bool_]:
        """Say for each delay whether the motion tends to zero."""
        self._excite(delays)
        amplitudes, saturated = self._watch(round(FREE_RUN / WINDOW))
        return np.array([tends_to_zero(lane) for lane in amplitudes]) & ~saturated

    def oscillation(self, delay: float) -> tuple[float, str]:
        """Return frequency [Hz] and mode name of the motion that is left after the free run."""
        self._excite(np.array([delay]))
        self._watch(round(FREE_RUN / WINDOW) - 2)
        signals = np.concatenate([self._batch.advance()[0] for _ in range(2 * self._window)])
        step = self._stepping.time_step
        time = step * np.arange(len(signals))
        taper = np.hanning(len(signals))
        floor = signals[:, :2].sum(axis=1) * taper
        bins = np.fft.rfftfreq(16 * len(signals), step)
        size = np.abs(np.fft.rfft(floor, 16 * len(signals)))
        frequency = float(bins[np.argmax(np.where(bins <= self.highest_frequency, size, 0.0))])
        first = self._record.index(COORDINATES[0])
        q = signals[:, first : first + len(COORDINATES)]
        shape = (q * (taper * np.exp(-2j * np.pi * frequency * time))[:, None]).sum(axis=0)
        return frequency, mode_name(lateral_twin(self._vehicle), 2j * np.pi * frequency, shape)

    def limit_cycle(self, delay: float) -> dict[str, Any]:
        """Return what the growing motion ends in: amplitudes over the last window."""
        self._excite(np.array([delay]))
        windows = 3 * round(FREE_RUN / WINDOW)
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
            self._batch.reset(lanes, (self._track,), seed=self._seed, level=scale)
            peak = np.zeros(len(delays))
            for k in range(self._excited):
                outputs = self._batch.advance()
                if k >= self._excited - self._window // 5 and m:
                    peak = np.maximum(peak, self._asked(outputs))
            if limit is None or not m:
                break
            too_large = ~(peak <= COMMAND_SHARE * limit) | self._batch.blown_up
            if not np.any(too_large):
                break
            # A saturated run does not tell by how much: then go down by a fixed factor.
            factor = np.clip(0.5 * COMMAND_SHARE * limit / np.maximum(peak, 1.0), 0.02, 0.5)
            factor[self._batch.blown_up] = np.minimum(
                factor[self._batch.blown_up], self.lost_factor
            )
            scale[too_large] *= factor[too_large]
        self._batch.simulation.end_track()

    def _asked(self, outputs: FloatArray) -> FloatArray:
        """Return the largest force asked for in a control period just recorded, (lanes,) [N].

        That of the actuators' commands, or of the dampers themselves.
        """
        if not self._vehicle.num_actuators:
            return np.zeros(len(outputs))
        if not self._on_dampers:
            return np.abs(self._batch.commands).max(axis=1)
        first = len(ACCELERATIONS)
        forces = outputs[:, :, first : first + self._vehicle.num_actuators]
        return np.abs(forces).max(axis=(1, 2))

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
                outputs = self._batch.advance()
                energy += np.mean(np.square(outputs[:, :, : len(ACCELERATIONS)]), axis=(1, 2))
                if limit is not None:
                    saturated |= self._asked(outputs) >= limit
            amplitudes[:, w] = np.sqrt(energy / self._window)
        return amplitudes, saturated


def tends_to_zero(amplitudes: FloatArray) -> bool:
    """Judge one lane from its windows.

    It tends to zero if it has decayed to nothing, or if it falls over the second half by more than
    `_FLAT` and has not grown since the start. A limit cycle is flat.
    """
    if not np.all(np.isfinite(amplitudes)):
        return False
    if amplitudes[-1] <= _DECAYED * amplitudes[0]:
        return True
    late = amplitudes[len(amplitudes) // 2 :]
    time = WINDOW * np.arange(len(late))
    rate = np.polyfit(time, np.log(np.maximum(late, 1e-300)), 1)[0]
    return bool(rate < -_FLAT and amplitudes[-1] < _GROWN * amplitudes[0])


def _plain(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None
