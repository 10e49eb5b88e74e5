"""What a controller is, and linear feedback as the one the oracle reads directly.

A controller is any object with `reset(num_lanes, seed)` and `act(observations) -> actions`, batched
with lanes first. Observations are those of the environment (`railenv.envs.observation`): sensors,
then past actions, SI units. One that has `measures`, a tuple of names, gets these columns in place
of the standard sensors (any output or state of the vehicle, for laws that are told more than a
vehicle usually measures). An action of one is `action_scale` newtons (3 kN unless the controller
says otherwise); in simulation and benchmark only the actuator's force limit bounds it, the
environment's box clips at one. State is kept inside and must not depend on the number of lanes.

One that wants to know the delay has a method `tell(delays)`: the delay that every lane is told,
shape (lanes,) [s], handed over after every `reset` and before the first `act`. It is the mean over
the lane's channels, and may be wrong by a told error. A controller that has the method and takes no
notice says so with an attribute `is_told` that is False.

A linear controller also offers `to_delay_system(vehicle, actuator)` for the stability oracle, and
`to_sampled_loop(vehicle, period, actuator)` for proofs about the loop with sampling and hold.
"""

import sys
from collections.abc import Generator
from contextlib import contextmanager, redirect_stdout
from functools import cache
from typing import Any, Protocol, runtime_checkable

import numpy as np

from baselines import export
from railenv.actuation import ActuatorSpec
from railenv.envs.observation import DEFAULT_ACTION_SCALE, sensor_names
from railenv.errors import ArgumentError, ControllerError, check_positive, unknown_name
from railenv.stability import DelaySystem, SampledLoop
from railenv.stability.loops import LinearSystem, static_gain
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle, lateral17, state_space
from railenv.vehicle.coordinates import Layout, actuator_positions, parse_layout

LARGEST_NUMBER = 1e20
"""Largest entry of a law's matrices; what is beyond overflows in products with the vehicle's."""


@contextmanager
def users_own_code(what: str) -> Generator[None, None, None]:
    """Run code that is not ours: whatever it raises is a `ControllerError`, `exit` included.

    What it prints goes to standard error, so that it does not mix with results.
    """
    try:
        with redirect_stdout(sys.stderr):
            yield
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        try:
            text = f"{type(error).__name__}: {error}"
        except Exception:
            text = type(error).__name__
        raise ControllerError(f"{what} raised {text}") from error


@runtime_checkable
class Controller(Protocol):
    """Anything that turns observations into actions, batched."""

    def reset(self, num_lanes: int, seed: int) -> None:
        """Forget the past and get ready for a number of lanes."""
        ...

    def act(self, observations: FloatArray) -> FloatArray:
        """Return actions, shape (lanes, channels), for observations, shape (lanes, columns)."""
        ...


def measured_columns(sensors: tuple[str, ...], layout: Layout) -> tuple[str, ...]:
    """Return what has to be measured for a law: the standard sensors, then whatever it asks beyond.

    Args:
        sensors: Names of the law's inputs: standard sensors, or other outputs and states of the
            vehicle's state space, for laws that assume more than a vehicle usually carries.
        layout: The actuators' layout.

    Raises:
        ArgumentError: A sensor does not exist; the message names the nearest.
    """
    standard = sensor_names(layout)
    for name in sensors:
        if name not in standard and name not in _all_signals(layout):
            raise unknown_name("sensor", name, (*standard, *_all_signals(layout)))
    return (*standard, *dict.fromkeys(name for name in sensors if name not in standard))


@cache
def _all_signals(layout: Layout) -> tuple[str, ...]:
    """Return the names of every output and state; which there are depends on the layout alone."""
    system = state_space(lateral17("paper_fit", layout, 300.0))
    return (*system.outputs, *system.states)


def measured_by(controller: object, layout: Layout) -> tuple[str, ...]:
    """Return the measured columns of a controller's observation: its `measures`, or the standard.

    Raises:
        ArgumentError: `measures` is no tuple of names.
    """
    names: Any = getattr(controller, "measures", None)
    if names is None:
        return sensor_names(layout)
    if not isinstance(names, tuple | list) or not all(isinstance(name, str) for name in names):
        raise ArgumentError(
            f"the controller's measures = {names!r:.80} must be a tuple of names of sensors, "
            "outputs or states"
        )
    return tuple(names)


def check_size(name: str, matrix: FloatArray) -> None:
    """Raise `ArgumentError` if a law's matrix holds a number beyond `LARGEST_NUMBER`."""
    largest = float(np.abs(matrix).max(initial=0.0))
    if largest > LARGEST_NUMBER:
        raise ArgumentError(
            f"{name} holds {largest:.3g}, beyond what a law can mean; give {LARGEST_NUMBER:g} or "
            "less in SI units"
        )


def check_layout(layout: Layout, vehicle: LateralVehicle) -> None:
    """Raise `ArgumentError` unless the vehicle has the controller's layout."""
    if vehicle.layout != layout:
        raise ArgumentError(
            f"the controller is for layout {layout}, the vehicle has layout "
            f"{vehicle.layout}; use the same for both"
        )


