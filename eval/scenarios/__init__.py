"""What the benchmark runs: scenarios, the suites made of them, and the tracks nobody trains on."""

from eval.scenarios.channel import CHANNELS, Channel
from eval.scenarios.scenario import MODELS, VEHICLES, Scenario, vehicle_parameters
from eval.scenarios.seeds import TestTracks, commitment
from eval.scenarios.suite import Suite, load_suite

__all__ = [
    "CHANNELS",
    "MODELS",
    "VEHICLES",
    "Channel",
    "Scenario",
    "Suite",
    "TestTracks",
    "commitment",
    "load_suite",
    "vehicle_parameters",
]
