"""Compiled calls that can be interrupted, and independent work on executors, with a progress bar.

Python runs signal handlers between bytecodes of the main thread only, so that an interrupt would
wait until a compiled call in the main thread returns, and the end of a pool would wait for those in
its workers. Long calls therefore go through `stoppable`: they read a flag, and return soon after it
is set.

Independent pieces of work run on any `concurrent.futures.Executor`. Threads of this process, the
default, suffice for what is compiled, since that releases the interpreter lock. Pools of processes,
MPI's, loky's and Dask's executors take the same work.
"""

from __future__ import annotations

import logging
import os
import pickle
import signal
import sys
import threading
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from contextlib import ExitStack, contextmanager, suppress
from functools import cached_property, lru_cache, partial
from importlib.util import find_spec
from itertools import islice
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any, TextIO, TypeVar

import numpy as np
import threadpoolctl
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from cg.support.capsules import provide_lapack
from cg.support.checks import check_integer


def in_children(call: Callable[[], object]) -> None:
    """Register a function to be called in each process forked from this one."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=call)


def _free_properties() -> None:
    """Replace the locks of all cached properties of the package."""
    modules = [module for name, module in sys.modules.items() if name.partition(".")[0] == "cg"]
    kinds = [kind for module in modules for kind in vars(module).values() if isinstance(kind, type)]
    for member in [member for kind in kinds for member in vars(kind).values()]:
        if isinstance(member, cached_property):
            member.lock = threading.RLock()  # type: ignore[attr-defined]


if sys.version_info < (3, 12):
    in_children(_free_properties)


_AHEAD = 2  # pieces handed out for each worker, so that none waits for this process
_LOG_SECONDS = 30.0  # time between lines of a bar in a file

Result = TypeVar("Result")
Item = TypeVar("Item")

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
    """Return the libraries of linear algebra; a new number of loaded modules starts a new search.

    To find them takes as long as a short integration.
    """
    return list(ThreadpoolController().lib_controllers)


class _Limit:
    """The limit of one thread of linear algebra, set by its first and lifted by its last user."""

    def __init__(self) -> None:
        self.lock = threading.RLock()  # a signal handler may take it again
        self.users = 0
        self._before: list[tuple[Any, int]] = []  # libraries and their previous numbers of threads

    def begin(self) -> None:
        with self.lock:
            if not self.users:
                provide_lapack()  # a library that is loaded later would have all threads
                _take_control()
                libraries = _libraries(len(sys.modules))
                counts = [(library, library.num_threads or 1) for library in libraries]
                self._before = [count for count in counts if count[1] > 1]
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
    _limit.lock = threading.RLock()  # a thread that the child lacks may hold the old one
    _limit.lift()
    _limit = _Limit()


def _hold() -> None:
    """Take the lock before forks: a child can't take a library's lock that another thread holds."""
    _limit.lock.acquire()


def _release() -> None:
    _limit.lock.release()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_hold, after_in_parent=_release, after_in_child=_lift_in_child)


def _take_control() -> None:
    """Let any thread set the next limit; newer threadpoolctl allows only one thread to do so."""
    release = getattr(threadpoolctl.OpenBLASController, "clear_controlling_thread", None)
    if release is not None:
        release(force=True)


def stoppable(call: Callable[[StopFlag], Result], *, brief: bool = False) -> Result:
    """Return ``call(flag)`` for a compiled call that reads the flag and releases the GIL.

    In a worker of `cg.support.parallel`, `Stopped` is raised if its pool has ended. In the main
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
    """Raise `Stopped` in a worker of `cg.support.parallel.completed` whose pool has ended."""
    if _worker.stop_flag is not None and _worker.stop_flag[0]:
        raise Stopped


def new_flag() -> StopFlag:
    """Return a new flag that isn't set."""
    return np.zeros(1, dtype=np.intc)


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


ExecutorLike = Executor | str | None
"""None for threads, ``"processes"``, or an executor."""

_log = logging.getLogger("cg")


def check_executor(executor: Any, workers: int | None) -> tuple[ExecutorLike, int | None]:
    """Return the arguments `executor` and `workers` after checking them."""
    if workers is not None:
        workers = check_integer("workers", workers, 1)
    if executor not in (None, "processes"):
        if isinstance(executor, str):
            raise ValueError(f"executor must be 'processes' or an executor, got {executor!r}")
        if isinstance(executor, type) or not callable(getattr(executor, "submit", None)):
            raise TypeError(
                f"executor must be a concurrent.futures.Executor or 'processes', got {executor!r}"
            )
    return executor, workers


