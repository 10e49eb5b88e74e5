"""Settings of the environment: one typed dataclass, a sentence per field."""

from dataclasses import dataclass
from typing import Any

from railenv.actuation import ActuatorSpec, DelaySpec
from railenv.actuation.actuator import PAPER_FORCE_LIMIT
from railenv.envs.delays import DelayDraw
from railenv.envs.observation import (
    DEFAULT_ACTION_SCALE,
    DEFAULT_MAX_DELAY,
    OBSERVATIONS,
    SCALES,
    pipe_length,
)
from railenv.errors import (
    ArgumentError,
    check_count,
    check_not_negative,
    check_positive,
    unknown_name,
)
from railenv.metrics.ride_index import SPERLING_BAND
from railenv.simulation import DEFAULT_CONTROL_PERIOD, DEFAULT_TIME_STEP, whole_multiple
from railenv.simulation.lateral import check_time_step
from railenv.track.seed_domains import check_no_test_seed
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
from railenv.vehicle.coordinates import actuator_positions, parse_layout
from railenv.vehicle.randomisation import VehicleRanges, get_ranges

ACTIONS = ("each", "bogies")
STARTS = ("rest", "controlled")
LONGEST_STEP = 0.5 / SPERLING_BAND[1]
"""Physics steps must be shorter [s]: the ride filter needs the band of the ride index."""

_LONGEST = (("episode_seconds", 3600.0), ("max_delay", 10.0))


