"""No control: the passive vehicle with all four lateral dampers, and actuators without command."""

import numpy as np

from baselines.controller import LinearFeedback
from baselines.registered import Registered
from railenv.vehicle.coordinates import actuator_positions, parse_layout


class Passive(LinearFeedback):
    """The passive vehicle; implies layout "passive"."""

    def __init__(self) -> None:
        super().__init__(np.zeros((0, 0)), (), "passive")


class Zero(LinearFeedback):
    """Actuators that never push: with four of them the vehicle is all but undamped.

    Args:
        layout: 2 or 4.
    """

    def __init__(self, layout: object = 4) -> None:
        channels = len(actuator_positions(parse_layout(layout)))
        super().__init__(np.zeros((channels, 0)), (), layout)


PASSIVE = Registered(
    "passive",
    "no actuators, all four lateral dampers (implies layout passive)",
    "Chen, Shi, Yu, Appendix 2",
    {},
    lambda vehicle: Passive(),  # noqa: ARG005
)

ZERO = Registered(
    "zero",
    "actuators that never push, dampers replaced as the layout says",
    "this project",
    {},
    lambda vehicle: Zero(vehicle.layout),
)
