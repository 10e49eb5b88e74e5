"""Controllers: the protocol, the reference laws, and making one by name."""

from baselines.controller import Controller, LinearFeedback
from baselines.linear_dynamic import LinearDynamic
from baselines.linearise import linearise
from baselines.passive import Passive, Zero
from baselines.policy_file import load_policy, save_policy
from baselines.registry import make_controller, registered_controllers
from baselines.skyhook import SkyHook

__all__ = [
    "Controller",
    "LinearDynamic",
    "LinearFeedback",
    "Passive",
    "SkyHook",
    "Zero",
    "linearise",
    "load_policy",
    "make_controller",
    "registered_controllers",
    "save_policy",
]
