"""Long runs: on any executor, with a store for what they find."""

from __future__ import annotations

from .execution import ExecutorLike, Finished, as_finished, check_executor, completed
from .records import Failure, Record, RunSummary
from .store import Store, StoredRun

__all__ = [
    "ExecutorLike",
    "Failure",
    "Finished",
    "Record",
    "RunSummary",
    "Store",
    "StoredRun",
    "as_finished",
    "check_executor",
    "completed",
]
