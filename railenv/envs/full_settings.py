"""Settings of the environment of the nonlinear vehicle: those of the linear one, and the rails'."""

from dataclasses import dataclass
from typing import Any

from railenv.contact import get_profile
from railenv.envs.settings import LONGEST_STEP, EnvSettings
from railenv.errors import ArgumentError, check_finite, check_not_negative, check_positive
from railenv.simulation import DEFAULT_TIME_STEP, whole_multiple
from railenv.simulation.full import DEFAULT_FULL_STEP
from railenv.units import Dimensionless, Metre, Second
from railenv.vehicle import get_vehicle
from railenv.vehicle.nonlinear import ContactSettings
from railenv.vehicle.nonlinear.curve import CurveArrays, curved_line, straight_line

SHARPEST_CURVE = 100.0
"""Smallest radius of a curve [m]."""

LARGEST_CANT = 0.25
"""Largest cant [m]."""


@dataclass(frozen=True)
class FullSettings(EnvSettings):
    """Everything `gym.make("railenv/Full50-v0", ...)` takes.

    The fields of `EnvSettings` mean what they mean there, with three differences. `vehicle_ranges`
    vary the lateral parameters, and with them the nonlinear vehicle; conicity and creep follow from
    profiles and contact instead (creep coefficients count with `creep_law="given"`). `start` is
    "rest": steady rolling. `time_step` is the step of the integration.

    Attributes:
        time_step: Physics step [s].
        record_step: Time between the accelerations that enter the reward [s], a whole multiple of
            `time_step`.
        wheel: Profile of the wheels, by name; see `railenv.contact.profiles`.
        rail: Profile of the rails, by name.
        friction: Coefficient of friction between wheel and rail [1].
        creep_law: "fastsim-table", "fastsim", "polach", "shen-hedrick-elkins", "linear" or "given";
            see `railenv.vehicle.nonlinear.ContactSettings`.
        curve: Radius [m], above zero to the right and below to the left, and cant of the outer rail
            over the inner one [m]; None for a straight line.
        curve_start: Where the transition into the curve begins, ahead of the leading wheelset at
            the start [m].
        curve_transition: Its length [m].

    Raises:
        ArgumentError: A value is out of its range; the message names it.
    """

    time_step: Second = DEFAULT_FULL_STEP
    record_step: Second = DEFAULT_TIME_STEP
    wheel: str = ContactSettings.wheel
    rail: str = ContactSettings.rail
    friction: Dimensionless = ContactSettings.friction
    creep_law: str = ContactSettings.law
    curve: tuple[Metre, Metre] | None = None
    curve_start: Metre = 100.0
    curve_transition: Metre = 200.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.start != "rest":
            raise ArgumentError(
                f"start = {self.start!r} is made of states of a linear vehicle, scaled with the "
                "level of the track; give start='rest', which is steady rolling"
            )
        if check_positive("record_step", self.record_step, "seconds") >= LONGEST_STEP:
            raise ArgumentError(
                f"record_step = {self.record_step:g} s does not resolve 40 Hz, the upper end of "
                f"what comfort counts; give less than {LONGEST_STEP:g} s"
            )
        whole_multiple("record_step", self.record_step, "time_step", self.time_step)
        whole_multiple("control_period", self.control_period, "record_step", self.record_step)
        for name, kind in (("wheel", "wheel"), ("rail", "rail")):
            text: Any = getattr(self, name)
            if not isinstance(text, str):
                raise ArgumentError(f"{name} = {text!r} must be the name of a profile")
            found = get_profile(text)
            if found.kind != kind:
                raise ArgumentError(f"{name} = {text!r} is the profile of a {found.kind}")
        if not isinstance(self.creep_law, str):  # pyright: ignore[reportUnnecessaryIsInstance]
            raise ArgumentError(f"creep_law = {self.creep_law!r} must be a text")
        self.contact()
        check_not_negative("curve_start", self.curve_start, "m")
        check_positive("curve_transition", self.curve_transition, "m")
        self.line()

    def record_period(self) -> float:
        """Return the time between the accelerations that enter the reward [s]."""
        return self.record_step

    def contact(self) -> ContactSettings:
        """Return how wheel and rail meet."""
        return ContactSettings(
            wheel=self.wheel, rail=self.rail, friction=self.friction, law=self.creep_law
        )

    def line(self) -> CurveArrays:
        """Return the line's curves.

        Raises:
            ArgumentError: `curve` is no pair, or a number in it is out of range.
        """
        given: Any = self.curve
        if given is None:
            return straight_line()
        if not isinstance(given, tuple | list) or len(given) != 2:  # pyright: ignore
            raise ArgumentError(
                f"curve = {given!r} must be a (radius, cant) pair in metres, or None"
            )
        radius = check_finite("curve radius", given[0], "m")  # pyright: ignore
        if not abs(radius) >= SHARPEST_CURVE:
            raise ArgumentError(
                f"curve radius = {radius:g} m is sharper than {SHARPEST_CURVE:g} m, where small "
                "angles end; give a larger one, or None for a straight line"
            )
        cant = check_finite("curve cant", given[1], "m")  # pyright: ignore
        spacing = 2.0 * get_vehicle(self.vehicle).parameters.half_contact_spacing
        if not abs(cant) <= LARGEST_CANT:
            raise ArgumentError(
                f"curve cant = {cant:g} m is beyond {LARGEST_CANT:g} m; give metres of the outer "
                "rail over the inner one"
            )
        angle = cant / spacing if radius > 0.0 else -cant / spacing
        end = self.curve_start + self.curve_transition
        return curved_line([(self.curve_start, 0.0, 0.0), (end, 1.0 / radius, angle)])
