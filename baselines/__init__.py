"""Controllers: the protocol, one law per file, and making one by name."""

from baselines.clipped_lqg import ClippedLqg
from baselines.controller import Controller, LinearFeedback
from baselines.groundhook import GroundHook
from baselines.hinfinity import HInfinity
from baselines.hinfinity_shaping import HInfinityShaping
from baselines.lead import SkyHookLead
from baselines.linear_dynamic import LinearDynamic
from baselines.linearise import linearise
from baselines.lqg import DelayLqg, Lqg
from baselines.lqr import LinearQuadraticRegulator
from baselines.mixedhook import MixedHook
from baselines.optimum import FullInformation
from baselines.passive import Passive, Zero
from baselines.pid import ModalPid
from baselines.policies import (
    History,
    HistoryPolicy,
    LinearPolicy,
    NetworkPolicy,
    RecurrentPolicy,
    load_trained,
    save_trained,
)
from baselines.policy_file import load_policy, save_policy
from baselines.predictor import PredictorSkyHook
from baselines.registry import make_controller, registered_controllers
from baselines.relative import RelativeDamping
from baselines.semi_active import OnOffSkyHook, SemiActiveSkyHook
from baselines.skyhook import SkyHook, SkyHookAccelerometer
from baselines.smith import SmithSkyHook

__all__ = [
    "ClippedLqg",
    "Controller",
    "DelayLqg",
    "FullInformation",
    "GroundHook",
    "HInfinity",
    "HInfinityShaping",
    "History",
    "HistoryPolicy",
    "LinearDynamic",
    "LinearFeedback",
    "LinearPolicy",
    "LinearQuadraticRegulator",
    "Lqg",
    "MixedHook",
    "ModalPid",
    "NetworkPolicy",
    "OnOffSkyHook",
    "Passive",
    "PredictorSkyHook",
    "RecurrentPolicy",
    "RelativeDamping",
    "SemiActiveSkyHook",
    "SkyHook",
    "SkyHookAccelerometer",
    "SkyHookLead",
    "SmithSkyHook",
    "Zero",
    "linearise",
    "load_policy",
    "load_trained",
    "make_controller",
    "registered_controllers",
    "save_policy",
    "save_trained",
]
