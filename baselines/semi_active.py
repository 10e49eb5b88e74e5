"""Sky-hook by semi-active dampers: on-off, and continuous.

A damper between carbody and bogie resists the stroke rate s' and cannot push. Where the carbody's
absolute lateral velocity v and s' have one sign, its force also resists v, as the damper hooked to
the sky would; elsewhere it is made as soft as it can be:

    on-off       c = c_max                   if v s' > 0, else c_min
    continuous   c = clip(c_sky v / s', c_min, c_max)   if v s' > 0, else c_min

Karnopp, Crosby, Harwood, J. Eng. Ind. 96 (1974) 619; Savaresi et al., Semi-Active Suspension
Control Design for Vehicles (2010). v is taken at damper level at the damper's own place.

An action of one is the largest coefficient, c_max [N s/m]. The damper itself, with its range and
response time, is `railenv.actuation.SemiActiveDamper`; the delay acts on the coefficient. The laws
are not linear, so that the oracle has no answer for them: `--method simulation` has.

What to expect: no delay up to 0.3 s makes the comfort collapse as it does under the active
sky-hook, because a late coefficient still dissipates. The gain is small: on German low at 300 km/h
the best ranges come out level with a constant 7.5 kN s/m, since a stiffer damper also ties the
carbody to the bogies' motion.
"""

import numpy as np

from baselines.controller import measured_columns
from baselines.registered import Registered
from railenv.actuation import SemiActiveDamper
from railenv.errors import ArgumentError, check_not_negative, check_positive, unknown_name
from railenv.simulation import DEFAULT_CONTROL_PERIOD
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle
from railenv.vehicle.coordinates import Layout, actuator_positions, parse_layout

RATES = ("stroke", "measured")

DIFFERENCE_TIME = 0.01
"""Time constant of the filter that differentiates a stroke [s]; chosen, a corner of 16 Hz."""


class SemiActiveLaw:
    """What the laws of semi-active dampers have in common: the damper, and the strokes' rates.

    Args:
        damper: The dampers, all alike.
        layout: 2 or 4.
        rate: Where the strokes' rates come from: "stroke", a filtered difference of the standard
            stroke sensors, or "measured", the rates themselves, which no vehicle measures so well.
        control_period: Time between actions [s]; it must be that of the run.
        difference_time: Time constant of that filter [s].

    Attributes:
        measures: The measured columns of the observation that it takes.
        action_scale: Coefficient of an action of one, `damper.highest` [N s/m].

    Raises:
        ArgumentError: The layout has no damper place, `rate` is another word, or a time is not
            above zero.
    """

    def __init__(
        self,
        damper: SemiActiveDamper,
        layout: object = 4,
        rate: str = "stroke",
        control_period: float = DEFAULT_CONTROL_PERIOD,
        difference_time: float = DIFFERENCE_TIME,
    ) -> None:
        self.damper = damper
        self.layout: Layout = parse_layout(layout)
        self.action_scale = damper.highest
        self._places = actuator_positions(self.layout)
        if not self._places:
            raise ArgumentError(
                "layout = 'passive' has no place for a semi-active damper; choose 2 or 4"
            )
        if rate not in RATES:
            raise unknown_name("rate", rate, RATES)
        self.rate = rate
        self.control_period = check_positive("control_period", control_period, "seconds")
        time = check_positive("difference_time", difference_time, "seconds")
        self._weight = -np.expm1(-self.control_period / time)
        source = "suspension_stroke" + ("_rate" if rate == "measured" else "")
        names = tuple(f"{source}_{k}" for k in self._places)
        self.measures = measured_columns(names, self.layout)
        self._source = [self.measures.index(name) for name in names]
        self._rates: FloatArray = np.zeros((0, len(names)))
        self._strokes: FloatArray | None = None

    def reset(self, num_lanes: int, seed: int) -> None:  # noqa: ARG002
        """Forget the strokes seen; every lane starts with strokes that have not moved."""
        self._rates = np.zeros((num_lanes, len(self._places)))
        self._strokes = None

    def columns(self, quantity: str) -> list[int]:
        """Return the columns of a quantity at the dampers' places, as "carbody_..._velocity"."""
        return [self.measures.index(f"{quantity}_{k}") for k in self._places]

    def stroke_rates(self, observations: FloatArray) -> FloatArray:
        """Return the strokes' rates, to be called once per action, shape (lanes, channels) [m/s].

        From strokes s by T r' + r = s', exactly for a stroke that runs linearly between samples.

        Raises:
            ArgumentError: The number of lanes is not that of the last reset.
        """
        if observations.shape[0] != self._rates.shape[0]:
            raise ArgumentError(
                f"observations have {observations.shape[0]} lanes, reset was called for "
                f"{self._rates.shape[0]}; call reset(num_lanes, seed) first"
            )
        now = observations[:, self._source]
        if self.rate == "measured":
            return now
        if self._strokes is not None:
            slope = (now - self._strokes) / self.control_period
            self._rates = self._rates + self._weight * (slope - self._rates)
        self._strokes = now
        return self._rates.copy()


