"""Sky-hook damping: every actuator resists the carbody's absolute lateral velocity at its place.

F_k(t) = -c_sky v_k(t - tau), Karnopp's damper hooked to the sky, section 5 of Chen, Shi and Yu, J.
Vib. Control, doi 10.1177/10775463261463161. v_k is taken at damper level at the actuator's own
place; the paper's gain matrices are lost, and of the sensor places tried this one reproduces its
result.

No sensor measures v_k. `SkyHookAccelerometer` makes it from the accelerometer at the same place,

    v_k = s / (s^2 + 2 zeta w s + w^2) a_k,   w = 2 pi highpass_hz,

an integrator behind a second-order high-pass, s^2 / (s^2 + 2 zeta w s + w^2) times 1 / s. A
constant reading (an offset, the pull of a steady curve) leaves no force.
"""

import numpy as np

from baselines.controller import LinearFeedback
from baselines.linear_dynamic import LinearDynamic
from baselines.registered import Registered
from railenv.envs.observation import DEFAULT_ACTION_SCALE
from railenv.errors import ArgumentError, check_not_negative, check_positive
from railenv.simulation import DEFAULT_CONTROL_PERIOD
from railenv.vehicle.coordinates import actuator_positions, parse_layout


def actuated_places(layout: object, law: str) -> tuple[int, ...]:
    """Return the places of a layout's actuators, for a law that needs some.

    Args:
        layout: 2 or 4.
        law: Name of the law, for the message.

    Raises:
        ArgumentError: The layout does not exist or has no actuator.
    """
    places = actuator_positions(parse_layout(layout))
    if not places:
        raise ArgumentError(f"layout = 'passive' has no actuator for {law}; choose 2 or 4")
    return places


class SkyHook(LinearFeedback):
    """Sky-hook damping with one gain for all actuators.

    Args:
        gain: Damping coefficient c_sky [N s/m], zero or more.
        layout: 2 or 4.
        action_scale: Force of an action of one [N].

    Raises:
        ArgumentError: The gain is negative or not finite, or the layout has no actuator.
    """

    def __init__(
        self, gain: float = 35e3, layout: object = 4, action_scale: float = DEFAULT_ACTION_SCALE
    ) -> None:
        coefficient = check_not_negative("gain", gain, "N s/m")
        places = actuated_places(layout, "sky-hook")
        sensors = tuple(f"carbody_lateral_velocity_{k}" for k in places)
        super().__init__(coefficient * np.eye(len(places)), sensors, layout, action_scale)


class SkyHookAccelerometer(LinearDynamic):
    """Sky-hook damping whose velocity is made from the accelerometer at each actuator.

    The corner is a compromise. Below it, entering a curve counts as motion: a reading that rises by
    r [m/s^3] settles at the velocity r / w^2. A transition of 1 m/s^2 in 5 s then asks for 17.7 kN
    with a corner of 0.1 Hz, 4.4 kN with 0.2 Hz, 2.0 kN with 0.3 Hz (35 kN s/m, once settled). Above
    it, the filter leads the true velocity by about 2 zeta w / omega: at the crossing this makes up
    for some delay, but it takes the damping of the slow motion near the corner: without delay the
    least damped slow mode has 36 % at 0.2 Hz, 9 % at 0.3 Hz, and the loop is unstable beyond 0.405
    Hz (`paper_fit`, 300 km/h, four actuators). Hence 0.2 Hz. The law is strictly proper, so that
    the accelerometer's feedthrough leaves the loop retarded.

    Args:
        gain: Damping coefficient c_sky [N s/m], zero or more.
        highpass_hz: Corner of the high-pass w / (2 pi) [Hz].
        zeta: Its damping ratio [1].
        layout: 2 or 4.
        action_scale: Force of an action of one [N].
        control_period: Time between actions [s]; it must be that of the run.

    Raises:
        ArgumentError: A value is out of range, or the layout has no actuator.
    """

    def __init__(
        self,
        gain: float = 35e3,
        highpass_hz: float = 0.2,
        zeta: float = 0.7,
        layout: object = 4,
        action_scale: float = DEFAULT_ACTION_SCALE,
        control_period: float = DEFAULT_CONTROL_PERIOD,
    ) -> None:
        coefficient = check_not_negative("gain", gain, "N s/m")
        corner = 2 * np.pi * check_positive("highpass_hz", highpass_hz, "Hz")
        ratio = check_positive("zeta", zeta)
        places = actuated_places(layout, "sky-hook")
        # States of one channel: a pseudo-displacement [m] and its rate, the velocity [m/s].
        one = (
            np.array([[0.0, 1.0], [-(corner**2), -2 * ratio * corner]]),
            np.array([[0.0], [1.0]]),
            np.array([[0.0, coefficient]]),
            np.zeros((1, 1)),
        )
        law = tuple(np.kron(np.eye(len(places)), part) for part in one)
        sensors = tuple(f"carbody_lateral_acceleration_{k}" for k in places)
        super().__init__(law, sensors, layout, action_scale, control_period)


SKYHOOK = Registered(
    "skyhook",
    "F = -gain * carbody lateral velocity at each actuator",
    "Chen, Shi, Yu, section 5; Karnopp 1995",
    {"gain": (35e3, "N s/m")},
    lambda vehicle, gain: SkyHook(gain, vehicle.layout),
)

SKYHOOK_ACCELEROMETER = Registered(
    "skyhook-acc",
    "sky-hook whose velocity is the high-passed integral of the carbody accelerometers",
    "Chen, Shi, Yu, section 5, with a realistic velocity (this project)",
    {"gain": (35e3, "N s/m"), "highpass_hz": (0.2, "Hz"), "zeta": (0.7, "1")},
    lambda vehicle, gain, highpass_hz, zeta: SkyHookAccelerometer(
        gain, highpass_hz, zeta, vehicle.layout
    ),
)
