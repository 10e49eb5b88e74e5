"""The stability oracle: how much delay does a linear feedback stand?

Everything offered here so far is floating point to rounding accuracy and marked `proved = False`.
"""

from railenv.stability.crossings import CriticalDelays, Crossing, critical_delays
from railenv.stability.delay_system import DelaySystem
from railenv.stability.modes import Mode, follow, modal_assurance
from railenv.stability.pade import pade_critical_delays, pade_matrix, pade_roots, required_order
from railenv.stability.sampled import (
    sampled_critical_delay,
    sampled_growth_rate,
    sampled_roots,
)
from railenv.stability.spectrum import count_unstable, rightmost_roots

__all__ = [
    "CriticalDelays",
    "Crossing",
    "DelaySystem",
    "Mode",
    "count_unstable",
    "critical_delays",
    "follow",
    "modal_assurance",
    "pade_critical_delays",
    "pade_matrix",
    "pade_roots",
    "required_order",
    "rightmost_roots",
    "sampled_critical_delay",
    "sampled_growth_rate",
    "sampled_roots",
]
