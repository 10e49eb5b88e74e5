"""Clipped LQG: a semi-active damper does what it can of the force that LQG wants.

LQG for a known delay (`baselines.lqg`) wants a force; the damper gives the nearest it can: Tseng
and Hedrick, Vehicle System Dynamics 23 (1994) 545; "clipped-optimal" in Dyke, Spencer, Sain,
Carlson, Smart Materials and Structures 5 (1996) 565. What is commanded is the coefficient c, and
the force is c times the stroke rate at arrival: the law predicts both, the state to the moment of
arrival and the mean rate s' from there over a control period.

The further the prediction, the less is known of s' and of the wanted force F. The coefficient with
the least mean square of c s' + F over what is not known is

    c = -E[F s'] / E[s'^2] = -(F s' + covariance) / (s'^2 + variance),   within the damper's range

with predictions in the last form. Known exactly, that is `SemiActiveDamper.towards`; with nothing
known it is a constant. Both moments follow from Kalman's covariance and do not change in time.

Observer and prediction are driven by the forces that the dampers will give, with their range,
response time and the coefficients on their way (`baselines.design.damped`). The response is
predicted, but no command is raised to make up for it.

Clipping is no optimum: the gain is that of a loop in which every force can be had, and each damper
is set as if the others gave what is wanted of them.

What to expect on German low at 300 km/h with four dampers and noisy sensors: ride index 1.85 front
and 1.80 rear without delay, 1.91 and 2.03 at 300 ms (1.90 and 1.88 with preview), where a constant
7.5 kN s/m has 1.96 and 2.03. Told a delay of zero at 300 ms it has 2.03 and 2.09.
"""

import numpy as np

from baselines.controller import measured_columns
from baselines.design.damped import DampedVehicle, coefficient_weights, give_forces, stroke_rows
from baselines.design.model import DESIGN_NOISE, DESIGN_TRACK, design_model
from baselines.design.optimum import Estimator, estimator, regulator
from baselines.lane_matrix import LaneMatrix
from baselines.registered import Registered, check_switch, designed_for
from railenv.actuation import SemiActiveDamper
from railenv.envs.observation import sensor_names
from railenv.errors import ArgumentError
from railenv.simulation import DEFAULT_CONTROL_PERIOD
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle
from railenv.vehicle.coordinates import Layout

EFFORT = 1e-2
"""Cost of a mean square force of (3 kN)^2 beside the lowest dashpot's [(m/s^2)^2]. Chosen on German
low at 300 km/h, 0 to 300 ms: 1e-3 and 1e-1 give ride indices up to 0.05 higher."""


