"""How many pieces of work are handed out together."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .execution import Finished, _Pool

__all__ = ["Chunks"]

_CHUNK_SECONDS = 0.25  # that a chunk is to take: far longer than it takes to hand out
_MIN_SECONDS = 0.02  # even at the end: about what handing out takes on a cluster
_TAIL = 4  # chunks that a worker still gets at least, so that all end at about the same time
_REMEMBERED = 0.3  # weight of one piece in the mean time of a piece


class Chunks:
    """Indices in chunks that take about equally long."""

    def __init__(self, indices: Iterable[int], total: int, pool: _Pool) -> None:
        self._indices = iter(indices)
        self._left = total
        self._pool = pool
        self._mean: float | None = None

    def next(self) -> list[int]:
        """Return the next chunk, empty at the end."""
        size = 1
        if (not self._pool.threads or self._pool.data) and self._mean is not None:
            fair = self._left // (_TAIL * self._pool.workers)
            mean = max(self._mean, 1e-6)
            least = max(1, int(_MIN_SECONDS / mean))
            size = max(least, min(int(_CHUNK_SECONDS / mean), fair))
        chunk = list(islice(self._indices, size))
        self._left -= len(chunk)
        return chunk

    def learn(self, results: list[Finished[Any]]) -> None:
        """Take note of how long pieces took."""
        if results:
            mean = sum(finished.seconds for finished in results) / len(results)
            old = mean if self._mean is None else self._mean
            pieces = sum(max(1, len(finished.chunk)) for finished in results)
            # the first piece of a worker, which also loads what it needs, is soon forgotten
            self._mean = mean + (1.0 - _REMEMBERED) ** pieces * (old - mean)
