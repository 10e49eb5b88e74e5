"""Sky-hook damping: every actuator resists the carbody's absolute lateral velocity at its place.

F_k(t) = -c_sky v_k(t - tau), Karnopp's damper hooked to the sky, section 5 of Chen, Shi and Yu, J.
Vib. Control, doi 10.1177/10775463261463161. v_k is taken at damper level at the actuator's own
place; the paper's gain matrices are lost, and of the sensor places tried this one reproduces its
result.
"""

import numpy as np

from baselines.controller import LinearFeedback
from baselines.registered import Registered
from railenv.envs.observation import DEFAULT_ACTION_SCALE
from railenv.errors import ArgumentError, check_not_negative
from railenv.vehicle.coordinates import actuator_positions, parse_layout


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
        places = actuator_positions(parse_layout(layout))
        if not places:
            raise ArgumentError("layout = 'passive' has no actuator for sky-hook; choose 2 or 4")
        sensors = tuple(f"carbody_lateral_velocity_{k}" for k in places)
        super().__init__(coefficient * np.eye(len(places)), sensors, layout, action_scale)


SKYHOOK = Registered(
    "skyhook",
    "F = -gain * carbody lateral velocity at each actuator",
    "Chen, Shi, Yu, section 5; Karnopp 1995",
    {"gain": (35e3, "N s/m")},
    lambda vehicle, gain: SkyHook(gain, vehicle.layout),
)
