"""Adaptive steps of a compiled right-hand side, wholly in compiled code."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cg.frames.base import Array, Points
from cg.integrate.adaptive import (
    ErrorNorm,
    error_exponent,
    too_many_steps,
    too_small_a_step,
)
from cg.integrate.blocks import describe_blocks
from cg.integrate.dense import DenseOutput, EnsembleOutput, SegmentTable
from cg.integrate.external import CompiledRhs, Stop, failure
from cg.integrate.pace import Pace
from cg.integrate.result import Solution
from cg.integrate.step import Step


@dataclass(frozen=True)
class AdaptiveTask:
    """What every trajectory of a compiled right-hand side is integrated with.

    Attributes
    ----------
    rhs
        The right-hand side.
    step
        The step function of an explicit pair.
    norm
        The tolerances.
    stop
        Final time.
    max_step
        Largest step size.
    first_step
        Size of the first step, or None to choose it from the problem.
    max_steps
        Largest number of steps, rejected ones included.
    keep
        Whether to keep all steps.
    dense
        Whether to make a continuous solution.
    """

    rhs: CompiledRhs
    step: Step
    norm: ErrorNorm
    stop: float
    max_step: float
    first_step: float | None
    max_steps: int
    keep: bool
    dense: bool


@dataclass
class Run:
    """One trajectory.

    Attributes
    ----------
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
    sol
        The continuous solution, if it was asked for.
    """

    t: Array
    y: Array
    used: int
    steps: int = 0
    rejected: int = 0
    trouble: str = ""
    sol: DenseOutput | None = None


@dataclass
class _Kept:
    """Steps as compiled code leaves them, one array for every call."""

    t: list[Array] = field(default_factory=list)
    y: list[Array] = field(default_factory=list)
    slopes: list[Array] = field(default_factory=list)


def solve_compiled(
    task: AdaptiveTask, start: float, points: Points, batch: tuple[int, ...], wanted: Array | None
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
        an ensemble, which has no common ones, the ends.

    Raises
    ------
    ValueError, RuntimeError, OverflowError
        If ``f`` or its numbers end the integration.
    """
    if batch and wanted is None:
        wanted = np.unique([start, task.stop])[:: -1 if task.stop < start else 1]
    times = np.empty(0) if wanted is None else np.array(wanted)
    rows = points.reshape(math.prod(batch), -1).view(np.float64)
    found = np.full((len(rows), len(times), rows.shape[1]), math.nan)
    pace, constants = Pace(), _constants(task)
    runs = []
    for i, row in enumerate(rows):
        index = tuple(map(int, np.unravel_index(i, batch))) if batch else None
        runs.append(_run(task, start, row, times, found[i], pace, index, constants))

    shape = task.step.frame.point_shape
    if wanted is None:
        t, y = runs[0].t, runs[0].y[None]
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
    message = _message(runs, batch)
    return Solution(
        t=t,
        y=y,
        sol=sol,
        t_events=None,
        y_events=None,
        nfev=task.step.nfev,
        njev=0,
        nlu=0,
        nexp=task.step.nexp,
        steps=sum(run.steps for run in runs),
        nrejected=sum(run.rejected for run in runs),
        status=-1 if message else 0,
        message=message or "The end of t_span was reached.",
        success=not message,
        method=task.step.tableau,
    )


def _message(runs: list[Run], batch: tuple[int, ...]) -> str:
    troubled = [i for i, run in enumerate(runs) if run.trouble]
    if not troubled:
        return ""
    first = runs[troubled[0]].trouble
    if not batch:
        return f"Failure: {first}."
    index = ", ".join(str(int(k)) for k in np.unravel_index(troubled[0], batch))
    return f"Failure of {len(troubled)} of {len(runs)} trajectories; of y0[{index}]: {first}."


