"""What exceptions of executors say: a worker that died, work that was lost."""

from __future__ import annotations

from concurrent.futures import BrokenExecutor, CancelledError

__all__ = ["broken_executor", "dropped", "worker_died"]


def worker_died(error: Exception) -> bool:
    """Return whether an exception says that a process ended, not that a piece of work failed."""
    of_dask = type(error).__name__ == "KilledWorker" and type(error).__module__.startswith(
        "distributed"
    )
    return isinstance(error, BrokenExecutor) or of_dask


def dropped(error: Exception) -> bool:
    """Return whether an exception says that an executor lost work which it had taken."""
    of_dask = type(error).__module__.partition(".")[0] == "distributed"
    return isinstance(error, CancelledError) or (of_dask and not worker_died(error))


def broken_executor(reason: Exception, pieces: list[int]) -> BrokenExecutor:
    """Return the error of an executor that takes no more work and can't be made anew."""
    if not dropped(reason):
        kind = type(reason) if isinstance(reason, BrokenExecutor) else BrokenExecutor
        return kind(
            f"a worker died while pieces {pieces} were at work; if `executor` is a function "
            "that makes an executor, the run goes on without the one that ends its worker"
        )
    return BrokenExecutor(
        f"the executor lost pieces {pieces} that were at work ({type(reason).__name__}): its "
        "scheduler has ended, or can't be reached any more; if `executor` is a function that "
        "makes an executor, the run goes on with a new one"
    )
