"""Safety of many runs of the nonlinear vehicle side by side: the worst of every lane.

Forces are means over a control period, see `eval.full50_safety`.
"""

import numpy as np

from eval.rollout import ControlledBatch
from eval.simulations import FullRuns, Vehicle
from railenv.units import FloatArray
from railenv.vehicle.nonlinear import FullVehicle
from railenv.vehicle.nonlinear.rates import WHEEL_COLUMNS

_LOAD, _GUIDING = WHEEL_COLUMNS.index("vertical"), WHEEL_COLUMNS.index("lateral")


class SafetyOfLanes:
    """Keeps derailment quotient and wheel unloading; give `watch` to `eval.rollout.rollout`.

    Args:
        vehicle: The vehicle; of a linear one, which has no wheel loads, nothing is kept.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self._static_load = 0.0
        if isinstance(vehicle, FullVehicle):
            self._static_load = vehicle.parameters.lateral.axle_load / 2.0
        self._quotient: FloatArray = np.zeros(0)
        self._unloading: FloatArray = np.zeros(0)

    def watch(self, batch: ControlledBatch, _: FloatArray) -> None:
        """Note one control period."""
        if not isinstance(batch.simulation, FullRuns):
            return
        wheels = batch.simulation.wheels
        load, outwards = wheels[..., _LOAD], wheels[..., _GUIDING]
        bearing = load > 0.0
        quotient = np.where(bearing, outwards, 0.0) / np.where(bearing, load, 1.0)
        worst, lifted = quotient.max(axis=1), 1.0 - load.min(axis=1) / self._static_load
        if not len(self._quotient):
            self._quotient, self._unloading = np.zeros(len(worst)), np.zeros(len(worst))
        # Lanes that have ended stand still, and what stands there says nothing.
        running = ~batch.blown_up
        self._quotient = np.where(running, np.maximum(self._quotient, worst), self._quotient)
        self._unloading = np.where(running, np.maximum(self._unloading, lifted), self._unloading)

    def lane(self, index: int) -> dict[str, float | None]:
        """Return a lane's worst values: `derailment_quotient` and `wheel_unloading` [1]."""
        if not len(self._quotient):
            return {"derailment_quotient": None, "wheel_unloading": None}
        return {
            "derailment_quotient": float(self._quotient[index]),
            "wheel_unloading": float(self._unloading[index]),
        }
