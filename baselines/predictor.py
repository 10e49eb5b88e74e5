"""Sky-hook on the predicted state: finite spectrum assignment for a law that is not its own.

The law takes sky-hook's gain, F_k = -gain v_k, and applies it to the velocity that the carbody will
have when the force arrives: Kalman's estimate of the state, predicted over the commands on their
way (Manitius and Olbrot 1979, IEEE Trans. Automatic Control 24, 541; in the predictor form of
Artstein 1982). In a loop with exactly that delay the poles are those of sky-hook without delay and
those of the estimator, and zeros. Whole control periods are predicted over; of a delay with a rest
sky-hook keeps the rest.
"""

from baselines.design.model import DESIGN_NOISE, DESIGN_TRACK, design_model
from baselines.design.optimum import estimator
from baselines.design.predictor_law import PredictorLaw
from baselines.registered import Registered, designed_for
from railenv.envs.observation import sensor_names
from railenv.errors import check_not_negative
from railenv.simulation import DEFAULT_CONTROL_PERIOD
from railenv.vehicle import LateralVehicle
from railenv.vehicle.coordinates import actuator_positions

LIVELY_NOISE = 10.0 * DESIGN_NOISE
"""Sensors' noise that the estimator is designed for; less makes it sharp in the delay."""


class PredictorSkyHook(PredictorLaw):
    """Sky-hook damping on the state predicted to the arrival of the force.

    Args:
        vehicle: What it predicts with, with actuators.
        delay: Between measurement and force, the same for all channels [s].
        gain: Damping coefficient [N s/m], zero or more.
        noise: Standard deviation of the sensors' noise that the estimator expects, in units of the
            columns' controlled response [1], above zero.
        control_period: Time between actions [s].

    Attributes:
        delay: The delay it is designed for [s].

    Raises:
        ArgumentError: A value is out of its range.
    """

    def __init__(
        self,
        vehicle: LateralVehicle,
        delay: float = 0.1,
        gain: float = 35e3,
        noise: float = LIVELY_NOISE,
        control_period: float = DEFAULT_CONTROL_PERIOD,
    ) -> None:
        model = design_model(vehicle, delay, track=DESIGN_TRACK, period=control_period)
        places = actuator_positions(vehicle.layout)
        velocities = model.measurement(tuple(f"carbody_lateral_velocity_{k}" for k in places))
        self.delay = float(delay)
        super().__init__(
            model,
            check_not_negative("gain", gain, "N s/m") * velocities,
            estimator(model, sensor_names(vehicle.layout), noise),
        )


PREDICTOR = Registered(
    "predictor",
    "sky-hook on the state predicted to the force's arrival, finite spectrum assignment",
    "Manitius and Olbrot 1979; Artstein 1982",
    {
        "delay": (0.1, "s"),
        "gain": (35e3, "N s/m"),
        "noise": (LIVELY_NOISE, "of the controlled response"),
        "design_kmh": (0.0, "km/h, 0: the run's"),
    },
    lambda vehicle, delay, gain, noise, design_kmh: PredictorSkyHook(
        designed_for(vehicle, design_kmh), delay, gain, noise
    ),
)
