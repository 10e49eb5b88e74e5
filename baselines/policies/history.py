"""What a policy sees: readings and its own actions at chosen ages, and the delay it is told.

Features are dimensionless. A reading is divided by its scale (by convention the controlled response
of `railenv.envs.observation.bound`), an action is in units of `action_scale`. Their order: for each
age of `sensor_lags` every sensor, then for each age of `action_lags` every action; an action of age
one is the last one issued. Before the first sample everything past is zero, as in the environment.

The told delay is no feature: it schedules the linear path, by weights that are linear between knots
and constant beyond them (`hat`), so that a policy told one delay for good is a linear law of finite
history.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.controller import measured_columns
from railenv.envs.observation import DEFAULT_ACTION_SCALE, bound, sensor_names
from railenv.errors import ArgumentError, check_count, check_finite, check_positive, unknown_name
from railenv.simulation import DEFAULT_CONTROL_PERIOD
from railenv.units import Dimensionless, FloatArray, Newton, Second
from railenv.vehicle.coordinates import Layout, actuator_positions, parse_layout

ACTIONS = ("each", "bogies")

LONGEST_LAG = 10_000
"""Oldest age that is remembered [control periods]."""

_MOST_FEATURES = 100_000
_MOST_KNOTS = 1000


@dataclass(frozen=True)
class History:
    """What a policy sees, and what its actions mean.

    Attributes:
        layout: "2" or "4" actuators.
        sensors: Names of the readings: standard sensors, or other outputs and states.
        scales: What each reading is divided by [its SI unit].
        sensor_lags: Ages of the readings [control periods], rising from 0.
        action_lags: Ages of the actions [control periods], rising from 1 or later; may be empty.
        action: "each" (one action per actuator) or "bogies" (one per bogie).
        control_period: Time between actions [s].
        action_scale: Force of an action of one [N].
        told_knots: Told delays between which gains are interpolated, rising from 0 [s]; empty for
            a policy that is not told the delay.

    Raises:
        ArgumentError: A value is out of its range or the lengths do not fit.
    """

    layout: Layout
    sensors: tuple[str, ...]
    scales: tuple[Dimensionless, ...]
    sensor_lags: tuple[int, ...] = (0,)
    action_lags: tuple[int, ...] = ()
    action: str = "bogies"
    control_period: Second = DEFAULT_CONTROL_PERIOD
    action_scale: Newton = DEFAULT_ACTION_SCALE
    told_knots: tuple[Second, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "layout", parse_layout(self.layout))
        if self.layout == "passive":
            raise ArgumentError("layout = 'passive' has no actuator to control; choose 2 or 4")
        for name in ("sensors", "scales", "sensor_lags", "action_lags", "told_knots"):
            object.__setattr__(self, name, _tuple(name, getattr(self, name)))
        self._check_sensors()
        object.__setattr__(self, "scales", tuple(check_positive("scales", s) for s in self.scales))
        for name, first in (("sensor_lags", 0), ("action_lags", 1)):
            object.__setattr__(self, name, _lags(name, getattr(self, name), first))
        if not self.sensor_lags or self.sensor_lags[0] != 0:
            raise ArgumentError(
                f"sensor_lags = {self.sensor_lags} must begin with 0, the present reading"
            )
        if self.action not in ACTIONS:
            raise unknown_name("action", str(self.action), ACTIONS)
        for name, unit in (("control_period", "seconds"), ("action_scale", "N")):
            object.__setattr__(self, name, check_positive(name, getattr(self, name), unit))
        knots = tuple(check_finite("told_knots", knot, "seconds") for knot in self.told_knots)
        if knots and (knots[0] != 0.0 or any(np.diff(knots) <= 0.0) or len(knots) > _MOST_KNOTS):
            raise ArgumentError(
                f"told_knots = {knots!s:.80} must rise from 0 and be at most {_MOST_KNOTS}"
            )
        object.__setattr__(self, "told_knots", knots)
        if self.num_features > _MOST_FEATURES:
            raise ArgumentError(
                f"sensor_lags and action_lags make {self.num_features} features; choose fewer "
                f"lags, {_MOST_FEATURES} features are the most"
            )

    def _check_sensors(self) -> None:
        if not self.sensors or not all(isinstance(name, str) for name in self.sensors):
            raise ArgumentError("sensors must be names of readings, one at least")
        if len(set(self.sensors)) != len(self.sensors):
            raise ArgumentError(f"sensors = {self.sensors!s:.80} name one twice; name each once")
        measured_columns(self.sensors, self.layout)
        if len(self.scales) != len(self.sensors):
            raise ArgumentError(
                f"scales has {len(self.scales)} entries for {len(self.sensors)} sensors; give one "
                "per sensor"
            )

    @classmethod
    def of(
        cls, layout: object = 4, sensors: Sequence[str] | None = None, **fields: Any
    ) -> "History":
        """Return a history with the scales of the controlled response.

        Args:
            layout: 2 or 4.
            sensors: Names of the readings; the standard sensors of the layout unless given.
            fields: The other fields.

        Raises:
            ArgumentError: A value is out of its range, or a sensor has no controlled response.
        """
        place = parse_layout(layout)
        names = sensor_names(place) if sensors is None else tuple(sensors)
        measured_columns(names, place)
        return cls(place, names, tuple(bound(name)[2] for name in names), **fields)

    @property
    def num_channels(self) -> int:
        """Number of actuators."""
        return len(actuator_positions(self.layout))

    @property
    def num_actions(self) -> int:
        """Number of entries of an action."""
        return 2 if self.action == "bogies" else self.num_channels

    @property
    def share(self) -> int:
        """Number of neighbouring actuators that take the same action."""
        return self.num_channels // self.num_actions

    @property
    def num_features(self) -> int:
        """Number of features F."""
        return len(self.sensor_lags) * len(self.sensors) + len(self.action_lags) * self.num_actions

    @property
    def num_knots(self) -> int:
        """Number of sets of gains: one per knot, one in all if the delay is not told."""
        return max(1, len(self.told_knots))

    @property
    def is_told(self) -> bool:
        """Whether the policy has to be told the delay."""
        return bool(self.told_knots)

    @property
    def feature_names(self) -> tuple[str, ...]:
        """Name of every feature, as the environment names its columns."""
        readings = (
            name if age == 0 else f"{name}_ago_{age}"
            for age in self.sensor_lags
            for name in self.sensors
        )
        actions = (
            f"action_{age}_ago_{a}"
            for age in self.action_lags
            for a in range(1, self.num_actions + 1)
        )
        return (*readings, *actions)

    def environment(self) -> dict[str, Any]:
        """Return the fields of `EnvSettings` with which an environment observes what is needed.

        Raises:
            ArgumentError: A sensor is not among the standard ones, which are all that an
                environment observes, or its scale is not the controlled response.
        """
        standard = sensor_names(self.layout)
        for name, scale in zip(self.sensors, self.scales, strict=True):
            if name not in standard:
                raise ArgumentError(
                    f"sensor {name!r} is not observed by the environment; choose standard sensors"
                )
            if scale != bound(name)[2]:
                raise ArgumentError(
                    f"scale {scale:g} of sensor {name!r} is not the environment's, "
                    f"{bound(name)[2]:g}; use that one, or History.of"
                )
        return {
            "layout": self.layout,
            "action": self.action,
            "action_scale": self.action_scale,
            "control_period": self.control_period,
            "observation": "sensors",
            "observation_scale": "controlled",
            "observation_history": self.sensor_lags[-1],
            "action_history": self.action_lags[-1] if self.action_lags else 0,
            "delay_observed": self.is_told,
        }

    def columns(self, observation_names: Sequence[str]) -> NDArray[np.int64]:
        """Return the columns of an observation that are the features, in their order.

        Args:
            observation_names: Names of the observation's columns, `observation_names` of an
                environment.

        Raises:
            ArgumentError: A feature is not among them.
        """
        places = {name: index for index, name in enumerate(observation_names)}
        for name in self.feature_names:
            if name not in places:
                raise ArgumentError(
                    f"the observation has no column {name!r}; make the environment with "
                    "history.environment()"
                )
        return np.array([places[name] for name in self.feature_names], dtype=np.int64)

    def told_columns(self, observation_names: Sequence[str]) -> NDArray[np.int64]:
        """Return the columns that tell the delay: one per channel if they differ; may be none.

        An environment with `observation_scale="controlled"` gives them in units of its
        `max_delay`; a policy is told their mean in seconds.
        """
        found = [i for i, name in enumerate(observation_names) if name.startswith("told_delay")]
        return np.array(found, dtype=np.int64)

    def hat(self, told: FloatArray) -> FloatArray:
        """Return the weights of the knots, shape (lanes, knots).

        Linear between neighbouring knots, constant beyond the ends; a row sums to one. Ones of
        shape (lanes, 1) for a policy that is not told.

        Args:
            told: Told delay of every lane, shape (lanes,) [s].
        """
        lanes = len(told)
        if len(self.told_knots) < 2:
            return np.ones((lanes, 1))
        lower, share = self.place(told)
        weights = np.zeros((lanes, len(self.told_knots)))
        weights[np.arange(lanes), lower] = 1.0 - share
        weights[np.arange(lanes), lower + 1] = share
        return weights

    def place(self, told: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
        """Return the knot below every told delay and the share of the way to the next.

        Args:
            told: Told delay of every lane, shape (lanes,) [s].

        Returns:
            Index of the lower knot, and the share in [0, 1], both of shape (lanes,); zeros with
            fewer than two knots.
        """
        if len(self.told_knots) < 2:
            return np.zeros(len(told), dtype=np.int64), np.zeros(len(told))
        knots = np.array(self.told_knots)
        inside = np.minimum(np.maximum(told, knots[0]), knots[-1])
        lower = np.clip(np.searchsorted(knots, inside) - 1, 0, len(knots) - 2)
        share = (inside - knots[lower]) / (knots[lower + 1] - knots[lower])
        return lower.astype(np.int64), share


def _tuple(name: str, values: Any) -> tuple[Any, ...]:
    if not isinstance(values, tuple | list):
        raise ArgumentError(f"{name} = {values!r:.60} must be a list")
    return tuple(values)


def _lags(name: str, lags: tuple[Any, ...], first: int) -> tuple[int, ...]:
    whole = tuple(check_count(name, lag, minimum=first) for lag in lags)
    if any(after <= before for before, after in pairwise(whole)):
        raise ArgumentError(f"{name} = {whole!s:.60} must rise")
    if whole and whole[-1] > LONGEST_LAG:
        raise ArgumentError(
            f"{name} reaches back {whole[-1]} control periods; {LONGEST_LAG} are the most"
        )
    return whole
