"""The probe of `eval.delay_probe` for the nonlinear vehicle.

A vehicle on real profiles may hunt for ever by itself, in a limit cycle that no controller made and
that the track's irregularity sets going. So a run without any control is watched first, after the
excitation at its full level. If its bogies have settled in a motion that does not fade, that is the
vehicle's own hunting: the carbody's motion well below the hunting frequency is then judged as the
linear vehicle's whole motion is, and what is faster must end within twice what the run without
control has there. Without such hunting the whole of the carbody's motion is judged.

It is the carbody's motion (both floor ends) that is judged: it is where a delayed force acts.

Simulation takes time, so a lane is not run on once the answer is plain: its motion has fallen to a
ten-thousandth (or to a twentieth of what the hunting has), or grown fourfold, or reached the force
limit (having started at a fifth of it or less), or its vehicle has derailed.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import cheby2, sosfilt

from baselines.controller import Controller
from eval.delay_probe import FREE_RUN, WINDOW, Probe, tends_to_zero
from eval.rollout import Stepping
from eval.simulations import Vehicle
from railenv.units import FloatArray

_FADED = 1e-4
_FADED_BESIDE_HUNTING = 0.05
_GROWN = 4.0
# Windows of a limit cycle agree to some per cent; bogies without one have decayed by decades.
_SETTLED = 0.1
_MOST_HUNTING = 2.0
# Bogies that follow a slowly decaying carbody do not hunt; its modes lie below this [Hz].
_SLOWEST_HUNTING = 2.5
# The carbody's modes that delay makes unstable lie below 2 Hz, the hunting at 5 Hz and above: the
# filter passes 0.6 of the hunting frequency and is 80 dB down at 0.9 of it.
_FILTER_ORDER, _FILTER_LOSS, _FILTER_EDGE = 10, 80.0, 0.9
_SLOW = 0.6
_FLOORS, _BOGIES = slice(0, 2), slice(2, 4)


@dataclass(frozen=True)
class Hunting:
    """The motion that a vehicle keeps up by itself.

    Attributes:
        frequency: Its frequency [Hz]; 0 for none.
        floor: RMS acceleration of the floor it makes [m/s^2].
        bogie: RMS acceleration of the bogie frames [m/s^2].
    """

    frequency: float
    floor: float
    bogie: float


class FullProbe(Probe):
    """Excites a batch of nonlinear vehicles, takes the track away, and watches.

    Args:
        controller: The controller.
        vehicle: The vehicle.
        stepping: Steps, limits and lag.
        track: Irregularity that excites.
        seed: Seed of the irregularity, and given to the controller.

    Raises:
        ArgumentError: The vehicle is too slow, or a setting is out of range.
    """

    # Vehicles derail where the linear one only leaves its range: much less is needed then.
    lost_factor = 0.05

    def __init__(
        self, controller: Controller, vehicle: Vehicle, stepping: Stepping, track: str, seed: int
    ) -> None:
        super().__init__(controller, vehicle, stepping, track, seed)
        self._hunting: Hunting | None = None

    @property
    def hunting(self) -> Hunting:
        """What the vehicle does without control after the excitation at its full level."""
        if self._hunting is None:
            batch, windows = self._batch, round(FREE_RUN / WINDOW / 2)
            batch.silent = np.ones(1, dtype=bool)
            self._excite(np.zeros(1))
            signals = np.array(
                [
                    np.concatenate([batch.advance()[0, :, :4] for _ in range(self._window)])
                    for _ in range(windows)
                ]
            )
            batch.silent = None
            self._hunting = _hunting(signals, self._stepping.time_step)
            if self._hunting.frequency > 0.0:
                self.highest_frequency = _SLOW * self._hunting.frequency
        return self._hunting

    def stable(self, delays: FloatArray) -> NDArray[np.bool_]:
        """Say for each delay whether the carbody's motion tends to zero, hunting apart."""
        own = self.hunting.floor
        self._excite(delays)
        verdict = np.zeros(len(delays), dtype=np.int64)
        slow, fast = self.watch_windows(verdict)
        for lane in np.flatnonzero(verdict == 0):
            calm = tends_to_zero(slow[lane]) and fast[lane, -1] <= _MOST_HUNTING * own
            verdict[lane] = 1 if calm else -1
        return verdict > 0

    def watch_windows(self, verdict: NDArray[np.int64] | None = None) -> tuple[FloatArray, ...]:
        """Watch the free motion.

        Args:
            verdict: Becomes 1 for a lane that is plainly stable and -1 for one that is not; such a
                lane is not run on. None to run all lanes to the end.

        Returns:
            RMS floor acceleration of successive windows, slow part and fast part, each of shape
            (lanes, windows); without hunting all of it is the slow part and the fast one is zero.
        """
        batch, limit = self._batch, self._stepping.actuator.force_limit
        lanes, number = batch.simulation.num_lanes, round(FREE_RUN / WINDOW)
        own, frequency = self.hunting.floor, self.hunting.frequency
        sections = _low_pass(frequency, self._stepping.time_step) if frequency else None
        memory = np.zeros((0 if sections is None else len(sections), lanes, 2, 2))
        slow, fast = np.full((lanes, number), np.nan), np.full((lanes, number), np.nan)
        for w in range(number):
            energy, rest = np.zeros(lanes), np.zeros(lanes)
            saturated = np.zeros(lanes, dtype=bool)
            for _ in range(self._window):
                floor = passed = np.swapaxes(batch.advance()[:, :, _FLOORS], 1, 2)
                if sections is not None:
                    passed, memory = sosfilt(sections, floor, axis=-1, zi=memory)
                energy += np.mean(np.square(passed), axis=(1, 2))
                rest += np.mean(np.square(floor), axis=(1, 2))
                if limit is not None and self._vehicle.num_actuators:
                    saturated |= np.any(np.abs(batch.commands) >= limit, axis=1)
            slow[:, w] = np.sqrt(energy / self._window)
            # Slow and fast part share no frequency, so their energies add up.
            fast[:, w] = np.sqrt(np.maximum(rest - energy, 0.0) / self._window)
            if verdict is None:
                continue
            now, first = slow[:, w], np.maximum(slow[:, 0], own)
            plainly = saturated | ~(now <= _GROWN * first)
            verdict[(verdict == 0) & plainly] = -1
            faded = now <= np.maximum(_FADED * first, _FADED_BESIDE_HUNTING * own)
            calm = faded & ((fast[:, w] <= _MOST_HUNTING * own) | (frequency == 0.0))
            verdict[(verdict == 0) & calm] = 1
            batch.simulation.stop(verdict != 0)
            if np.all(verdict != 0):
                break
        return slow, fast


