"""Trained policies: what they see, their classes, and their files; numpy and numba only.

What needs torch is in `torch_modules` and what needs onnx in `onnx_export`, imported by name.
"""

from baselines.policies.folder import is_policy, load_trained, save_trained
from baselines.policies.gated import GatedPolicy
from baselines.policies.history import History
from baselines.policies.linear import LinearPolicy
from baselines.policies.network import NetworkPolicy
from baselines.policies.policy import HistoryPolicy
from baselines.policies.recurrent import RecurrentPolicy

__all__ = [
    "GatedPolicy",
    "History",
    "HistoryPolicy",
    "LinearPolicy",
    "NetworkPolicy",
    "RecurrentPolicy",
    "is_policy",
    "load_trained",
    "save_trained",
]