def plant_seen(
    vehicle: LateralVehicle, sensors: tuple[str, ...], actuator: ActuatorSpec | None
) -> LinearSystem:
    """Return what a controller stands before: commands in, sensors out.

    Args:
        vehicle: The vehicle.
        sensors: Names of the sensors.
        actuator: Its lag becomes part of the plant; limits do not act on small motion.

    Returns:
        The vehicle's states, followed by the forces if there is a lag: feedthrough from them is
        then ordinary output.
    """
    system = state_space(vehicle)
    C, D = system.output_rows(sensors)
    D = D[:, : system.num_actuators]
    lag = ActuatorSpec() if actuator is None else actuator
    A, B = lag.with_lag(system.A, system.actuator_input)
    if lag.lag > 0.0:
        C, D = np.hstack([C, D]), np.zeros_like(D)
    return LinearSystem(A, B, C, D, system.inputs[: system.num_actuators], sensors)


class LinearFeedback:
    """Static linear feedback of sensors, u = -gain @ y(t - tau).

    Args:
        gain: Shape (channels, sensors) [N per sensor unit].
        sensors: Names of the sensors: columns of the standard observation of the layout, or other
            outputs and states of the vehicle.
        layout: "passive" (no channel), 2 or 4.
        action_scale: Force of an action of one [N].

    Attributes:
        measures: The measured columns of the observation that it takes.

    Raises:
        ArgumentError: The gain has the wrong shape or is not finite, or a sensor does not exist.
    """

    def __init__(
        self,
        gain: Any,
        sensors: tuple[str, ...],
        layout: object,
        action_scale: float = DEFAULT_ACTION_SCALE,
    ) -> None:
        self.layout: Layout = parse_layout(layout)
        self.sensors = tuple(sensors)
        self.gain: FloatArray = np.array(gain, dtype=float)
        self.action_scale = check_positive("action_scale", action_scale, "N")
        self.measures = measured_columns(self.sensors, self.layout)
        self._columns = [self.measures.index(name) for name in self.sensors]
        shape = (len(actuator_positions(self.layout)), len(self.sensors))
        if self.gain.shape != shape:
            raise ArgumentError(f"gain has shape {self.gain.shape}; it must be {shape}")
        if not np.all(np.isfinite(self.gain)):
            raise ArgumentError(
                "gain holds a value that is not finite; every entry must be a number"
            )
        check_size("gain", self.gain)

    def reset(self, num_lanes: int, seed: int) -> None:
        """Nothing to forget: the feedback is static."""

    def act(self, observations: FloatArray) -> FloatArray:
        """Return -gain @ y / action_scale, shape (lanes, channels).

        One multiply-add per sensor in a fixed order, so that a lane's numbers do not depend on how
        many lanes there are (a matrix library's would).
        """
        actions = np.zeros((observations.shape[0], self.gain.shape[0]))
        for index, column in enumerate(self._columns):
            actions -= observations[:, column, None] * self.gain[:, index]
        return actions / self.action_scale

    def to_delay_system(
        self, vehicle: LateralVehicle, actuator: ActuatorSpec | None = None
    ) -> DelaySystem:
        """Close the loop around a vehicle.

        Args:
            vehicle: The vehicle; its layout must be the controller's.
            actuator: Its lag becomes part of the plant; limits do not act on small motion.

        Returns:
            The loop; neutral if a fed-back sensor has direct feedthrough and there is no lag.

        Raises:
            ArgumentError: The layouts differ.
        """
        check_layout(self.layout, vehicle)
        return DelaySystem.from_loop(plant_seen(vehicle, self.sensors, actuator), self.gain)

    def to_sampled_loop(
        self, vehicle: LateralVehicle, period: float, actuator: ActuatorSpec | None = None
    ) -> SampledLoop:
        """Close the loop around a vehicle with u_k = -gain @ y_k, held for a period.

        Args:
            vehicle: The vehicle; its layout must be the controller's.
            period: Control period [s].
            actuator: Its lag becomes part of the plant; limits do not act on small motion.

        Returns:
            The loop; a sensor with direct feedthrough sees the force before the switch.

        Raises:
            ArgumentError: The layouts differ, or the period is not above zero.
        """
        check_layout(self.layout, vehicle)
        plant = plant_seen(vehicle, self.sensors, actuator)
        m, p = self.gain.shape
        return SampledLoop(
            A=plant.A,
            B=plant.B,
            C=plant.C,
            D=plant.D,
            period=period,
            Ac=np.zeros((0, 0)),
            Bc=np.zeros((0, p)),
            Cc=np.zeros((m, 0)),
            Dc=-self.gain,
        )

    def to_scipy(self) -> Any:
        """Return the static system from sensors to forces [N], u = -gain @ y, of scipy.signal.

        Raises:
            ArgumentError: There is no sensor or no actuator.
        """
        return export.to_scipy(static_gain(self.gain), None)

    def to_control(self) -> Any:
        """Return the same system of python-control, with the names of sensors and forces.

        Raises:
            ArgumentError: There is no sensor or no actuator, or python-control is not installed.
        """
        return export.to_control(static_gain(self.gain), None, self.sensors, self.layout)
