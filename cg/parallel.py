"""Independent pieces of work on all cores, in threads, since the compiled core frees the lock."""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Iterable
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
        pending: set[Future[Result]] = set()
        try:
            for index in indices:
                pending.add(pool.submit(work, index))
                if len(pending) < 2 * workers:
                    continue
                finished, pending = wait(pending, return_when=FIRST_COMPLETED)
                yield from (future.result() for future in finished)
            while pending:
                finished, pending = wait(pending, return_when=FIRST_COMPLETED)
                yield from (future.result() for future in finished)
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