def _low_pass(frequency: float, time_step: float) -> FloatArray:
    """Return the sections of the filter that keeps what is slower than hunting."""
    edge = _FILTER_EDGE * frequency
    return cheby2(_FILTER_ORDER, _FILTER_LOSS, edge, fs=1.0 / time_step, output="sos")


def _hunting(signals: FloatArray, time_step: float) -> Hunting:
    """Judge a run without control.

    Args:
        signals: Accelerations of both floor ends and both bogie frames, (windows, steps, 4).
        time_step: Time between them [s].
    """
    bogies = np.sqrt(np.mean(np.square(signals[:, :, _BOGIES]), axis=(1, 2)))
    late = bogies[-4:]
    if not np.all(np.isfinite(bogies)) or late.max() > (1.0 + _SETTLED) * late.min():
        return Hunting(0.0, 0.0, 0.0)
    last = signals[-4:].reshape(-1, signals.shape[2])
    taper = np.hanning(len(last))[:, None]
    spectrum = np.abs(np.fft.rfft(last[:, _BOGIES] * taper, axis=0)).sum(axis=1)
    bins = np.fft.rfftfreq(len(last), time_step)
    frequency = float(bins[np.argmax(spectrum)])
    if frequency < _SLOWEST_HUNTING:
        return Hunting(0.0, 0.0, 0.0)
    floor = last[:, _FLOORS].T
    passed = sosfilt(_low_pass(frequency, time_step), floor, axis=-1)
    # The filter needs the first half to settle; what it passes is late, so energies are compared.
    energy, slow = (np.mean(np.square(x[:, len(last) // 2 :])) for x in (floor, passed))
    return Hunting(frequency, float(np.sqrt(max(energy - slow, 0.0))), float(late.max()))
