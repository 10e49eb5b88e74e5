"""The single Gymnasium environment of the linear lateral vehicle: a batch of one."""

from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from railenv.envs.checkpoint import restored, state_of
from railenv.envs.episode_lanes import EpisodeLanes
from railenv.envs.lanes import Lanes
from railenv.envs.picture import RENDER_MODES, Pictures, check_render_mode
from railenv.envs.spaces import checked_settings, single_spaces
from railenv.errors import ArgumentError
from railenv.vehicle import LateralVehicle

Observation = NDArray[np.float32]

_ONLY = np.zeros(1, dtype=np.int64)


class Lateral17Env(gym.Env[Observation, Observation]):
    """Active lateral suspension of a railway vehicle whose forces arrive late.

    ## Description
    A carbody on two bogies runs at constant speed over an irregular track. Actuators between
    carbody and bogies replace two or all four lateral dampers. A force takes effect `delay`
    seconds after the observation that it answers; past a critical delay a feedback loop turns
    unstable, abruptly. The vehicle is the linear 17-coordinate lateral model
    (`railenv.vehicle.linear`), stepped exactly.

    ## Action space
    `Box(-1, 1, (actions,), float32)`. With `action="each"` an action per actuator, front to rear: 4
    with layout 4 (both ends of the front bogie, then of the rear bogie), 2 with layout 2 (front end
    of the front bogie, rear end of the rear bogie). With `action="bogies"` one per bogie, front and
    rear, for all actuators of that bogie.

    | index | meaning | min | max | unit |
    | --- | --- | --- | --- | --- |
    | k | force on the carbody to the right, reaction on the bogie, in `action_scale` | -1 | 1 | 1 |

    An action outside the box is clipped to it and flagged in `info["action_clipped"]`. The force
    limit (30 kN), the rate limit and the lag act behind it.

    ## Observation space
    `Box` of float32 at the instant of measurement. With `observation="sensors"`, c = channels:

    | index (layout 4) | meaning | min | max | unit | scale |
    | --- | --- | --- | --- | --- | --- |
    | 0 to c-1 (0-3) | carbody lateral velocity at each actuator | -5 | 5 | m/s | 0.02 |
    | c to 2c-1 (4-7) | carbody lateral acceleration there | -50 | 50 | m/s^2 | 0.15 |
    | 2c, 2c+1 (8, 9) | lateral acceleration of the two bogie frames | -200 | 200 | m/s^2 | 1.7 |
    | 2c+2 (10) | carbody roll rate | -2 | 2 | rad/s | 0.007 |
    | 2c+3 (11) | carbody yaw rate | -2 | 2 | rad/s | 0.001 |
    | 2c+4 to 2c+7 (12-15) | stroke at places 1 to 4, carbody minus bogie | -0.5 | 0.5 | m | 0.006 |
    | then | the same of the last `observation_history` periods (0), newest first | | | | |
    | then (16-135) | `action_history` past actions (30 periods), newest first | -1 | 1 | 1 | 1 |
    | then | told delay, if `delay_observed`; one, or c if channels differ | -0.3 | 0.3 | s | 0.3 |

    With `observation_scale="controlled"` (default) a column is in units of its scale, about the
    root mean square of the controlled vehicle, and its bounds accordingly; told delays are in units
    of `max_delay`. With "si" it is in the unit of the table. `env.unwrapped.observation_names`
    lists the columns, `env.unwrapped.observation_scales` the scales in use.

    Velocities and accelerations of the carbody are those at damper level. y is to the right and z
    down: positive roll puts the right side down, positive yaw turns the
    nose to the right. Damper places 1 and 2 are the front and rear end of the front bogie, 3 and 4
    of the rear bogie. Accelerations are those just before a force that switches at this very
    instant. A reading beyond its bound is clipped and flagged in `info["observation_clipped"]`.
    With `observation="state"` the model's own states stand in place of the sensors, each within
    +-100 SI units: 17 coordinates, their 17 velocities, one node per Maxwell damper (38 with layout
    4, 40 with layout 2).

    Readings carry no noise unless `sensor_noise` is above zero: then each has white Gaussian noise
    of its own at every measurement, with a standard deviation of `sensor_noise` times the column's
    scale, also where the observation is in SI units. Past actions and told delays have none; reward
    and info are those of the true motion. A lost measurement leaves the last one with its noise.

    Past actions reach as far back as `max_delay`, unless `action_history` says otherwise. The told
    delay is the time from measurement to force without jitter, wrong by up to `told_error`.

    ## Rewards
    `comfort + effort + stroke + divergence`, every term in `info`; see `railenv.envs.reward`:
    comfort is -min(a / 0.05 m/s^2, 5) for the ride-filtered RMS a of both floor ends over the step,
    effort -0.01 times the mean square action, stroke -0.05 times the mean square stroke in units of
    0.03 m, at most -0.05, and divergence, on an ending by gauge or divergence, more than the worst
    episode without costs in all (-10 120 with the defaults). Settings change the constants.

    ## Info
    Same keys at every step: `time` [s], `delay` per channel (from the measurement to the force of
    the action just sent, jitter included, infinite if it was lost) [s], `sensor_delay` (its share
    that passed before the action was chosen) [s], `told_delay` per channel (if it is observed) [s],
    `command` (action times `action_scale`) and `force` (what acts at the end of the step) per
    channel [N], `vehicle` (number in the pool), `speed` [m/s], `track` (number in the pool, -1 for
    one that was given), `weighted_acceleration` a of the reward [m/s^2], `ride_index` (running,
    front and rear floor), `reward_comfort`, `reward_effort`, `reward_stroke`, `reward_divergence`,
    `action_clipped`, `observation_clipped`, `ended_by` ("", "gauge" or "divergence").

    ## Start state
    With `start="rest"` at rest, anywhere on a track of the pool, whose irregularity grows over the
    first 100 m; with `start="controlled"` in a state under a mild sky-hook, at the place where it
    was taken. Vehicle, track, place, level and delay are drawn anew at every reset.

    The environment's clock is that of the measurements: with a sensor delay the controller gets the
    observation of `info["time"]` later, and its action takes force by the whole `delay` after it.

    ## Termination and truncation
    Terminated when a floor end leaves the vehicle's clearance gauge (its lateral displacement
    passes `gauge_limit`, 0.1 m; wheel-rail clearance is not modelled) or the floor acceleration
    passes `acceleration_limit` or is not finite; the reason is in `info["ended_by"]`. Truncated
    after `episode_seconds`.

    ## Arguments
    Keyword arguments are the fields of `railenv.envs.settings.EnvSettings`, and `render_mode`:
    "rgb_array" (640 x 480 pixels), "human" (a window) or "ansi" (text). `reset` takes
    `options={"delay": seconds, "track_seed": integer, "vehicle": integer}` to fix what is drawn
    otherwise; `checkpoint` and `restore` save and go back to any moment.

    ## Version history
    - v0: first version.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (Gymnasium's own form)
        "render_modes": list(RENDER_MODES),
        "render_fps": 100,
    }

    def __init__(self, render_mode: str | None = None, **settings: Any) -> None:
        self.render_mode = check_render_mode(render_mode)
        self._lanes = self._made(settings)
        self.settings = self._lanes.settings
        self.metadata = {
            **self.metadata,
            "render_fps": round(1.0 / self.settings.control_period),
        }
        self.observation_space, self.action_space = single_spaces(self._lanes)  # pyright: ignore
        self._actions = (self._lanes.num_actions,)
        self._started = False
        self._pictures = None if render_mode is None else Pictures(self._lanes)

    def _made(self, settings: dict[str, Any]) -> EpisodeLanes:
        """The one lane, of these settings."""
        return Lanes(checked_settings(settings), 1)

    @property
    def observation_names(self) -> tuple[str, ...]:
        """Name of every column of the observation."""
        return self._lanes.observation_names

    @property
    def observation_scales(self) -> NDArray[np.float64]:
        """What each column is in units of, shape (columns,) [its SI unit]."""
        return self._lanes.scales.copy()

    @property
    def vehicles(self) -> tuple[LateralVehicle, ...]:
        """The pool of vehicles."""
        return self._lanes.episodes.vehicles

    @property
    def vehicle(self) -> LateralVehicle:
        """The vehicle of this episode."""
        return self.vehicles[int(self._lanes.episodes.vehicle[0])]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode.

        Args:
            seed: Seeds the environment's generator.
            options: "delay" [s] (one value, one per channel, or a DelaySpec), "track_seed" and
                "vehicle" (number in the pool) fix what is drawn.

        Returns:
            Observation and info.

        Raises:
            ArgumentError: An option is unknown or out of its range.
        """
        super().reset(seed=seed)
        if options is not None and not isinstance(options, dict):  # pyright: ignore
            raise ArgumentError(f"options = {options!r} must be a dictionary")
        self._lanes.generators[0] = self.np_random
        self._lanes.reset(_ONLY, [dict(options)] if options else None)
        self._started = True
        if self._pictures is not None:
            self._pictures.begin(_ONLY)
        return self._lanes.here.observation[0].copy(), self._info()

    def step(self, action: Observation) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Send an action on its way and advance by one control period.

        Args:
            action: Shape (actions,), in [-1, 1].

        Returns:
            Observation, reward, terminated, truncated, info.

        Raises:
            ArgumentError: The action has the wrong shape or is not finite, or there was no reset.
        """
        given = np.asarray(action)
        if given.dtype.kind not in "fiu" or given.shape != self._actions:
            raise ArgumentError(f"action = {action!r} must be {self._actions} numbers in [-1, 1]")
        wanted = given.astype(np.float64)
        if not np.isfinite(wanted).all():
            raise ArgumentError(f"action = {action!r} must be finite; give numbers in [-1, 1]")
        if not self._started:
            raise ArgumentError("step before the first reset; call reset first")
        here = self._lanes.here
        here.actions[0] = wanted
        self._lanes.step()
        if self._pictures is not None:
            self._pictures.note(here.active, here.reward)
        ended, late = bool(here.terminated[0]), bool(here.truncated[0])
        return here.observation[0].copy(), float(here.reward[0]), ended, late, self._info()

    def checkpoint(self) -> dict[str, Any]:
        """Return everything that the coming steps depend on: plain arrays, numbers and texts.

        `restore` of an environment with the same settings goes on identically.
        """
        own = {"started": self._started, "seed": self._np_random_seed}
        return state_of(self._lanes, own)

    def restore(self, checkpoint: dict[str, Any]) -> None:
        """Go back to a checkpoint.

        Raises:
            ArgumentError: It is none of an environment with these settings.
        """
        own = restored(self._lanes, checkpoint, ("started", "seed"))
        self._started, self._np_random_seed = bool(own["started"]), own["seed"]
        generator = self._lanes.generators[0]
        if generator is not None:
            self._np_random = generator
        if self._pictures is not None:
            self._pictures.begin(_ONLY)

    def render(self) -> Any:
        """Return the picture of the chosen mode: pixels (height, width, 3), text, or None."""
        if self._pictures is None:
            return None
        assert self.render_mode is not None
        pictures = self._pictures.render(self.render_mode)
        return None if pictures is None else pictures[0]

    def close(self) -> None:
        """Close the window."""
        if self._pictures is not None:
            self._pictures.close()

    def _info(self) -> dict[str, Any]:
        info = self._lanes.info()
        return {
            name: values[0] if values.ndim > 1 else values[0].item()
            for name, values in info.items()
        }
