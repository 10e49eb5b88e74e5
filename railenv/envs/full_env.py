"""The Gymnasium environments of the nonlinear vehicle, single and vectorised."""

from typing import Any

from railenv.envs.full_lanes import FullLanes
from railenv.envs.full_settings import FullSettings
from railenv.envs.rail_env import Lateral17Env
from railenv.envs.rail_vector_env import Lateral17VectorEnv
from railenv.envs.spaces import settings_of
from railenv.vehicle.nonlinear import FullVehicle


class Full50Env(Lateral17Env):
    """Active lateral suspension of a nonlinear railway vehicle whose forces arrive late.

    ## Description
    The task of `railenv/Lateral17-v0` on the vehicle with 50 coordinates
    (`railenv.vehicle.nonlinear`): carbody, two bogie frames and four wheelsets with six coordinates
    each and the pitch of eight axle boxes, on standard wheel and rail profiles that touch at one or
    two points per wheel or not at all, with creep forces that end at friction, dampers with
    blow-off and bump stops. It runs at constant speed over rails that are irregular in all four
    ways (alignment, cross level, vertical, gauge), on straight track or into a curve with cant. It
    can derail. A force takes effect `delay` seconds after the observation that it answers; past a
    critical delay a feedback loop turns unstable, abruptly. The motion is integrated by the
    classical Runge-Kutta method of fourth order; where a force switches, the step is cut, so that
    no delay is rounded.

    Actions and observations are those of `railenv/Lateral17-v0` column by column, so a policy
    moves over unchanged.

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

    With `observation_scale="controlled"` (default) a column is in units of its scale, and its
    bounds accordingly; told delays are in units of `max_delay`. The scales are those of
    `railenv/Lateral17-v0`, whose controlled response they are about; bogie accelerations are some
    twice as large here. With "si" a column is in the unit of the table.
    `env.unwrapped.observation_names` lists the columns, `env.unwrapped.observation_scales` the
    scales in use.

    Velocities and accelerations of the carbody are those at damper level, relative to the track
    frame, so that a curve's centrifugal acceleration is not in them. y is to the right and z down:
    positive roll puts the right side down, positive yaw turns the nose to the right. Damper places
    1 and 2 are the front and rear end of the front bogie, 3 and 4 of the rear bogie. Readings pass
    no filter. Accelerations are those just before a force that switches at this very instant. A
    reading beyond its bound is clipped and flagged in `info["observation_clipped"]`. With
    `observation="state"` the model's own states stand in place of the sensors, each within +-100 SI
    units: 50 coordinates, their 50 velocities, one node per damper with a spring in series (104
    with layout 4, 106 with layout 2).

    Readings carry no noise unless `sensor_noise` is above zero: then each has white Gaussian noise
    of its own at every measurement, with a standard deviation of `sensor_noise` times the column's
    scale, also where the observation is in SI units. Past actions and told delays have none; reward
    and info are those of the true motion. A lost measurement leaves the last one with its noise.

    Past actions reach as far back as `max_delay`, unless `action_history` says otherwise. The told
    delay is the time from measurement to force without jitter, wrong by up to `told_error`.

    ## Rewards
    `comfort + effort + stroke + divergence`, every term in `info`; see `railenv.envs.reward`:
    comfort is -min(a / 0.05 m/s^2, 5) for the ride-filtered RMS a of both floor ends over the
    records of the step (every 5 ms), effort -0.01 times the mean square action, stroke -0.05 times
    the mean square stroke in units of 0.03 m, at most -0.05, and divergence, on an ending by
    derailment, gauge or divergence, more than the worst episode without costs in all (-10 120 with
    the defaults). Safety is told, not rewarded. Settings change the constants.

    ## Info
    Same keys at every step: those of `railenv/Lateral17-v0`, which are `time` [s], `delay` per
    channel (from the measurement to the force of the action just sent, jitter included, infinite if
    it was lost) [s], `sensor_delay` (its share that passed before the action was chosen) [s],
    `told_delay` per channel (if it is observed) [s], `command` (action times `action_scale`) and
    `force` (what acts at the end of the step) per channel [N], `vehicle` (number in the pool),
    `speed` [m/s], `track` (number in the pool, -1 for one that was given), `weighted_acceleration`
    a of the reward [m/s^2], `ride_index` (running, front and rear floor), `reward_comfort`,
    `reward_effort`, `reward_stroke`, `reward_divergence`, `action_clipped`, `observation_clipped`,
    `ended_by` ("", "derailment", "gauge" or "divergence").

    And how safe the step was, with forces averaged over the control period:

    | key | meaning | unit |
    | --- | --- | --- |
    | `derailment_quotient` | largest Y / Q of a wheel: guiding force outwards over wheel load | 1 |
    | `wheel_unloading` | largest 1 - Q / Q_0 of a wheel, Q_0 its static load; 1: lifted | 1 |
    | `wheelset_shift` | largest shift of a wheelset on a rail at the end of the step | m |
    | `guiding_force` | largest sum of Y of a wheelset's two wheels | N |

    EN 14363 takes Y / Q and the sum of Y as sliding means over 2 m; a step of 10 ms at 300 km/h is
    0.83 m, so peaks here are no smaller than there.

    ## Start state
    Steady rolling on straight level track, anywhere on a track of the pool, whose irregularity
    grows over the first 100 m. Vehicle, track, place, level and delay are drawn anew at every
    reset. `start="controlled"` is not offered: such states are scaled with the level of the track,
    which only a linear vehicle allows.

    The environment's clock is that of the measurements: with a sensor delay the controller gets the
    observation of `info["time"]` later, and its action takes force by the whole `delay` after it.

    ## Termination and truncation
    Terminated by "derailment" when a wheelset has moved 25 mm across a rail or both its wheels are
    a flange's height (28 mm) above the rails; by "gauge" when a floor end leaves the vehicle's
    clearance gauge (its lateral displacement passes `gauge_limit`, 0.1 m); by "divergence" when the
    floor acceleration passes `acceleration_limit` or a number leaves all bounds. If several happen
    in one step, derailment is named. A vehicle that has derailed must be reset before the next
    step. Truncated after `episode_seconds`.

    ## Arguments
    Keyword arguments are the fields of `railenv.envs.full_settings.FullSettings`, and
    `render_mode`: "rgb_array" (640 x 480 pixels), "human" (a window) or "ansi" (text). Beyond those
    of `railenv/Lateral17-v0`:

    | argument | meaning | default |
    | --- | --- | --- |
    | `wheel`, `rail` | profiles by name, see `railenv.contact.profiles` | "s1002cn", "cn60" |
    | `friction` | coefficient of friction | 0.3 |
    | `creep_law` | `law` of `railenv.vehicle.nonlinear.ContactSettings` | "fastsim-table" |
    | `time_step` | step of the integration [s] | 0.0005 |
    | `record_step` | time between the accelerations that enter the reward [s] | 0.005 |
    | `curve` | (radius, cant) [m], radius below zero for a left-hand curve, or None | None |
    | `curve_start` | where the transition begins, ahead of the first wheelset [m] | 100 |
    | `curve_transition` | length of the transition [m] | 200 |

    `vehicle_ranges` vary the lateral parameters, and with them this vehicle; conicity and creep
    follow from profiles and friction instead. `reset` takes `options={"delay": seconds,
    "track_seed": integer, "vehicle": integer}` to fix what is drawn otherwise; `checkpoint` and
    `restore` save and go back to any moment.

    ## Version history
    - v0: first version.
    """

    _lanes: FullLanes

    def _made(self, settings: dict[str, Any]) -> FullLanes:
        """The one lane, of these settings."""
        return FullLanes(settings_of(FullSettings, settings), 1)

    @property
    def vehicles(self) -> tuple[FullVehicle, ...]:  # type: ignore[override]
        """The pool of vehicles."""
        return self._lanes.vehicles

    @property
    def vehicle(self) -> FullVehicle:  # type: ignore[override]
        """The vehicle of this episode."""
        return self.vehicles[int(self._lanes.episodes.vehicle[0])]


class Full50VectorEnv(Lateral17VectorEnv):
    """Many `Full50Env` at once, in threads that share the lanes.

    Lane k with seed s equals the single environment with seed s + k, bit for bit, whatever the
    number of lanes and threads. Spaces, reward, info and settings are those of `Full50Env`, see
    there; masks of info, autoreset and options are those of
    `railenv.envs.rail_vector_env.Lateral17VectorEnv`.

    Args:
        num_envs: Number of lanes.
        autoreset_mode: "next_step", "same_step" or "disabled", or the enum's member.
        threads: Threads that share the lanes; one per core pays from two lanes on.
        render_mode: As of the single environment; `render` gives one picture per lane.
        settings: Fields of `railenv.envs.full_settings.FullSettings`.

    Raises:
        ArgumentError: A setting is unknown or out of its range.
    """

    _lanes: FullLanes

    def _made(self, settings: dict[str, Any], threads: int) -> FullLanes:
        """The lanes, of these settings."""
        return FullLanes(settings_of(FullSettings, settings), self.num_envs, threads)

    @property
    def vehicles(self) -> tuple[FullVehicle, ...]:  # type: ignore[override]
        """The pool of vehicles."""
        return self._lanes.vehicles
