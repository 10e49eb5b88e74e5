"""The yardstick: the H2 optimum for a known delay with full information.

The bound (`exact_optimum`) knows every state of the vehicle, the track under each wheelset up to
now, and the delay. No causal linear law of the same control period has a smaller mean square of the
ride-filtered floor acceleration at the same mean square force, in the model it is designed for:

- without preview, every wheelset on a track of its own, which no real track is: in a row the same
  law does worse, at 100 ms by 23 %;
- with preview, trailing wheelsets on the track of the leading one: the outer limit, since this is
  what the vehicle really meets.

The law that runs (`FullInformation`) is told all this at the samples only and estimates the rest:
the rates of the track, and the ride filters, which see the physics steps in between. Its root mean
square is above the bound by 0.8 % at 100 ms (1.0 % with preview) and by 4.5 % (0.7 %) without
delay, where the bound is next to nothing, 1.6 (2.1) mm/s^2; `paper_fit`, 300 km/h, four actuators.

A bound in that quadratic cost is no bound in the ride index, which weighs otherwise. A law on the
benchmark's noisy sensors has `lqg-delay` as its bound.
"""

from baselines.design.model import DESIGN_TRACK, DesignModel, design_model
from baselines.design.optimum import Optimum, estimator, perfect_knowledge, regulator
from baselines.design.predictor_law import PredictorLaw
from baselines.lqg import SHARP_EFFORT
from baselines.registered import Registered, check_switch, designed_for
from railenv.simulation import DEFAULT_CONTROL_PERIOD
from railenv.vehicle import LateralVehicle, state_space
from railenv.vehicle.coordinates import WHEELSETS

_ALL_BUT_EXACT = 1e-3
# Noise of the readings that stand for full information, in units of the controlled response. Their
# equation needs some: without preview rounding spoils it at 1e-5. A thousandth of this changes the
# cost by 2e-4 of itself at most (tests/test_baselines_optimum.py).


def everything(vehicle: LateralVehicle) -> tuple[str, ...]:
    """Return the names of all states and of what the wheelsets meet."""
    met = tuple(f"{kind}_{w}" for kind in ("alignment", "track_roll") for w in WHEELSETS)
    return (*state_space(vehicle).states, *met)


class FullInformation(PredictorLaw):
    """The optimum for a known delay, told states and track.

    Args:
        vehicle: What it is designed for, with actuators.
        delay: Between measurement and force, the same for all channels [s].
        effort: Cost of the mean square command in units of (3 kN)^2 [(m/s^2)^2], above zero.
        preview: Whether trailing wheelsets are known to meet the track of the leading ones.
        track: Name of the spectrum it is designed for; its densities must be rational.
        control_period: Time between actions [s].

    Attributes:
        delay: The delay it is designed for [s].
        optimum: The design with exact knowledge, and its cost: the bound, not the law's own cost
            (that is `baselines.design.cost.loop_cost`).

    Raises:
        ArgumentError: A value is out of its range or the spectrum is not rational.
    """

    def __init__(
        self,
        vehicle: LateralVehicle,
        delay: float = 0.1,
        effort: float = SHARP_EFFORT,
        preview: bool = False,
        track: str = DESIGN_TRACK,
        control_period: float = DEFAULT_CONTROL_PERIOD,
    ) -> None:
        model = design_model(vehicle, delay, preview=preview, track=track, period=control_period)
        self.delay = float(delay)
        self.optimum = exact_optimum(model, effort)
        readings = estimator(model, everything(vehicle), _ALL_BUT_EXACT)
        super().__init__(model, self.optimum.regulator.gain, readings)


def exact_optimum(model: DesignModel, effort: float) -> Optimum:
    """Return the optimum with exact knowledge of the state and of the track met so far."""
    return Optimum(model, regulator(model, effort), perfect_knowledge(model))


OPTIMUM = Registered(
    "optimum",
    "yardstick: H2 optimum for a known delay, told every state and the track met so far",
    "Astrom 1970, chapter 8; Doyle, Glover, Khargonekar, Francis 1989",
    {
        "delay": (0.1, "s"),
        "effort": (SHARP_EFFORT, "(m/s^2)^2"),
        "preview": (0.0, "0 or 1"),
        "track": (DESIGN_TRACK, "spectrum"),
        "design_kmh": (0.0, "km/h, 0: the run's"),
    },
    lambda vehicle, delay, effort, preview, track, design_kmh: FullInformation(
        designed_for(vehicle, design_kmh), delay, effort, check_switch("preview", preview), track
    ),
)
