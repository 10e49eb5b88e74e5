"""The actuation channel: delay, hold, force and rate limits, lag."""

from railenv.actuation.actuator import PAPER_FORCE_LIMIT, ActuatorSpec
from railenv.actuation.delay import DelayLine, DelaySpec
from railenv.actuation.hold import held_input, ramped_input

__all__ = [
    "PAPER_FORCE_LIMIT",
    "ActuatorSpec",
    "DelayLine",
    "DelaySpec",
    "held_input",
    "ramped_input",
]
