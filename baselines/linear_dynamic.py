"""Dynamic linear feedback: filters, integrators, observers, in continuous time or sampled.

    xc' = A xc + B y,               u = -(C xc + D y)       continuous
    xc_(k+1) = A xc_k + B y_k,      u_k = -(C xc_k + D y_k) sampled

The oracle is given either law as it stands; a sampled one is judged with its hold
(`to_sampled_loop`) and has no continuous loop. In simulation a sampled law is stepped as it is. A
continuous one is stepped once per control period T with the exact transition exp(A T) and a reading
that runs linearly from one sample to the next (first-order hold): poles stay where they were
designed, and the reading is used at once, so that no delay beyond the sampling itself is added;
what remains differs from the continuous law by terms of order T^2. A zero-order hold on the reading
would act T/2 later.

In an unstable loop the actuators' limit bounds the vehicle, and nothing bounds a law that is
unstable by itself, as sharp estimators with a gain often are. A lane whose state would leave the
range of numbers keeps the state it has: its commands have long been beyond every limit.
"""

from typing import Any

import numpy as np
from scipy import linalg

from baselines import export
from baselines.controller import check_layout, check_size, measured_columns, plant_seen
from baselines.lane_matrix import LaneMatrix
from railenv.actuation import ActuatorSpec
from railenv.actuation.hold import ramped_input
from railenv.envs.observation import DEFAULT_ACTION_SCALE
from railenv.errors import ArgumentError, check_positive
from railenv.simulation import DEFAULT_CONTROL_PERIOD
from railenv.stability import DelaySystem, SampledLoop
from railenv.stability.loops import LinearSystem, linear_system
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle
from railenv.vehicle.coordinates import Layout, actuator_positions, parse_layout

_OUT_OF_RANGE = 1e250
# Far above any meaning, and below overflow by more than `LARGEST_NUMBER` in a matrix can add.


