"""Long runs: on any executor, with a store for what they find."""

from __future__ import annotations

from .database import StoreError
from .execution import ExecutorLike, Finished, as_finished, check_executor, completed
from .one_run import StoredRun
from .progress import ProgressLine, Tally, check_progress
from .records import Failure, Record, RunSummary
from .resuming import stored_run
from .store import Store

__all__ = [
    "ExecutorLike",
    "Failure",
    "Finished",
    "ProgressLine",
    "Record",
    "RunSummary",
    "Store",
    "StoreError",
    "StoredRun",
    "Tally",
    "as_finished",
    "check_executor",
    "check_progress",
    "completed",
    "stored_run",
]
