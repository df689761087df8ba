"""Members of an ensemble that go to the end in compiled code, with steps of their own."""

from __future__ import annotations

import math
from typing import cast

import numpy as np
from numpy.typing import NDArray

from cg.frames.arrays import Array, Points
from cg.integration.compiled_rhs import CompiledRhs
from cg.integration.compiled_run import CompiledRun
from cg.integration.messages import failure, too_many_steps, too_small_a_step
from cg.integration.problem import Problem
from cg.integration.progress import Progress
from cg.integration.step_budget import StepBudget
from cg.integration.stepper import AdaptiveSchedule, Counts
from cg.shared_numbers import Stop

__all__ = ["member_ends"]

_MEMBERS = 1024  # at a time, so that memory doesn't grow with the ensemble
_NONE_BETWEEN = 2**31 - 1  # steps


def member_ends(
    problem: Problem, schedule: AdaptiveSchedule, watch: Progress
) -> tuple[Points, Counts, dict[tuple[int, ...], str]]:
    """Integrate an ensemble for a compiled function, of which nothing is kept but the ends.

    The steps of a member are those that it takes alone, to the bit.

    Parameters
    ----------
    problem
        The ensemble.
    schedule
        How steps are chosen.
    watch
        Is told how far it has come.

    Returns
    -------
    ends
        The points at the end, shape ``(*batch, *point_shape)``, NaN where it wasn't reached.
    counts
        What all members took.
    failures
        Why members ended early, by their indices.

    Raises
    ------
    MemoryError
        If there isn't enough for one step.
    """
    counts, failures = Counts(), dict[tuple[int, ...], str]()
    total = math.prod(problem.batch)
    start = np.ascontiguousarray(problem.points)
    rows = start.reshape(total, -1).view(np.float64)
    ends = np.full_like(start, math.nan)
    end_rows = ends.reshape(total, -1).view(np.float64)
    first, steps = 0, StepBudget()
    budget = StepBudget()  # of members: one step of all of them can't be interrupted
    while first < total:
        part = slice(first, min(first + min(budget.start(), _MEMBERS), total))
        troubles = _finish(
            problem, schedule, rows[part], first, end_rows[part], steps, counts, watch
        )
        for place, trouble in troubles.items():
            index = tuple(map(int, np.unravel_index(first + place, problem.batch)))
            failures[index] = trouble
        watch.finish_members(part.stop - first)
        budget.stop(part.stop - first)
        first = part.stop
    return ends, counts, failures


def _finish(
    problem: Problem,
    schedule: AdaptiveSchedule,
    rows: Array,
    first: int,
    ends: Array,
    budget: StepBudget,
    counts: Counts,
    watch: Progress,
) -> dict[int, str]:
    """Integrate some members; return why those that failed did, by their places."""
    rhs = cast(CompiledRhs, problem.rhs)
    run = CompiledRun(rhs, problem.frame, problem.method, rows, schedule, first=first)
    everyone, t = slice(0, len(rows)), np.empty(1)
    paused = np.full(len(rows), schedule.start != schedule.stop)
    if not paused.any():
        ends[:] = rows
    left = schedule.max_steps
    reached = np.full(len(rows), schedule.start)
    troubles: dict[int, str] = {}
    while paused.any() and left > 0:
        steps = min(max(1, budget.start() // int(paused.sum())), left)
        taken, statuses, flags, at = run.advance(
            everyone, steps, _NONE_BETWEEN, t, ends[None], None
        )
        attempts, accepted, _, nfev, nexp = taken.sum(axis=1, dtype=np.int64).tolist()
        budget.stop(attempts)
        left -= steps
        counts.add(Counts(nfev=nfev, nexp=nexp, steps=accepted, rejected=attempts - accepted))
        failed = paused & (statuses != Stop.PAUSED) & (statuses != Stop.FINISHED)
        for i in np.flatnonzero(failed).tolist():
            troubles[i] = _trouble(run, i, Stop(statuses[i]), int(flags[i]), float(at[i]))
        paused = statuses == Stop.PAUSED
        reached = _reached(statuses, at, schedule.stop)
        watch.reach(reached)
    for i in np.flatnonzero(paused).tolist():
        troubles[i] = too_many_steps(schedule.max_steps, float(reached[i]))
    return troubles


def _reached(statuses: NDArray[np.intc], at: Array, stop: float) -> Array:
    return np.where(statuses == Stop.FINISHED, stop, at)


def _trouble(run: CompiledRun, i: int, stop: Stop, flag: int, t: float) -> str:
    """Return why a member ended early."""
    if stop is Stop.STEP_TOO_SMALL:
        return too_small_a_step(t, run.smallest_step(t))
    slope = run.slope(i)[0] if stop is Stop.SLOPE_NOT_FINITE else None
    error = failure(stop, flag, t, slope)
    if isinstance(error, MemoryError):
        raise error
    return str(error)