class ClippedLqg:
    """Clipped LQG for a known delay.

    Args:
        vehicle: What it is designed for, with layout 2 or 4.
        damper: The dampers, all alike.
        delay: Between measurement and coefficient, the same for all channels [s].
        effort: Cost of the mean square force beside the lowest dashpot's, in units of (3 kN)^2
            [(m/s^2)^2], above zero.
        noise: Standard deviation of the sensors' noise it expects, in units of the columns'
            controlled response [1], above zero.
        preview: Whether trailing wheelsets are known to meet the track of the leading ones.
        track: Name of the spectrum it is designed for; its densities must be rational.
        control_period: Time between actions [s]; it must be that of the run.

    Attributes:
        measures: The measured columns of the observation that it takes.
        action_scale: Coefficient of an action of one, `damper.highest` [N s/m].
        model: The design model, dashpots in, whole periods of the delay; n states beside the force.
        state: Estimate of its states before the next measurement, shape (n, lanes).
        coefficient: Of the dampers at the next measurement, shape (lanes, channels) [N s/m].
        wanted: Force on the carbody that the last action aimed at, shape (channels, lanes) [N].
        variance: Of the mean stroke rate at arrival, as foreseen, shape (channels, 1) [(m/s)^2].
        covariance: Of that rate and the force then wanted, shape (channels, 1) [N m/s].

    Raises:
        ArgumentError: A value is out of its range, the layout has no damper place, or the spectrum
            is not rational.
    """

    def __init__(
        self,
        vehicle: LateralVehicle,
        damper: SemiActiveDamper,
        delay: float = 0.1,
        effort: float = EFFORT,
        noise: float = DESIGN_NOISE,
        preview: bool = False,
        track: str = DESIGN_TRACK,
        control_period: float = DEFAULT_CONTROL_PERIOD,
    ) -> None:
        self.damper = damper
        self.layout: Layout = vehicle.layout
        self.action_scale = damper.highest
        self.control_period = control_period
        damped = DampedVehicle(vehicle.parameters, vehicle.layout, vehicle.speed, damper.lowest)
        arriving = design_model(damped, delay, preview=preview, track=track, period=control_period)
        self.delay = float(delay)
        self._late = arriving.late
        # The gain knows the part of a period r in the delay; the prediction runs from one
        # measurement to the next, and a mean force takes the place of two within a period.
        self.model = arriving
        if arriving.rest > 0.0:
            whole = arriving.late * control_period
            self.model = design_model(
                damped, whole, preview=preview, track=track, period=control_period
            )
        sensors = sensor_names(vehicle.layout)
        self.measures = measured_columns(sensors, vehicle.layout)
        self._weights = coefficient_weights(damper.response_time, arriving.rest, control_period)
        knowledge = estimator(self.model, sensors, noise)
        self._prepare(knowledge, regulator(arriving, effort).gain, arriving.rest / control_period)
        self.reset(0, 0)

    def _prepare(self, knowledge: Estimator, gain: FloatArray, part: float) -> None:
        """Make the matrices that are applied to lanes.

        Args:
            knowledge: Kalman's filter.
            gain: Of the optimal law over the states and the force that acted last, shape (m, n+m).
            part: Share of a period for which the force before still acts at arrival [1].
        """
        model, d, m = self.model, self._late, self.model.num_channels
        n = len(model.A) - m
        A, B = model.A[:n, :n], model.B[:n]
        stroke, rate = stroke_rows(model, n)
        # The mean rate over a period from the states, and from a force held over it.
        mean, own = stroke @ (A - np.eye(n)) / model.period, stroke @ B / model.period
        L, M, D = knowledge.gain[:n], knowledge.M[:, :n], knowledge.M[:, n:]
        self._correct = LaneMatrix(np.hstack([np.eye(n) - L @ M, L, -L @ D]))
        self._rate, self._step = LaneMatrix(rate), LaneMatrix(np.hstack([A, B]))
        # The state after j periods over (state now, forces in d periods).
        ahead = np.hstack([np.eye(n), np.zeros((n, d * m))])
        means: list[FloatArray] = []
        for j in range(d):
            means.append(mean @ ahead)
            ahead = A @ ahead
            ahead[:, n + j * m : n + (j + 1) * m] += B
        free = np.array([row[:, :n] for row in means]).reshape(d * m, n)
        self._free = LaneMatrix(free if d > 0 else mean)
        self._own = own
        # How the mean rate answers a force i + 1 periods ago, shape (d, m, m).
        self._answer = np.zeros((d, m, m))
        for i in range(1, d):
            self._answer[i - 1] = means[-1][:, n + (d - 1 - i) * m : n + (d - i) * m]
        K, K_before = gain[:, :n], gain[:, n:]
        # Between two periods' means: the rate in the period of an action, which begins at r.
        between = (1.0 - part) * mean + part * mean @ A
        self._arrival = LaneMatrix(np.vstack([rate, -K, between]) @ ahead)
        self._before = LaneMatrix(-K_before)
        of_before = (1.0 - part) * part * own + part**2 * mean @ B
        of_wanted = (1.0 - part) ** 2 * own + part * ((1.0 - part) * mean @ B + own)
        self._under = LaneMatrix(np.hstack([of_wanted, of_before]))
        error, added = knowledge.error, model.G @ model.G.T
        for _ in range(d):
            error = model.A @ error @ model.A.T + added
        error = error[:n, :n]
        self.variance = np.sum((mean @ error) * mean, axis=1)[:, None]
        total = K + self.damper.lowest * mean
        self.covariance = -np.sum((total @ error) * mean, axis=1)[:, None]

    def reset(self, num_lanes: int, seed: int) -> None:  # noqa: ARG002
        """Start every lane at rest, with the lowest coefficient in effect and on its way."""
        m, lowest = self.model.num_channels, self.damper.lowest
        self.state: FloatArray = np.zeros((len(self.model.A) - m, num_lanes))
        self.wanted: FloatArray = np.zeros((m, num_lanes))
        self.coefficient: FloatArray = np.full((num_lanes, m), lowest)
        # In the order of arrival; the first has arrived.
        self._pipe = np.full((num_lanes, self._late + 1, m), lowest)

    def act(self, observations: FloatArray) -> FloatArray:
        """Return c / c_max, shape (lanes, channels).

        Raises:
            ArgumentError: The number of lanes is not that of the last reset.
        """
        lanes, m, lowest = self.state.shape[1], self.model.num_channels, self.damper.lowest
        if observations.shape[0] != lanes:
            raise ArgumentError(
                f"observations have {observations.shape[0]} lanes, reset was called for {lanes}; "
                "call reset(num_lanes, seed) first"
            )
        reading = observations[:, : len(self.measures)].T
        force = -(self.coefficient.T - lowest) * self._rate(self.state)
        state = self._correct(np.vstack([self.state, reading, force]))
        free = self._free(state)
        forces, at_arrival = self._forces(free, self._pipe)
        found = self._arrival(np.vstack([state, forces]))
        before = -(at_arrival.T - lowest) * found[:m]
        beside = found[m : 2 * m] + self._before(before)
        rate = found[2 * m :] + self._under(np.vstack([beside, before]))
        self.wanted = beside - lowest * rate
        known = self.wanted * rate + self.covariance
        # The filter's noise is above zero, so that the variance is.
        command = self.damper.limited(-known / (rate**2 + self.variance)).T
        # The period that begins now; without delay the command itself acts in it.
        pipe = np.concatenate([self._pipe, command[:, None]], axis=1)
        now, self.coefficient = self._forces(free[:m], pipe[:, :2])
        self.state = self._step(np.vstack([state, now]))
        self._pipe = pipe[:, 1:]
        return command / self.action_scale

    def _forces(self, free: FloatArray, pipe: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the forces beside the lowest dashpots' in the coming periods.

        Args:
            free: Mean rates of a motion without these forces, a block of rows per period, [m/s].
            pipe: Coefficients in the order of arrival, shape (lanes, periods + 1, m) [N s/m].

        Returns:
            Forces, shape (periods * m, lanes) [N], and the coefficients at the end, (lanes, m).
        """
        periods, m = pipe.shape[1] - 1, pipe.shape[2]
        forces, end = np.zeros((periods * m, len(pipe))), self.coefficient.copy()
        give_forces(
            free, pipe, self._own, self._answer, self._weights, self.damper.lowest, forces, end
        )
        return forces, end


def _build(
    vehicle: LateralVehicle,
    delay: float,
    effort: float,
    noise: float,
    preview: float,
    lowest: float,
    highest: float,
    response_time: float,
    design_kmh: float,
) -> ClippedLqg:
    design = designed_for(vehicle, design_kmh)
    damper = SemiActiveDamper(lowest, highest, response_time)
    return ClippedLqg(design, damper, delay, effort, noise, check_switch("preview", preview))


CLIPPED_LQG = Registered(
    "clipped-lqg",
    "semi-active damper: the coefficient nearest to the force of LQG, for a known delay",
    "Tseng and Hedrick 1994; Dyke, Spencer, Sain, Carlson 1996",
    {
        "delay": (0.1, "s"),
        "effort": (EFFORT, "(m/s^2)^2"),
        "noise": (DESIGN_NOISE, "of the controlled response"),
        "preview": (0.0, "0 or 1"),
        "lowest": (SemiActiveDamper.lowest, "N s/m"),
        "highest": (SemiActiveDamper.highest, "N s/m"),
        "response_time": (SemiActiveDamper.response_time, "s"),
        "design_kmh": (0.0, "km/h, 0: the run's"),
    },
    _build,
)
