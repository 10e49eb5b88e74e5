"""Comfort of a linear loop over random track, as an integral over frequency, with its gradient.

At every frequency the loop is one small linear system: readings y = Gy w + Hy u, modal forces
u = -exp(-j omega tau) K y, floor accelerations z = Gz w + Hz u. w are the two channels of the track
that act (alignment and cross level), each met by the four wheelsets one after the other. The mean
square of z through Sperling's comfort filter, summed over both, is an integral of the track's
density; with K it changes by

    dz = -Hz (I + e K Hy)^-1 e dK y,   e = exp(-j omega tau).

The delay is exact. The integral stands for a stationary response, so the loop must be stable.
"""

import numpy as np

from baselines.hinfinity_plant import FLOORS
from baselines.modal_signals import ModalSignals
from railenv.metrics import sperling_filter
from railenv.metrics.ride_filter import ride_index_from_mean_square
from railenv.track import get_spectrum
from railenv.units import ComplexArray, FloatArray, NewtonSecondPerMetre
from railenv.vehicle import LateralVehicle, state_space
from railenv.vehicle.coordinates import WHEELSETS
from railenv.vehicle.suspension import NUM_TRACK

_LOWEST, _HIGHEST, _POINTS = 0.3, 40.0, 300
# 1.6 % from one frequency to the next: a mode that decays with 0.25 1/s at 0.55 Hz is 15 % wide.


class LoopComfort:
    """Ride-filtered floor acceleration of the loop, as a function of modal gains and delay.

    Args:
        vehicle: The vehicle at its speed.
        signals: Readings and forces of the two modes.
        track: Name of the spectrum.
    """

    def __init__(
        self, vehicle: LateralVehicle, signals: ModalSignals, track: str = "german_low"
    ) -> None:
        frequency = np.geomspace(_LOWEST, _HIGHEST, _POINTS)
        self._omega = 2.0 * np.pi * frequency
        step = np.gradient(frequency)
        ride = np.asarray(sperling_filter(frequency))
        self._line: FloatArray = step
        self._weight: FloatArray = ride**2 * step
        system = state_space(vehicle)
        m, p = system.num_actuators, len(signals.readings)
        C, D = system.output_rows((*signals.sensors, *FLOORS))
        s = 1j * self._omega[:, None, None]
        states = np.linalg.solve(s * np.eye(len(system.A)) - system.A, system.B.astype(complex))
        response = C @ states + D
        mix = np.zeros((p + len(FLOORS), len(C)))
        mix[:p, : len(signals.sensors)] = signals.readings
        mix[p:, len(signals.sensors) :] = np.eye(len(FLOORS))
        forced = mix @ response[:, :, :m] @ signals.forces
        excited = mix @ response[:, :, m:] @ _track(vehicle, track, frequency)
        self._Hy, self._Hz = forced[:, :p], forced[:, p:]
        self._Gy, self._Gz = excited[:, :p], excited[:, p:]

    def mean_square(self, gain: FloatArray, delay: float) -> tuple[float, FloatArray]:
        """Return the weighted mean square, averaged over both floors, and its gradient.

        Args:
            gain: Modal gain K, shape (2, readings).
            delay: Between measurement and force [s].

        Returns:
            The mean square [(m/s^2)^2] and its derivative by the entries of K.
        """
        late = np.exp(-1j * self._omega * delay)[:, None, None]
        inverse = np.linalg.inv(np.eye(2) + late * (gain @ self._Hy))
        force = -inverse @ (late * (gain @ self._Gy))
        reading = self._Gy + self._Hy @ force
        floor = self._Gz + self._Hz @ force
        share = self._weight[:, None, None] / len(FLOORS)
        value = float(np.sum(np.abs(floor) ** 2 * share))
        # d value = 2 Re sum conj(floor) d floor, with d floor = -Hz inverse late dK reading.
        left = np.swapaxes(self._Hz @ inverse, 1, 2) @ (-2.0 * late * share * floor.conj())
        gradient = (left @ np.swapaxes(reading, 1, 2)).sum(axis=0).real
        return value, np.asarray(gradient)

    def index(self, gain: FloatArray, delays: tuple[float, ...]) -> tuple[float, FloatArray]:
        """Return the ride index of the mean square over both floors and several delays.

        Args:
            gain: Modal gain K, shape (2, readings).
            delays: Delays [s]; the mean squares of all are averaged.

        Returns:
            The estimate `ride_index_from_mean_square` [1] and its derivative by the entries of K.
        """
        parts = [self.mean_square(gain, delay) for delay in delays]
        value = float(np.mean([part for part, _ in parts]))
        gradient = np.mean([slope for _, slope in parts], axis=0)
        index = float(ride_index_from_mean_square(value))
        # Wz grows with the power 0.15 of the mean square.
        return index, np.asarray(0.15 * index / value * gradient)

    def reading_rms(self, gain: FloatArray) -> FloatArray:
        """Return the RMS of every reading without delay, shape (readings,)."""
        force = -np.linalg.solve(np.eye(2) + gain @ self._Hy, gain @ self._Gy)
        power = np.sum(np.abs(self._Gy + self._Hy @ force) ** 2, axis=2)
        return np.asarray(np.sqrt(self._line @ power))


def _track(vehicle: LateralVehicle, name: str, frequency: FloatArray) -> ComplexArray:
    """Return the track inputs per channel, times the square root of its density per hertz.

    Shape (frequencies, 16, 2): alignment and roll at the wheelsets, then their rates.
    """
    spectrum = get_spectrum(name)
    wavenumber = frequency / vehicle.speed
    inside = (wavenumber >= 1.0 / spectrum.longest_wavelength) & (
        wavenumber <= 1.0 / spectrum.shortest_wavelength
    )
    omega = 2.0 * np.pi * frequency[:, None]
    met = np.exp(-1j * omega * np.asarray(vehicle.wheelset_setback) / vehicle.speed)
    roll = 0.5 / vehicle.parameters.half_contact_spacing
    inputs = np.zeros((len(frequency), 2 * NUM_TRACK, 2), dtype=np.complex128)
    number = len(WHEELSETS)
    for column, (channel, share) in enumerate((("alignment", 1.0), ("cross_level", roll))):
        density = np.where(inside, spectrum.density(channel, wavenumber) / vehicle.speed, 0.0)
        motion = share * np.sqrt(density)[:, None] * met
        first = column * number
        inputs[:, first : first + number, column] = motion
        inputs[:, NUM_TRACK + first : NUM_TRACK + first + number, column] = 1j * omega * motion
    return inputs


def sky_hook_gain(signals: ModalSignals, gain: NewtonSecondPerMetre) -> FloatArray:
    """Return the modal gain of sky-hook damping that is the same in sway and in yaw.

    Args:
        signals: They hold the velocity.
        gain: Damping coefficient per actuator [N s/m].
    """
    K = np.zeros((2, len(signals.names)))
    for row, mode in enumerate(("sway", "yaw")):
        K[row, signals.names.index(f"velocity_{mode}")] = gain
    return K
