"""Safety of a run of the nonlinear vehicle, and its vertical comfort.

Forces are means over a control period. EN 14363 takes sliding means over 2 m; 10 ms at 300 km/h are
0.83 m, so peaks here are no smaller than there.
"""

import numpy as np

from eval.rollout import ControlledBatch
from eval.simulations import FullRuns
from railenv.metrics import sperling
from railenv.simulation import Trajectory
from railenv.units import FloatArray
from railenv.vehicle.nonlinear import FullVehicle
from railenv.vehicle.nonlinear.rates import WHEEL_COLUMNS

VERTICAL = ("floor_front_vertical_acceleration", "floor_rear_vertical_acceleration")
"""What is recorded for vertical comfort, 1 m right of the centre line."""

_LOAD, _GUIDING = WHEEL_COLUMNS.index("vertical"), WHEEL_COLUMNS.index("lateral")
_SHIFT = WHEEL_COLUMNS.index("shift")


class SafetyWatch:
    """Keeps the worst of lane 0 over a run; give `watch` to `eval.rollout.rollout`.

    Args:
        vehicle: The vehicle, for its static wheel load.

    Attributes:
        derailment_quotient: Largest Y / Q of a wheel that bears on its rail, guiding force outwards
            over wheel load [1].
        wheel_unloading: Largest 1 - Q / Q_0 of a wheel [1].
        guiding_force: Largest sum of the guiding forces of a wheelset's two wheels [N].
        wheelset_shift: Largest displacement of a wheelset on a rail [m].
        derailed_at: When the vehicle derailed [s]; None if it did not.
    """

    def __init__(self, vehicle: FullVehicle) -> None:
        self._static_load = vehicle.parameters.lateral.axle_load / 2.0
        self.derailment_quotient, self.wheel_unloading = 0.0, 0.0
        self.guiding_force, self.wheelset_shift = 0.0, 0.0
        self.derailed_at: float | None = None
        self._periods = 0

    def watch(self, batch: ControlledBatch, _: FloatArray) -> None:
        """Note one control period; what was recorded in it is not needed."""
        if not isinstance(batch.simulation, FullRuns) or self.derailed_at is not None:
            return
        self._periods += 1
        wheels = batch.simulation.wheels[0]
        load, outwards = wheels[:, _LOAD], wheels[:, _GUIDING]
        bearing = load > 0.0
        if np.any(bearing):
            worst = float(np.max(outwards[bearing] / load[bearing]))
            self.derailment_quotient = max(self.derailment_quotient, worst)
        unloading = 1.0 - float(load.min()) / self._static_load
        self.wheel_unloading = max(self.wheel_unloading, unloading)
        # Outwards is to the right for a right wheel and to the left for a left one.
        sums = outwards[1::2] - outwards[::2]
        self.guiding_force = max(self.guiding_force, float(np.abs(sums).max()))
        self.wheelset_shift = max(self.wheelset_shift, float(np.abs(wheels[:, _SHIFT]).max()))
        if batch.simulation.derailed[0]:
            self.derailed_at = self._periods * batch.stepping.control_period

    def answer(self, trajectory: Trajectory, skip: float) -> dict[str, float | bool | None]:
        """Return plain values: the worst of the whole run, and vertical comfort of lane 0.

        Args:
            trajectory: The run, with the signals `VERTICAL`.
            skip: Time left out of comfort at the start [s].
        """
        values: dict[str, float | bool | None] = {
            "derailed": self.derailed_at is not None,
            "derailed_at_s": self.derailed_at,
            "derailment_quotient": self.derailment_quotient,
            "wheel_unloading": self.wheel_unloading,
            "guiding_force": self.guiding_force,
            "wheelset_shift": self.wheelset_shift,
        }
        start = int(np.searchsorted(trajectory.time, skip * (1 + 1e-12), side="right"))
        for name in VERTICAL:
            end, signal = name.split("_")[1], trajectory.signal(name)[0, start:]
            index = None
            if np.all(np.isfinite(signal)):
                index = float(sperling(signal, trajectory.sample_rate, direction="vertical"))
            values[f"ride_index_vertical_{end}"] = index
        return values
