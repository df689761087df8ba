"""Independent pieces of work on any executor, in chunks of about equal duration.

The default executor is threads of this process, since the compiled core releases the interpreter
lock. Processes, Dask, MPI, loky and other executors with the interface of
`concurrent.futures.Executor` take the same work.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from dataclasses import dataclass, field
from functools import partial
from itertools import chain
from multiprocessing import get_context
from typing import Any, Generic, TypeVar

from cg.executors.chunks import Chunks, even_size
from cg.executors.worker_errors import broken_executor, picklable, work_was_lost, worker_died
from cg.support.checks import check_integer
from cg.support.parallel import available_cores, end_with_parent, new_flag, single_threads, work_for

Result = TypeVar("Result")

ExecutorLike = Executor | Callable[[], Executor] | str | None
"""None or ``"threads"``, ``"processes"``, an executor, or a function that makes one."""

_CHUNKS_PER_WORKER = 2  # handed out in advance, so that no worker waits for this process
_ATTEMPTS = 2  # of a piece that runs alone: its worker may have been killed from outside

_log = logging.getLogger("cg")


@dataclass(frozen=True)
class Finished(Generic[Result]):
    """A piece of work that has finished, or whose worker died; of a whole chunk the first index."""

    index: int
    result: Result | None  # None if the worker died
    seconds: float = 0.0
    failure: str | None = None  # why it died
    chunk: list[int] = field(default_factory=list)  # all its indices


def check_executor(executor: Any, workers: int | None) -> tuple[ExecutorLike, int | None]:
    """Return the arguments `executor` and `workers` after checking them."""
    if workers is not None:
        workers = check_integer("workers", workers, 1)
    if isinstance(executor, str) and executor not in ("threads", "processes"):
        raise ValueError(
            f"executor must be 'threads', 'processes' or an executor, got {executor!r}"
        )
    if executor is not None and not isinstance(executor, str):
        if isinstance(executor, type):
            raise TypeError(
                f"executor must be an executor, got the class {executor.__name__}; call it"
            )
        if not callable(getattr(executor, "submit", None)) and not callable(executor):
            raise TypeError(
                "executor must be a concurrent.futures.Executor, a function that makes one, "
                f"'threads' or 'processes', got {executor!r}"
            )
    return executor, workers


def completed(
    work: Callable[[Any], Result],
    indices: Iterable[int],
    total: int,
    workers: int | None = None,
    executor: ExecutorLike = None,
    *,
    finish_on_interrupt: bool = False,
    data: Callable[[list[int]], Any] | None = None,
    largest: int | None = None,
) -> Generator[Finished[Result], None, None]:
    """Yield ``work(index)`` for each of `total` indices, in the order in which they finish.

    `work` must be picklable for executors other than threads. With `data` it takes whole chunks,
    ``work(data(indices))``. With `largest` chunks have one size, at most this, which doesn't depend
    on measured time. With `finish_on_interrupt`, running pieces finish after the first
    interrupt, before KeyboardInterrupt is raised.

    If `executor` is a function, or ``"processes"``, a new executor is made when a worker died. The
    pieces that were running are then run one by one, and those whose worker dies again are yielded
    with a failure. An executor that the caller passes isn't shut down, and BrokenExecutor is raised
    if it breaks.
    """
    pool = _Pool(executor, workers, data)
    size = 1 if pool.threads and data is None else None
    if largest is not None:
        size = even_size(total, pool.workers, largest)
    queue = Chunks(indices, total, pool.workers, size)
    with single_threads(), pool:
        yield from _loop(work, pool, queue, finish_on_interrupt)


def _loop(
    work: Callable[[Any], Result], pool: _Pool, queue: Chunks, finish_on_interrupt: bool
) -> Iterator[Finished[Result]]:
    interrupted: KeyboardInterrupt | None = None
    while True:
        try:
            if interrupted is None:
                pool.fill(work, queue)
            if not pool.pending:
                break
            done = pool.wait()
        except KeyboardInterrupt as interrupt:
            if not finish_on_interrupt or interrupted is not None:
                raise
            interrupted = interrupt
            running = pool.cancel_waiting()
            _log.warning(
                "interrupted: finishing %d pieces; interrupt again to discard them", running
            )
        else:
            yield from _results_of(done, pool, work, queue)
    if interrupted is not None:
        raise interrupted


def _results_of(
    done: list[Future[Any]], pool: _Pool, work: Callable[[Any], Result], queue: Chunks
) -> Iterator[Finished[Result]]:
    """Yield the results of finished chunks; run those again whose worker died."""
    suspects: list[int] = []
    for future in done:
        chunk = pool.pending.pop(future)
        results, error, died = _outcome(future.result)
        if died is not None:
            suspects += chunk
            reason = died
        for finished in results:
            queue.learn(max(1, len(finished.chunk)), finished.seconds)
        yield from results
        if error is not None:
            raise error
    if suspects:
        yield from _one_by_one(pool, work, suspects, reason)


def _outcome(
    result: Callable[[], tuple[list[Finished[Any]], Exception | None]],
) -> tuple[list[Finished[Any]], Exception | None, Exception | None]:
    """Return the results of a chunk, the exception of the work, and that of a lost worker."""
    try:
        return *result(), None
    except Exception as died:
        if not worker_died(died) and not work_was_lost(died):
            raise
        return [], None, died


def as_finished(
    work: Callable[[int], Result], indices: Iterable[int], workers: int
) -> Generator[Result, None, None]:
    """Yield ``work(index)`` for each index from threads, in the order in which they finish."""
    numbers = list(indices)
    for finished in completed(work, numbers, len(numbers), workers):
        yield finished.result  # type: ignore[misc]  # threads have no failures


def _run_chunk(
    work: Callable[[int], Result], chunk: list[int]
) -> tuple[list[Finished[Result]], Exception | None]:
    """Run some pieces; return the results before the first exception, and the exception."""
    results: list[Finished[Result]] = []
    for index in chunk:
        began = time.perf_counter()
        try:
            result = work(index)
        except Exception as error:
            return results, error
        results.append(Finished(index, result, time.perf_counter() - began))
    return results, None


def _run_whole(
    work: Callable[[Any], Result], chunk: list[int], data: Any
) -> tuple[list[Finished[Result]], None]:
    """Run a chunk that is one piece of work."""
    began = time.perf_counter()
    result = work(data)
    seconds = (time.perf_counter() - began) / len(chunk)
    return [Finished(chunk[0], result, seconds, chunk=chunk)], None


def _run_elsewhere(
    task: Callable[..., tuple[list[Finished[Any]], Exception | None]], *arguments: Any
) -> tuple[list[Finished[Any]], Exception | None]:
    """Run a chunk in another process, which sends exceptions by pickle."""
    try:
        results, error = task(*arguments)
    except Exception as reason:
        raise picklable(reason) from reason
    return results, None if error is None else picklable(error)


def _one_by_one(
    pool: _Pool, work: Callable[[int], Result], suspects: list[int], reason: Exception
) -> Iterator[Finished[Result]]:
    """Run pieces one at a time, to find those that kill their worker."""
    if pool.broken(reason):
        suspects = sorted({*suspects, *chain(*pool.pending.values())})
        pool.pending.clear()
        if not pool.renew():
            raise broken_executor(reason, suspects) from reason
    for index in suspects:
        for _ in range(_ATTEMPTS):
            results, error, died = _outcome(
                lambda index=index: pool.hand_out(work, [index]).result()  # type: ignore[misc]
            )
            if died is None:
                break
            if pool.broken(died) and not pool.renew():
                raise broken_executor(died, [index]) from died
            message = f"{type(died).__name__}: {died}"
            results = [Finished(index, None, failure=message, chunk=[index])]
        yield from results
        if error is not None:
            raise error


class _Pool:
    """An executor with its pending chunks, and a function that makes a new one."""

    def __init__(
        self, executor: ExecutorLike, workers: int | None, data: Callable[[list[int]], Any] | None
    ) -> None:
        self.data = data
        self.pending: dict[Future[Any], list[int]] = {}  # in the order of submission
        self._stop_flag = new_flag()
        self.threads = executor is None or executor == "threads"
        self._make: Callable[[], Executor] | None = None
        if self.threads:
            workers = workers or available_cores()
            self._make = partial(
                ThreadPoolExecutor, workers, initializer=work_for, initargs=(self._stop_flag,)
            )
        elif executor == "processes":
            workers = workers or available_cores()
            # a fork of a process with threads may hang
            self._make = partial(
                ProcessPoolExecutor,
                workers,
                mp_context=get_context("spawn"),
                initializer=end_with_parent,
            )
        elif isinstance(executor, Executor) or not callable(executor):
            self.executor: Executor = executor  # type: ignore[assignment]
        else:
            self._make = executor
        if self._make is not None:
            self.executor = self._make()
        if not callable(getattr(self.executor, "submit", None)):
            raise TypeError(f"executor must return an executor, got {self.executor!r}")
        self.workers = workers or _workers_of(self.executor)

    def __enter__(self) -> _Pool:
        return self

    def __exit__(self, *_: object) -> None:
        self._stop_flag[0] = 1
        for future in self.pending:
            future.cancel()
        if self._make is not None:
            self._shut_down(wait=True)

    def fill(self, work: Callable[[int], Any], queue: Chunks) -> None:
        """Hand out chunks until there are enough for all workers."""
        while len(self.pending) < _CHUNKS_PER_WORKER * self.workers and (chunk := queue.next()):
            try:
                future = self.hand_out(work, chunk)
            except Exception as error:
                # a worker died since the last chunk, perhaps while this one's was being started
                refused = isinstance(error, OSError) and not work_was_lost(error)
                died = BrokenExecutor(str(error)) if refused else error
                if not worker_died(died) and not work_was_lost(died):
                    raise
                future = Future()
                future.set_exception(died)
            self.pending[future] = chunk

    def hand_out(self, work: Callable[[Any], Any], chunk: list[int]) -> Future[Any]:
        """Submit a chunk to the executor."""
        task: tuple[Any, ...] = (_run_chunk, work, chunk)
        if self.data is not None:
            task = _run_whole, work, chunk, self.data(chunk)
        if not self.threads:
            task = _run_elsewhere, *task
        return self.executor.submit(*task)

    def wait(self) -> list[Future[Any]]:
        """Wait for at least one chunk; return the finished ones, oldest first."""
        done, _ = wait(self.pending, return_when=FIRST_COMPLETED)
        return [future for future in self.pending if future in done]

    def cancel_waiting(self) -> int:
        """Cancel chunks that no worker has begun; return the number of running pieces."""
        for future in list(self.pending):
            if future.cancel():
                del self.pending[future]
        return sum(map(len, self.pending.values()))

    def broken(self, reason: Exception) -> bool:
        """Return whether the executor accepts no more work after this exception."""
        return isinstance(reason, BrokenExecutor) or work_was_lost(reason)

    def renew(self) -> bool:
        """Replace a broken executor; return False if there is no way to make a new one."""
        if self._make is None:
            return False
        self._shut_down(wait=False)
        self.executor = self._make()
        return True

    def _shut_down(self, wait: bool) -> None:
        """Shut down an executor that was made here, and kill workers of a broken one.

        A broken `ProcessPoolExecutor` waits also for a worker that it was starting when another
        died.
        """
        if getattr(self.executor, "_broken", False):
            for worker in list((getattr(self.executor, "_processes", None) or {}).values()):
                worker.kill()
        self.executor.shutdown(wait=wait)


def _workers_of(executor: Any) -> int:
    """Return the number of workers, from the attributes in which executors store it."""
    for name in ("_max_workers", "num_workers"):
        number = getattr(executor, name, None)
        if isinstance(number, int) and number > 0:
            return number
    client = getattr(executor, "_client", None)  # of Dask
    if client is not None:
        return max(1, int(sum(client.ncores().values())))
    return available_cores()
