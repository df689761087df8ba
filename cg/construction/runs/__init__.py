"""Long runs, with a store for their results."""

from cg.construction.runs.database import StoreError
from cg.construction.runs.entries import Failure, RunSummary, StoredStart
from cg.construction.runs.long_run import LongRun, RunOptions, stored_run
from cg.construction.runs.one_run import StoredRun
from cg.construction.runs.progress import ProgressLine, Score
from cg.construction.runs.store import Store

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
