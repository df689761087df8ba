"""Exceptions of executors: workers that died, work that was lost, errors that can't be pickled."""

import pickle
from concurrent.futures import BrokenExecutor, CancelledError


def worker_died(error: Exception) -> bool:
    """Return whether an exception means that a worker process ended."""
    kind = type(error)
    of_dask = kind.__name__ == "KilledWorker" and kind.__module__.startswith("distributed")
    return isinstance(error, BrokenExecutor) or of_dask


def work_was_lost(error: Exception) -> bool:
    """Return whether an exception means that an executor lost work that it had accepted."""
    of_dask = type(error).__module__.partition(".")[0] == "distributed"
    return isinstance(error, CancelledError) or (of_dask and not worker_died(error))


def broken_executor(reason: Exception, pieces: list[int]) -> BrokenExecutor:
    """Return the error for an executor that can't be replaced."""
    if not work_was_lost(reason):
        kind = type(reason) if isinstance(reason, BrokenExecutor) else BrokenExecutor
        return kind(
            f"a worker died while pieces {pieces} were running; if `executor` is a function that "
            "makes an executor, work continues without the piece that kills its worker"
        )
    return BrokenExecutor(
        f"the executor lost pieces {pieces} that were running ({type(reason).__name__}): its "
        "scheduler has ended, or can't be reached any more; if `executor` is a function that "
        "makes an executor, work continues with a new one"
    )


def picklable(error: Exception) -> Exception:
    """Return an error, or a RuntimeError with its name and message if it can't be unpickled."""
    try:
        if type(pickle.loads(pickle.dumps(error))) is type(error):
            return error
    except Exception:  # any error of the exception's own class
        pass
    return RuntimeError(f"{type(error).__module__}.{type(error).__qualname__}: {error}")
