"""Work in worker processes that may fail, hang, eat memory or die at their own cost."""

from eval.workers.outcome import InlinePool, Limits, Outcome, Pool, Status
from eval.workers.pool import LocalPool
from eval.workers.ray_pool import RayPool

__all__ = ["InlinePool", "Limits", "LocalPool", "Outcome", "Pool", "RayPool", "Status"]
