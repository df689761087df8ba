"""Compiled calls that can be stopped, and one thread of linear algebra for each piece of work.

Python's signal handlers run between bytecodes of the main thread only, so that an interrupt
would wait for a compiled call there, and the end of a pool for those in its workers. Calls
that may take long therefore go through `stoppable`: they watch a flag, and return soon after
it is set.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from typing import Any, TypeVar

import numpy as np
import threadpoolctl
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from .forks import at_forks

__all__ = [
    "Stopped",
    "available_cores",
    "end_with_parent",
    "new_flag",
    "raise_if_stopped",
    "single_threads",
    "stoppable",
    "work_for",
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


class _Limit:
    """The limit of one thread: set by the first user in a process, lifted by the last one."""

    lock = threading.RLock()

    def __init__(self) -> None:
        self.users = 0
        self._before: list[tuple[Any, int]] = []  # libraries, numbers of their threads

    def begin(self) -> None:
        with self.lock:
            if not self.users:
                _take_control()
                libraries = ThreadpoolController().lib_controllers
                counts = [(one, one.num_threads or 1) for one in libraries]
                self._before = [(one, threads) for one, threads in counts if threads > 1]
                for library, _ in self._before:
                    library.set_num_threads(1)
            self.users += 1

    def end(self) -> None:
        with self.lock:
            self.users -= 1
            if not self.users:
                self.lift()

    def lift(self) -> None:
        """Set the numbers that were there before, except where someone else has set another."""
        _take_control()
        for library, threads in self._before:
            if library.num_threads == 1:
                library.set_num_threads(threads)
        self._before = []
        _take_control()


_limit = _Limit()


@contextmanager
def single_threads() -> Iterator[None]:
    """Keep linear algebra to one thread each, so that results don't depend on their number.

    The limit is one for the whole process: the first user sets it, the last one lifts it. A limit
    that someone else sets meanwhile holds instead, and isn't touched. In a forked child it is
    lifted.
    """
    limit = _limit  # a child of a fork has another
    limit.begin()
    try:
        yield
    finally:
        limit.end()


def _lift_in_child() -> None:
    global _limit  # noqa: PLW0603
    if _limit.users:
        _limit.lift()
    _limit = _Limit()


at_forks(_Limit.lock, _lift_in_child)


def _take_control() -> None:
    """Let any thread set the limit next: newer threadpoolctl ignores all but one thread."""
    release = getattr(threadpoolctl.OpenBLASController, "clear_controlling_thread", None)
    if release is not None:
        release(force=True)


def stoppable(call: Callable[[StopFlag], Result], *, brief: bool = False) -> Result:
    """Return ``call(flag)`` of a compiled call that watches the flag and frees the lock.

    In a worker of `cg.runs.completed` the flag is that of its run. In the main thread the call
    goes to a thread of its own, so that an interrupt is noticed at once; not if it is `brief`,
    since on a busy machine the detour takes a millisecond. An interrupt can't reach other threads.

    Raises
    ------
    Stopped
        In a worker whose run has ended: the call may have been cut short.
    """
    if _worker.stop_flag is not None:
        result = call(_worker.stop_flag)
        raise_if_stopped()
        return result
    stop_flag = new_flag()
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
    """Raise `Stopped` in a worker of `cg.runs.completed` whose run has ended."""
    if _worker.stop_flag is not None and _worker.stop_flag[0]:
        raise Stopped


def new_flag() -> StopFlag:
    """Return the flag of a run that has begun."""
    return np.zeros(1, dtype=np.intc)


def work_for(stop_flag: StopFlag) -> None:
    """Make the current thread a worker of the run with this flag."""
    _worker.stop_flag = stop_flag


def end_with_parent() -> None:
    """End this process when the one that started it has ended, even if that was killed.

    Workers of a pool would wait for work for ever.
    """
    from multiprocessing import parent_process

    parent = parent_process()
    if parent is None:
        return

    def wait() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=wait, name="end_with_parent", daemon=True).start()
