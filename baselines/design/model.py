"""The sampled design model: vehicle, track, ride filter and late force over one control period.

    X_(k+1) = A X_k + B v_k + G e_k,   z_k = C X_k + D v_k + H e_k,   y_k = M X_k + noise

X holds the vehicle's states, the ride filters of both floor ends, the track process
(`track_filter`) and the force that acted last; e is white noise of unit covariance; v_k is the
command that arrives in the period: v_k = u_(k-d) at t_k + r for a delay of d T + r. z holds the
ride-filtered accelerations at every physics step of the period, scaled such that E z'z is their
mean square over steps and both floor ends: the square of what the environment's reward counts.

Everything is exact for a track whose irregularity is that process, taken as linear between the
physics steps as the simulation does. The actuator's limits and its lag are left out.
"""

from dataclasses import dataclass

import numpy as np

from baselines.design.track_filter import repeated, wheel_process
from railenv.actuation import held_input, ramped_input
from railenv.envs.observation import bound
from railenv.errors import ArgumentError, check_not_negative, check_positive
from railenv.metrics.ride_filter import ride_filter
from railenv.simulation import DEFAULT_CONTROL_PERIOD, DEFAULT_TIME_STEP, whole_multiple
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle, state_space
from railenv.vehicle.suspension import NUM_TRACK

FLOOR_ACCELERATIONS = (
    "floor_front_lateral_acceleration",
    "floor_rear_lateral_acceleration",
)

DESIGN_TRACK = "german_low"
"""Track that laws are designed for unless they are told another one."""

DESIGN_NOISE = 0.1
"""Standard deviation of the sensors' noise, in units of the columns' controlled response [1]."""

MOST_PERIODS = 1000
"""Longest delay that a law can be designed for, in control periods: it remembers its commands."""


@dataclass(frozen=True, eq=False)
class DesignModel:
    """One control period of the vehicle on random track; n states, m channels.

    Attributes:
        A: Shape (n, n).
        B: Shape (n, m).
        G: Shape (n, noises).
        C: Shape (outputs, n).
        D: Shape (outputs, m).
        H: Shape (outputs, noises).
        late: Whole control periods d between command and arrival.
        rest: What is left of the delay, r in [0, T) [s].
        period: Control period T [s].
        vehicle: The vehicle.
        wheels: What the wheelsets meet over the track states, shape (8, track states).
        filters: Number of the ride filters' states.
    """

    A: FloatArray
    B: FloatArray
    G: FloatArray
    C: FloatArray
    D: FloatArray
    H: FloatArray
    late: int
    rest: float
    period: float
    vehicle: LateralVehicle
    wheels: FloatArray
    filters: int

    @property
    def num_channels(self) -> int:
        """Number of channels m."""
        return self.B.shape[1]

    @property
    def num_track(self) -> int:
        """Number of states of the track process."""
        return self.wheels.shape[1]

    def measurement(self, sensors: tuple[str, ...]) -> FloatArray:
        """Return M, the rows of outputs or states over X, just before a force switches.

        Raises:
            ArgumentError: A name is neither an output nor a state.
        """
        system = state_space(self.vehicle)
        C, D = system.output_rows(sensors)
        n, m = C.shape[1], self.num_channels
        rows = np.zeros((len(sensors), len(self.A)))
        rows[:, :n] = C
        rows[:, n + self.filters : n + self.filters + self.num_track] = (
            D[:, m : m + NUM_TRACK] @ self.wheels
        )
        rows[:, -m:] = D[:, :m]
        return rows


