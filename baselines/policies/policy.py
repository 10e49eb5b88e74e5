"""Policies with a history: what all classes share.

A policy sees the features of its `History` and answers with actions that are cut to [-1, 1], as the
environment cuts them; the cut action is what is issued and what is remembered. With `base`, a
classical law, the policy's own action is added to the law's before the cut (residual learning:
Johannink et al., ICRA 2019; Silver et al., arXiv:1812.06298).

A policy that is told the delay needs `tell(delays)` after every `reset` and before the first `act`.

The oracle judges a policy at rest and inside the box: `law_at(told)` is the linear law that it is
there as long as it is told one delay, exact for a linear policy.
"""

import math

import numpy as np

from baselines.controller import Controller, check_layout, check_size, measured_columns, plant_seen
from baselines.linear_dynamic import LinearDynamic
from baselines.policies.base_law import BaseLaw, spread_of
from baselines.policies.history import History
from baselines.policies.realisation import Realisation, affine_form, observer_form
from railenv.actuation import ActuatorSpec
from railenv.errors import ArgumentError, check_not_negative, check_positive
from railenv.stability import SampledLoop
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle
from railenv.vehicle.coordinates import Layout

TOLD_UNIT = 0.3
"""What a network's told delay is in units of [s]."""


class HistoryPolicy:
    """A policy of finite history with a linear path; subclasses add to it.

    Args:
        history: What it sees, and what its actions mean.
        weights: Gains of the linear path, shape (knots, actions, F) [1]; one knot if not told.
        base: Classical law whose action is added before the cut; None for none.

    Attributes:
        history: As given.
        weights: As given, in double precision, read-only.
        base: As given.
        layout: The history's.
        sensors: Every reading that is used, those of `base` included.
        measures: The measured columns of the observation that it takes.
        action_scale: Force of an action of one [N].
        control_period: Time between actions [s].
        is_linear: Whether it is linear inside the box.

    Raises:
        ArgumentError: The weights have the wrong shape, are not finite, or `base` does not fit.
    """

    is_linear = False

    def __init__(
        self, history: History, weights: FloatArray, base: Controller | None = None
    ) -> None:
        self.history = history
        shape = (history.num_knots, history.num_actions, history.num_features)
        self.weights = checked_array("weights", weights, shape)
        self._base = None if base is None else BaseLaw(base, history)
        self.base = None if self._base is None else self._base.law
        self.layout: Layout = history.layout
        self.action_scale = history.action_scale
        self.control_period = history.control_period
        extra = () if self._base is None else self._base.sensors
        self.sensors: tuple[str, ...] = tuple(dict.fromkeys((*history.sensors, *extra)))
        self.measures = measured_columns(self.sensors, self.layout)
        self._columns = [self.measures.index(name) for name in history.sensors]
        self._scales = np.array(history.scales)
        self._base_columns = (
            [] if self._base is None else [self.measures.index(n) for n in self._base.measures]
        )
        self._readings: FloatArray = np.zeros((1, 0, len(history.sensors)))
        self._actions: FloatArray = np.zeros((1, 0, history.num_actions))
        self._told: FloatArray | None = None
        self._time = 0

    @property
    def is_told(self) -> bool:
        """Whether it has to be told the delay before it acts."""
        return self.history.is_told

    def reset(self, num_lanes: int, seed: int) -> None:  # noqa: ARG002
        """Forget the past of every lane, and the delay that was told."""
        history = self.history
        past = history.action_lags[-1] if history.action_lags else 1
        self._readings = np.zeros((history.sensor_lags[-1] + 1, num_lanes, len(history.sensors)))
        self._actions = np.zeros((past, num_lanes, history.num_actions))
        self._told = None
        self._time = 0
        if self._base is not None:
            self._base.reset(num_lanes)
        self._begin(num_lanes)

    def tell(self, delays: FloatArray) -> None:
        """Say which delay every lane is told; a policy that is not told takes no notice.

        Args:
            delays: Shape (lanes,) [s], zero or more.

        Raises:
            ArgumentError: The shape is not that of the last reset, or a value is not usable.
        """
        told = np.array(delays, dtype=float)
        lanes = self._readings.shape[1]
        if told.shape != (lanes,) or not np.all(np.isfinite(told)) or np.any(told < 0.0):
            raise ArgumentError(
                f"delays of shape {told.shape} must be one number per lane, shape ({lanes},), "
                "zero or more in seconds, after reset(num_lanes, seed)"
            )
        self._told = told

    def act(self, observations: FloatArray) -> FloatArray:
        """Return the actions, shape (lanes, channels), in [-1, 1].

        Raises:
            ArgumentError: The number of lanes is not that of the last reset, or the policy has to
                be told the delay and was not.
        """
        history, lanes = self.history, self._readings.shape[1]
        if observations.shape[0] != lanes:
            raise ArgumentError(
                f"observations have {observations.shape[0]} lanes, reset was called for {lanes}; "
                "call reset(num_lanes, seed) first"
            )
        if self._told is None and history.is_told:
            raise ArgumentError(
                "the policy has to be told the delay and was not; call tell(delays) after reset"
            )
        depth, past = len(self._readings), len(self._actions)
        self._readings[self._time % depth] = observations[:, self._columns] / self._scales
        parts = [self._readings[(self._time - age) % depth] for age in history.sensor_lags]
        parts += [self._actions[(self._time - age) % past] for age in history.action_lags]
        features = np.concatenate(parts, axis=1, dtype=np.float64)
        told = np.zeros(lanes) if self._told is None else self._told
        wanted = self._decide(features, told)
        if self._base is not None:
            wanted = wanted + self._base.act(observations[:, self._base_columns])
        actions = np.clip(wanted, -1.0, 1.0)
        self._actions[self._time % past] = actions
        self._time += 1
        return np.repeat(actions, history.share, axis=1)

    def _begin(self, num_lanes: int) -> None:
        """Make ready what a subclass remembers."""

    def _decide(self, features: FloatArray, told: FloatArray) -> FloatArray:
        """Return the policy's own actions before the cut, shape (lanes, actions), a new array.

        Args:
            features: Shape (lanes, F).
            told: Told delay, shape (lanes,) [s]; zeros if it is not told.
        """
        raise NotImplementedError

    def _at_rest(self, told: float) -> Realisation:
        """Return the policy's own law, linearised at rest; see `law_at`."""
        raise NotImplementedError

    def gains_at(self, told: float) -> FloatArray:
        """Return the gains of the linear path as it is told a delay, shape (actions, F) [1].

        Args:
            told: Told delay [s]; beyond the knots the gains are those of the last one.
        """
        delay = np.array([check_not_negative("told", told, "seconds")])
        lower, share = (each[0] for each in self.history.place(delay))
        if share == 0.0:
            return self.weights[lower].copy()
        return (1.0 - share) * self.weights[lower] + share * self.weights[lower + 1]

    def law_at(self, told: float = 0.0) -> LinearDynamic:
        """Return the linear law that the policy is at rest, as long as it is told one delay.

        Exact inside the box for a linear policy; for others the linearisation at rest, where every
        policy's action is zero. The base is included.

        Args:
            told: Told delay [s].
        """
        realisation = joined(self, self._at_rest(told))
        spread = self.action_scale * spread_of(self.history)
        A, B, C, D = realisation.A, realisation.B, realisation.C, realisation.D
        return LinearDynamic(
            (A, B, -spread @ C, -spread @ D),
            self.sensors,
            self.layout,
            self.action_scale,
            self.control_period,
            sampled=True,
        )

    def to_sampled_loop(
        self, vehicle: LateralVehicle, period: float, actuator: ActuatorSpec | None = None
    ) -> SampledLoop:
        """Close the loop around a vehicle, as the oracle wants it.

        Args:
            vehicle: The vehicle; its layout must be the policy's.
            period: Control period [s]; it must be the policy's own.
            actuator: Its lag becomes part of the plant; limits do not act on small motion.

        Returns:
            The loop, scheduled on the told delay for a policy that is told; a sensor with direct
            feedthrough sees the force before the switch.

        Raises:
            ArgumentError: The layouts or periods differ, or the policy is told the delay and not
                linear.
        """
        check_layout(self.layout, vehicle)
        given = check_positive("period", period, "seconds")
        if not math.isclose(given, self.control_period, rel_tol=1e-9):
            raise ArgumentError(
                f"period = {period:g} s, but the policy acts every control_period = "
                f"{self.control_period:g} s; use the same for both"
            )
        if not self.history.is_told:
            return self.law_at().to_sampled_loop(vehicle, self.control_period, actuator)
        if not self.is_linear:
            raise ArgumentError(
                f"{type(self).__name__} is told the delay and is not linear, so that no one loop "
                "holds for every told delay; ask law_at(told).to_sampled_loop(vehicle, period) for "
                "one told delay at a time"
            )
        forms = [joined(self, affine_form(self.history, gains)) for gains in self.weights]
        plant = plant_seen(vehicle, self.sensors, actuator)
        spread = self.action_scale * spread_of(self.history)
        return SampledLoop(
            A=plant.A,
            B=plant.B,
            C=plant.C,
            D=plant.D,
            period=self.control_period,
            Ac=np.stack([form.A for form in forms]),
            Bc=np.stack([form.B for form in forms]),
            Cc=np.stack([spread @ form.C for form in forms]),
            Dc=np.stack([spread @ form.D for form in forms]),
            told=np.array(self.history.told_knots),
        )

    def _linear_at_rest(self, gains: FloatArray) -> Realisation:
        return observer_form(self.history, gains)


