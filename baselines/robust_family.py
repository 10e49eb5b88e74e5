"""Static feedback of sway and yaw: its roots, crossings and comfort as functions of the gains.

Every reading of a mode (`baselines.modal_signals`) has one gain to the force of that mode. With
M(s) = s I - A + B K C exp(-s tau) and u, v the left and right null vectors at a root s,

    ds/dK_ij = -(u^H b_i) (c_j v) exp(-s tau) / (u^H M' v)
    ds/dtau  = s exp(-s tau) (u^H B K C v) / (u^H M' v)

and a crossing s = j omega at delay tau moves with dtau/dK = -Re(ds/dK) / Re(ds/dtau).
"""

import numpy as np
from scipy import linalg

from baselines.controller import LinearFeedback
from baselines.modal_signals import modal_signals
from baselines.robust_comfort import LoopComfort, sky_hook_gain
from baselines.robust_search import Piece
from railenv.errors import ArgumentError
from railenv.stability import DelaySystem, critical_delays, rightmost_roots
from railenv.units import ComplexArray, FloatArray
from railenv.vehicle import LateralVehicle, state_space

_ROOTS = 3
"""Rightmost roots whose real parts are told to the search, at each delay."""

_NEAR = 0.3
"""Crossings up to so long after the first are told as well [s]."""

_REFERENCE = 1e4
"""Sky-hook gain whose readings set the scale of the gains [N s/m]."""

_FORCE = 200.0
"""Force that a scaled gain of one gives for a reading's RMS there [N]."""


class ModalFamily:
    """All static feedback laws of some readings, sway to sway and yaw to yaw.

    Args:
        vehicle: With two or four actuators.
        kinds: Kinds of reading, some of `modal_signals.SIGNALS`, velocity among them.

    Attributes:
        vehicle: The vehicle.
        signals: Readings and forces.
        comfort: Comfort of the loop by modal gain and delay.
        scale: What a scaled gain of one is, per reading, shape (n,) [N per unit of the reading].

    Raises:
        ArgumentError: The vehicle has no actuator, a kind does not exist, or velocity is missing.
    """

    def __init__(self, vehicle: LateralVehicle, kinds: tuple[str, ...]) -> None:
        if not vehicle.num_actuators:
            raise ArgumentError("layout = 'passive' has no actuator; choose 2 or 4")
        if "velocity" not in kinds:
            raise ArgumentError(f"signals = {kinds!r} must hold 'velocity': sky-hook is the start")
        self.vehicle = vehicle
        self.signals = modal_signals(vehicle.layout, kinds)
        self.comfort = LoopComfort(vehicle, self.signals)
        system = state_space(vehicle)
        self._A = system.A
        self._B = system.actuator_input @ self.signals.forces
        self._C = self.signals.readings @ system.output_rows(self.signals.sensors)[0]
        rms = self.comfort.reading_rms(sky_hook_gain(self.signals, _REFERENCE))
        self.scale: FloatArray = _FORCE / rms

    def modal_gain(self, point: FloatArray) -> FloatArray:
        """Return the modal gain of scaled gains, shape (2, n)."""
        K = np.zeros((2, len(point)))
        K[self.signals.mode, np.arange(len(point))] = point * self.scale
        return K

    def point(self, gains: FloatArray) -> FloatArray:
        """Return the scaled gains of one gain per reading [N per unit of the reading]."""
        return np.asarray(gains / self.scale)

    def sky_hook(self, gain: float) -> FloatArray:
        """Return the scaled gains of sky-hook damping [N s/m]."""
        return self.point(sky_hook_gain(self.signals, gain).sum(axis=0))

    def controller(self, point: FloatArray) -> LinearFeedback:
        """Return the law of scaled gains for sensors and actuators."""
        gain = self.signals.forces @ self.modal_gain(point) @ self.signals.readings
        return LinearFeedback(gain, self.signals.sensors, self.vehicle.layout)

    def loop(self, point: FloatArray) -> DelaySystem:
        """Return the loop over the two modal forces."""
        return DelaySystem(self._A, self._B, self.modal_gain(point) @ self._C)

    def index(self, point: FloatArray, delays: tuple[float, ...]) -> Piece:
        """Return the ride index estimate over several delays, and its slope."""
        value, slope = self.comfort.index(self.modal_gain(point), delays)
        return value, self._along(slope)

    def roots(self, point: FloatArray, delay: float) -> list[Piece]:
        """Return the real parts of the rightmost roots at a delay [1/s], largest first."""
        loop = self.loop(point)
        found: list[Piece] = []
        for mode in rightmost_roots(loop, delay, _ROOTS):
            by_gain, _ = self._slopes(loop, mode.root, delay)
            found.append((mode.root.real, self._along(by_gain.real)))
        return found

    def crossings(self, point: FloatArray, max_delay: float) -> list[Piece]:
        """Return the first delays at which a root leaves the left half plane [s], smallest first.

        None at all up to `max_delay` gives that delay with slope zero; a loop that is unstable
        without delay gives an empty list.
        """
        loop = self.loop(point)
        found = critical_delays(loop, max_delay)
        first = found.critical_delay
        if first == 0.0:
            return []
        if first is None:
            return [(max_delay, np.zeros(len(point)))]
        pieces: list[Piece] = []
        for crossing in found.crossings:
            if crossing.direction < 0 or not first <= crossing.delay <= first + _NEAR:
                continue
            by_gain, by_delay = self._slopes(loop, crossing.mode.root, crossing.delay)
            pieces.append((crossing.delay, self._along(-by_gain.real / by_delay.real)))
        return pieces

    def _along(self, slope: FloatArray) -> FloatArray:
        """Return the slope by the scaled gains of a slope by the modal gain's entries."""
        return np.asarray(slope[self.signals.mode, np.arange(len(self.scale))] * self.scale)

    def _slopes(
        self, loop: DelaySystem, root: complex, delay: float
    ) -> tuple[ComplexArray, complex]:
        """Return ds/dK, shape (2, n), and ds/dtau of a simple root."""
        scaled, delays = loop.scaled, loop.delays(delay)
        U, _, V = linalg.svd(scaled.characteristic_matrix(root, delays))
        left, right = U[:, -1].conj(), V[-1].conj()
        slope = left @ scaled.characteristic_derivative(root, delays) @ right
        pushed = left @ scaled.B * np.exp(-root * delay) / slope
        seen = (self._C * loop.state_scale) @ right
        by_delay = root * (pushed @ (scaled.K @ right))
        return -np.outer(pushed, seen), complex(by_delay)