def design_model(
    vehicle: LateralVehicle,
    delay: float,
    *,
    preview: bool = False,
    track: str = DESIGN_TRACK,
    period: float = DEFAULT_CONTROL_PERIOD,
    time_step: float = DEFAULT_TIME_STEP,
) -> DesignModel:
    """Build the model for one delay.

    Args:
        vehicle: The vehicle, with actuators.
        delay: Between measurement and force, the same for all channels [s].
        preview: Whether the trailing wheelsets meet the track of the leading one, or tracks of
            their own; see `track_filter`.
        track: Name of a spectrum whose densities are rational.
        period: Control period [s].
        time_step: Physics step [s].

    Raises:
        ArgumentError: A value is out of range, the vehicle has no actuator, or the spectrum is not
            rational.
    """
    late_by, m = check_not_negative("delay", delay, "seconds"), vehicle.num_actuators
    if m == 0:
        raise ArgumentError("layout = 'passive' has no actuator to design for; choose 2 or 4")
    check_positive("period", period, "seconds")
    check_positive("time_step", time_step, "seconds")
    steps = whole_multiple("period", period, "time_step", time_step)
    late, rest = whole_and_rest(late_by, period)
    system = state_space(vehicle)
    process = wheel_process(vehicle, track, time_step, preview=preview)
    floor, through = system.output_rows(FLOOR_ACCELERATIONS)
    n, q, noises = len(system.A), len(process.F), process.N.shape[1]
    E = system.B[:, m : m + NUM_TRACK]
    before, after = ramped_input(system.A, E, system.B[:, m + NUM_TRACK :], time_step)
    transition, full = held_input(system.A, system.actuator_input, time_step)
    Af, Bf, Cf, Df = _both_floors(1.0 / time_step)
    filters = len(Af)
    size = n + filters + q + m
    # Everything as rows over (X_k, v_k, e_k); the noise of the substeps lies side by side.
    wide = size + m + steps * noises
    rows = np.eye(wide)
    x, f, s = rows[:n], rows[n : n + filters], rows[n + filters : n + filters + q]
    old, new = rows[size - m : size], rows[size : size + m]
    recorded: list[FloatArray] = []
    for step in range(steps):
        noise = rows[size + m + step * noises : size + m + (step + 1) * noises]
        next_s = process.F @ s + process.N @ noise
        # The new force acts for the last `acting` seconds of this step.
        acting = min(max((step + 1) * time_step - rest, 0.0), time_step)
        _, share = held_input(system.A, system.actuator_input, acting)
        x = transition @ x + before @ process.H @ s + after @ process.H @ next_s
        x = x + (full - share) @ old + share @ new
        s = next_s
        # A record at the very instant of a switch sees the force before it.
        force = new if acting > 1e-9 * time_step else old
        acceleration = floor @ x + through[:, :m] @ force + through[:, m : m + 8] @ process.H @ s
        recorded.append(Cf @ f + Df @ acceleration)
        f = Af @ f + Bf @ acceleration
    z = np.vstack(recorded) / np.sqrt(2.0 * steps)
    future = np.vstack([x, f, s, new])
    a, b = size, size + m
    return DesignModel(
        future[:, :a],
        future[:, a:b],
        future[:, b:],
        z[:, :a],
        z[:, a:b],
        z[:, b:],
        late,
        rest,
        period,
        vehicle,
        process.H,
        filters,
    )


def whole_and_rest(delay: float, period: float) -> tuple[int, float]:
    """Return d and r of a delay d T + r, r in [0, T).

    Args:
        delay: Zero or more [s].
        period: Control period T, above zero [s].

    Raises:
        ArgumentError: The delay has more than `MOST_PERIODS` periods.
    """
    if delay > MOST_PERIODS * period:
        raise ArgumentError(
            f"delay = {delay:g} s is more than {MOST_PERIODS} control periods of {period:g} s; "
            "give a shorter delay or a longer period"
        )
    # The quotient of two decimal fractions may be off by rounding: 0.29 / 0.01 < 29.
    late = int(np.floor(delay / period + 1e-9))
    return late, max(delay - late * period, 0.0)


def _both_floors(rate: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the ride filter of both floor ends, f' = A f + B a, weighted = C f + D a."""
    A, B, C, D = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.eye(1)
    for b0, b1, b2, _, a1, a2 in ride_filter(rate):
        # Direct form II transposed: y = b0 u + p, p' = b1 u - a1 y + r, r' = b2 u - a2 y.
        own = np.array([[-a1, 1.0], [-a2, 0.0]])
        drive = np.array([[b1 - a1 * b0], [b2 - a2 * b0]])
        if a2 == b2 == 0.0:
            own, drive = own[:1, :1], drive[:1]
        first = np.eye(1, len(own))
        A = np.block([[A, np.zeros((len(A), len(own)))], [drive @ C, own]])
        B = np.vstack([B, drive @ D])
        C, D = np.hstack([b0 * C, first]), b0 * D
    return repeated(2, A), repeated(2, B), repeated(2, C), repeated(2, D)


def sensor_noise(sensors: tuple[str, ...], level: float) -> FloatArray:
    """Return the standard deviation of every sensor's noise [its SI unit].

    Args:
        sensors: Names of measured columns; what the wheelsets meet may be among them.
        level: Noise in units of the columns' controlled response [1], of 1 mm or 1 mrad for track.
    """
    share = check_not_negative("noise", level)
    return np.array([share * (1e-3 if _of_track(name) else bound(name)[2]) for name in sensors])


def _of_track(name: str) -> bool:
    return name.startswith(("alignment_", "track_roll_"))
