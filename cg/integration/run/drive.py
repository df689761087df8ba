"""Advancing a run to its end, with interrupts, progress, and warnings where it takes many steps."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from cg.frames.facts import facts_of
from cg.integration.run.run import Run
from cg.support.checks import NO_LIMIT
from cg.support.parallel import raise_if_stopped
from cg.support.shared_numbers import LoopStatus
from cg.support.shared_records import COUNTS
from cg.tables import Kind

_STIFF = "the equation is stiff, for which method='RadauIIA5' takes larger steps"
_REJECTED = (
    "many are rejected, as where f jumps or has kinks: name known times of jumps as "
    "breakpoints; where the solution meets a jump, end it by a terminal event, and continue with "
    "f of the other side; where it would stay on the jump, as in static friction, use a smooth f"
)
_MAX_DIM = 300  # largest Jacobian whose eigenvalues are computed, in dim³ operations
_STEP = float(np.sqrt(np.finfo(np.float64).eps))  # best for one-sided differences
# Least fraction of the real stability limit that steps reach if stability limits their size
_NEAR_LIMIT = 0.5
_DAMPED = 0.05  # least -Re λ / |λ| of a damped eigenvalue; accuracy limits steps of oscillations
_COUNTS = [COUNTS.index("steps"), COUNTS.index("nrejected")]
_FIRST_CHECK = 10_000  # steps, rejected ones included; a check takes as long as a hundred steps
_CONFIRMED = 1000  # steps after which a check is repeated: a single one may find a chance event
_MANY_REJECTED = 0.25  # rejected steps per accepted step; some 0.06 where f is smooth
_SECONDS = 0.03  # time between two checks for an interrupt
_REPORT_SECONDS = 0.1
_MAX_GROWTH = 8  # factor of the steps from a call to the next, since later ones may be slower
_MAX_STEPS = 2**30  # fits into 32 bits


class StepCheck:
    """Warns once while a run takes many steps, if its equation is stiff or many are rejected.

    A check looks for a reason after 10,000, 20,000, 40,000, … steps of a member. If it finds one,
    another check follows 1000 steps later, and warns if the reason is the same.
    """

    def __init__(self, run: Run, warn: Callable[[str], None]) -> None:
        self._run, self._warn = run, warn
        self._taken = 0  # steps of all members
        self._next = self._first = _FIRST_CHECK if run.control.h is None else NO_LIMIT
        self._last: str | None = None

    def steps_left(self) -> int:
        """Return the number of steps of a single trajectory until the next check."""
        return max(self._next - self._taken, 1) if self._run.members == 1 else NO_LIMIT

    def update(self, taken: int) -> None:
        """Count steps of all members, and check the one that has taken most if it is time."""
        run = self._run
        self._taken += taken
        if self._taken < self._next:
            return
        active = np.where(run.status == LoopStatus.PAUSED, run.counts[:, _COUNTS].sum(axis=1), 0)
        member = int(active.argmax())
        if active[member] < self._next:
            return
        difficulty = find_difficulty(run, member, float(run.reached[member]))
        if difficulty and difficulty == self._last:
            self._warn(f"the integration takes many steps, since {difficulty}")
            self._next = NO_LIMIT
        elif difficulty and self._last is None:
            self._next = int(active[member]) + _CONFIRMED
        else:
            self._first *= 2
            self._next, difficulty = max(self._first, self._next + 1), None
        self._last = difficulty


def find_difficulty(run: Run, member: int, t: float) -> str | None:
    """Return why a member takes many steps near ``t``, if it is a known reason.

    The equation is stiff if h λ is near the limit of the method's stability, for the step size h
    and a damped eigenvalue λ of the Jacobian, which is computed by differences.
    """
    plan, table, h = run.plan, run.plan.table, run.record.step_size
    frame = plan.frame
    steps, rejected = run.counts[member, _COUNTS].tolist()
    if rejected > _MANY_REJECTED * steps:
        return _REJECTED + ("" if table.kind is Kind.COLLOCATION else " and method='RadauIIA5'")
    explicit = table.explicit and table.kind is not Kind.LINEAR
    real_limit = table.real_limit() if explicit and facts_of(frame).has_brackets else None
    if real_limit is None or frame.dim > _MAX_DIM:
        return None
    if run.members > 1:
        h = (t - run.t0) / max(steps, 1)
    y = plan.points(run.end[member].copy(), ())
    sizes = _STEP * np.maximum(frame.coordinate_sizes(y), 1.0)
    try:
        start = run.rhs.at_member(member, t, y)
        moved = [run.rhs.at_member(member, t, frame.flow(v, y)) for v in np.diag(sizes)]
        eigenvalues = np.linalg.eigvals((np.array(moved) - start).T / sizes)
    except Exception:  # f needn't exist at points that the integration doesn't evaluate it at
        return None
    damped = eigenvalues[eigenvalues.real <= -_DAMPED * np.abs(eigenvalues)]
    near_limit = abs(h) * np.abs(damped).max(initial=0.0) >= _NEAR_LIMIT * real_limit
    return _STIFF if near_limit else None


def drive(run: Run, report: Callable[[float], None] | None, warn: Callable[[str], None]) -> None:
    """Advance all members to their ends; ``report`` gets the time covered by all together."""
    budget, check = StepBudget(), None
    while True:
        steps = budget.start()
        if check is not None:
            steps = min(steps, check.steps_left())
        taken = run.call(steps)
        raise_if_stopped()
        if report is not None:
            with np.errstate(over="ignore"):  # members may have no end
                report(float(np.abs(run.reached - run.t0).sum()))
        if run.record.ended == run.members:
            return
        check = check or StepCheck(run, warn)
        budget.stop(taken)
        check.update(taken)


class StepBudget:
    """The number of steps to take at a time, chosen from the duration of the last ones.

    Python can't stop compiled code; a keyboard interrupt takes effect when it returns.
    """

    def __init__(self) -> None:
        self.steps = 1  # at first, since the cost of a step is unknown
        self._since = 0.0  # set by `start`

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

    The total is the time from ``start`` to ``end``, times the number of members.
    """

    def __init__(self, function: Any, start: float, end: float, members: int = 1) -> None:
        if function is not None and not callable(function):
            raise TypeError(f"progress must be callable, got {function!r}")
        self.function = function
        self.length = abs(end - start)
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
