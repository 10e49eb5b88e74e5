"""Relative damping: every actuator acts as a damper between carbody and bogie, with delay.

F_k(t) = -c (stroke rate)_k(t - tau). Without delay this is a dashpot in place of the actuator, the
damper that was taken out, without its series stiffness. The stroke rate itself is no standard
sensor. `FilteredRelativeDamping` makes it from the stroke transducer by a filtered derivative,

    (stroke rate)_k = s / (1 + s / w) (stroke)_k,   w = 2 pi filter_hz,

so that to the vehicle it is a Maxwell damper: dashpot c in series with the spring c w.
"""

import numpy as np

from baselines.controller import LinearFeedback
from baselines.linear_dynamic import LinearDynamic
from baselines.registered import Registered
from baselines.skyhook import actuated_places
from railenv.envs.observation import DEFAULT_ACTION_SCALE
from railenv.errors import check_not_negative, check_positive
from railenv.simulation import DEFAULT_CONTROL_PERIOD


class RelativeDamping(LinearFeedback):
    """Relative damping by the ideal stroke rate.

    Args:
        gain: Damping coefficient c [N s/m], zero or more; by default that of one lateral damper of
            Chen, Shi and Yu, Appendix 2.
        layout: 2 or 4.
        action_scale: Force of an action of one [N].

    Raises:
        ArgumentError: The gain is negative or not finite, or the layout has no actuator.
    """

    def __init__(
        self, gain: float = 15e3, layout: object = 4, action_scale: float = DEFAULT_ACTION_SCALE
    ) -> None:
        coefficient = check_not_negative("gain", gain, "N s/m")
        places = actuated_places(layout, "relative damping")
        sensors = tuple(f"suspension_stroke_rate_{k}" for k in places)
        super().__init__(coefficient * np.eye(len(places)), sensors, layout, action_scale)


class FilteredRelativeDamping(LinearDynamic):
    """Relative damping by the filtered derivative of the stroke transducers.

    Args:
        gain: Damping coefficient c [N s/m], zero or more.
        filter_hz: Corner of the derivative w / (2 pi) [Hz].
        layout: 2 or 4.
        action_scale: Force of an action of one [N].
        control_period: Time between actions [s]; it must be that of the run.

    Raises:
        ArgumentError: A value is out of range, or the layout has no actuator.
    """

    def __init__(
        self,
        gain: float = 15e3,
        filter_hz: float = 20.0,
        layout: object = 4,
        action_scale: float = DEFAULT_ACTION_SCALE,
        control_period: float = DEFAULT_CONTROL_PERIOD,
    ) -> None:
        coefficient = check_not_negative("gain", gain, "N s/m")
        corner = 2 * np.pi * check_positive("filter_hz", filter_hz, "Hz")
        places = actuated_places(layout, "relative damping")
        eye = np.eye(len(places))
        # The state is the low-passed stroke, the node of the Maxwell damper.
        stiffness = coefficient * corner * eye
        law = (-corner * eye, corner * eye, -stiffness, stiffness)
        sensors = tuple(f"suspension_stroke_{k}" for k in places)
        super().__init__(law, sensors, layout, action_scale, control_period)


def relative_damping(
    gain: float, filter_hz: float, layout: object
) -> RelativeDamping | FilteredRelativeDamping:
    """Return relative damping by the ideal rate, or by a filtered one.

    Args:
        gain: Damping coefficient [N s/m].
        filter_hz: Corner of the filtered derivative [Hz]; zero for the ideal rate.
        layout: 2 or 4.

    Raises:
        ArgumentError: A value is out of range, or the layout has no actuator.
    """
    if check_not_negative("filter_hz", filter_hz, "Hz") == 0.0:
        return RelativeDamping(gain, layout)
    return FilteredRelativeDamping(gain, filter_hz, layout)


RELATIVE = Registered(
    "relative",
    "F = -gain * stroke rate; filter_hz > 0 takes it from the stroke transducer",
    "the lateral damper of Chen, Shi, Yu, Appendix 2, as a command",
    {"gain": (15e3, "N s/m"), "filter_hz": (0.0, "Hz, 0 for the ideal rate")},
    lambda vehicle, gain, filter_hz: relative_damping(gain, filter_hz, vehicle.layout),
)
