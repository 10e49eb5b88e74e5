"""Controllers: the protocol, the reference laws, and making one by name."""

from baselines.controller import Controller, LinearFeedback
from baselines.passive import Passive, Zero
from baselines.registry import make_controller, registered_controllers
from baselines.skyhook import SkyHook

__all__ = [
    "Controller",
    "LinearFeedback",
    "Passive",
    "SkyHook",
    "Zero",
    "make_controller",
    "registered_controllers",
]
