"""A line that tells how far a run is."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from .arguments import say

__all__ = ["Counter"]


class Counter:
    """Tells the number of pieces, their rate, and the time that is left.

    Parameters
    ----------
    pieces : str
        What they are called.
    """

    def __init__(self, pieces: str) -> None:
        self._pieces = pieces
        self._began = time.monotonic()
        self._first: int | None = None
        self._done = 0

    def __call__(self, done: int, total: int) -> None:
        """Tell that so many of all are done, what a store had among them."""
        now = time.monotonic()
        if self._first is None:
            self._first = done - 1
        here, passed = done - self._first, max(now - self._began, 1e-9)
        left = (total - done) * passed / here
        say(
            f"{done} of {total} {self._pieces}, {here / passed:.3g} a second, "
            f"{_duration(left)} left"
        )

    def one_of(self, total: int) -> Callable[[Any], None]:
        """Return what counts one more of so many each time it is called."""

        def count(_: Any) -> None:
            self._done += 1
            self(self._done, total)

        return count


def _duration(seconds: float) -> str:
    hours, rest = divmod(round(seconds), 3600)
    return f"{hours}:{rest // 60:02d}:{rest % 60:02d}"
