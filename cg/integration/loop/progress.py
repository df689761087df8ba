"""Reports of progress to a function of the user."""

from __future__ import annotations

import time
from typing import Any

_SECONDS = 0.1


class Progress:
    """Calls ``function(done, total)`` with the time covered so far, at most ten times a second.

    The total is the time from ``start`` to ``stop``, times the number of members.
    """

    def __init__(self, function: Any, start: float, stop: float, members: int = 1) -> None:
        if function is not None and not callable(function):
            raise TypeError(f"progress must be callable, got {function!r}")
        self.function = function
        self.length = abs(stop - start)
        self.total = members * self.length
        self._before = 0.0
        self._done = 0.0
        self._last_call = time.perf_counter()

    def update(self, covered: float) -> None:
        """Set the time that the present trajectories have covered, summed over them."""
        if self.function is None:
            return
        self._done = max(self._done, self._before + covered)
        if time.perf_counter() - self._last_call >= _SECONDS:
            self._call()

    def count_finished(self, count: int) -> None:
        """Count the present trajectories as finished, even if they ended early."""
        self._before += count * self.length
        self._done = max(self._done, self._before)

    def finish(self) -> None:
        """Report the final progress."""
        if self.function is not None:
            self._call()

    def _call(self) -> None:
        self.function(self._done, self.total)
        self._last_call = time.perf_counter()
