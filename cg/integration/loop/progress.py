"""How far an integration has come, for a function of the user."""

from __future__ import annotations

import time
from typing import Any

__all__ = ["Progress"]

_SECONDS = 0.1


class Progress:
    """Tells a function how much time was covered, ten times a second at most.

    Parameters
    ----------
    function
        ``progress(done, total)``, or None.
    start, stop
        The ends of the integration.
    members
        How many trajectories there are.

    Raises
    ------
    TypeError
        If the function can't be called.
    """

    def __init__(self, function: Any, start: float, stop: float, members: int = 1) -> None:
        if function is not None and not callable(function):
            raise TypeError(f"progress must be callable, got {function!r}")
        self.function = function
        self.length = abs(stop - start)
        self.total = members * self.length
        self._before = 0.0
        self._done = 0.0
        self._told = time.perf_counter()

    def reach(self, covered: float) -> None:
        """Note how much time the present trajectories have covered, summed over them."""
        if self.function is None:
            return
        self._done = max(self._done, self._before + covered)
        if time.perf_counter() - self._told >= _SECONDS:
            self._tell()

    def finish_members(self, count: int) -> None:
        """Note that the present trajectories have ended, perhaps early."""
        self._before += count * self.length
        self._done = max(self._done, self._before)

    def finish(self) -> None:
        """Tell what was reached."""
        if self.function is not None:
            self._tell()

    def _tell(self) -> None:
        self.function(self._done, self.total)
        self._told = time.perf_counter()
