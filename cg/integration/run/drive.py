"""Advancing a run to its end, with interrupts and reports of progress."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from cg.integration.run.run import Run
from cg.integration.run.stiffness import StepCheck
from cg.support.parallel import raise_if_stopped

_SECONDS = 0.03  # between two checks for an interrupt
_REPORT_SECONDS = 0.1
_MAX_GROWTH = 8
_MAX_STEPS = 2**30  # fits into 32 bits


def drive(
    run: Run,
    watch: Callable[[float], None] | None = None,
    warn: Callable[[str], None] | None = None,
) -> None:
    """Advance all members to their ends; ``watch`` gets the time covered by all together."""
    budget, record, check = StepBudget(), run.record, None
    while True:
        given = budget.start()
        if check is not None:
            given = min(given, check.steps_left())
        record.budget = given
        run.call()
        raise_if_stopped()
        if watch is not None:
            with np.errstate(over="ignore"):  # members may have no end
                watch(float(np.abs(run.reached - run.t0).sum()))
        if record.ended == run.members:
            return
        check = check or StepCheck(run, warn)
        budget.stop(max(given - record.budget, 1))
        check.update(given - record.budget)


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
        self._before = self._done = 0.0
        self._last_call = time.perf_counter()

    def update(self, covered: float) -> None:
        """Set the time that the present trajectories have covered, summed over them."""
        if self.function is None:
            return
        self._done = max(self._done, self._before + covered)
        if time.perf_counter() - self._last_call >= _REPORT_SECONDS:
            self.function(self._done, self.total)
            self._last_call = time.perf_counter()

    def count_finished(self, count: int) -> None:
        """Count the present trajectories as finished, even if they ended early."""
        self._before += count * self.length
        self._done = max(self._done, self._before)

    def finish(self) -> None:
        """Report the final progress."""
        if self.function is not None:
            self.function(self._done, self.total)
