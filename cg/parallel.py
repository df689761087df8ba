"""Independent pieces of work on all cores, in threads, since the compiled core frees the lock."""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from typing import TypeVar

from threadpoolctl import threadpool_limits

__all__ = ["as_finished", "available_cores"]

Result = TypeVar("Result")


def available_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0))


def as_finished(
    work: Callable[[int], Result], indices: Iterable[int], workers: int
) -> Generator[Result, None, None]:
    """Yield ``work(index)`` for each index, in the order in which they finish.

    Only few are queued at a time, so that an interrupt or a closed generator ends after
    what is running.
    """
    # one piece a core: threads inside the linear algebra would only be in each other's way
    with threadpool_limits(1), ThreadPoolExecutor(max_workers=workers) as pool:
        pending: dict[Future[Result], None] = {}  # in the order of submission
        try:
            for index in indices:
                pending[pool.submit(work, index)] = None
                if len(pending) == 2 * workers:
                    yield from _collect(pending)
            while pending:
                yield from _collect(pending)
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _collect(pending: dict[Future[Result], None]) -> Iterator[Result]:
    """Wait for at least one and yield what is finished; one worker thus keeps the order."""
    done, _ = wait(pending, return_when=FIRST_COMPLETED)
    finished = [future for future in pending if future in done]
    for future in finished:
        del pending[future]
    # one by one: a failure must not take the results before it along
    yield from (future.result() for future in finished)
