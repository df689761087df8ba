"""Independent pieces of work on any `concurrent.futures.Executor`, by default on threads.

Threads of this process suffice for what is compiled, since that releases the interpreter lock.
Pools of processes, MPI's, loky's and Dask's executors take the same work.
"""

from __future__ import annotations

import logging
import pickle
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from contextlib import contextmanager
from functools import partial
from itertools import islice
from multiprocessing import get_context
from typing import Any, TypeVar

from cg.support.checks import check_integer
from cg.support.parallel import (
    available_cores,
    end_with,
    interrupts_blocked,
    new_flag,
    single_threads,
    work_for,
)

Item = TypeVar("Item")
Result = TypeVar("Result")

ExecutorLike = Executor | str | None
"""None for threads, ``"processes"``, or an executor."""

_AHEAD = 2  # pieces handed out for each worker, so that none waits for this process

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
    work: Callable[[Item], Result],
    items: Iterable[Item],
    executor: ExecutorLike = None,
    workers: int | None = None,
    *,
    finish: bool = False,
) -> Generator[tuple[Item, Result], None, None]:
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
    if executor is not None and not isinstance(executor, str):
        try:
            yield executor
        finally:
            _cancel(pending)
        return
    if executor is None:
        stop_flag = new_flag()
        with ThreadPoolExecutor(size, initializer=work_for, initargs=(stop_flag,)) as pool:
            try:
                yield pool
            finally:
                stop_flag[0] = 1
                _cancel(pending)
        return
    spawn = get_context("spawn")  # a fork of a process with threads may hang
    theirs, ours = spawn.Pipe(duplex=False)
    with (
        theirs,
        ours,
        ProcessPoolExecutor(size, spawn, initializer=end_with, initargs=(theirs,)) as workers,
    ):
        try:
            yield workers
        finally:
            _cancel(pending)
            if pending:  # pieces that nobody waits for
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
    """Run a piece in another process, for which one that sends another error counts as dead."""
    try:
        with single_threads():
            return work(item)
    except Exception as error:
        if _travels(error):
            raise
        kind = type(error)
        raise RuntimeError(f"{kind.__module__}.{kind.__qualname__}: {error}") from error


def _travels(error: Exception) -> bool:
    try:
        return type(pickle.loads(pickle.dumps(error))) is type(error)
    except Exception:  # any error of the exception's own class
        return False