class OnOffSkyHook(SemiActiveLaw):
    """On-off sky-hook: the stiffest damper where it resists the carbody, else the softest.

    Args:
        damper: The dampers, all alike.
        layout: 2 or 4.
        rate: See `SemiActiveLaw`, as for the others.
        control_period: Time between actions [s].
        difference_time: Time constant of the filter [s].
    """

    def act(self, observations: FloatArray) -> FloatArray:
        """Return c / c_max, shape (lanes, channels)."""
        v = observations[:, self.columns("carbody_lateral_velocity")]
        resists = v * self.stroke_rates(observations) > 0.0
        return np.where(resists, self.damper.highest, self.damper.lowest) / self.action_scale


class SemiActiveSkyHook(SemiActiveLaw):
    """Continuous sky-hook: the coefficient whose force is the sky-hook's, within the range.

    Args:
        gain: Damping coefficient c_sky [N s/m], zero or more.
        damper: The dampers, all alike.
        layout: 2 or 4.
        rate: See `SemiActiveLaw`, as for the others.
        control_period: Time between actions [s].
        difference_time: Time constant of the filter [s].

    Raises:
        ArgumentError: The gain is negative or not finite, or see `SemiActiveLaw`.
    """

    def __init__(
        self,
        gain: float,
        damper: SemiActiveDamper,
        layout: object = 4,
        rate: str = "stroke",
        control_period: float = DEFAULT_CONTROL_PERIOD,
        difference_time: float = DIFFERENCE_TIME,
    ) -> None:
        super().__init__(damper, layout, rate, control_period, difference_time)
        self.gain = check_not_negative("gain", gain, "N s/m")

    def act(self, observations: FloatArray) -> FloatArray:
        """Return c / c_max, shape (lanes, channels)."""
        v = observations[:, self.columns("carbody_lateral_velocity")]
        wanted = self.damper.towards(-self.gain * v, self.stroke_rates(observations))
        return wanted / self.action_scale


def _on_off(
    vehicle: LateralVehicle, lowest: float, highest: float, response_time: float, rate: str
) -> OnOffSkyHook:
    return OnOffSkyHook(SemiActiveDamper(lowest, highest, response_time), vehicle.layout, rate)


def _continuous(
    vehicle: LateralVehicle,
    gain: float,
    lowest: float,
    highest: float,
    response_time: float,
    rate: str,
) -> SemiActiveSkyHook:
    damper = SemiActiveDamper(lowest, highest, response_time)
    return SemiActiveSkyHook(gain, damper, vehicle.layout, rate)


ON_OFF_HIGHEST = 15e3
"""Stiff setting of the on-off law [N s/m]: that of the passive damper. It is commanded whenever v
and s' have one sign, at full stroke rate too; stiffer, the law shakes the carbody more than it
calms it (60 kN s/m on German low at 300 km/h: ride index 2.5 at the front, passive 2.1)."""

_DAMPER: dict[str, tuple[float | str, str]] = {
    "lowest": (SemiActiveDamper.lowest, "N s/m"),
    "highest": (SemiActiveDamper.highest, "N s/m"),
    "response_time": (SemiActiveDamper.response_time, "s"),
    "rate": ("stroke", "stroke or measured"),
}

SEMIACTIVE_ONOFF = Registered(
    "semiactive-onoff",
    "semi-active damper: highest coefficient where it resists the carbody's velocity, else lowest",
    "Karnopp, Crosby, Harwood 1974; Savaresi et al. 2010",
    {**_DAMPER, "highest": (ON_OFF_HIGHEST, "N s/m")},
    _on_off,
)

SEMIACTIVE_SKYHOOK = Registered(
    "semiactive-skyhook",
    "semi-active damper: the coefficient that gives the sky-hook's force where it can",
    "Karnopp, Crosby, Harwood 1974; Savaresi et al. 2010",
    {"gain": (35e3, "N s/m"), **_DAMPER},
    _continuous,
)
