"""Ensembles whose members have steps of their own."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from cg.frames.arrays import Array, Points
from cg.integration.dense import DenseOutput, EnsembleOutput
from cg.integration.member_ends import member_ends
from cg.integration.messages import FINISHED, TERMINAL_EVENT, failed_members
from cg.integration.outcome import Logs, by_event, outcome
from cg.integration.problem import Problem
from cg.integration.progress import Progress
from cg.integration.recorder import Recorder
from cg.integration.results import Solution
from cg.integration.stepper import AdaptiveSchedule, Counts, Stepper

__all__ = ["solve_members"]


@dataclass(frozen=True)
class _Members:
    """What members came to.

    Attributes
    ----------
    y
        Their points at all times, shape ``(times, *batch, *point_shape)``, NaN after their ends.
    counts
        What all of them took.
    failures
        Why some ended early, by their indices.
    outputs
        Their continuous solutions, if these are wanted.
    stopped
        Whether events ended all of them.
    """

    y: Points
    counts: Counts
    failures: dict[tuple[int, ...], str]
    outputs: list[DenseOutput] = field(default_factory=list)
    stopped: bool = False


def solve_members(
    problem: Problem,
    schedule: AdaptiveSchedule,
    wanted: Array | None,
    dense: bool,
    logs: Logs | None,
    watch: Progress,
) -> Solution:
    """Integrate every member of an ensemble for a compiled function.

    Parameters
    ----------
    problem, schedule
        The ensemble, and how its steps are chosen.
    wanted
        Times at which to keep the solution, or None for the ends.
    dense
        Whether to keep a continuous solution.
    logs
        The events of every member, or None.
    watch
        Is told how far it has come.
    """
    batch, points = problem.batch, problem.points
    ends = np.unique([schedule.start, schedule.stop])
    if wanted is None:
        wanted = ends if schedule.stop >= schedule.start else ends[::-1]
    if not dense and not any((logs or {}).values()) and np.isin(wanted, ends).all():
        found = _to_their_ends(problem, schedule, wanted, watch)
    else:
        found = _one_by_one(problem, schedule, wanted, dense, logs, watch)
    watch.finish()
    status, message = (1, TERMINAL_EVENT) if found.stopped else (0, FINISHED)
    if found.failures:
        status, message = -1, failed_members(found.failures, math.prod(batch))
    wanted = wanted.copy()
    wanted.flags.writeable = found.y.flags.writeable = False
    counts = found.counts
    return Solution(
        t=wanted,
        y=found.y,
        sol=EnsembleOutput(found.outputs, points, batch) if dense else None,
        t_events=by_event(logs, batch, lambda log, _: log.times()),
        y_events=by_event(logs, batch, lambda log, i: log.points(points[i])),
        nfev=counts.nfev,
        njev=counts.njev,
        nlu=counts.nlu,
        nexp=counts.nexp,
        steps=counts.steps,
        nrejected=counts.rejected,
        status=status,
        message=message,
        success=status >= 0,
        method=problem.method,
        failures=found.failures,
        frame=problem.frame,
    )


def _to_their_ends(
    problem: Problem, schedule: AdaptiveSchedule, wanted: Array, watch: Progress
) -> _Members:
    """Integrate without output between the ends: no member needs Python on its way."""
    last, counts, failures = member_ends(problem, schedule, watch)
    at_start = (wanted == schedule.start).reshape(-1, *(1,) * problem.points.ndim)
    return _Members(np.where(at_start, problem.points, last), counts, failures)


def _one_by_one(
    problem: Problem,
    schedule: AdaptiveSchedule,
    wanted: Array,
    dense: bool,
    logs: Logs | None,
    watch: Progress,
) -> _Members:
    """Integrate each member by itself."""
    points = problem.points
    y = np.full((len(wanted), *points.shape), math.nan, dtype=points.dtype)
    counts, failures = Counts(), dict[tuple[int, ...], str]()
    outputs: list[DenseOutput] = []
    stopped: list[bool] = []
    for member in np.ndindex(problem.batch):
        log: Logs | None = None if logs is None else {(): logs[member]}
        alone = problem.member(member)
        stepper, recorder, trouble = _record_member(alone, schedule, wanted, dense, log, watch)
        watch.finish_members()
        if trouble or stepper.trouble:
            failures[member] = trouble or stepper.trouble
        solution = outcome(stepper, recorder, alone, log)
        y[(slice(len(solution.t)), *member)] = solution.y
        counts.add(replace(stepper.counts, steps=solution.steps))
        if solution.sol is not None:
            outputs.append(solution.sol)
        stopped.append(solution.status == 1)
    return _Members(y, counts, failures, outputs, all(stopped))


def _record_member(
    problem: Problem,
    schedule: AdaptiveSchedule,
    wanted: Array,
    dense: bool,
    logs: Logs | None,
    watch: Progress,
) -> tuple[Stepper, Recorder, str]:
    """Take all steps of one member; return what went wrong in ``f`` or its numbers, if anything.

    What was found before stands.  An error in an event is none of the member's.
    """
    looked_for = {member: log for member, log in (logs or {}).items() if log}
    stepper = problem.stepper(schedule, slopes=True, watched=bool(looked_for))
    recorder = Recorder(stepper, schedule.start, problem.points, wanted, dense, looked_for)
    blocks = stepper.blocks()
    while True:
        try:
            block = next(blocks, None)
        except (ValueError, RuntimeError, OverflowError) as error:
            return stepper, recorder, str(error)
        if block is None or recorder.add(block):
            return stepper, recorder, ""
        watch.reach(block.t[-1])