def count_workers(executor: ExecutorLike, workers: int | None) -> int:
    """Return the number of workers, of an executor from the attributes in which it is stored."""
    if workers is not None:
        return workers
    for name in ("_max_workers", "num_workers"):
        number = getattr(executor, name, None)
        if isinstance(number, int) and number > 0:
            return number
    client = getattr(executor, "_client", None)  # Dask's client
    return available_cores() if client is None else max(1, int(sum(client.ncores().values())))


def completed(
    work: Callable[[Item], Result], items: Iterable[Item], executor: ExecutorLike = None,
    workers: int | None = None, *, finish: bool = False,
) -> Generator[tuple[Item, Result], None, None]:  # fmt: skip
    """Yield each item with ``work(item)``, in the order in which they finish.

    `work` and items must be picklable for executors other than threads. With `finish`, running
    pieces finish after the first interrupt or error, before it is raised. An executor that the
    caller passes isn't shut down.
    """
    size = count_workers(executor, workers)
    call = work if executor is None else partial(_with_picklable_errors, work)
    queue, pending = iter(items), dict[Future[Result], Item]()
    ending: BaseException | None = None
    with single_threads(), _pool(executor, size, pending) as pool:
        while True:
            try:
                if ending is None:
                    for item in islice(queue, _AHEAD * size - len(pending)):
                        pending[_submit(executor, pool, call, item)] = item
                if not pending:
                    break
                done = wait(pending, return_when=FIRST_COMPLETED).done
            except KeyboardInterrupt as interrupt:
                if not finish or ending is not None:
                    raise
                ending = interrupt
                _cancel(pending)
                _log.warning(
                    "interrupted: finishing %d pieces; interrupt again to discard them",
                    len(pending),
                )
                continue
            for future in [each for each in pending if each in done]:  # oldest first
                item, error = pending.pop(future), future.exception()
                if error is None:
                    yield item, future.result()
                elif not finish:
                    raise error
                elif ending is None:
                    ending = error
                    _cancel(pending)
    if ending is not None:
        raise ending


@contextmanager
def _pool(
    executor: ExecutorLike, size: int, pending: dict[Future[Result], Item]
) -> Iterator[Executor]:
    """Yield the pool; at the end cancel what is pending, and stop workers of a pool made here."""
    stop_flag = new_flag()
    with ExitStack() as stack:
        if executor is None:
            flag = _worker, "stop_flag", stop_flag
            pool: Any = ThreadPoolExecutor(size, initializer=setattr, initargs=flag)
            stack.enter_context(pool)
        elif isinstance(executor, str):
            spawn = get_context("spawn")  # a fork of a process with threads may hang
            theirs, ours = map(stack.enter_context, spawn.Pipe(duplex=False))
            pool = ProcessPoolExecutor(size, spawn, initializer=end_with, initargs=(theirs,))
            stack.enter_context(pool)
        else:
            pool = executor
        try:
            yield pool
        finally:
            stop_flag[0] = 1
            _cancel(pending)
            if pending and executor == "processes":  # pieces that nobody waits for
                ours.close()


def _cancel(pending: dict[Future[Result], Item]) -> None:
    """Cancel pieces that no worker has begun, and forget them."""
    for future in list(pending):
        if future.cancel():
            del pending[future]


def _submit(
    executor: ExecutorLike, pool: Executor, call: Callable[[Item], Result], item: Item
) -> Future[Result]:
    """Submit a piece; what a broken executor raises is the error of the piece."""
    try:
        with interrupts_blocked(executor == "processes"):
            return pool.submit(call, item)
    except Exception as error:
        future: Future[Result] = Future()
        future.set_exception(error)
        return future


def _with_picklable_errors(work: Callable[[Item], Result], item: Item) -> Result:
    """Run a piece in another process; an error that can't be pickled becomes a RuntimeError."""
    try:
        with single_threads():
            return work(item)
    except Exception as error:
        if _is_picklable(error):  # a process that sends another counts as dead
            raise
        kind = type(error)
        raise RuntimeError(f"{kind.__module__}.{kind.__qualname__}: {error}") from error


def _is_picklable(error: Exception) -> bool:
    try:
        return type(pickle.loads(pickle.dumps(error))) is type(error)
    except Exception:  # any error of the exception's own class
        return False


def has_bars() -> bool:
    """Return whether tqdm is installed."""
    return find_spec("tqdm") is not None


def make_bar(file: TextIO | None = None, **options: Any) -> Any:
    """Return a bar of tqdm on a stream, by default standard error; `options` are those of tqdm."""
    try:
        from tqdm import tqdm
    except ImportError as error:
        raise ImportError("a progress bar needs tqdm: python -m pip install tqdm") from error
    file = file or sys.stderr
    seconds = 0.1 if file.isatty() else _LOG_SECONDS
    return tqdm(file=file, dynamic_ncols=True, mininterval=seconds, **options)