def _constants(task: AdaptiveTask) -> tuple[Any, ...]:
    """Return the arguments of compiled code that are the same for every call."""
    step, norm = task.step, task.norm
    weights, embedded = np.zeros((2, step.tableau.stages))
    for target, chosen in ((weights, step.weights), (embedded, step.embedded or ())):
        for j, weight in chosen:
            target[j] = weight
    return (
        task.rhs.address, task.rhs.user_data, describe_blocks(step.frame), step.tableau.a,
        weights, embedded, step.tableau.c, np.array(np.broadcast_to(norm.atol, step.frame.dim)),
        np.array([norm.rtol, error_exponent(step.tableau), task.stop, task.max_step]),
    )  # fmt: skip


def _run(
    task: AdaptiveTask,
    start: float,
    row: Array,
    times: Array,
    found: Array,
    pace: Pace,
    index: tuple[int, ...] | None,
    constants: tuple[Any, ...],
) -> Run:
    """Integrate one trajectory from a flat point; fill ``found`` at the times that are wanted."""
    import cg._external as core

    step = task.step
    dim = step.frame.dim
    reals = np.array([start, task.first_step or 0.0, 1.0, math.nan])
    keep = task.keep or task.dense
    logicals = np.array([0, 0, keep], dtype=np.intc)
    point, slope = row.copy(), np.zeros(dim)
    used = int((times == start).sum())
    found[:used] = row
    run = Run(np.array([start]), row[None].copy(), used)
    kept = _Kept()
    # f2py wants at least one time, and this one is never reached
    never = np.array([math.copysign(math.inf, task.stop - start)]), np.empty((1, row.size))
    status = Stop.PAUSED if start != task.stop else Stop.FINISHED
    while status == Stop.PAUSED and run.steps + run.rejected < task.max_steps:
        budget = min(pace.start(), task.max_steps - run.steps - run.rejected)
        capacity = budget if keep else 1
        rest = (times[run.used :], found[run.used :]) if run.used < len(times) else never
        buffers = [np.empty((capacity, width)) for width in (1, row.size, dim)]
        counts, code, flag = core.adapt(
            *constants, reals, logicals, point, slope, budget, buffers[0].reshape(-1), buffers[1].T,
            buffers[2].T, rest[0], rest[1].T,
        )  # fmt: skip
        status = Stop(code)
        attempts, accepted, nfev, nexp, reached = counts.tolist()
        pace.stop(attempts)
        run.steps += accepted
        run.rejected += attempts - accepted
        run.used += reached
        step.nfev += nfev
        step.nexp += nexp
        if keep:
            kept.t.append(buffers[0][:accepted, 0].copy())
            kept.y.append(buffers[1][:accepted].copy())
            kept.slopes.append(buffers[2][:accepted].copy())
        if status == Stop.SLOPE_NOT_FINITE:
            raise OverflowError(f"f is too large to choose a step at t = {start!r}, got {slope}")
        if status not in (Stop.FINISHED, Stop.PAUSED, Stop.STEP_TOO_SMALL):
            raise failure(status, flag, float(reals[3]), index)
    t = float(reals[0])
    if status == Stop.STEP_TOO_SMALL:
        run.trouble = too_small_a_step(t)
    elif status == Stop.PAUSED:
        run.trouble = too_many_steps(task.max_steps, t)
    if kept.t:
        run.t = np.concatenate([run.t, *kept.t])
        run.y = np.concatenate([run.y, *kept.y])
    if task.dense:
        run.sol = _dense_output(task, run, kept, slope if logicals[1] else None)
    return run


def _dense_output(task: AdaptiveTask, run: Run, kept: _Kept, slope: Array | None) -> DenseOutput:
    """Return the continuous solution, with the coefficients at its end if they are known."""
    frame = task.step.frame
    points = run.y.view(frame.dtype).reshape(-1, *frame.point_shape)
    if len(run.t) == 1:
        return DenseOutput(run.t, (), points[0])
    if slope is None:
        slope = task.step.evaluate(float(run.t[-1]), points[-1])
    slopes = np.concatenate([*kept.slopes, slope[None]])
    return DenseOutput(run.t, SegmentTable(task.step, run.t, points, slopes), points[0])