def joined(policy: HistoryPolicy, own: Realisation) -> Realisation:
    """Return a policy's law with its base, over the readings `policy.sensors`.

    Args:
        policy: The policy.
        own: Its own law, over the readings of its history.

    Returns:
        The whole law; its E is that of `own`, with no effect on the base's states.
    """
    history, sensors = policy.history, policy.sensors
    p, own_p = len(sensors), len(history.sensors)
    B, D = np.zeros((len(own.A), p)), np.zeros((history.num_actions, p))
    # The history's readings come first.
    B[:, :own_p], D[:, :own_p] = own.B, own.D
    base = policy._base
    if base is None:
        return Realisation(own.A, B, own.C, D, own.E)
    Ab, Bb, Cb, Db = base.matrices()
    columns = [sensors.index(name) for name in base.sensors]
    through, entry = np.zeros_like(D), np.zeros((len(Ab), p))
    for k, column in enumerate(columns):
        through[:, column] += Db[:, k]
        entry[:, column] += Bb[:, k]
    A = np.block([[own.A, own.E @ Cb], [np.zeros((len(Ab), len(own.A))), Ab]])
    B = np.vstack([B + own.E @ through, entry])
    E = np.vstack([own.E, np.zeros((len(Ab), history.num_actions))])
    return Realisation(A, B, np.hstack([own.C, Cb]), D + through, E)


def checked_array(name: str, values: object, shape: tuple[int, ...]) -> FloatArray:
    """Return a read-only array of double precision of one shape.

    Raises:
        ArgumentError: It has another shape, or holds a value that is not finite or too large.
    """
    array = np.array(values, dtype=float)
    if array.shape != shape:
        raise ArgumentError(f"{name} has shape {array.shape}; it must be {shape}")
    if not np.all(np.isfinite(array)):
        raise ArgumentError(
            f"{name} holds a value that is not finite; every entry must be a number"
        )
    check_size(name, array)
    array.setflags(write=False)
    return array
