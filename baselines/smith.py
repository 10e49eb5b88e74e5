"""Sky-hook behind a Smith predictor: a model of the vehicle takes the delay out of the feedback.

    u = -gain (v + v_model - v_model(t - delay))

The model runs beside the vehicle on the same commands; what it says without delay less what it says
with the delay is added to the measurement (Smith 1957, Chem. Eng. Progress 53, 217). With an exact
model and delay the feedback sees the vehicle as if there were none.

What it does not do: move the vehicle's own poles. The model is never corrected, so that its
difference from the vehicle dies out as the uncontrolled vehicle does: the loop's poles are those of
the sky-hook without delay *and* those of the vehicle without control. With four actuators these are
damped by 0.2 %, and whatever the track puts into them, the loop leaves there.
"""

import numpy as np

from baselines.design.model import whole_and_rest
from baselines.linear_dynamic import LinearDynamic
from baselines.registered import Registered, designed_for
from railenv.actuation import held_input
from railenv.errors import ArgumentError, check_not_negative, check_positive
from railenv.simulation import DEFAULT_CONTROL_PERIOD
from railenv.vehicle import LateralVehicle, state_space
from railenv.vehicle.coordinates import actuator_positions


class SmithSkyHook(LinearDynamic):
    """Sky-hook damping behind a Smith predictor, as a sampled law.

    The state is that of the model without delay less that of the model with the delay, and the
    commands on their way.

    Args:
        vehicle: The model, with actuators.
        delay: Between command and force in the model [s].
        gain: Damping coefficient [N s/m], zero or more.
        control_period: Time between actions [s].

    Attributes:
        delay: The delay it is designed for [s].

    Raises:
        ArgumentError: A value is out of its range, or the vehicle has no actuator.
    """

    def __init__(
        self,
        vehicle: LateralVehicle,
        delay: float = 0.1,
        gain: float = 35e3,
        control_period: float = DEFAULT_CONTROL_PERIOD,
    ) -> None:
        self.delay = check_not_negative("delay", delay, "seconds")
        coefficient = check_not_negative("gain", gain, "N s/m")
        period = check_positive("control_period", control_period, "seconds")
        places = actuator_positions(vehicle.layout)
        if not places:
            raise ArgumentError("layout = 'passive' has no actuator for sky-hook; choose 2 or 4")
        sensors = tuple(f"carbody_lateral_velocity_{k}" for k in places)
        system = state_space(vehicle)
        velocities, _ = system.output_rows(sensors)
        late, rest = whole_and_rest(self.delay, period)
        transition, full = held_input(system.A, system.actuator_input, period)
        _, share = held_input(system.A, system.actuator_input, period - rest)
        n, m = system.actuator_input.shape
        # The pipe holds u_(k-1) ... u_(k-d-1); the last acts for the rest of the delay.
        pipe = (late + 1) * m
        A, B = np.zeros((n + pipe, n + pipe)), np.zeros((n + pipe, m))
        C = np.hstack([coefficient * velocities, np.zeros((m, pipe))])
        D = coefficient * np.eye(m)
        # Effect of u_k, straight and delayed; u = -(C xc + D y) is put in below.
        drive = full - (share if late == 0 else 0.0)
        A[:n, :n] = transition
        if late > 0:
            A[:n, n + (late - 1) * m : n + late * m] -= share
        A[:n, n + late * m :] -= full - share
        A[n + m :, n:-m] = np.eye(pipe - m)
        A[:n] -= drive @ C
        B[:n] -= drive @ D
        A[n : n + m], B[n : n + m] = -C, -D
        super().__init__((A, B, C, D), sensors, vehicle.layout, control_period=period, sampled=True)


SMITH = Registered(
    "smith",
    "sky-hook behind a Smith predictor; keeps the uncontrolled vehicle's own poles",
    "Smith 1957",
    {
        "delay": (0.1, "s"),
        "gain": (35e3, "N s/m"),
        "design_kmh": (0.0, "km/h, 0: the run's"),
    },
    lambda vehicle, delay, gain, design_kmh: SmithSkyHook(
        designed_for(vehicle, design_kmh), delay, gain
    ),
)
