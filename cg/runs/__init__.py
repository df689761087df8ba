"""Long runs, with a store for their results."""

from cg.runs.database import StoreError
from cg.runs.long_run import LongRun, RunOptions, stored_run
from cg.runs.one_run import StoredRun
from cg.runs.progress import ProgressLine, Score
from cg.runs.records import Failure, Record, RunSummary
from cg.runs.store import Store

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
