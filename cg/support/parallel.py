"""Compiled calls that can be interrupted, and single-threaded linear algebra.

Python runs signal handlers between bytecodes of the main thread only, so that an interrupt would
wait until a compiled call in the main thread returns, and the end of a pool would wait for those in
its workers. Long calls therefore go through `stoppable`: they read a flag, and return soon after it
is set.
"""

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from functools import lru_cache
from multiprocessing.connection import Connection
from typing import Any, TypeVar

import numpy as np
import threadpoolctl
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from cg.support.capsules import provide_lapack
from cg.support.forks import at_forks

Result = TypeVar("Result")

StopFlag = NDArray[np.intc]
"""Flag of shape (1,); compiled calls that read it return soon after it is not zero."""


class Stopped(BaseException):
    """Raised in a worker whose pool has ended; its result is discarded."""


class _Worker(threading.local):
    stop_flag: StopFlag | None = None  # flag of this thread's pool


_worker = _Worker()


def available_cores() -> int:
    """Return the number of cores that this process may use, or of all cores if unknown."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@lru_cache(maxsize=1)
def _libraries(modules: int) -> list[Any]:
    """Return the libraries of linear algebra, searched for again when other modules are there.

    To find them takes as long as a short integration.
    """
    return list(ThreadpoolController().lib_controllers)


class _Limit:
    """The limit of one thread of linear algebra, set by its first and lifted by its last user."""

    lock = threading.RLock()

    def __init__(self) -> None:
        self.users = 0
        self._before: list[tuple[Any, int]] = []  # libraries and their previous numbers of threads

    def begin(self) -> None:
        with self.lock:
            if not self.users:
                provide_lapack()  # a library that is loaded later would have all threads
                _take_control()
                counts = [(one, one.num_threads or 1) for one in _libraries(len(sys.modules))]
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
        """Restore the previous numbers of threads, unless other code has changed them."""
        _take_control()
        for library, threads in self._before:
            if library.num_threads == 1:
                library.set_num_threads(threads)
        self._before = []
        _take_control()


_limit = _Limit()


@contextmanager
def single_threads() -> Iterator[None]:
    """Limit linear algebra to one thread, so that results don't depend on the number of threads.

    The limit holds for the whole process; the first user sets it, and the last one lifts it, unless
    other code has changed it in the meantime.
    """
    limit = _limit  # a forked child replaces the global one
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
    """Let any thread set the next limit; newer threadpoolctl allows only one thread to do so."""
    release = getattr(threadpoolctl.OpenBLASController, "clear_controlling_thread", None)
    if release is not None:
        release(force=True)


def stoppable(call: Callable[[StopFlag], Result], *, brief: bool = False) -> Result:
    """Return ``call(flag)`` for a compiled call that reads the flag and releases the GIL.

    In a worker of `cg.support.executors`, `Stopped` is raised if its pool has ended. In the main
    thread the call runs in a new thread, so that an interrupt takes effect at once, but not with
    `brief`: a new thread may take a millisecond on a busy machine.
    """
    if _worker.stop_flag is not None:
        result = call(_worker.stop_flag)
        raise_if_stopped()
        return result
    stop_flag = new_flag()
    if brief or threading.current_thread() is not threading.main_thread():
        return call(stop_flag)
    future: Future[Result] = Future()

    def call_and_keep() -> None:
        try:
            future.set_result(call(stop_flag))
        except BaseException as error:
            future.set_exception(error)

    try:
        threading.Thread(target=call_and_keep, name="stoppable").start()
        return future.result()
    finally:
        stop_flag[0] = 1


def raise_if_stopped() -> None:
    """Raise `Stopped` in a worker of `cg.support.executors.completed` whose pool has ended."""
    if _worker.stop_flag is not None and _worker.stop_flag[0]:
        raise Stopped


def new_flag() -> StopFlag:
    """Return a new flag that isn't set."""
    return np.zeros(1, dtype=np.intc)


def work_for(stop_flag: StopFlag) -> None:
    """Make the current thread a worker of the pool with a flag."""
    _worker.stop_flag = stop_flag


def end_with(connection: Connection) -> None:
    """End this process when the other end of a connection closes, also if its owner was killed.

    Interrupts, which a terminal sends to all processes, are its owner's: one that came while a
    result is sent would leave a lock behind, for which all others wait.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def wait() -> None:
        with suppress(EOFError, OSError):
            connection.recv()
        os._exit(1)

    threading.Thread(target=wait, name="end_with", daemon=True).start()


@contextmanager
def interrupts_blocked(block: bool) -> Iterator[None]:
    """Let interrupts wait; processes that are started meanwhile never see any."""
    if not block or not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
