"""Independent pieces of work on all cores, in threads, since the compiled core frees the lock.

Python's signal handlers run between bytecodes of the main thread only, so that an interrupt
would wait for a compiled call there, and the end of a pool for those in its workers. Calls
that may take long therefore go through `stoppable`: they watch a flag, and return soon after
it is set.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from typing import Any, TypeVar

import numpy as np
import threadpoolctl
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

__all__ = [
    "Stopped",
    "as_finished",
    "available_cores",
    "raise_if_stopped",
    "single_threads",
    "stoppable",
]

Result = TypeVar("Result")

StopFlag = NDArray[np.intc]
"""Shape (1,); not zero once the calls that watch it are to end."""


class Stopped(BaseException):
    """The run to which a piece of work belongs has ended; what the work came to is void."""


class _Worker(threading.local):
    stop_flag: StopFlag | None = None  # of the run that the thread works for


_worker = _Worker()


def available_cores() -> int:
    """Return the number of cores that this process may use; of all where that isn't told."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


_limit_lock = threading.Lock()
_limited: dict[str, Any] = {"users": 0, "limits": None}


@contextmanager
def single_threads() -> Iterator[None]:
    """Keep linear algebra to one thread each, so that results don't depend on their number.

    The limit is one for the whole process: the first user sets it, the last one lifts it.
    """
    with _limit_lock:
        if not _limited["users"]:
            _take_control()
            _limited["limits"] = threadpool_limits(1)
        _limited["users"] += 1
    try:
        yield
    finally:
        with _limit_lock:
            _limited["users"] -= 1
            if not _limited["users"]:
                _take_control()
                _limited["limits"].restore_original_limits()
                _take_control()


def _take_control() -> None:
    """Let any thread set the limit next: newer threadpoolctl ignores all but one thread."""
    release = getattr(threadpoolctl.OpenBLASController, "clear_controlling_thread", None)
    if release is not None:
        release(force=True)


def as_finished(
    work: Callable[[int], Result], indices: Iterable[int], workers: int
) -> Generator[Result, None, None]:
    """Yield ``work(index)`` for each index, in the order in which they finish.

    Only few are queued at a time. An interrupt, an exception or a closed generator ends what
    is running within one step of its solver, and its results are dropped.
    """
    stop_flag = _new_flag()
    # one piece a core: threads inside the linear algebra would only be in each other's way
    with (
        single_threads(),
        ThreadPoolExecutor(workers, initializer=_work_for, initargs=(stop_flag,)) as pool,
    ):
        pending: dict[Future[Result], None] = {}  # in the order of submission
        try:
            for index in indices:
                pending[pool.submit(work, index)] = None
                if len(pending) == 2 * workers:
                    yield from _collect(pending)
            while pending:
                yield from _collect(pending)
        finally:
            stop_flag[0] = 1
            pool.shutdown(wait=True, cancel_futures=True)


def stoppable(call: Callable[[StopFlag], Result], *, brief: bool = False) -> Result:
    """Return ``call(flag)`` of a compiled call that watches the flag and frees the lock.

    In a worker of `as_finished` the flag is that of its run. In the main thread the call goes
    to a thread of its own, so that an interrupt is noticed at once; not if it is `brief`, since
    on a busy machine the detour takes a millisecond. An interrupt can't reach other threads.

    Raises
    ------
    Stopped
        In a worker whose run has ended: the call may have been cut short.
    """
    if _worker.stop_flag is not None:
        result = call(_worker.stop_flag)
        raise_if_stopped()
        return result
    stop_flag = _new_flag()
    if brief or threading.current_thread() is not threading.main_thread():
        return call(stop_flag)
    outcome: Future[Result] = Future()

    def run() -> None:
        try:
            outcome.set_result(call(stop_flag))
        except BaseException as error:
            outcome.set_exception(error)

    try:
        threading.Thread(target=run, name="stoppable").start()
        return outcome.result()
    finally:
        stop_flag[0] = 1


def raise_if_stopped() -> None:
    """Raise `Stopped` in a worker of `as_finished` whose run has ended."""
    if _worker.stop_flag is not None and _worker.stop_flag[0]:
        raise Stopped


def _new_flag() -> StopFlag:
    return np.zeros(1, dtype=np.intc)


def _work_for(stop_flag: StopFlag) -> None:
    _worker.stop_flag = stop_flag


def _collect(pending: dict[Future[Result], None]) -> Iterator[Result]:
    """Wait for at least one and yield what is finished; one worker thus keeps the order."""
    done, _ = wait(pending, return_when=FIRST_COMPLETED)
    finished = [future for future in pending if future in done]
    for future in finished:
        del pending[future]
    # one by one: a failure must not take the results before it along
    yield from (future.result() for future in finished)