class LinearDynamic:
    """Dynamic linear feedback of sensors, u = -law(y), batched.

    Args:
        law: The controller, sensors in, forces [N] out: a tuple (A, B, C, D), or a state space or
            transfer function of scipy.signal or python-control in continuous time. u = -law(y).
        sensors: Names of its inputs, columns of the standard observation of the layout.
        layout: 2 or 4.
        action_scale: Force of an action of one [N].
        control_period: Time between actions [s]; it must be that of the run.
        sampled: Whether law is a tuple of the matrices of a sampled law, one step per action.

    Raises:
        ArgumentError: The law is no linear system or has the wrong size, or a sensor does not
            exist.
    """

    def __init__(
        self,
        law: Any,
        sensors: tuple[str, ...],
        layout: object,
        action_scale: float = DEFAULT_ACTION_SCALE,
        control_period: float = DEFAULT_CONTROL_PERIOD,
        sampled: bool = False,
    ) -> None:
        self.layout: Layout = parse_layout(layout)
        self.sensors = tuple(sensors)
        self.law: LinearSystem = linear_system(law, "law")
        self.action_scale = check_positive("action_scale", action_scale, "N")
        self.control_period = check_positive("control_period", control_period, "seconds")
        self.sampled = bool(sampled)
        self.measures = measured_columns(self.sensors, self.layout)
        self._columns = [self.measures.index(name) for name in self.sensors]
        shape = (len(actuator_positions(self.layout)), len(self.sensors))
        if self.law.D.shape != shape:
            raise ArgumentError(
                f"law has shape {self.law.D.shape}; it must be {shape}: one output per actuator, "
                "one input per sensor"
            )
        for letter in "ABCD":
            check_size(f"law.{letter}", getattr(self.law, letter))
        A, B = self.law.A, self.law.B
        # States, the reading before, the present one: what `_step` takes, a column per lane.
        self._lanes: FloatArray = np.zeros((len(A) + 2 * len(self.sensors), 0))
        self._started = False
        if self.sampled:
            self._before, self._after, self._transition = B, np.zeros_like(B), A
            self._prepare()
            return
        with np.errstate(over="ignore", invalid="ignore"):
            self._before, self._after = ramped_input(A, B, np.zeros_like(B), self.control_period)
            self._transition = _transition(A, self.control_period)
        if not all(np.all(np.isfinite(m)) for m in (self._before, self._after, self._transition)):
            raise ArgumentError(
                f"law is too fast to be stepped at control_period = {self.control_period:g} s "
                "(its transition is not finite); give a shorter period or a slower law"
            )
        self._prepare()

    def _prepare(self) -> None:
        """Make ready to be applied to lanes: states, the reading before and the present one."""
        self._step = LaneMatrix(np.hstack([self._transition, self._before, self._after]))
        self._force = LaneMatrix(np.hstack([self.law.C, self.law.D]))

    def reset(self, num_lanes: int, seed: int) -> None:  # noqa: ARG002
        """Start every lane with the law's states at zero."""
        self._lanes = np.zeros((len(self._lanes), num_lanes))
        self._started = False

    def act(self, observations: FloatArray) -> FloatArray:
        """Step the law and return its actions, shape (lanes, channels).

        Raises:
            ArgumentError: The number of lanes is not that of the last reset.
        """
        if observations.shape[0] != self._lanes.shape[1]:
            raise ArgumentError(
                f"observations have {observations.shape[0]} lanes, reset was called for "
                f"{self._lanes.shape[1]}; call reset(num_lanes, seed) first"
            )
        n, m = len(self.law.A), len(self.sensors)
        before, present = self._lanes[n : n + m], self._lanes[n + m :]
        present[:] = observations[:, self._columns].T
        if self._started:
            self._step.advance(self._lanes, _OUT_OF_RANGE)
        self._started = True
        before[:] = present
        force = self._force(self._lanes[: n + m])
        return -force.T / self.action_scale

    def to_delay_system(
        self, vehicle: LateralVehicle, actuator: ActuatorSpec | None = None
    ) -> DelaySystem:
        """Close the loop of the continuous law around a vehicle.

        Args:
            vehicle: The vehicle; its layout must be the controller's.
            actuator: Its lag becomes part of the plant; limits do not act on small motion.

        Returns:
            The loop over the states of the vehicle, the forces (with a lag) and the law; neutral if
            the law passes a sensor with direct feedthrough straight through and there is no lag.

        Raises:
            ArgumentError: The layouts differ, or the law is sampled.
        """
        check_layout(self.layout, vehicle)
        if self.sampled:
            raise ArgumentError(
                "the law is a sampled one and has no continuous loop; ask to_sampled_loop"
            )
        return DelaySystem.from_loop(plant_seen(vehicle, self.sensors, actuator), self.law)

    def to_sampled_loop(
        self, vehicle: LateralVehicle, period: float, actuator: ActuatorSpec | None = None
    ) -> SampledLoop:
        """Close the loop of the law as `act` steps it around a vehicle.

        `act` computes xc_k = E xc_(k-1) + P y_(k-1) + Q y_k. What is carried from one period to the
        next is z_k = E xc_(k-1) + P y_(k-1), so that xc_k = z_k + Q y_k and

            u_k = -(C z_k + (C Q + D) y_k),   z_(k+1) = E z_k + (E Q + P) y_k

        with products rounded to double precision.

        Args:
            vehicle: The vehicle; its layout must be the controller's.
            period: Control period [s]; it must be the controller's own.
            actuator: Its lag becomes part of the plant; limits do not act on small motion.

        Returns:
            The loop; a sensor with direct feedthrough sees the force before the switch.

        Raises:
            ArgumentError: The layouts differ, or the period is not the controller's.
        """
        check_layout(self.layout, vehicle)
        if check_positive("period", period, "seconds") != self.control_period:
            raise ArgumentError(
                f"period = {period:g} s, but the controller is stepped with "
                f"control_period = {self.control_period:g} s; use the same for both"
            )
        plant = plant_seen(vehicle, self.sensors, actuator)
        E, P, Q, law = self._transition, self._before, self._after, self.law
        return SampledLoop(
            A=plant.A,
            B=plant.B,
            C=plant.C,
            D=plant.D,
            period=period,
            Ac=E,
            Bc=E @ Q + P,
            Cc=-law.C,
            Dc=-(law.C @ Q + law.D),
        )

    def to_scipy(self) -> Any:
        """Return the system from sensors to forces [N], u = -law(y), of scipy.signal.

        A sampled law comes in discrete time with its control period, a continuous one as it is.

        Raises:
            ArgumentError: There is no sensor or no actuator.
        """
        return export.to_scipy(self.law, self.control_period if self.sampled else None)

    def to_control(self) -> Any:
        """Return the same system of python-control, with the names of sensors and forces.

        Raises:
            ArgumentError: There is no sensor or no actuator, or python-control is not installed.
        """
        period = self.control_period if self.sampled else None
        return export.to_control(self.law, period, self.sensors, self.layout)


def _transition(A: FloatArray, period: float) -> FloatArray:
    """Return exp(A T)."""
    return np.asarray(linalg.expm(A * period)) if A.size else A.copy()
