"""Work in worker processes that may fail, hang, eat memory or die at their own cost."""

from eval.workers.outcome import InlinePool, Limits, Outcome, Pool, Status
from eval.workers.pool import LocalPool

__all__ = ["InlinePool", "Limits", "LocalPool", "Outcome", "Pool", "Status"]
