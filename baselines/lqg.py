"""LQG on the standard sensors: the H2-optimal law for noisy readings, with or without the delay.

The law minimises the mean square of the ride-filtered floor acceleration and of the command over a
random track, given readings with white noise (`baselines.design`): Kalman's estimator, the state
predicted to the moment the command arrives, and a gain on the prediction.

- `Lqg`, designed without delay: what a textbook gives.
- `DelayLqg`, designed for a known delay. The commands on their way are states of the loop, whose
  estimate is exact; that is LQG of the delay-augmented plant (Astrom, Introduction to Stochastic
  Control Theory, 1970, chapter 8), written without its large Riccati equation.

A sharp design (noise as the sensors have it, little effort) is the better one at its own delay and
unstable when the delay is wrong by 10 ms (`paper_fit`, 300 km/h, four actuators, 100 and 200 ms); a
detuned design (ten times the noise, ten times the effort) stands 50 ms there and costs comfort.
That is no guarantee: at 350 km/h and 300 ms, with preview, a delay 20 ms too long ends it too.

With `preview` the estimator knows that every wheelset meets the track of the one before it;
without, each is taken to run on a track of its own.
"""

from baselines.design.model import DESIGN_NOISE, DESIGN_TRACK, design_model
from baselines.design.optimum import Optimum, estimator, regulator
from baselines.design.predictor_law import PredictorLaw
from baselines.registered import Registered, check_switch, designed_for
from railenv.envs.observation import sensor_names
from railenv.simulation import DEFAULT_CONTROL_PERIOD
from railenv.vehicle import LateralVehicle

SHARP_EFFORT = 1e-3
"""Cost of a mean square command of (3 kN)^2 in the sharp design [(m/s^2)^2]."""

DETUNED = 10.0
"""Factor on noise and effort that makes a sharp design a detuned one."""


class DelayLqg(PredictorLaw):
    """LQG for a known delay.

    Args:
        vehicle: What it is designed for, with actuators.
        delay: Between measurement and force, the same for all channels [s].
        effort: Cost of the mean square command in units of (3 kN)^2 [(m/s^2)^2], above zero.
        noise: Standard deviation of the sensors' noise it expects, in units of the columns'
            controlled response [1], above zero.
        preview: Whether trailing wheelsets are known to meet the track of the leading ones.
        track: Name of the spectrum it is designed for; its densities must be rational.
        sensors: What it measures; the standard sensors unless given.
        control_period: Time between actions [s].

    Attributes:
        optimum: The design, with the cost it predicts.

    Raises:
        ArgumentError: A value is out of its range or the spectrum is not rational.
    """

    def __init__(
        self,
        vehicle: LateralVehicle,
        delay: float = 0.1,
        effort: float = SHARP_EFFORT,
        noise: float = DESIGN_NOISE,
        preview: bool = False,
        track: str = DESIGN_TRACK,
        sensors: tuple[str, ...] | None = None,
        control_period: float = DEFAULT_CONTROL_PERIOD,
    ) -> None:
        model = design_model(vehicle, delay, preview=preview, track=track, period=control_period)
        measured = sensor_names(vehicle.layout) if sensors is None else tuple(sensors)
        self.delay = float(delay)
        self.optimum = Optimum(model, regulator(model, effort), estimator(model, measured, noise))
        super().__init__(model, self.optimum.regulator.gain, self.optimum.estimator)


class Lqg(DelayLqg):
    """LQG designed without delay; arguments are those of `DelayLqg` but the delay."""

    def __init__(
        self,
        vehicle: LateralVehicle,
        effort: float = DETUNED * SHARP_EFFORT,
        noise: float = DETUNED * DESIGN_NOISE,
        preview: bool = False,
        track: str = DESIGN_TRACK,
    ) -> None:
        super().__init__(vehicle, 0.0, effort, noise, preview, track)


_DESIGN: dict[str, tuple[float | str, str]] = {
    "preview": (0.0, "0 or 1"),
    "track": (DESIGN_TRACK, "spectrum"),
    "design_kmh": (0.0, "km/h, 0: the run's"),
}

LQG = Registered(
    "lqg",
    "Kalman filter on the standard sensors and quadratic optimum, designed without delay (detuned)",
    "Kalman 1960; Anderson and Moore 1990",
    {
        "effort": (DETUNED * SHARP_EFFORT, "(m/s^2)^2"),
        "noise": (DETUNED * DESIGN_NOISE, "of the controlled response"),
        **_DESIGN,
    },
    lambda vehicle, effort, noise, preview, track, design_kmh: Lqg(
        designed_for(vehicle, design_kmh), effort, noise, check_switch("preview", preview), track
    ),
)

DELAY_LQG = Registered(
    "lqg-delay",
    "H2 optimum for a known delay: Kalman filter, prediction to the arrival, gain (sharp)",
    "Astrom 1970, chapter 8; Manitius and Olbrot 1979",
    {
        "delay": (0.1, "s"),
        "effort": (SHARP_EFFORT, "(m/s^2)^2"),
        "noise": (DESIGN_NOISE, "of the controlled response"),
        **_DESIGN,
    },
    lambda vehicle, delay, effort, noise, preview, track, design_kmh: DelayLqg(
        designed_for(vehicle, design_kmh),
        delay,
        effort,
        noise,
        check_switch("preview", preview),
        track,
    ),
)
