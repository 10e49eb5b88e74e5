"""The actuation channel: delay, hold, force and rate limits, lag; semi-active dampers."""

from railenv.actuation.actuator import PAPER_FORCE_LIMIT, ActuatorSpec
from railenv.actuation.delay import DelaySpec
from railenv.actuation.delay_line import DelayLine, split_delay
from railenv.actuation.hold import held_input, ramped_input
from railenv.actuation.semi_active import SemiActiveDamper, coefficient_names

__all__ = [
    "PAPER_FORCE_LIMIT",
    "ActuatorSpec",
    "DelayLine",
    "DelaySpec",
    "SemiActiveDamper",
    "coefficient_names",
    "held_input",
    "ramped_input",
    "split_delay",
]
