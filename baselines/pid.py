"""PID on the carbody's sway and yaw, decoupled.

With v_front and v_rear the mean carbody velocities at the actuators of each bogie, at damper level,

    v_sway = (v_front + v_rear) / 2,   v_yaw = (v_front - v_rear) / 2            [m/s]
    F_mode = -[P + I / (s + w_leak) + D s / (1 + s / w_d)] v_mode(t - tau)       [N]
    F = F_sway + F_yaw at each front actuator, F_sway - F_yaw at each rear one.

P is a damper to the sky, I a spring to the sky (on a leaky integral, the displacement), D a mass
that the carbody seems to carry, each per actuator. The lateral-roll modes move v_sway alone and
the yaw mode v_yaw alone, equal forces make no yaw moment, opposite ones no lateral force: as far as
the carbody goes the two loops do not meet. They meet in the bogies, whose front and rear ends
differ while they roll (with two actuators also by the force off the frame's centre).

Modal control of railway vehicles: survey of Fu et al., Railway Engineering Science 28, 2020,
doi 10.1007/s40534-020-00207-w; the gains are this project's.
"""

from dataclasses import dataclass

import numpy as np

from baselines.linear_dynamic import LinearDynamic
from baselines.registered import Registered
from baselines.skyhook import actuated_places
from railenv.envs.observation import DEFAULT_ACTION_SCALE
from railenv.errors import check_not_negative, check_positive
from railenv.simulation import DEFAULT_CONTROL_PERIOD
from railenv.units import FloatArray, Kilogram, NewtonPerMetre, NewtonSecondPerMetre
from railenv.vehicle import LateralVehicle
from railenv.vehicle.coordinates import bogie_of_position


@dataclass(frozen=True)
class ModalGains:
    """Gains of one mode, each per actuator and zero or more.

    Attributes:
        proportional: P, a damper to the sky [N s/m].
        integral: I, a spring to the sky [N/m].
        derivative: D, a mass that the carbody seems to carry [N s^2/m].
    """

    proportional: NewtonSecondPerMetre
    integral: NewtonPerMetre
    derivative: Kilogram

    def __post_init__(self) -> None:
        check_not_negative("proportional", self.proportional, "N s/m")
        check_not_negative("integral", self.integral, "N/m")
        check_not_negative("derivative", self.derivative, "N s^2/m")


SWAY = ModalGains(35e3, 50e3, 5e3)
YAW = ModalGains(10e3, 20e3, 5e3)


class ModalPid(LinearDynamic):
    """PID on sway and yaw of the carbody.

    The default gains come from a random search of 400 steps for the lowest ride index of the worse
    floor end on German low (four realisations of 40 s that no suite uses), `paper_fit`, 300 km/h,
    four actuators, no delay, with a margin: a critical delay of at least 0.2 s, that of sky-hook at
    35 kN s/m. It ended at sway 37e3, 102e3, 5.7e3 and yaw 0, 3e3, 5.7e3 with index 1.92. The
    defaults are rounded towards more damping, so that the margin holds with two actuators and at
    200 km/h too, and have 1.95 there. The derivative is what gains comfort; the integral buys
    delay.

    Args:
        sway: Gains of the lateral-roll motion.
        yaw: Gains of the yaw motion.
        leak_hz: Corner below which the integral forgets, w_leak / (2 pi) [Hz].
        derivative_hz: Corner of the filtered derivative, w_d / (2 pi) [Hz].
        layout: 2 or 4.
        action_scale: Force of an action of one [N].
        control_period: Time between actions [s]; it must be that of the run.

    Raises:
        ArgumentError: A value is out of range, or the layout has no actuator.
    """

    def __init__(
        self,
        sway: ModalGains = SWAY,
        yaw: ModalGains = YAW,
        leak_hz: float = 0.1,
        derivative_hz: float = 10.0,
        layout: object = 4,
        action_scale: float = DEFAULT_ACTION_SCALE,
        control_period: float = DEFAULT_CONTROL_PERIOD,
    ) -> None:
        leak = 2 * np.pi * check_positive("leak_hz", leak_hz, "Hz")
        corner = 2 * np.pi * check_positive("derivative_hz", derivative_hz, "Hz")
        places = actuated_places(layout, "PID")
        # Columns: what one newton of sway and of yaw asks of each actuator. Transposed and divided
        # by the number of actuators, the same numbers average the velocities to the modes'.
        share = np.array([[1.0, 1.0 if bogie_of_position(k) == 1 else -1.0] for k in places])
        A, B, C, D = _modes((sway, yaw), leak, corner)
        measured = share.T / len(places)
        law = (A, B @ measured, share @ C, share @ D @ measured)
        sensors = tuple(f"carbody_lateral_velocity_{k}" for k in places)
        super().__init__(law, sensors, layout, action_scale, control_period)


def _modes(
    gains: tuple[ModalGains, ModalGains], leak: float, corner: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return both modes' laws side by side: two velocities in, two forces out.

    A part whose gain is zero gets no state: hidden states would show among the loop's roots.
    """
    poles: list[float] = []
    inputs: list[FloatArray] = []
    outputs: list[FloatArray] = []
    D = np.zeros((2, 2))
    for of_mode, gain in zip(np.eye(2), gains, strict=True):
        direct = gain.proportional
        if gain.integral > 0.0:
            poles.append(-leak)
            inputs.append(of_mode)
            outputs.append(gain.integral * of_mode)
        if gain.derivative > 0.0:
            # D s / (1 + s / w) = D w [1 - w / (s + w)]: the state is the low-passed velocity.
            poles.append(-corner)
            inputs.append(corner * of_mode)
            outputs.append(-gain.derivative * corner * of_mode)
            direct += gain.derivative * corner
        D += direct * np.outer(of_mode, of_mode)
    states = len(poles)
    return (
        np.diag(poles),
        np.array(inputs).reshape(states, 2),
        np.array(outputs).reshape(states, 2).T,
        D,
    )


def _from_settings(
    vehicle: LateralVehicle,
    *,
    sway_proportional: float,
    sway_integral: float,
    sway_derivative: float,
    yaw_proportional: float,
    yaw_integral: float,
    yaw_derivative: float,
    leak_hz: float,
    derivative_hz: float,
) -> ModalPid:
    """Return the law for a vehicle's layout."""
    sway = ModalGains(
        check_not_negative("sway_proportional", sway_proportional, "N s/m"),
        check_not_negative("sway_integral", sway_integral, "N/m"),
        check_not_negative("sway_derivative", sway_derivative, "N s^2/m"),
    )
    yaw = ModalGains(
        check_not_negative("yaw_proportional", yaw_proportional, "N s/m"),
        check_not_negative("yaw_integral", yaw_integral, "N/m"),
        check_not_negative("yaw_derivative", yaw_derivative, "N s^2/m"),
    )
    return ModalPid(sway, yaw, leak_hz, derivative_hz, vehicle.layout)


PID = Registered(
    "pid",
    "PID on the carbody's sway and yaw velocities, decoupled",
    "modal control, survey of Fu et al. 2020; gains by search (this project)",
    {
        "sway_proportional": (SWAY.proportional, "N s/m"),
        "sway_integral": (SWAY.integral, "N/m"),
        "sway_derivative": (SWAY.derivative, "N s^2/m"),
        "yaw_proportional": (YAW.proportional, "N s/m"),
        "yaw_integral": (YAW.integral, "N/m"),
        "yaw_derivative": (YAW.derivative, "N s^2/m"),
        "leak_hz": (0.1, "Hz"),
        "derivative_hz": (10.0, "Hz"),
    },
    _from_settings,
)
