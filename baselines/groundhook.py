"""Ground-hook damping: every actuator resists the bogie frame's absolute lateral velocity.

F_k(t) = c_ground v_bogie_k(t - tau),   v_bogie_k = v_carbody_k - (stroke rate)_k

at the actuator's place on the frame, at damper level. F acts on the carbody with its sign and on
the bogie with the opposite one: the frame is held by a damper to the ground, and the carbody takes
the reaction. It is the counterpart of Karnopp's sky-hook; Chen, Shi and Yu, doi
10.1177/10775463261463161, leave it to others in their outlook.

The carbody gets nothing but the reaction, which pushes it along with the bogies: where four
actuators replace all dampers its lower centre roll (0.54 Hz) stays all but undamped; the loop is
unstable without any delay beyond 2.9, 4.6 and 6.1 kN s/m at 150, 200 and 300 km/h (`paper_fit`).
The default stays below. The law is for mixing (`baselines.mixedhook`).
"""

import numpy as np

from baselines.controller import LinearFeedback
from baselines.registered import Registered
from baselines.skyhook import actuated_places
from railenv.envs.observation import DEFAULT_ACTION_SCALE
from railenv.errors import check_not_negative


class GroundHook(LinearFeedback):
    """Ground-hook damping with one gain for all actuators.

    Args:
        gain: Damping coefficient c_ground [N s/m], zero or more; see above for its limits.
        layout: 2 or 4.
        action_scale: Force of an action of one [N].

    Raises:
        ArgumentError: The gain is negative or not finite, or the layout has no actuator.
    """

    def __init__(
        self, gain: float = 2e3, layout: object = 4, action_scale: float = DEFAULT_ACTION_SCALE
    ) -> None:
        ground = check_not_negative("gain", gain, "N s/m") * np.eye(
            len(actuated_places(layout, "ground-hook"))
        )
        super().__init__(
            np.hstack([-ground, ground]), carbody_and_stroke(layout), layout, action_scale
        )


def carbody_and_stroke(layout: object) -> tuple[str, ...]:
    """Return the names of the carbody velocities at the actuators, then of the stroke rates."""
    places = actuated_places(layout, "a damper")
    return (
        *(f"carbody_lateral_velocity_{k}" for k in places),
        *(f"suspension_stroke_rate_{k}" for k in places),
    )


GROUNDHOOK = Registered(
    "groundhook",
    "F = +gain * bogie lateral velocity at each actuator",
    "Chen, Shi, Yu, outlook; the counterpart of Karnopp's sky-hook",
    {"gain": (2e3, "N s/m")},
    lambda vehicle, gain: GroundHook(gain, vehicle.layout),
)
