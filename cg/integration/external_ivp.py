"""All that `cg.solve_ivp` offers for a compiled right-hand side, in compiled code."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.frames.base import Array, Points
from cg.integration.adaptive import too_many_steps, too_small_a_step
from cg.integration.blocks import describe_blocks
from cg.integration.dense import DenseOutput, EnsembleOutput, SegmentTable, StoredSegment
from cg.integration.events import EventLog
from cg.integration.external import Stop, failure
from cg.integration.external_task import Task
from cg.integration.pace import Pace
from cg.integration.result import Solution
from cg.integration.step import Step

# Steps between looks for events: the fewer, the less is computed beyond the one that ends it all.
_STEPS_BETWEEN_LOOKS = 64


@dataclass
class Run:
    """One trajectory.

    Attributes
    ----------
    step
        Its step function, which counts.
    t
        Times of steps, shape ``(n,)``.
    y
        Points at them, shape ``(n, size)``.
    used
        How many of the wanted times were reached.
    steps, rejected
        Accepted and rejected steps.
    trouble
        Why it ended early, empty if it didn't.
    ended
        Whether an event ended it.
    sol
        The continuous solution, if it was asked for.
    """

    step: Step
    t: Array
    y: Array
    used: int
    steps: int = 0
    rejected: int = 0
    trouble: str = ""
    ended: bool = False
    sol: DenseOutput | None = None


@dataclass
class _Kept:
    """Steps as compiled code leaves them, one array for every call."""

    t: list[Array] = field(default_factory=list)
    y: list[Array] = field(default_factory=list)
    slopes: list[Array] = field(default_factory=list)


@dataclass(frozen=True)
class _Block:
    """Steps of one call: where it starts, then their ends, and the slopes at their beginnings."""

    t: Array  # (n + 1,)
    y: Array  # (n + 1, size)
    slopes: Array  # (n, dim)

    def __len__(self) -> int:
        return len(self.slopes)


def solve_compiled(
    task: Task,
    start: float,
    points: Points,
    batch: tuple[int, ...],
    wanted: Array | None,
    log: EventLog,
) -> Solution:
    """Integrate one trajectory, or every member of an ensemble with steps of its own.

    Parameters
    ----------
    task
        What to do.
    start
        Initial time.
    points
        Initial points, shape ``(*batch, *point_shape)``.
    batch
        Leading axes.
    wanted
        Times at which to store the solution.  If it is None, these are those of the steps; of
        an ensemble that chooses its steps, which has no common ones, the ends.
    log
        Events to look for, of a single trajectory.

    Raises
    ------
    ValueError, RuntimeError, OverflowError
        If ``f`` or its numbers end the integration.
    """
    if batch and wanted is None and not task.given:
        wanted = np.unique([start, task.stop])[:: -1 if task.stop < start else 1]
    times = np.empty(0) if wanted is None else np.array(wanted)
    rows = points.reshape(math.prod(batch), -1).view(np.float64)
    found = np.full((len(rows), len(times), rows.shape[1]), math.nan)
    pace, constants = Pace(), _constants(task)
    log.start(start, points)
    runs = []
    for i, row in enumerate(rows):
        index = tuple(map(int, np.unravel_index(i, batch))) if batch else None
        runs.append(_run(task, start, row, times, found[i], pace, index, constants, log))

    shape = task.step.frame.point_shape
    if wanted is None:
        t, y = runs[0].t, np.stack([run.y for run in runs])
    elif batch:
        t, y = times, found
    else:
        t, y = times[: runs[0].used], found[:, : runs[0].used]
    y = np.ascontiguousarray(np.moveaxis(y, 0, 1)).view(points.dtype)
    y = y.reshape(len(t), *batch, *shape)
    t.flags.writeable = y.flags.writeable = False
    outputs = [run.sol for run in runs if run.sol is not None]
    sol: DenseOutput | None = None
    if task.dense:
        sol = EnsembleOutput(outputs, points, batch) if batch else outputs[0]
    status, message = _status(runs, batch)
    # Common steps count once for all members.
    total: Callable[[Iterable[int]], int] = max if task.given else sum
    return Solution(
        t=t,
        y=y,
        sol=sol,
        t_events=log.times(),
        y_events=log.points(points),
        nfev=total(run.step.nfev for run in runs),
        njev=0,
        nlu=0,
        nexp=total(run.step.nexp for run in runs),
        steps=total(run.steps for run in runs),
        nrejected=total(run.rejected for run in runs),
        status=status,
        message=message,
        success=status >= 0,
        method=task.step.tableau,
    )


def _status(runs: list[Run], batch: tuple[int, ...]) -> tuple[int, str]:
    troubled = [i for i, run in enumerate(runs) if run.trouble]
    if not troubled:
        if runs[0].ended:
            return 1, "A terminal event ended the integration."
        return 0, "The end of t_span was reached."
    first = runs[troubled[0]].trouble
    if not batch:
        return -1, f"Failure: {first}."
    index = ", ".join(str(int(k)) for k in np.unravel_index(troubled[0], batch))
    return -1, f"Failure of {len(troubled)} of {len(runs)} trajectories; of y0[{index}]: {first}."


def _constants(task: Task) -> tuple[Any, ...]:
    """Return the arguments of compiled code that are the same for every call."""
    step = task.step
    weights, embedded = np.zeros((2, step.tableau.stages))
    for target, chosen in ((weights, step.weights), (embedded, step.embedded or ())):
        for j, weight in chosen:
            target[j] = weight
    return (
        task.rhs.address, task.rhs.user_data, describe_blocks(step.frame), step.tableau.a,
        weights, embedded, step.tableau.c, task.atol, np.array([task.stop, *task.limits]),
        task.given,
    )  # fmt: skip


def _run(
    task: Task,
    start: float,
    row: Array,
    times: Array,
    found: Array,
    pace: Pace,
    index: tuple[int, ...] | None,
    constants: tuple[Any, ...],
    log: EventLog,
) -> Run:
    """Integrate one trajectory from a flat point; fill ``found`` at the times that are wanted."""
    import cg._external as core

    step = copy.copy(task.step)
    dim = step.frame.dim
    reals = np.array([start, task.first_step or 0.0, 1.0, math.nan])
    keep = task.keep or task.dense
    logicals = np.array([0, 0, keep or bool(log)], dtype=np.intc)
    point, slope = row.copy(), np.zeros(dim)
    used = int((times == start).sum())
    found[:used] = row
    run = Run(step, np.array([start]), row[None].copy(), used)
    kept = _Kept()
    # f2py wants at least one time, and this one is never reached
    never = np.array([math.copysign(math.inf, task.stop - start)]), np.empty((1, row.size))
    status = Stop.PAUSED if start != task.stop else Stop.FINISHED
    while status == Stop.PAUSED and run.steps + run.rejected < task.max_steps:
        budget = min(pace.start(), task.max_steps - run.steps - run.rejected)
        if log:
            budget = min(budget, _STEPS_BETWEEN_LOOKS)
        capacity = budget if logicals[2] else 1
        rest = (times[run.used :], found[run.used :]) if run.used < len(times) else never
        buffers = [np.empty((capacity, width)) for width in (1, row.size, dim)]
        before = float(reals[0]), point.copy()
        counts, code, flag = core.adapt(
            *constants, run.steps, reals, logicals, point, slope, budget, buffers[0].reshape(-1),
            buffers[1].T, buffers[2].T, rest[0], rest[1].T,
        )  # fmt: skip
        status = Stop(code)
        attempts, accepted, nfev, nexp, reached = counts.tolist()
        pace.stop(attempts)
        run.steps += accepted
        run.rejected += 0 if task.given else attempts - accepted
        run.used += reached
        step.nfev += nfev
        step.nexp += nexp
        if logicals[2]:
            block = _Block(
                np.append(before[0], buffers[0][:accepted, 0]),
                np.concatenate([before[1][None], buffers[1][:accepted]]),
                buffers[2][:accepted].copy(),
            )
            ended, last = _first_end(step, block, slope if logicals[1] else None, log)
            if last is not None:  # perhaps found on the way
                slope[:], logicals[1] = last, 1
            if ended is not None:
                return _ended(task, run, kept, block, last, ended, times)
            if keep:
                kept.t.append(block.t[1:])
                kept.y.append(block.y[1:])
                kept.slopes.append(block.slopes)
        if status == Stop.SLOPE_NOT_FINITE:
            raise OverflowError(f"f is too large to choose a step at t = {start!r}, got {slope}")
        if status not in (Stop.FINISHED, Stop.PAUSED, Stop.STEP_TOO_SMALL):
            raise failure(status, flag, float(reals[3]), index)
    run.trouble = _trouble(status, float(reals[0]), task.max_steps)
    _put_together(task, run, kept, slope if logicals[1] else None)
    return run


def _trouble(status: Stop, t: float, max_steps: int) -> str:
    if status == Stop.STEP_TOO_SMALL:
        return too_small_a_step(t)
    return too_many_steps(max_steps, t) if status == Stop.PAUSED else ""


def _first_end(
    step: Step, block: _Block, last: Array | None, log: EventLog
) -> tuple[tuple[int, float, Points] | None, Array | None]:
    """Record the events of a block.

    Returns
    -------
    end
        Number of the step, time, and point of the event that ends it all, or None.
    last
        The coefficients at the end of the block, given or found, or None if they aren't known.
    """
    points = _points(step, block.y)
    for k in range(len(block) if log else 0):
        slopes = block.slopes[k], block.slopes[k + 1] if k + 1 < len(block) else last
        segment = StoredSegment(step, block.t[k : k + 2], points[k : k + 2], slopes)
        end = log.record(segment)
        if k + 1 == len(block):
            last = segment.last
        if end is not None:
            return (k, end, segment(np.array([end]))[0]), last
    return None, last


def _ended(
    task: Task,
    run: Run,
    kept: _Kept,
    block: _Block,
    last: Array | None,
    ended: tuple[int, float, Points],
    times: NDArray[np.float64],
) -> Run:
    """Cut off what was computed beyond the event that ends the integration."""
    k, t, point = ended
    run.ended = True
    run.steps -= len(block) - (k + 1)
    beyond = np.sign(task.stop - block.t[0]) * (times - t) > 0.0
    run.used = min(run.used, int((~beyond).sum()))
    kept.t.append(block.t[1 : k + 2])
    kept.y.append(block.y[1 : k + 2])
    kept.slopes.append(block.slopes[: k + 1])
    _put_together(task, run, kept, block.slopes[k + 1] if k + 1 < len(block) else last, t)
    run.y[-1] = np.ascontiguousarray(point).reshape(-1).view(np.float64)
    return run


def _put_together(
    task: Task, run: Run, kept: _Kept, slope: Array | None, end: float | None = None
) -> None:
    """Join what was kept; ``slope`` are the coefficients at its end if they are known.

    An event may end the solution at ``end``, within the last step.
    """
    if kept.t:
        run.t = np.concatenate([run.t, *kept.t])
        run.y = np.concatenate([run.y, *kept.y])
    if task.dense:
        run.sol = _dense_output(run, kept, slope, end)
    if end is not None:
        run.y = run.y.copy()  # the continuous solution has the end of the step
        run.t = np.append(run.t[:-1], end)


def _dense_output(run: Run, kept: _Kept, slope: Array | None, end: float | None) -> DenseOutput:
    points = _points(run.step, run.y)
    if len(run.t) == 1:
        return DenseOutput(run.t, (), points[0])
    if slope is None:
        slope = run.step.evaluate(float(run.t[-1]), points[-1])
    slopes = np.concatenate([*kept.slopes, slope[None]])
    ends = run.t if end is None else np.append(run.t[:-1], end)
    return DenseOutput(ends, SegmentTable(run.step, run.t, points, slopes), points[0])


def _points(step: Step, rows: Array) -> Points:
    return rows.view(step.frame.dtype).reshape(-1, *step.frame.point_shape)
