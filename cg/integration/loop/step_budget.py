"""The number of steps that compiled code takes between two checks for an interrupt."""

from __future__ import annotations

import time

_SECONDS = 0.03
_MAX_GROWTH = 8
_MAX_STEPS = 2**30  # fits into 32 bits


class StepBudget:
    """The number of steps to take at a time, chosen from the duration of the last ones.

    Python can't stop compiled code; a keyboard interrupt takes effect when it returns.
    """

    def __init__(self) -> None:
        self.steps = 1  # at first, since the cost of a step is unknown
        self._since = time.perf_counter()

    def start(self) -> int:
        """Return the number of steps to take, and start the clock."""
        self._since = time.perf_counter()
        return self.steps

    def stop(self, taken: int) -> None:
        """Choose the next number of steps after ``taken``, fewer than `steps` at the end."""
        seconds = max(time.perf_counter() - self._since, 1e-6)
        steps = int(min(taken * _SECONDS / seconds, _MAX_STEPS))
        self.steps = max(1, min(steps, _MAX_GROWTH * self.steps))