@dataclass(frozen=True)
class EnvSettings:
    """Everything `gym.make("railenv/Lateral17-v0", ...)` takes.

    Attributes:
        layout: 4 or 2 actuators.
        speed_kmh: Running speed [km/h], unless `vehicle_ranges` has a range of speeds.
        vehicle: Name of a catalogued vehicle.
        vehicle_ranges: How vehicles vary from episode to episode: "none", "narrow", "wide" or a
            `railenv.vehicle.randomisation.VehicleRanges`.
        vehicle_pool: How many vehicles are drawn, once, for episodes to choose from.
        track: Spectrum's name, "flat", or the path of a measured CSV file, or several of these.
        track_pool: How many tracks are realised, once, for episodes to choose from; a run starts
            anywhere on one.
        track_level: (low, high) factor on the track's power spectral density, drawn per episode.
        pool_seed: Seed of both pools; environments with one seed have the same pools. Below those
            of the tracks of benchmarks, see `railenv.track.seed_domains`.
        delay: Seconds, a (low, high) range drawn once per episode, or a DelaySpec (per channel).
        delay_per_channel: Whether a range is drawn anew for every channel.
        sensor_delay: Share of the sensors, on top of `delay`: seconds or a (low, high) range.
        jitter: Every command is later by a draw from [0, jitter] [s].
        common_jitter: Whether the channels share that draw.
        dropout: Probability that a channel's command is lost and the actuator holds its last [1].
        sensor_dropout: Probability that a measurement is lost and the last one stays [1].
        sensor_noise: Standard deviation of every reading's white Gaussian noise, in units of the
            controlled vehicle's response (what `observation_scale="controlled"` divides by) [1].
        max_delay: Longest delay allowed, all parts together [s].
        delay_observed: Whether the observation tells the delay.
        told_error: The told delay is wrong by a draw from +-told_error per episode [s].
        observation: "sensors" or "state".
        observation_scale: "controlled" (in units of the controlled vehicle's response) or "si".
        observation_history: How many past measurements follow the newest.
        action_history: How many past actions are observed; None for all that `max_delay` can hold.
        action: "each" (one action per actuator) or "bogies" (one per bogie).
        start: "rest" or "controlled" (a state of the vehicle running under a mild sky-hook).
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
        stroke_weight: Cost of a step with every stroke at `stroke_reference` [1].
        stroke_reference: Stroke of the secondary suspension that costs `stroke_weight` [m].
        divergence_penalty: Cost of ending by divergence or leaving the gauge [1]; None for more
            than the worst episode without.
        gauge_limit: Largest lateral displacement of the floor ends [m].
        acceleration_limit: Largest floor acceleration [m/s^2]; beyond, the run has diverged.

    Raises:
        ArgumentError: A value is out of its range; the message names it.
    """

    layout: int | str = 4
    speed_kmh: KilometrePerHour = 300.0
    vehicle: str = "paper_fit"
    vehicle_ranges: str | VehicleRanges = "none"
    vehicle_pool: int = 64
    track: str | tuple[str, ...] = "tb3352"
    track_pool: int = 16
    track_level: tuple[Dimensionless, Dimensionless] = (1.0, 1.0)
    pool_seed: int = 0
    delay: Second | tuple[Second, Second] | DelaySpec = 0.0
    delay_per_channel: bool = False
    sensor_delay: Second | tuple[Second, Second] = 0.0
    jitter: Second = 0.0
    common_jitter: bool = False
    dropout: Dimensionless = 0.0
    sensor_dropout: Dimensionless = 0.0
    sensor_noise: Dimensionless = 0.0
    max_delay: Second = DEFAULT_MAX_DELAY
    delay_observed: bool = False
    told_error: Second = 0.0
    observation: str = "sensors"
    observation_scale: str = "controlled"
    observation_history: int = 0
    action_history: int | None = None
    action: str = "each"
    start: str = "rest"
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
    stroke_weight: Dimensionless = 0.05
    stroke_reference: Metre = 0.03
    divergence_penalty: Dimensionless | None = None
    gauge_limit: Metre = 0.1
    acceleration_limit: MetrePerSecondSquared = 20.0

    def __post_init__(self) -> None:
        self._check_names()
        for name, unit in (
            ("speed_kmh", "km/h"),
            ("control_period", "seconds"),
            ("time_step", "seconds"),
            ("episode_seconds", "seconds"),
            ("action_scale", "N"),
            ("comfort_reference", "m/s^2"),
            ("comfort_cap", ""),
            ("stroke_reference", "m"),
            ("gauge_limit", "m"),
            ("acceleration_limit", "m/s^2"),
        ):
            check_positive(name, getattr(self, name), unit)
        for name in (
            "sensor_noise",
            "max_delay",
            "told_error",
            "effort_weight",
            "stroke_weight",
        ):
            check_not_negative(name, getattr(self, name))
        if self.divergence_penalty is not None:
            check_not_negative("divergence_penalty", self.divergence_penalty)
        for name in ("vehicle_pool", "track_pool"):
            check_count(name, getattr(self, name))
        check_no_test_seed("pool_seed", self.pool_seed)
        check_count("observation_history", self.observation_history, minimum=0)
        if self.action_history is not None:
            check_count("action_history", self.action_history, minimum=0)
        if self.told_error > 0.0 and not self.delay_observed:
            raise ArgumentError(
                f"told_error = {self.told_error:g} s without delay_observed=True has no effect; "
                "set both or none"
            )
        if self.delay_observed and self.max_delay == 0.0:
            raise ArgumentError(
                "delay_observed = True with max_delay = 0 has nothing to tell; leave one out"
            )
        for name, longest in _LONGEST:
            if getattr(self, name) > longest:
                raise ArgumentError(
                    f"{name} = {getattr(self, name):g} s is too long; give {longest:g} s or less"
                )
        if check_time_step(self.time_step) >= LONGEST_STEP:
            raise ArgumentError(
                f"time_step = {self.time_step:g} s does not resolve 40 Hz, the upper end of what "
                f"comfort counts; give less than {LONGEST_STEP:g} s"
            )
        whole_multiple("control_period", self.control_period, "time_step", self.time_step)
        self.level_range()
        self.ranges()
        self.num_periods()
        self.delays()
        self.actuator()

    def _check_names(self) -> None:
        texts: list[tuple[str, Any]] = [("vehicle", self.vehicle)]
        texts += [("track", spec) for spec in self.tracks()]
        for name, text in texts:
            if not isinstance(text, str):
                raise ArgumentError(f"{name} = {text!r} must be a text")
        get_vehicle(self.vehicle)
        if parse_layout(self.layout) == "passive":
            raise ArgumentError("layout = 'passive' has no actuator to control; choose 2 or 4")
        for name, known in (
            ("observation", OBSERVATIONS),
            ("observation_scale", SCALES),
            ("action", ACTIONS),
            ("start", STARTS),
        ):
            if getattr(self, name) not in known:
                raise unknown_name(name, str(getattr(self, name)), known)
        for name in ("delay_per_channel", "common_jitter", "delay_observed"):
            if not isinstance(getattr(self, name), bool):
                raise ArgumentError(f"{name} = {getattr(self, name)!r} must be True or False")

    def actuator(self) -> ActuatorSpec:
        """Return the actuator's limits and lag."""
        return ActuatorSpec(self.force_limit, self.rate_limit, self.actuator_lag)

    def delays(self) -> DelayDraw:
        """Return from what an episode's delays are drawn."""
        channels = len(actuator_positions(parse_layout(self.layout)))
        return DelayDraw.of(self, channels)

    def ranges(self) -> VehicleRanges:
        """Return the ranges of vehicles."""
        given: Any = self.vehicle_ranges
        if isinstance(given, str):
            return get_ranges(given)
        if not isinstance(given, VehicleRanges):
            raise ArgumentError(
                f"vehicle_ranges = {given!r} must be a name or a VehicleRanges; see "
                "railenv.vehicle.randomisation"
            )
        return given

    def tracks(self) -> tuple[str, ...]:
        """Return the descriptions of the tracks."""
        given: Any = self.track
        return tuple(given) if isinstance(given, tuple | list) else (given,)  # pyright: ignore

    def level_range(self) -> tuple[float, float]:
        """Return the range of the track's level.

        Raises:
            ArgumentError: It is no pair, negative, or upside down.
        """
        given: Any = self.track_level
        if not isinstance(given, tuple | list) or len(given) != 2:  # pyright: ignore
            raise ArgumentError(f"track_level = {given!r} must be a (low, high) pair")
        low, high = (check_not_negative("track_level", level) for level in given)  # pyright: ignore
        if low > high:
            raise ArgumentError(f"track_level = ({low:g}, {high:g}) is upside down")
        return low, high

    def record_period(self) -> float:
        """Return the time between the accelerations that enter the reward [s]."""
        return self.time_step

    def num_periods(self) -> int:
        """Return how many actions an episode has."""
        return whole_multiple(
            "episode_seconds", self.episode_seconds, "control_period", self.control_period
        )

    def num_past_actions(self) -> int:
        """Return how many past actions are observed."""
        if self.action_history is not None:
            return self.action_history
        return pipe_length(self.max_delay, self.control_period)

    def penalty(self) -> float:
        """Return the cost of ending by divergence or leaving the gauge."""
        if self.divergence_penalty is not None:
            return float(self.divergence_penalty)
        worst = self.comfort_cap + self.effort_weight + self.stroke_weight
        return worst * self.num_periods()
