"""Mixed sky-hook and ground-hook: a damper to the sky, one to the ground, one between the bodies.

F_k(t) = [-c_sky v_carbody_k + c_ground v_bogie_k - c_relative (stroke rate)_k](t - tau)

with v_bogie_k = v_carbody_k - (stroke rate)_k at the actuator's place. Since the stroke rate is the
difference of the two velocities, c_relative only adds to both other coefficients: equal sky and
ground coefficients are a relative damper, and what lies beyond it is a weight between the two
bodies. Chen, Shi and Yu, doi 10.1177/10775463261463161, leave it to others in their outlook.
"""

import numpy as np

from baselines.controller import LinearFeedback
from baselines.groundhook import carbody_and_stroke
from baselines.registered import Registered
from baselines.skyhook import actuated_places
from railenv.envs.observation import DEFAULT_ACTION_SCALE
from railenv.errors import check_not_negative


class MixedHook(LinearFeedback):
    """Mixed sky-hook, ground-hook and relative damping, the same at all actuators.

    The default keeps the sky coefficient of Chen, Shi and Yu; 10 kN s/m to the ground is the best
    beside it of 0, 2, 4, 5, 6, 8, 10 and 15 kN s/m by the ride index of the worse floor end on
    German low (`paper_fit`, 300 km/h, four actuators, no delay), and costs 2 ms of critical delay.

    Args:
        sky: Damping coefficient c_sky [N s/m], zero or more.
        ground: Damping coefficient c_ground [N s/m], zero or more.
        relative: Damping coefficient c_relative [N s/m], zero or more.
        layout: 2 or 4.
        action_scale: Force of an action of one [N].

    Raises:
        ArgumentError: A coefficient is negative or not finite, or the layout has no actuator.
    """

    def __init__(
        self,
        sky: float = 35e3,
        ground: float = 10e3,
        relative: float = 0.0,
        layout: object = 4,
        action_scale: float = DEFAULT_ACTION_SCALE,
    ) -> None:
        to_sky = check_not_negative("sky", sky, "N s/m")
        to_ground = check_not_negative("ground", ground, "N s/m")
        between = check_not_negative("relative", relative, "N s/m")
        eye = np.eye(len(actuated_places(layout, "the mixed hook")))
        # c_ground v_bogie = c_ground (v_carbody - stroke rate)
        gain = np.hstack([(to_sky - to_ground) * eye, (to_ground + between) * eye])
        super().__init__(gain, carbody_and_stroke(layout), layout, action_scale)


MIXEDHOOK = Registered(
    "mixedhook",
    "F = -sky * carbody velocity + ground * bogie velocity - relative * stroke rate",
    "Chen, Shi, Yu, outlook",
    {"sky": (35e3, "N s/m"), "ground": (10e3, "N s/m"), "relative": (0.0, "N s/m")},
    lambda vehicle, sky, ground, relative: MixedHook(sky, ground, relative, vehicle.layout),
)
