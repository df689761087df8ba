"""How many steps compiled code takes before Python looks for an interrupt."""

from __future__ import annotations

import time

_SECONDS = 0.03
_FASTEST_GROWTH = 8
_MOST = 2**30  # as integers of 32 bits have them


class StepBudget:
    """The number of steps to take at a time, from the time that the last ones took.

    Python can't stop compiled code, so that an interrupt from the keyboard waits until it pauses.

    Attributes
    ----------
    steps
        How many steps to take next.  It begins with one, since nothing is known of what a step
        costs.
    """

    def __init__(self) -> None:
        self.steps = 1
        self._since = time.perf_counter()

    def start(self) -> int:
        """Return how many steps to take, and take the time from here."""
        self._since = time.perf_counter()
        return self.steps

    def stop(self, taken: int) -> None:
        """Choose the next number of steps.

        Parameters
        ----------
        taken
            How many steps were taken, fewer than wanted if the end came first.
        """
        seconds = max(time.perf_counter() - self._since, 1e-6)
        wanted = int(min(taken * _SECONDS / seconds, _MOST))
        self.steps = max(1, min(wanted, _FASTEST_GROWTH * self.steps))
