"""Ensembles whose members have steps of their own."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from cg.frames.arrays import Array, Points
from cg.integration.dense import DenseOutput, EnsembleOutput
from cg.integration.member_ends import member_ends
from cg.integration.member_output import MemberOutput
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
        Their continuous solutions by their indices, if these are wanted.
    stopped
        Whether events ended all of them.
    """

    y: Points
    counts: Counts
    failures: dict[tuple[int, ...], str]
    outputs: dict[tuple[int, ...], DenseOutput] = field(default_factory=dict)
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
    eventful = any((logs or {}).values())
    if not dense and not eventful and np.isin(wanted, ends).all():
        found = _to_their_ends(problem, schedule, wanted, watch)
    elif eventful or len(ends) == 1:
        found = _one_by_one(problem, schedule, wanted, dense, logs, watch)
    else:
        found = _with_output(problem, schedule, wanted, dense, logs, watch)
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
        sol=_continuous(found, points, batch) if dense else None,
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


def _with_output(
    problem: Problem,
    schedule: AdaptiveSchedule,
    wanted: Array,
    dense: bool,
    logs: Logs | None,
    watch: Progress,
) -> _Members:
    """Integrate in compiled code, but for members that fail: these tell by themselves why."""
    run = MemberOutput(problem, schedule, wanted, dense, watch)
    run.integrate()
    indices = list(np.ndindex(problem.batch))
    found = _Members(run.y.reshape(len(wanted), *problem.points.shape), run.counts, {})
    found.outputs.update((indices[i], output) for i, output in run.outputs.items())
    for i in run.left:
        _integrate_alone(problem, indices[i], schedule, dense, logs, watch, wanted, found)
    return found


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
    found = _Members(y, Counts(), {})
    stopped = [
        _integrate_alone(problem, member, schedule, dense, logs, watch, wanted, found)
        for member in np.ndindex(problem.batch)
    ]
    return replace(found, stopped=all(stopped))


def _integrate_alone(
    problem: Problem,
    member: tuple[int, ...],
    schedule: AdaptiveSchedule,
    dense: bool,
    logs: Logs | None,
    watch: Progress,
    wanted: Array,
    found: _Members,
) -> bool:
    """Integrate one member and add what it comes to; return whether an event ended it."""
    log: Logs | None = None if logs is None else {(): logs[member]}
    alone = problem.member(member)
    stepper, recorder, trouble = _record_member(alone, schedule, wanted, dense, log, watch)
    watch.finish_members()
    if trouble or stepper.trouble:
        found.failures[member] = trouble or stepper.trouble
    solution = outcome(stepper, recorder, alone, log)
    place: Any = (slice(len(solution.t)), *member)
    found.y[place] = solution.y
    found.counts.add(replace(stepper.counts, steps=solution.steps))
    if solution.sol is not None:
        found.outputs[member] = solution.sol
    return solution.status == 1


def _continuous(found: _Members, points: Points, batch: tuple[int, ...]) -> EnsembleOutput:
    return EnsembleOutput([found.outputs[index] for index in np.ndindex(batch)], points, batch)


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
            ended = block is not None and not looked_for and recorder.add(block)
        except (ValueError, RuntimeError, OverflowError) as error:
            return stepper, recorder, str(error)
        if block is not None and looked_for:
            ended = recorder.add(block)
        if block is None or ended:
            return stepper, recorder, ""
        watch.reach(block.t[-1])
