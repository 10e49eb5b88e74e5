"""The stability oracle: how much delay does a linear feedback stand?

`critical_delays` and `certify` prove their answers in exact and ball arithmetic; what is floating
point to rounding accuracy is marked `proved = False`. Certificates are re-checked by
`railenv.stability.verifier`.
"""

from railenv.stability.certificate import Certificate
from railenv.stability.certify import certify
from railenv.stability.critical_delay import critical_delays
from railenv.stability.crossings import CriticalDelays, Crossing, estimated_critical_delays
from railenv.stability.delay_system import DelaySystem, as_delay_system
from railenv.stability.enclosed_roots import EnclosedRoot, EnclosedRoots, enclosed_roots
from railenv.stability.history_loop import FiniteHistoryLoop
from railenv.stability.lifted_roots import lifted_roots, unstable_at
from railenv.stability.modes import Mode, follow, modal_assurance
from railenv.stability.pade import pade_critical_delays, pade_matrix, pade_roots, required_order
from railenv.stability.proof.jitter import largest_jitter
from railenv.stability.proof.sampled_critical import SampledCriticalDelay, proved_critical_delay
from railenv.stability.sampled import (
    sampled_critical_delay,
    sampled_growth_rate,
    sampled_roots,
)
from railenv.stability.sampled_loop import SampledLoop
from railenv.stability.sampled_windows import SampledCrossing, SampledWindows, sampled_windows
from railenv.stability.spectrum import count_unstable, rightmost_roots
from railenv.stability.uncertain import UncertainDelaySystem

__all__ = [
    "Certificate",
    "CriticalDelays",
    "Crossing",
    "DelaySystem",
    "EnclosedRoot",
    "EnclosedRoots",
    "FiniteHistoryLoop",
    "Mode",
    "SampledCriticalDelay",
    "SampledCrossing",
    "SampledLoop",
    "SampledWindows",
    "UncertainDelaySystem",
    "as_delay_system",
    "certify",
    "count_unstable",
    "critical_delays",
    "enclosed_roots",
    "estimated_critical_delays",
    "follow",
    "largest_jitter",
    "lifted_roots",
    "modal_assurance",
    "pade_critical_delays",
    "pade_matrix",
    "pade_roots",
    "proved_critical_delay",
    "required_order",
    "rightmost_roots",
    "sampled_critical_delay",
    "sampled_growth_rate",
    "sampled_roots",
    "sampled_windows",
    "unstable_at",
]
