"""Long runs, with a store for their results."""

from __future__ import annotations

from .database import StoreError
from .long_run import LongRun, RunOptions, stored_run
from .one_run import StoredRun
from .progress import ProgressLine, Score
from .records import Failure, Record, RunSummary
from .store import Store

__all__ = [
    "Failure",
    "LongRun",
    "ProgressLine",
    "Record",
    "RunOptions",
    "RunSummary",
    "Score",
    "Store",
    "StoreError",
    "StoredRun",
    "stored_run",
]
