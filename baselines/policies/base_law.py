"""The classical law under a residual policy: its action per bogie or actuator, and its matrices.

A policy adds its own action to that of the law, before the cut to the box. Where an action goes to
all actuators of a bogie, the law's is the mean of its forces there.
"""

import numpy as np

from baselines.controller import Controller, LinearFeedback, measured_by
from baselines.linear_dynamic import LinearDynamic
from baselines.policies.history import History
from railenv.errors import ArgumentError
from railenv.units import FloatArray
from railenv.vehicle import lateral17

ClassicalLaw = LinearFeedback | LinearDynamic

_ACTS = (LinearFeedback.act, LinearDynamic.act)


class BaseLaw:
    """A classical law as part of a policy.

    Args:
        law: Linear feedback, static or dynamic, that acts by the method of its class.
        history: Layout, actions and control period of the policy.

    Attributes:
        law: As given.
        sensors: Names of its readings.
        measures: Names of the measured columns that it is given.

    Raises:
        ArgumentError: It is no linear law, or has another layout or control period.
    """

    def __init__(self, law: Controller, history: History) -> None:
        if not isinstance(law, ClassicalLaw) or type(law).act not in _ACTS:
            raise ArgumentError(
                f"base {type(law).__name__} is no linear law; give a LinearFeedback or a "
                "LinearDynamic, as make_controller('skyhook') does"
            )
        if law.layout != history.layout:
            raise ArgumentError(
                f"base has layout {law.layout} and history layout {history.layout}; use the same"
            )
        if isinstance(law, LinearDynamic) and law.control_period != history.control_period:
            raise ArgumentError(
                f"base has control_period = {law.control_period:g} s and history "
                f"{history.control_period:g} s; use the same"
            )
        self.law: ClassicalLaw = law
        self.sensors = law.sensors
        self.measures = measured_by(law, history.layout)
        self._history = history

    def reset(self, num_lanes: int) -> None:
        """Start every lane of the law at rest."""
        self.law.reset(num_lanes, 0)

    def act(self, observations: FloatArray) -> FloatArray:
        """Return the law's actions, shape (lanes, actions) [1].

        Args:
            observations: The columns `measures`, shape (lanes, columns), SI units.
        """
        share = self._history.share
        each = self.law.act(observations) * (self.law.action_scale / self._history.action_scale)
        total = each[:, ::share].copy()
        for place in range(1, share):
            total += each[:, place::share]
        return total / share

    def matrices(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return the sampled law from its readings [SI] to its actions [1]: A, B, C, D."""
        history = self._history
        # The law's own matrices do not depend on the vehicle that the loop is closed around.
        vehicle = lateral17("paper_fit", history.layout, 300.0)
        loop = self.law.to_sampled_loop(vehicle, history.control_period)
        mean = spread_of(history).T / (history.share * history.action_scale)
        return loop.Ac, loop.Bc, mean @ loop.Cc, mean @ loop.Dc

    def static_weights(self) -> FloatArray | None:
        """Return the law as gains of the features, shape (actions, F) [1].

        None for a law with states, or one with a reading that is no feature.
        """
        history = self._history
        if not isinstance(self.law, LinearFeedback):
            return None
        if not set(self.sensors) <= set(history.sensors):
            return None
        weights = np.zeros((history.num_actions, history.num_features))
        for column, name in enumerate(self.sensors):
            place = history.sensors.index(name)
            weights[:, place] += self.matrices()[3][:, column] * history.scales[place]
        return weights


def spread_of(history: History) -> FloatArray:
    """Return which actuator takes which action, shape (channels, actions), ones and zeros."""
    return np.repeat(np.eye(history.num_actions), history.share, axis=0)
