"""The twin as training uses it: given delays, both floor ends, and what only the model knows.

The twin draws delays by the environment's law; training wants laws of its own (`told_draws`). And
where the environment shows sensors and one comfort number, whoever trains with the model may look
inside: at each floor end, at the vehicle's states and at the track under the wheelsets.
"""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from baselines.twin import DifferentiableTwin
from baselines.twin_period import FLOOR_ENDS
from baselines.twin_track import WINDOW, TrackAhead
from railenv.envs.reward import RECORDED
from railenv.envs.settings import EnvSettings
from railenv.errors import ArgumentError
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle, state_space
from railenv.vehicle.suspension import NUM_TRACK

_DECIDED_HERE: dict[str, Any] = {
    "delay_observed": False,
    "told_error": 0.0,
    "observation_history": 0,
    "action_history": 0,
    "observation": "sensors",
    "observation_scale": "controlled",
}
# The policy's past is kept by `past.Past` and the told delay comes from the delays given: the twin
# shows the newest reading only, which is much cheaper than pushing every past one along.


class TrainingTwin(DifferentiableTwin):
    """The twin with delays given lane by lane.

    Args:
        num_lanes: Number of lanes.
        environment: Vehicle, track, noise, limits; what it says of the observation's form and of
            the told delay is left to training.
        dtype: `torch.float32` or `torch.float64`.

    """

    def __init__(
        self, num_lanes: int, environment: EnvSettings, dtype: torch.dtype = torch.float32
    ) -> None:
        fields = {name: getattr(environment, name) for name in EnvSettings.__dataclass_fields__}
        super().__init__(num_lanes, dtype=dtype, **{**fields, **_DECIDED_HERE})
        self._track: _Remembered = _Remembered(
            self._lanes.episodes, self._steps, self.settings.time_step
        )
        self._given: FloatArray = np.zeros(num_lanes)
        s = self.settings
        worst = [s.acceleration_limit] * FLOOR_ENDS + [s.gauge_limit] * FLOOR_ENDS
        self._limits = self._tensor(np.array(worst))
        self._any_ended = False

    @property
    def ended(self) -> NDArray[np.bool_]:
        """Which lanes have left the gauge or diverged, shape (lanes,)."""
        return self._ended.cpu().numpy().copy()

    @property
    def vehicle(self) -> LateralVehicle:
        """The vehicle.

        Raises:
            ArgumentError: There are several.
        """
        vehicles = self._lanes.episodes.vehicles
        if len(vehicles) != 1:
            raise ArgumentError(
                f"vehicle_ranges gives {len(vehicles)} vehicles where one is needed; set "
                'vehicle_ranges = "none"'
            )
        return vehicles[0]

    def start(self, seed: int, delay: FloatArray) -> Tensor:
        """Start a new episode with these delays.

        Args:
            seed: Lane k is seeded with seed + k.
            delay: Of each lane, the same for all channels, shape (lanes,) [s].

        Returns:
            The first reading, in units of the columns' scales, shape (lanes, measured).

        Raises:
            ArgumentError: A delay is negative or above `max_delay`.
        """
        longest = self.settings.max_delay * (1.0 + 1e-12)
        if not bool(np.all((delay >= 0.0) & (delay <= longest))):
            raise ArgumentError(
                f"delay = {delay.min():g} to {delay.max():g} s must be from 0 to max_delay = "
                f"{self.settings.max_delay:g} s; raise max_delay"
            )
        self._given, self._any_ended = delay, False
        return self.reset(seed)

    def _set_delays(self, vehicle: NDArray[np.int64], delay: FloatArray) -> None:
        # The array is the episodes' own: what the twin says of its delays stays true.
        delay[:] = self._given[:, None]
        super()._set_delays(vehicle, delay)
        self._by_force_first = self._by_force.transpose(1, 2).contiguous()

    def advance(self, actions: Tensor) -> tuple[Tensor, Tensor]:
        """Advance by one control period; `step` without the reward's terms, at twice its speed.

        A lane that leaves the gauge or diverges counts once more and is then frozen, as in `step`.

        Args:
            actions: Shape (lanes, actions), in [-1, 1] already.

        Returns:
            The new reading, in units of the columns' scales, shape (lanes, measured), and the
            ride-filtered acceleration of each floor end, front first, squared and averaged over
            the period, zero for lanes that had ended before, shape (lanes, 2) [(m/s^2)^2].

        Raises:
            ArgumentError: The episodes are over.
        """
        if self.periods >= self._last_period:
            raise ArgumentError("the episodes are over; call start, or set longer episode_seconds")
        rows = self._matrices.rows
        result = self._advance(self._send(actions).flatten(1))
        power = result[:, rows.weighted].unflatten(1, (-1, FLOOR_ENDS)).square().mean(dim=1)
        state, reading = result[:, rows.state], self._observe(result[:, rows.sampled])
        if self._any_ended:
            moving = ~self._ended[:, None]
            power = torch.where(moving, power, torch.zeros_like(power))
            state = torch.where(moving, state, self._state)
            reading = torch.where(moving, reading, self._observation)
        self._state, self._observation = state, reading
        self._ended = self._ended | self._gone(result.detach())
        self._any_ended = bool(self._ended.any())
        self.periods += 1
        return reading, power

    def _gone(self, result: Tensor) -> Tensor:
        """Return which lanes have left the gauge or diverged, by the rule of the reward."""
        recorded = result[:, self._matrices.rows.recorded].abs().unflatten(1, (-1, len(RECORDED)))
        return ~(recorded[..., : len(self._limits)] <= self._limits).flatten(1).all(dim=1)

    def _advance(self, forces: Tensor) -> Tensor:
        # As in the twin; a row times a matrix is four times as fast as a matrix times a column.
        place = self.periods % WINDOW
        if place == 0:
            inputs = self._tensor(self._track.window(self.periods))
            self._excited = inputs @ self._by_track.transpose(1, 2)
        if self._one_vehicle:
            own = torch.addmm(self._excited[:, place], self._state, self._by_state[0].T)
        else:
            own = (self._by_state @ self._state[:, :, None])[:, :, 0] + self._excited[:, place]
        return own + torch.bmm(forces[:, None], self._by_force_first)[:, 0]

    def known(self) -> FloatArray:
        """Return the vehicle's states and what its wheelsets meet now, shape (lanes, n + 8).

        In the order of `baselines.optimum.everything`; actuator lags, if any, are not among them.
        """
        self._check_started()
        n = len(state_space(self.vehicle).states)
        state = self._state[:, :n].detach().double().cpu().numpy()
        return np.hstack([state, self._track.now(self.periods)])


class _Remembered(TrackAhead):
    """Track inputs that can be asked for once more."""

    def start(self) -> FloatArray:
        self._first = super().start()
        self._window = np.zeros((len(self._first), WINDOW, 0))
        return self._first

    def window(self, periods: int) -> FloatArray:
        self._window = super().window(periods)
        return self._window

    def now(self, periods: int) -> FloatArray:
        """Return the inputs at the end of that many periods, shape (lanes, 8)."""
        if periods == 0:
            return self._first
        return self._window[:, (periods - 1) % WINDOW, -NUM_TRACK:]
