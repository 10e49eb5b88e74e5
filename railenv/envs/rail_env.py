"""The single Gymnasium environment of the linear lateral vehicle: a batch of one."""

import dataclasses
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from railenv.actuation import DelaySpec
from railenv.envs.observation import (
    Observer,
    bound,
    measured_names,
    pipe_length,
    recorded_columns,
)
from railenv.envs.reward import ComfortFilter, RewardTerms, reward_terms
from railenv.envs.settings import EnvSettings
from railenv.errors import ArgumentError, check_count, unknown_name
from railenv.simulation import (
    LateralSimulation,
    required_length,
    wheelset_inputs,
    whole_multiple,
)
from railenv.track import make_track
from railenv.units import FloatArray
from railenv.vehicle import lateral17
from railenv.vehicle.coordinates import actuator_positions

_FLOOR_ACCELERATIONS = ("floor_front_lateral_acceleration", "floor_rear_lateral_acceleration")
_FLOOR_DISPLACEMENTS = ("floor_front_lateral_displacement", "floor_rear_lateral_displacement")
_RESET_OPTIONS = ("delay", "track_seed")

Observation = NDArray[np.float32]


class Lateral17Env(gym.Env[Observation, Observation]):
    """Active lateral suspension of a railway vehicle whose forces arrive late.

    ## Description
    A carbody on two bogies runs at constant speed over an irregular track. Actuators between
    carbody and bogies replace two or all four lateral dampers. A force takes effect `delay`
    seconds after the observation that it answers; past a critical delay a feedback loop turns
    unstable, abruptly. The vehicle is the linear 17-coordinate lateral model
    (`railenv.vehicle.linear`), stepped exactly.

    ## Action space
    `Box(-1, 1, (channels,), float32)`; channels are the actuators front to rear: 4 with layout 4
    (both ends of the front bogie, then of the rear bogie), 2 with layout 2 (front end of the front
    bogie, rear end of the rear bogie).

    | index | meaning | min | max | unit |
    | --- | --- | --- | --- | --- |
    | k | force on the carbody to the right, reaction on the bogie, in `action_scale` | -1 | 1 | 1 |

    An action outside the box is clipped to it and flagged in `info["action_clipped"]`. The force
    limit (30 kN), the rate limit and the lag act behind it.

    ## Observation space
    `Box` of float32, SI units, at the instant of decision. With `observation="sensors"`, c =
    channels:

    | index (layout 4) | meaning | min | max | unit |
    | --- | --- | --- | --- | --- |
    | 0 to c-1 (0-3) | carbody lateral velocity at each actuator, damper level | -5 | 5 | m/s |
    | c to 2c-1 (4-7) | carbody lateral acceleration there | -50 | 50 | m/s^2 |
    | 2c, 2c+1 (8, 9) | lateral acceleration of the two bogie frames | -200 | 200 | m/s^2 |
    | 2c+2 (10) | carbody roll rate | -2 | 2 | rad/s |
    | 2c+3 (11) | carbody yaw rate | -2 | 2 | rad/s |
    | 2c+4 to 2c+7 (12-15) | stroke at places 1 to 4, carbody minus bogie | -0.5 | 0.5 | m |
    | from 2c+8 (16-135) | actions in the pipe, newest first, c per period | -1 | 1 | 1 |

    y is to the right and z down: positive roll puts the right side down, positive yaw turns the
    nose to the right. Damper places 1 and 2 are the front and rear end of the front bogie, 3 and 4
    of the rear bogie. Readings carry no noise. Accelerations are those just before a force that
    switches at this very instant.

    The pipe holds `max_delay / control_period` actions, rounded up (30). With `observation="state"`
    the model's own states stand in place of the sensors, each within +-100: 17 coordinates, their
    17 velocities, one node per Maxwell damper (38 with layout 4, 40 with layout 2). A reading
    beyond its bound is clipped and flagged in `info["observation_clipped"]`.
    `env.unwrapped.observation_names` lists the columns. The delay itself is not observed.

    ## Rewards
    `comfort + effort + divergence`: -min(a / 0.05 m/s^2, 5) for the Wd-weighted RMS a of both floor
    ends over the step, -0.01 times the mean square action, -500 on an ending by gauge or
    divergence. Every term is in `info`; settings change the constants; see `railenv.envs.reward`.

    ## Info
    Same keys at every step: `time` [s], `delay` per channel [s], `command` (action times
    `action_scale`) and `force` (what acts at the end of the step) per channel [N],
    `weighted_acceleration` a of the reward [m/s^2], `reward_comfort`, `reward_effort`,
    `reward_divergence`, `action_clipped`, `observation_clipped`, `ended_by` ("", "gauge" or
    "divergence").

    ## Start state
    At rest at the beginning of a track whose irregularity grows over its first 100 m. Delay (if a
    range is given) and track are drawn anew at every reset.

    ## Termination and truncation
    Terminated when a floor end leaves the vehicle's clearance gauge (its lateral displacement
    passes `gauge_limit`, 0.1 m; wheel-rail clearance is not modelled) or the floor acceleration
    passes `acceleration_limit` or is not finite; the reason is in `info["ended_by"]`. Truncated
    after `episode_seconds`.

    ## Arguments
    Keyword arguments are the fields of `railenv.envs.settings.EnvSettings`. `reset` takes
    `options={"delay": seconds, "track_seed": integer}` to fix what is drawn otherwise.

    ## Version history
    - v0: first version.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 (Gymnasium's own form)

    def __init__(self, render_mode: str | None = None, **settings: Any) -> None:
        if render_mode is not None:
            raise ArgumentError(f"render_mode = {render_mode!r} is not offered; leave it out")
        names = {field.name for field in dataclasses.fields(EnvSettings)}
        for name in settings:
            if name not in names:
                raise unknown_name("environment setting", name, names)
        self.render_mode = None
        self.settings = EnvSettings(**settings)
        s = self.settings
        self.vehicle = lateral17(s.vehicle, s.layout, s.speed_kmh)
        measured = measured_names(self.vehicle, s.observation)
        forces = tuple(f"actuator_force_{k}" for k in actuator_positions(self.vehicle.layout))
        self._simulation = LateralSimulation(
            self.vehicle,
            (*measured, *_FLOOR_ACCELERATIONS, *_FLOOR_DISPLACEMENTS, *forces),
            actuator=s.actuator(),
            control_period=s.control_period,
            time_step=s.time_step,
        )
        channels = self.vehicle.num_actuators
        pipe = pipe_length(s.max_delay, s.control_period)
        self._observer = Observer(measured, channels, pipe)
        self._measured = recorded_columns(self._simulation, measured)
        self._accelerations = recorded_columns(self._simulation, _FLOOR_ACCELERATIONS)
        self._displacements = recorded_columns(self._simulation, _FLOOR_DISPLACEMENTS)
        self._forces = recorded_columns(self._simulation, forces)
        self._comfort = ComfortFilter(1.0 / s.time_step, len(_FLOOR_ACCELERATIONS))
        self._num_periods = whole_multiple(
            "episode_seconds", s.episode_seconds, "control_period", s.control_period
        )
        self._delays: FloatArray = np.zeros(channels)
        limits = [bound(name)[0] for name in measured] + [1.0] * (pipe * channels)
        self._bound: Observation = np.array(limits, dtype=np.float32)
        self.observation_space = gym.spaces.Box(-self._bound, self._bound, dtype=np.float32)
        self.action_space = gym.spaces.Box(-1.0, 1.0, (channels,), dtype=np.float32)

    @property
    def observation_names(self) -> tuple[str, ...]:
        """Name of every column of the observation."""
        return self._observer.columns

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode: draw delay and track, vehicle at rest.

        Args:
            seed: Seeds the environment's generator.
            options: "delay" [s] (one value or one per channel) and "track_seed" fix what is drawn.

        Returns:
            Observation and info.

        Raises:
            ArgumentError: An option is unknown or out of its range.
        """
        super().reset(seed=seed)
        given = options or {}
        for name in given:
            if name not in _RESET_OPTIONS:
                raise unknown_name("reset option", str(name), _RESET_OPTIONS)
        # Both are always drawn, so that fixing one does not change the other.
        drawn_delay = self._drawn_delays()
        drawn_track = int(self.np_random.integers(2**63))
        self._delays = self._fixed_delays(given["delay"]) if "delay" in given else drawn_delay
        seed_of_track = check_count("track_seed", given.get("track_seed", drawn_track), minimum=0)
        s = self.settings
        steps = self._num_periods * self._simulation.steps_per_command
        length = required_length(self.vehicle, steps * s.time_step)
        track = make_track(s.track, length, seed_of_track)
        inputs = wheelset_inputs(self.vehicle, track, s.time_step, steps)
        self._simulation.reset(self._delays[None, :], inputs[None])
        self._observer.reset(1)
        self._comfort.reset()
        observation, clipped = self._observation(self._simulation.measure()[:, self._measured])
        zero = np.zeros(self.vehicle.num_actuators)
        terms = RewardTerms(0.0, 0.0, 0.0)
        return observation, self._info(zero, zero, terms, 0.0, False, clipped, "")

    def step(self, action: Observation) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Send an action on its way and advance by one control period.

        Args:
            action: Shape (channels,), in [-1, 1].

        Returns:
            Observation, reward, terminated, truncated, info.

        Raises:
            ArgumentError: The action has the wrong shape or is not finite.
        """
        given = np.asarray(action)
        if given.dtype.kind not in "fiu" or given.shape != self.action_space.shape:
            raise ArgumentError(
                f"action = {action!r} must be {self.action_space.shape} numbers in [-1, 1]"
            )
        wanted = given.astype(np.float64)
        if not np.all(np.isfinite(wanted)):
            raise ArgumentError(f"action = {action!r} must be finite; give numbers in [-1, 1]")
        applied = np.clip(wanted, -1.0, 1.0)
        s = self.settings
        recorded = self._simulation.advance(s.action_scale * applied[None, :])
        self._observer.push(applied[None, :])
        floor = recorded[0][:, self._accelerations].T
        ended_by = self._ended_by(floor, recorded[0][:, self._displacements])
        # Beyond divergence there is no comfort to be measured: the worst that is counted stands in.
        worst = s.comfort_cap * s.comfort_reference
        weighted = worst if ended_by == "divergence" else self._comfort.weighted_rms(floor)
        terms = reward_terms(s, weighted, applied, bool(ended_by))
        observation, clipped = self._observation(recorded[:, -1, self._measured])
        info = self._info(
            s.action_scale * applied,
            np.nan_to_num(recorded[0, -1, self._forces]),
            terms,
            weighted,
            bool(np.any(applied != wanted)),
            clipped,
            ended_by,
        )
        periods = self._simulation.step_count // self._simulation.steps_per_command
        return observation, terms.total, bool(ended_by), periods >= self._num_periods, info

    def _drawn_delays(self) -> FloatArray:
        channels = self.vehicle.num_actuators
        delay = self.settings.delay_range()
        if isinstance(delay, DelaySpec):
            return delay.per_channel(channels)
        return np.full(channels, self.np_random.uniform(*delay))

    def _fixed_delays(self, delay: Any) -> FloatArray:
        spec = delay if isinstance(delay, DelaySpec) else DelaySpec(delay)
        dataclasses.replace(self.settings, delay=spec)  # raises if it is above max_delay
        return spec.per_channel(self.vehicle.num_actuators)

    def _observation(self, measured: FloatArray) -> tuple[Observation, bool]:
        raw = self._observer.observe(measured)[0]
        clipped = np.clip(np.nan_to_num(raw, nan=0.0), -self._bound, self._bound)
        return clipped.astype(np.float32), bool(np.any(clipped != raw))

    def _ended_by(self, accelerations: FloatArray, displacements: FloatArray) -> str:
        if not np.all(np.abs(accelerations) <= self.settings.acceleration_limit):
            return "divergence"
        if not np.all(np.abs(displacements) <= self.settings.gauge_limit):
            return "gauge"
        return ""

    def _info(
        self,
        command: FloatArray,
        force: FloatArray,
        terms: RewardTerms,
        weighted: float,
        action_clipped: bool,
        observation_clipped: bool,
        ended_by: str,
    ) -> dict[str, Any]:
        return {
            "time": self._simulation.time,
            "delay": self._delays.copy(),
            "command": command.copy(),
            "force": force.copy(),
            "weighted_acceleration": weighted,
            "reward_comfort": terms.comfort,
            "reward_effort": terms.effort,
            "reward_divergence": terms.divergence,
            "action_clipped": action_clipped,
            "observation_clipped": observation_clipped,
            "ended_by": ended_by,
        }
