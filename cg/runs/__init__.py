"""Long runs, with a store for their results."""

from cg.runs.database import StoreError
from cg.runs.entries import Failure, RunSummary, StoredStart
from cg.runs.long_run import LongRun, RunOptions, stored_run
from cg.runs.one_run import StoredRun
from cg.runs.progress import ProgressLine, Score
from cg.runs.store import Store

__all__ = [
    "Failure",
    "LongRun",
    "ProgressLine",
    "RunOptions",
    "RunSummary",
    "Score",
    "Store",
    "StoreError",
    "StoredRun",
    "StoredStart",
    "stored_run",
]
