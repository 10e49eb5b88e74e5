"""Settings of the environment: one typed dataclass, a sentence per field."""

from dataclasses import dataclass

from railenv.actuation import ActuatorSpec, DelaySpec
from railenv.actuation.actuator import PAPER_FORCE_LIMIT
from railenv.envs.observation import DEFAULT_ACTION_SCALE, DEFAULT_MAX_DELAY
from railenv.errors import (
    ArgumentError,
    check_not_negative,
    check_positive,
    unknown_name,
)
from railenv.simulation import DEFAULT_CONTROL_PERIOD, DEFAULT_TIME_STEP, whole_multiple
from railenv.units import (
    Dimensionless,
    KilometrePerHour,
    Metre,
    MetrePerSecondSquared,
    Newton,
    NewtonPerSecond,
    Second,
)
from railenv.vehicle import get_vehicle
from railenv.vehicle.coordinates import parse_layout

OBSERVATIONS = ("sensors", "state")


@dataclass(frozen=True)
class EnvSettings:
    """Everything `gym.make("railenv/Lateral17-v0", ...)` takes.

    Attributes:
        layout: 4 or 2 actuators.
        speed_kmh: Running speed [km/h].
        vehicle: Name of a catalogued vehicle.
        track: Spectrum's name, "flat", or the path of a measured CSV file; a spectrum is realised
            anew in every episode.
        delay: Seconds, a (low, high) range drawn once per episode, or a DelaySpec (per channel).
        max_delay: Longest delay allowed [s]; sets how many past actions are observed.
        observation: "sensors" or "state".
        control_period: Time between actions [s].
        time_step: Physics step [s]; accelerations enter the reward at this rate.
        episode_seconds: Length of an episode [s], then truncation.
        action_scale: Force of an action of one [N].
        force_limit: Largest force of an actuator [N].
        rate_limit: Largest change of force per time [N/s]; None for none.
        actuator_lag: Time constant of the actuators' first-order lag [s].
        comfort_reference: Weighted floor acceleration that costs one per step [m/s^2].
        comfort_cap: Largest comfort cost of a step [1].
        effort_weight: Cost of a step with every action at one [1].
        divergence_penalty: Cost of ending by divergence or leaving the gauge [1].
        gauge_limit: Largest lateral displacement of the floor ends [m].
        acceleration_limit: Largest floor acceleration [m/s^2]; beyond, the run has diverged.

    Raises:
        ArgumentError: A value is out of its range; the message names it.
    """

    layout: int | str = 4
    speed_kmh: KilometrePerHour = 300.0
    vehicle: str = "paper_fit"
    track: str = "tb3352"
    delay: Second | tuple[Second, Second] | DelaySpec = 0.0
    max_delay: Second = DEFAULT_MAX_DELAY
    observation: str = "sensors"
    control_period: Second = DEFAULT_CONTROL_PERIOD
    time_step: Second = DEFAULT_TIME_STEP
    episode_seconds: Second = 20.0
    action_scale: Newton = DEFAULT_ACTION_SCALE
    force_limit: Newton = PAPER_FORCE_LIMIT
    rate_limit: NewtonPerSecond | None = None
    actuator_lag: Second = 0.0
    comfort_reference: MetrePerSecondSquared = 0.05
    comfort_cap: Dimensionless = 5.0
    effort_weight: Dimensionless = 0.01
    divergence_penalty: Dimensionless = 500.0
    gauge_limit: Metre = 0.1
    acceleration_limit: MetrePerSecondSquared = 20.0

    def __post_init__(self) -> None:
        for name in ("vehicle", "track", "observation"):
            if not isinstance(getattr(self, name), str):
                raise ArgumentError(f"{name} = {getattr(self, name)!r} must be a text")
        if parse_layout(self.layout) == "passive":
            raise ArgumentError("layout = 'passive' has no actuator to control; choose 2 or 4")
        get_vehicle(self.vehicle)
        for name, unit in (
            ("speed_kmh", "km/h"),
            ("control_period", "seconds"),
            ("time_step", "seconds"),
            ("episode_seconds", "seconds"),
            ("action_scale", "N"),
            ("comfort_reference", "m/s^2"),
            ("comfort_cap", ""),
            ("gauge_limit", "m"),
            ("acceleration_limit", "m/s^2"),
        ):
            check_positive(name, getattr(self, name), unit)
        for name in ("max_delay", "effort_weight", "divergence_penalty"):
            check_not_negative(name, getattr(self, name))
        for name, longest in (("episode_seconds", 3600.0), ("max_delay", 10.0)):
            if getattr(self, name) > longest:
                raise ArgumentError(
                    f"{name} = {getattr(self, name):g} s is too long; give {longest:g} s or less"
                )
        if self.observation not in OBSERVATIONS:
            raise unknown_name("observation", self.observation, OBSERVATIONS)
        whole_multiple("control_period", self.control_period, "time_step", self.time_step)
        whole_multiple(
            "episode_seconds", self.episode_seconds, "control_period", self.control_period
        )
        self.delay_range()
        self.actuator()

    def actuator(self) -> ActuatorSpec:
        """Return the actuator's limits and lag."""
        return ActuatorSpec(self.force_limit, self.rate_limit, self.actuator_lag)

    def delay_range(self) -> tuple[float, float] | DelaySpec:
        """Return the delay as a (low, high) range, or as the DelaySpec it was given as.

        Raises:
            ArgumentError: A delay is negative, above `max_delay`, or the range is upside down.
        """
        if isinstance(self.delay, DelaySpec):
            given = self.delay.delay
            self._check_longest(max(given) if isinstance(given, tuple) else given)
            return self.delay
        if isinstance(self.delay, tuple | list):
            if len(self.delay) != 2:
                raise ArgumentError(
                    f"delay = {self.delay!r} is no (low, high) range; for one delay per channel "
                    "give DelaySpec((...))"
                )
            low, high = (check_not_negative("delay", d, "seconds") for d in self.delay)
            if low > high:
                raise ArgumentError(f"delay = ({low:g}, {high:g}) is upside down; give (low, high)")
        else:
            low = high = check_not_negative("delay", self.delay, "seconds")
        self._check_longest(high)
        return low, high

    def _check_longest(self, longest: float) -> None:
        if longest > self.max_delay:
            raise ArgumentError(
                f"delay = {longest:g} s is above max_delay = {self.max_delay:g} s; raise max_delay"
            )
