"""The undelayed expert: it knows vehicle and track, and its command acts at once.

    wanted_j = -K X_j

with X_j the state of the design model (`baselines.design.model`) at sample j and K the gain of the
sampled regulator, for a command that is held for a control period. X holds the vehicle's states,
the track process and the ride filters. The vehicle's states and the track under the wheelsets are
read off the simulation; the filters and the rates of the track follow by an estimator on these, as
in `baselines.optimum`, which is told the forces that really act.

Beside it, the same expert made causal: under a delay of d periods it commands what the expert
will want on the average, given all that is known now and the commands on their way,

    u_k = -K [A^d X_k + sum_{i=1..d} A^(i-1) B u_(k-i)]

It still reads every state and the track, which no vehicle does.
"""

import numpy as np
from numpy.typing import NDArray

from baselines.design.model import design_model
from baselines.design.optimum import estimator, regulator
from baselines.optimum import everything
from baselines.policies.base_law import spread_of
from baselines.policies.history import History
from railenv.envs.settings import EnvSettings
from railenv.errors import ArgumentError
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle

_ALL_BUT_EXACT = 1e-3
# Noise of the readings that stand for full information, as in `baselines.optimum`.


class UndelayedExpert:
    """The expert of many lanes, each with a delay of its own.

    Args:
        vehicle: What it is designed for.
        environment: Gives track, time step and the actuator.
        history: Gives control period, actions and their scale.
        effort: Cost of the mean square command in units of (3 kN)^2 [(m/s^2)^2], above zero.
        preview: Whether it knows that trailing wheelsets meet the track of the leading one.

    Attributes:
        gain: K for the actions, mean over the actuators of a bogie, shape (actions, n) [1].

    Raises:
        ArgumentError: The track has no rational density, or the actuator has a lag, a rate limit
            or a force limit below the action's scale.
    """

    def __init__(
        self,
        vehicle: LateralVehicle,
        environment: EnvSettings,
        history: History,
        effort: float,
        preview: bool,
    ) -> None:
        e = environment
        if e.actuator_lag or e.rate_limit is not None or e.force_limit < history.action_scale:
            raise ArgumentError(
                "actuator_lag, rate_limit and a force_limit below action_scale are not in the "
                "expert's model; leave them out for imitation"
            )
        if len(e.tracks()) != 1:
            raise ArgumentError("the expert is designed for one kind of track; give one")
        model = design_model(
            vehicle,
            0.0,
            preview=preview,
            track=e.tracks()[0],
            period=history.control_period,
            time_step=e.time_step,
        )
        known = estimator(model, everything(vehicle), _ALL_BUT_EXACT)
        spread = spread_of(history)
        mean = spread.T / (history.share * history.action_scale)
        self.gain: FloatArray = mean @ regulator(model, effort).gain
        self._A, self._M, self._L = model.A, known.M, known.gain
        self._B = model.B @ (history.action_scale * spread)

    def start(self, late: NDArray[np.int64]) -> None:
        """Begin episodes with nothing on its way.

        Args:
            late: Delay of every lane in whole control periods, shape (lanes,).
        """
        self._late = late
        lanes, longest = len(self._late), int(self._late.max())
        size, actions = self._B.shape
        self._before: FloatArray = np.zeros((lanes, size))
        self._issued: FloatArray = np.zeros((longest + 1, lanes, actions))
        powers = [self.gain]
        for _ in range(longest):
            powers.append(powers[-1] @ self._A)
        self._ahead = np.array(powers)[self._late]
        # What an action of i + 1 periods ago adds by the time that the next one arrives.
        ages = [power @ self._B for power in powers[:-1]]
        self._ages = np.array(ages).reshape(longest, actions, actions)

    def see(self, known: FloatArray) -> FloatArray:
        """Take vehicle's states and track, and return what the expert wants to act now.

        Args:
            known: In the order of `baselines.optimum.everything`, shape (lanes, n + 8).

        Returns:
            Actions, not cut, shape (lanes, actions) [1].
        """
        self._state = self._before + (known - self._before @ self._M.T) @ self._L.T
        return -self._state @ self.gain.T

    def command(self) -> FloatArray:
        """Return the causal expert's actions for the delays of the lanes, (lanes, actions) [1]."""
        wanted = -np.einsum("lan,ln->la", self._ahead, self._state)
        for i, age in enumerate(self._ages):
            wanted -= np.where(self._late[:, None] > i, self._issued[i] @ age.T, 0.0)
        return wanted

    def go_on(self, issued: FloatArray) -> None:
        """Advance by one period.

        Args:
            issued: The actions that every lane has issued now, cut, shape (lanes, actions) [1].
        """
        self._issued = np.concatenate([issued[None], self._issued[:-1]])
        acting = self._issued[self._late, np.arange(len(self._late))]
        self._before = self._state @ self._A.T + acting @ self._B.T
