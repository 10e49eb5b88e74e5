"""Sky-hook with phase lead for a known delay.

    F_k = -c_sky [prod_(i=1)^n 1/sqrt(a) (1 + a T s) / (1 + T s)] v_k(t - tau)

Each stage leads most, by arcsin((a - 1) / (a + 1)), at omega_c = 1 / (T sqrt(a)), where its gain is
one (lead compensation, in any text on loop shaping). n stages
share the phase omega_c tau that the delay takes there, so that at omega_c the delayed law acts as
sky-hook acts without delay. Elsewhere it does not: above omega_c the gain grows to a^(n/2), below
it falls to a^(-n/2), while the phase that is made up falls behind the delay's as frequency rises.
"""

import math

import numpy as np

from baselines.linear_dynamic import LinearDynamic
from baselines.registered import Registered
from baselines.skyhook import actuated_places
from railenv.envs.observation import DEFAULT_ACTION_SCALE
from railenv.errors import ArgumentError, check_not_negative, check_positive
from railenv.simulation import DEFAULT_CONTROL_PERIOD
from railenv.units import FloatArray

MOST_PER_STAGE = math.radians(55.0)
"""Most phase lead asked of one stage [rad]; its gain then spans a factor of ten."""


class SkyHookLead(LinearDynamic):
    """Sky-hook damping with lead stages against a known delay.

    Args:
        delay: The delay that is made up for [s]; zero is plain sky-hook.
        gain: Damping coefficient c_sky [N s/m], zero or more.
        frequency_hz: Where it is made up for, omega_c / (2 pi) [Hz]; by default near the frequency
            at which the sky-hook loop of Chen, Shi and Yu crosses, 1.32 Hz.
        layout: 2 or 4.
        action_scale: Force of an action of one [N].
        control_period: Time between actions [s]; it must be that of the run.

    Attributes:
        stages: Number of lead stages.

    Raises:
        ArgumentError: A value is out of range, the delay is half a period of `frequency_hz` or
            more, or the layout has no actuator.
    """

    def __init__(
        self,
        delay: float = 0.1,
        gain: float = 35e3,
        frequency_hz: float = 1.3,
        layout: object = 4,
        action_scale: float = DEFAULT_ACTION_SCALE,
        control_period: float = DEFAULT_CONTROL_PERIOD,
    ) -> None:
        coefficient = check_not_negative("gain", gain, "N s/m")
        places = actuated_places(layout, "sky-hook")
        one = lead_stages(
            check_not_negative("delay", delay, "seconds"),
            check_positive("frequency_hz", frequency_hz, "Hz"),
        )
        self.stages = len(one[0])
        A, B, C, D = (np.kron(np.eye(len(places)), part) for part in one)
        sensors = tuple(f"carbody_lateral_velocity_{k}" for k in places)
        law = (A, B, coefficient * C, coefficient * D)
        super().__init__(law, sensors, layout, action_scale, control_period)


def lead_stages(
    delay: float, frequency_hz: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return n equal lead stages in series that make up for a delay at one frequency.

    Args:
        delay: [s].
        frequency_hz: [Hz].

    Returns:
        A, B, C, D with one input, one output and gain one at the frequency.

    Raises:
        ArgumentError: The delay is half a period or more: a force of the other sign is then nearer.
    """
    omega = 2 * math.pi * frequency_hz
    phase = omega * delay
    if phase >= math.pi:
        raise ArgumentError(
            f"delay = {delay:g} s is half a period of frequency_hz = {frequency_hz:g} Hz or more, "
            f"where lead only turns the sign round; give less than {0.5 / frequency_hz:.3g} s, "
            "or a lower frequency"
        )
    n = math.ceil(phase / MOST_PER_STAGE)
    A, B, C, D = np.zeros((n, n)), np.zeros((n, 1)), np.zeros((1, n)), np.ones((1, 1))
    if n == 0:
        return A, B, C, D
    lead = math.sin(phase / n)
    ratio = (1 + lead) / (1 - lead)
    root = math.sqrt(ratio)
    lag = 1 / (omega * root)
    # A stage is lag x' = u - x, y = root u + (1 / root - root) x; its u is the output of the last.
    for k in range(n):
        A[k], B[k] = C[0] / lag, D[0] / lag
        A[k, k] = -1 / lag
        C, D = root * C, root * D
        C[0, k] = 1 / root - root
    return A, B, C, D


SKYHOOK_LEAD = Registered(
    "skyhook-lead",
    "sky-hook with phase lead that makes up for a known delay at one frequency",
    "Chen, Shi, Yu, section 5; lead compensation of textbooks",
    {"delay": (0.1, "s"), "gain": (35e3, "N s/m"), "frequency_hz": (1.3, "Hz")},
    lambda vehicle, delay, gain, frequency_hz: SkyHookLead(
        delay, gain, frequency_hz, vehicle.layout
    ),
)
