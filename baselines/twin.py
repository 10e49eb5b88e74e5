"""A differentiable twin of the linear environment, in torch.

The same episodes and the same numbers as `railenv.envs.rail_vector_env.Lateral17VectorEnv`, written
a second time so that gradients flow: from a reward through ride filter, vehicle, late force and
actuator limits back to the action, and through the observation to everything before. Training on it
differentiates the model of the vehicle; it is not model-free.
"""

from typing import Any

import numpy as np
import torch
from gymnasium.utils import seeding
from torch import Tensor

from baselines.twin_period import PeriodMatrices, refuse_varying_delays
from baselines.twin_reward import TERMS, TwinReward
from baselines.twin_track import WINDOW, TrackAhead
from railenv.actuation.delay_line import split_delay
from railenv.envs.lanes import Lanes
from railenv.envs.observation import bound
from railenv.envs.spaces import checked_settings
from railenv.errors import ArgumentError, check_count
from railenv.metrics.ride_filter import ride_filter


class DifferentiableTwin:
    """Many linear vehicles side by side, from actions to rewards by differentiable operations.

    Spaces, reward and settings are those of `railenv.envs.rail_env.Lateral17Env`; lane k after
    `reset(seed=s)` is lane k of the vector environment after the same. In float64 the two agree to
    1e-9 in observation (in units of the columns' scales) and reward; measured: 1e-11. In float32
    measured columns are within 3e-4 of their scales and rewards within 1e-4 after 20 s (measured
    with both layouts in stable loops): enough to train with, not to score with.

    Differences to the environment:

    - Constant delays only, fractional, per channel and lane; jitter and dropouts are refused.
    - The observation is not rounded to float32.
    - No lane starts anew by itself. One that leaves the gauge or diverges gets the penalty in that
      step, as in the environment, and is then frozen: state and observation stay, rewards are zero
      and nothing it does has a gradient. All lanes end together after `episode_seconds`.
    - The gradient is that of the formulas as they stand: none through an action outside the box, a
      command beyond a limit, a comfort term at its cap or a reading beyond its bound, and none from
      the penalty, which is a constant.

    Example::

        twin = DifferentiableTwin(128, delay=(0.0, 0.2), track="german_low", dtype=torch.float32)
        gain = torch.zeros(len(twin.observation_names), twin.num_actions, requires_grad=True)
        optimiser = torch.optim.Adam([gain], lr=3e-3)
        for update in range(200):
            if update % 6 == 0:
                observation = twin.reset(seed=update * 128)
            observation = twin.detach()  # no gradient into the last window
            power = 0.0
            for _ in range(300):
                observation, reward, info = twin.step(observation @ gain)
                power = power + info["weighted_acceleration"] ** 2 / 300
            loss = torch.log(1.0 + power / 0.05**2).mean()
            optimiser.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_([gain], 1.0)
            optimiser.step()

    Args:
        num_lanes: Number of lanes.
        device: Where the tensors are, e.g. "cpu" or "cuda". Episodes are drawn and tracks sampled
            on the processor whatever the device.
        dtype: `torch.float64` or `torch.float32`.
        settings: Fields of `railenv.envs.settings.EnvSettings`.

    Attributes:
        settings: The settings.
        num_lanes: Number of lanes.
        num_actions: Entries of an action.
        observation_names: Name of every column of the observation.
        delay: From measurement to force in this episode, shape (lanes, channels) [s].
        periods: Control periods since the reset.

    Raises:
        ArgumentError: A setting is unknown or out of its range, or delays vary within an episode.
    """

    def __init__(
        self,
        num_lanes: int,
        *,
        device: str | torch.device = "cpu",
        dtype: torch.dtype = torch.float64,
        **settings: Any,
    ) -> None:
        self.num_lanes = check_count("num_lanes", num_lanes)
        self.settings = s = checked_settings(settings)
        refuse_varying_delays(s)
        if dtype not in (torch.float64, torch.float32):
            raise ArgumentError(f"dtype = {dtype} must be torch.float64 or torch.float32")
        self._kind: dict[str, Any] = {"device": torch.device(device), "dtype": dtype}
        self._lanes = Lanes(s, num_lanes)
        self.num_actions = self._lanes.num_actions
        self.observation_names = self._lanes.observation_names
        episodes = self._lanes.episodes
        self._measured = len(episodes.measured)
        scales = self._lanes.scales
        self._steps = round(s.control_period / s.time_step)
        self._matrices = PeriodMatrices(
            episodes.vehicles,
            episodes.measured,
            1.0 / scales[: self._measured],
            s.actuator(),
            s.time_step,
            self._steps,
            ride_filter(1.0 / s.time_step),
        )
        limits = np.array([bound(name)[0] for name in episodes.measured])
        self._bound = self._tensor(limits / scales[: self._measured])
        told = len(scales) - (s.observation_history + 1) * self._measured
        told -= s.num_past_actions() * self.num_actions
        self._told_scale = scales[len(scales) - told :]
        limit = s.actuator().force_limit
        self._force_limit = float("inf") if limit is None else limit
        self._reward = TwinReward(s, self._matrices.rows)
        self._track = TrackAhead(episodes, self._steps, s.time_step)
        self._last_period = s.num_periods()
        self._one_vehicle = len(episodes.vehicles) == 1
        self._started = False

    def reset(self, seed: int | None = None) -> Tensor:
        """Start a new episode in every lane.

        Args:
            seed: A number s seeds lane k with s + k, as in the vector environment; None goes on
                with the random streams as they are.

        Returns:
            Observations, shape (lanes, columns).
        """
        lanes, here, n = self._lanes, self._lanes.episodes, self._matrices.num_states
        everyone = np.arange(self.num_lanes, dtype=np.int64)
        if seed is not None:
            first = check_count("seed", seed, minimum=0)
            for lane in everyone:
                lanes.generators[lane] = seeding.np_random(first + int(lane))[0]
        states = here.start(everyone, [lanes.generator(int(lane)) for lane in everyone], None)
        if lanes.noise:
            lanes.noise.draw(range(self.num_lanes), lanes.generator)
        self._set_delays(here.vehicle, here.delay)
        begin = np.zeros((self.num_lanes, n)) if states is None else states
        at_start = np.concatenate([begin, self._track.start()], axis=1)
        sampled = (self._matrices.start[here.vehicle] @ at_start[..., None])[..., 0]
        memory = np.zeros((self.num_lanes, self._matrices.rows.state.stop - n))
        self._state = self._tensor(np.concatenate([begin, memory], axis=1))
        self._frames = self._zeros(self._measured * (self.settings.observation_history + 1))
        self._actions = self._zeros(self.settings.num_past_actions() * self.num_actions)
        self._told = self._tensor(here.told[:, : len(self._told_scale)] / self._told_scale)
        self.delay = self._tensor(here.delay)
        self._ended = torch.zeros(self.num_lanes, dtype=torch.bool, device=self._kind["device"])
        self.periods = 0
        self._started = True
        self._observation = self._observe(self._tensor(sampled))
        return self._observation.clone()

    def step(self, actions: Tensor) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
        """Send one action per lane on its way and advance by one control period.

        Args:
            actions: Shape (lanes, actions), cut to [-1, 1].

        Returns:
            Observations, shape (lanes, columns), rewards, shape (lanes,), and info, each entry
            with the lanes first: "comfort", "effort", "stroke" and "divergence" (the reward's
            terms), "weighted_acceleration" of this period [m/s^2], "force" per channel at its end
            [N], all zero for lanes that ended before, and "ended", the lanes that have ended by
            now.

        Raises:
            ArgumentError: The actions have the wrong shape, type or device or are not finite, there
                was no reset, or the episodes are over.
        """
        self._check(actions)
        rows, m = self._matrices.rows, self._matrices.num_channels
        applied = actions.clamp(-1.0, 1.0)
        forces = self._send(applied)
        result = self._advance(forces.flatten(1))
        moving = ~self._ended
        terms, gone = self._reward.assess(result, applied)
        n = self._matrices.num_states
        force = result[:, n - m : n] if self._matrices.lagged else forces[:, 1]
        zero = torch.zeros((), **self._kind)
        shown = torch.where(moving[:, None], torch.cat([terms, force], dim=1), zero)
        self._state = torch.where(moving[:, None], result[:, rows.state], self._state)
        if len(self._actions[0]):
            kept = self._actions[:, : -self.num_actions]
            self._actions = torch.cat([applied, kept], dim=1)
        observation = self._observe(result[:, rows.sampled])
        self._observation = torch.where(moving[:, None], observation, self._observation)
        self._ended = self._ended | gone
        self.periods += 1
        info = {name: shown[:, column] for column, name in enumerate(TERMS)}
        info["weighted_acceleration"] = shown[:, len(TERMS)]
        info["force"] = shown[:, len(TERMS) + 1 :]
        info["ended"] = self._ended.clone()
        return self._observation.clone(), shown[:, : len(TERMS)].sum(dim=1), info

    def detach(self) -> Tensor:
        """Cut the graph and keep the state, for truncated back-propagation.

        Returns:
            The latest observation, cut off too, shape (lanes, columns).
        """
        self._check_started()
        for name in ("_state", "_sent", "_frames", "_actions", "_observation"):
            setattr(self, name, getattr(self, name).detach())
        return self._observation.clone()

    def _set_delays(self, vehicle: np.ndarray, delay: np.ndarray) -> None:
        """Find the matrices of the lanes and which command each channel waits for."""
        matrices, m = self._matrices, self._matrices.num_channels
        whole, rest = split_delay(delay, self.settings.time_step)
        age = whole // self._steps
        after = matrices.switched(vehicle, whole % self._steps, rest)
        before = matrices.held[vehicle] - after
        self._by_force = self._tensor(np.concatenate([before, after], axis=2))
        which = np.zeros(1, dtype=np.int64) if self._one_vehicle else vehicle
        self._by_state = self._tensor(matrices.own[which])
        self._by_track = self._tensor(matrices.track[which])
        arrival = np.stack([age + 1, age], axis=1)
        self._arrival = torch.from_numpy(arrival).to(self._kind["device"])
        self._sent = self._zeros(int(age.max()) + 2, m)

    def _send(self, applied: Tensor) -> Tensor:
        """Send commands; return the forces before and after the switch, (lanes, 2, channels)."""
        s = self.settings
        command = s.action_scale * applied
        share = self._matrices.num_channels // self.num_actions
        if share > 1:
            command = command.repeat_interleave(share, dim=1)
        command = command.clamp(-self._force_limit, self._force_limit)
        if s.rate_limit is not None:
            change, last = s.rate_limit * s.control_period, self._sent[:, 0]
            command = torch.minimum(torch.maximum(command, last - change), last + change)
        self._sent = torch.cat([command[:, None], self._sent[:, :-1]], dim=1)
        return self._sent.gather(1, self._arrival)

    def _advance(self, forces: Tensor) -> Tensor:
        """Return the results of one period, see `PeriodMatrices`, shape (lanes, results)."""
        place = self.periods % WINDOW
        if place == 0:
            inputs = self._tensor(self._track.window(self.periods))
            self._excited = inputs @ self._by_track.transpose(1, 2)
        if self._one_vehicle:
            own = torch.addmm(self._excited[:, place], self._state, self._by_state[0].T)
        else:
            own = (self._by_state @ self._state[:, :, None])[:, :, 0] + self._excited[:, place]
        return own + (self._by_force @ forces[:, :, None])[:, :, 0]

    def _observe(self, sampled: Tensor) -> Tensor:
        """Add a measurement and return the observation."""
        noise = self._lanes.noise
        if noise:
            noise.renew(self._lanes.generator)
            sampled = sampled + self._tensor(noise.take())
        reading = torch.clamp(sampled, -self._bound, self._bound)
        self._frames = torch.cat([reading, self._frames[:, : -self._measured]], dim=1)
        return torch.cat([self._frames, self._actions, self._told], dim=1)

    def _check(self, actions: Tensor) -> None:
        self._check_started()
        if self.periods >= self._last_period:
            raise ArgumentError(
                f"the episodes of {self.settings.episode_seconds:g} s are over; call reset, or set "
                "a longer episode_seconds"
            )
        expected = (self.num_lanes, self.num_actions)
        if tuple(actions.shape) != expected or actions.dtype != self._kind["dtype"]:
            raise ArgumentError(
                f"actions of shape {tuple(actions.shape)} and type {actions.dtype} must be "
                f"{expected} of {self._kind['dtype']}"
            )
        if actions.device.type != self._kind["device"].type:
            raise ArgumentError(
                f"actions are on {actions.device} and not on the twin's {self._kind['device']}"
            )
        if not bool(torch.isfinite(actions).all()):
            raise ArgumentError("actions hold a value that is not finite; give numbers in [-1, 1]")

    def _check_started(self) -> None:
        if not self._started:
            raise ArgumentError("the twin has not been reset yet; call reset first")

    def _tensor(self, values: np.ndarray) -> Tensor:
        return torch.tensor(values, **self._kind)

    def _zeros(self, *columns: int) -> Tensor:
        return torch.zeros(self.num_lanes, *columns, **self._kind)
