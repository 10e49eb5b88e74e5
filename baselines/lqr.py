"""Linear quadratic regulator: a constant gain on the vehicle's full state, designed without delay.

u = -K x(t - tau) with K from the Riccati equation of

    J = integral of a_front^2 + a_rear^2 + (stroke/stroke_scale)^2 + effort |u|^2 / (m F0^2)

over the lateral accelerations of the floor ends [m/s^2] and the strokes of the secondary suspension
at the four damper places (Kalman 1960; for suspensions Hrovat 1997, Automatica 33, 1781). It needs
every state measured, which no vehicle offers: the reference for what knowledge is worth, and a
law that knows nothing of the delay it meets.
"""

import numpy as np
from scipy import linalg

from baselines.controller import LinearFeedback
from baselines.design.model import FLOOR_ACCELERATIONS
from baselines.registered import Registered, designed_for
from railenv.envs.observation import DEFAULT_ACTION_SCALE
from railenv.errors import ArgumentError, check_positive
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle, state_space
from railenv.vehicle.coordinates import DAMPER_POSITIONS

STROKE_SCALE = 0.1
"""Stroke [m] that costs as much as a floor acceleration of 1 m/s^2."""


class LinearQuadraticRegulator(LinearFeedback):
    """LQR on the full state.

    Args:
        vehicle: What it is designed for, with actuators.
        effort: Cost of the mean square command in units of (3 kN)^2 [(m/s^2)^2], above zero.

    Attributes:
        value: X of the Riccati equation, shape (n, n).
        riccati: Its A, B, Q, R and S.

    Raises:
        ArgumentError: The effort is not above zero, or the vehicle has no actuator.
    """

    def __init__(self, vehicle: LateralVehicle, effort: float = 0.1) -> None:
        m = vehicle.num_actuators
        if m == 0:
            raise ArgumentError("layout = 'passive' has no actuator for LQR; choose 2 or 4")
        system = state_space(vehicle)
        A, B = system.A, system.actuator_input
        strokes = tuple(f"suspension_stroke_{k}" for k in DAMPER_POSITIONS)
        C, D = system.output_rows((*FLOOR_ACCELERATIONS, *strokes))
        weight = np.array([1.0] * len(FLOOR_ACCELERATIONS) + [1.0 / STROKE_SCALE] * len(strokes))
        C, D = weight[:, None] * C, weight[:, None] * D[:, :m]
        cost = check_positive("effort", effort) / (m * DEFAULT_ACTION_SCALE**2)
        Q, R, S = C.T @ C, D.T @ D + cost * np.eye(m), C.T @ D
        self.riccati = (A, B, Q, R, S)
        self.value: FloatArray = np.asarray(
            linalg.solve_continuous_are(A, B, Q, R, s=S), dtype=np.float64
        )
        gain = linalg.solve(R, B.T @ self.value + S.T, assume_a="pos")
        super().__init__(gain, system.states, vehicle.layout)


LQR = Registered(
    "lqr",
    "full state to force, quadratic optimum without delay; ignores the delay it meets",
    "Kalman 1960; Hrovat 1997",
    {"effort": (0.1, "(m/s^2)^2"), "design_kmh": (0.0, "km/h, 0: the run's")},
    lambda vehicle, effort, design_kmh: LinearQuadraticRegulator(
        designed_for(vehicle, design_kmh), effort
    ),
)
