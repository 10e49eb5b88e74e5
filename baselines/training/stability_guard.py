"""Keeps a policy's loops stable near rest while something else is optimised.

Simulated windows do not show every instability: one that is confined to a strip of delays of some
tens of microseconds, or told at the edge of the error, is met by no lane, and one below the comfort
filter costs nothing until it is large. The oracle sees them. In every window some pairs of a true
and a told delay are looked at by eigenvalues z of the lifted map, and for each whose growth rate
exceeds -margin the gradient of that rate is added to the loss's.

With features x = phi(z) a z^k of a motion a z^k of the actions, the loop closes where

    (I - W phi(z)) a = 0,    l (I - W phi(z)) = 0.

Hence dz = -(l dW phi a) / (l W phi' a), and the growth rate ln|z| / T has the gradient
Re(dz / z) / T (Stewart and Sun, Matrix Perturbation Theory, 1990, for simple eigenvalues).

W are the gains of the policy near rest: for a linear policy those everywhere, for a network with
its Jacobian, for a gated policy those of the gates at rest (and, besides, those of the gates that
would be right in motion). They are functions of the weights, and the gradient goes on into these by
automatic differentiation.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from scipy import linalg
from torch import Tensor

from baselines.controller import Controller, plant_seen
from baselines.policies.base_law import BaseLaw, spread_of
from baselines.policies.history import History
from baselines.policies.linear import LinearPolicy
from railenv.actuation import ActuatorSpec
from railenv.actuation.hold import held_input
from railenv.errors import ArgumentError, check_count, check_not_negative, check_positive
from railenv.units import ComplexArray, FloatArray, PerSecond, Second
from railenv.vehicle import LateralVehicle

_BESIDE: Second = 1e-6
_STEP = 1e-6
# Step of the derivative as a share of z: rounding and curvature both give some 1e-9 of it.


_AT_KNOT = 0.4
# Share of the pairs that are told a knot of the schedule.
_OPEN_LOOP = 1e-9
# An eigenvalue this close (as a share) to one of the vehicle alone is not moved by the feedback.


@dataclass(frozen=True)
class GuardedDelays:
    """What is to stay stable.

    Attributes:
        low: Shortest delay [s].
        high: Longest delay [s].
        told_error: Largest error of the told delay; 0 for a hidden one [s].
        margin: Growth rates up to minus this are left alone [1/s].
        looks: New pairs of true and told delay per call; as many of the worst are looked at again.
    """

    low: Second
    high: Second
    told_error: Second
    margin: PerSecond = 0.05
    looks: int = 4

    def __post_init__(self) -> None:
        check_not_negative("low", self.low, "seconds")
        check_not_negative("told_error", self.told_error, "seconds")
        check_positive("margin", self.margin)
        check_count("looks", self.looks)
        if self.high < self.low:
            raise ArgumentError(f"delays from {self.low:g} to {self.high:g} s are upside down")


class StabilityGuard:
    """Growth rates of a policy around a vehicle, and their gradients.

    Args:
        vehicle: The vehicle.
        actuator: Its lag is part of the loop.
        guarded: Delays, error and margin.

    Attributes:
        watched: Pairs of true and told delay that are looked at again, shape (pairs, 2) [s].
    """

    def __init__(
        self, vehicle: LateralVehicle, actuator: ActuatorSpec, guarded: GuardedDelays
    ) -> None:
        self._vehicle, self._actuator, self._guarded = vehicle, actuator, guarded
        self.watched: FloatArray = np.zeros((0, 2))

    def slope(
        self,
        history: History,
        gains_of: Callable[[float], Tensor],
        base: Controller | None,
        generator: np.random.Generator,
    ) -> tuple[float, Tensor]:
        """Look at some pairs of delays.

        Args:
            history: What the policy sees; if it is told no delay, its gains are always the same.
            gains_of: Gains of the features for a told delay [s], with the graph, in double
                precision, shape (actions, F) [1].
            base: Classical law whose action is added; static, or None.
            generator: Chooses the pairs.

        Returns:
            The largest growth rate that was seen [1/s], and a number whose gradient with respect
            to the weights is that of the sum of what rates exceed -margin by; its value means
            nothing.

        """
        pairs = np.vstack([self.watched, self._drawn(history, generator)])
        rates, total = np.zeros(len(pairs)), torch.zeros((), dtype=torch.float64)
        alone = dataclasses.replace(history, told_knots=())
        untold = None if history.is_told else gains_of(0.0)
        for place, (delay, told) in enumerate(pairs):
            gains = gains_of(told) if untold is None else untold
            law = LinearPolicy(alone, gains.detach().numpy()[None], base=base)
            rates[place], own = self.growth(law, delay, told)
            if rates[place] > -self._guarded.margin:
                total = total + (torch.tensor(own) * gains).sum()
        worst_first = np.argsort(-rates)[: self._guarded.looks]
        self.watched = pairs[worst_first]
        return float(rates.max()), total

    def growth(self, policy: LinearPolicy, delay: float, told: float) -> tuple[float, FloatArray]:
        """Return the growth rate at one pair of delays and its gradient.

        Args:
            policy: The policy.
            delay: True delay [s].
            told: Told delay [s].

        Returns:
            ln|z| / T of the largest eigenvalue [1/s], and its gradient with respect to the gains in
            use there, shape (actions, F); zeros where the eigenvalue is one of the vehicle alone,
            which features of infinite size go with, as at the start of a training.
        """
        T = policy.control_period
        loop = policy.law_at(told).to_sampled_loop(self._vehicle, T, self._actuator)
        values = linalg.eigvals(loop.lifted_matrix(delay))
        z = complex(values[np.argmax(np.abs(values))])
        rate = float(np.log(abs(z)) / T)
        if np.abs(self._own(T) - z).min() <= _OPEN_LOOP * abs(z):
            return rate, np.zeros(policy.weights.shape[1:])
        gains = policy.gains_at(told) + _base_gains(policy)
        phi = self._features(policy, delay, z)
        ahead, behind = (self._features(policy, delay, z * (1.0 + s)) for s in (_STEP, -_STEP))
        slope = (ahead - behind) / (2.0 * _STEP * z)
        U, _, V = linalg.svd(np.eye(len(gains)) - gains @ phi)
        left, right = U[:, -1].conj(), V[-1].conj()
        turn = left @ gains @ slope @ right
        change = -np.outer(left, phi @ right) / (turn * z)
        return rate, np.real(change) / T

    def _own(self, period: float) -> ComplexArray:
        """Return the eigenvalues exp(s T) of the vehicle without feedback."""
        plant = plant_seen(self._vehicle, (), self._actuator)
        return np.exp(linalg.eigvals(plant.A) * period).astype(np.complex128)

    def _features(self, policy: LinearPolicy, delay: float, z: complex) -> ComplexArray:
        """Return phi(z): the features of a motion z^k of each action, shape (F, actions)."""
        history, T = policy.history, policy.control_period
        plant = plant_seen(self._vehicle, history.sensors, self._actuator)
        whole = int(np.floor(delay / T))
        rest = min(max(delay - whole * T, 0.0), T)
        spread = policy.action_scale * spread_of(history)
        transition, full = held_input(plant.A, plant.B @ spread, T)
        _, late = held_input(plant.A, plant.B @ spread, T - rest)
        pushed = (full - late) * z ** -(whole + 1) + late * z**-whole
        moved = linalg.solve(z * np.eye(len(plant.A)) - transition, pushed)
        reading = plant.C @ moved + plant.D @ spread * z ** -(whole + 1)
        reading = reading / np.array(history.scales)[:, None]
        parts = [reading * z**-age for age in history.sensor_lags]
        parts += [np.eye(history.num_actions) * z**-age for age in history.action_lags]
        return np.vstack(parts).astype(np.complex128)

    def _drawn(self, history: History, generator: np.random.Generator) -> FloatArray:
        """Draw pairs: beside a whole period or anywhere, told at an extreme, a knot or inside.

        At a knot the gains are those of the knot alone, a corner of what interpolation reaches.
        """
        guarded, T, n = self._guarded, history.control_period, self._guarded.looks
        delay = generator.uniform(guarded.low, guarded.high, n)
        share = np.clip(generator.uniform(-2.0, 2.0, n), -1.0, 1.0)
        knots = np.array(history.told_knots or (0.0,))
        at_knot = (generator.random(n) < _AT_KNOT) & history.is_told
        knot = generator.choice(knots, n)
        delay = np.where(at_knot, knot - guarded.told_error * share, delay)
        whole = np.round(delay / T) * T
        kind = generator.integers(0, 3, n)
        delay = np.choose(kind, [delay, whole - _BESIDE, whole + _BESIDE])
        delay = np.clip(delay, guarded.low, guarded.high)
        told = np.maximum(delay + guarded.told_error * share, 0.0)
        near = np.abs(knot - delay) <= guarded.told_error
        return np.column_stack([delay, np.where(at_knot & near, knot, told)])


def _base_gains(policy: LinearPolicy) -> FloatArray:
    """Return the base as gains of the features, shape (actions, F); zeros without one."""
    if policy.base is None:
        return np.zeros(policy.weights.shape[1:])
    gains = BaseLaw(policy.base, policy.history).static_weights()
    if gains is None:
        raise ArgumentError(
            "the policy's base has states or reads what is no feature, so that the guard has no "
            "gradient through it; give a static base, or growth_weight = 0"
        )
    return gains
