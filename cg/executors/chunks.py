"""Sizes of the chunks in which pieces of work are handed out."""

from collections.abc import Iterable
from itertools import islice

_CHUNK_SECONDS = 0.25  # duration of a chunk: far longer than handing it out takes
_MIN_SECONDS = 0.02  # smallest duration at the end: about what handing out takes on a cluster
_TAIL = 4  # number of chunks left for each worker, so that all end at about the same time
_OLD_WEIGHT = 0.7  # weight of the old mean after one more piece


def even_size(total: int, workers: int, largest: int) -> int:
    """Return a size of chunks that no measured time changes."""
    return max(1, min(largest, -(-total // (_TAIL * workers))))


class Chunks:
    """Indices, `total` in number, in chunks of about equal duration, or of a `size` if given."""

    def __init__(
        self, indices: Iterable[int], total: int, workers: int, size: int | None = None
    ) -> None:
        self._indices = iter(indices)
        self._left = total
        self._workers = workers
        self._size = size
        self._mean: float | None = None  # seconds that a piece takes

    def next(self) -> list[int]:
        """Return the next chunk, empty at the end."""
        size = self._size or 1
        if self._size is None and self._mean is not None:
            fair = self._left // (_TAIL * self._workers)
            mean = max(self._mean, 1e-6)
            least = max(1, int(_MIN_SECONDS / mean))
            size = max(least, min(int(_CHUNK_SECONDS / mean), fair))
        chunk = list(islice(self._indices, size))
        self._left -= len(chunk)
        return chunk

    def learn(self, pieces: int, seconds: float) -> None:
        """Update the mean duration of a piece by that of some pieces, whose mean is given."""
        old = seconds if self._mean is None else self._mean
        # a worker's first piece also loads modules; its weight soon vanishes
        self._mean = seconds + _OLD_WEIGHT**pieces * (old - seconds)
