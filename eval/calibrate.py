"""Calibration of the `paper_fit` vehicle: `python -m eval.calibrate`.

The source paper does not print the anti-roll stiffness and the vertical damping of the secondary
suspension. Both are fitted here, by least squares, so that the loop it reports crosses where it
says: four actuators, sky-hook 35 kN s/m, 300 km/h, first crossing at 202 ms and 1.323 Hz. The
measured velocity is the carbody's at damper level above the bogies' centres. Two equations, two
unknowns: the result is a fit, not a measurement, and frozen in `railenv.vehicle.catalogue`.
"""

import numpy as np
from scipy.optimize import least_squares

from railenv.stability import Crossing, DelaySystem, critical_delays
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle, VehicleParameters, get_vehicle, lateral17, state_space
from railenv.vehicle.coordinates import NUM_COORDINATES, lateral_of_point

GAIN = 35e3
"""Sky-hook gain of the paper's example [N s/m]."""

TARGET_DELAY, TARGET_FREQUENCY_HZ = 0.202, 1.323
"""What the paper reports for it [s], [Hz]."""

_START = (4e6, 60e3)


def centre_feedback(vehicle: LateralVehicle, gain: float) -> DelaySystem:
    """Return the loop with velocities measured above the bogies' centres, at damper level."""
    system = state_space(vehicle)
    p = vehicle.parameters
    K = np.zeros((system.num_actuators, system.A.shape[0]))
    for channel in range(system.num_actuators):
        place = (
            p.half_bogie_spacing if channel < system.num_actuators / 2 else -p.half_bogie_spacing
        )
        row = lateral_of_point("carbody", place, p.carbody_to_damper_height)
        K[channel, NUM_COORDINATES : 2 * NUM_COORDINATES] = gain * row
    return DelaySystem(system.A, system.actuator_input, K)


def first_crossing(parameters: VehicleParameters) -> Crossing:
    """Return where the paper's loop first loses stability with these parameters."""
    vehicle = lateral17(parameters, 4, 300.0)
    first = critical_delays(centre_feedback(vehicle, GAIN), 0.5).first
    if first is None:
        raise RuntimeError("the loop does not lose stability: the fit has left its ground")
    return first


def fit(parameters: VehicleParameters) -> VehicleParameters:
    """Return the parameters with anti-roll stiffness and vertical damping fitted."""

    def changed(logs: FloatArray) -> VehicleParameters:
        stiffness, damping = (float(value) for value in np.exp(logs))
        return parameters.replace(antiroll_stiffness=stiffness, secondary_vertical_damping=damping)

    def miss(logs: FloatArray) -> list[float]:
        crossing = first_crossing(changed(logs))
        return [
            crossing.delay / TARGET_DELAY - 1.0,
            crossing.frequency_hz / TARGET_FREQUENCY_HZ - 1.0,
        ]

    return changed(least_squares(miss, np.log(_START), xtol=1e-12, ftol=1e-12).x)


def main() -> None:
    """Fit, and print the result beside the frozen values."""
    frozen = get_vehicle("paper_fit").parameters
    for name, parameters in (("fitted now", fit(frozen)), ("frozen", frozen)):
        crossing = first_crossing(parameters)
        print(
            f"{name:<10}  anti-roll stiffness {parameters.antiroll_stiffness / 1e6:.4f} MN m/rad, "
            f"vertical damping {parameters.secondary_vertical_damping / 1e3:.3f} kN s/m  ->  "
            f"{1000 * crossing.delay:.3f} ms, {crossing.frequency_hz:.5f} Hz"
        )


if __name__ == "__main__":
    main()
