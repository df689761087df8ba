"""What an integration came to: its solution, status and events."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from cg.integration.events import EventLog
from cg.integration.messages import FINISHED, TERMINAL_EVENT, failed_members
from cg.integration.problem import Problem
from cg.integration.recorder import Recorder
from cg.integration.results import Solution
from cg.integration.stepper import Stepper

__all__ = ["Logs", "by_event", "outcome"]

Logs = dict[tuple[int, ...], EventLog]
"""The events of every member of an ensemble, those of a single point under the index ()."""


def _status(stepper: Stepper, recorder: Recorder) -> tuple[int, str]:
    if stepper.trouble:
        return -1, f"Failure: {stepper.trouble}."
    if stepper.failures:
        return -1, failed_members(stepper.failures, math.prod(stepper.batch))
    if recorder.ended and not recorder.logs:
        return 1, TERMINAL_EVENT
    return 0, FINISHED


def outcome(
    stepper: Stepper,
    recorder: Recorder,
    problem: Problem,
    logs: Logs | None,
) -> Solution:
    """Return the solution that a recorder has kept of a stepper's steps."""
    status, message = _status(stepper, recorder)
    counts = stepper.counts
    return Solution(
        t=recorder.times(),
        y=recorder.points(),
        sol=recorder.solution(),
        t_events=by_event(logs, problem.batch, lambda log, _: log.times()),
        y_events=by_event(logs, problem.batch, lambda log, i: log.points(problem.points[i])),
        nfev=counts.nfev,
        njev=counts.njev,
        nlu=counts.nlu,
        nexp=counts.nexp,
        steps=recorder.steps,
        nrejected=counts.rejected,
        status=status,
        message=message,
        success=status >= 0,
        method=problem.method,
        failures=dict(stepper.failures),
        frame=problem.frame,
    )


def by_event(
    logs: Logs | None, batch: tuple[int, ...], found: Callable[..., Any]
) -> list[Any] | None:
    """Return what was found for each event: itself for a single point, else arrays of it."""
    if logs is None:
        return None
    if not batch:
        alone: list[Any] = found(logs[()], ())
        return alone
    by_member = {member: found(log, member) for member, log in logs.items()}
    count = len(next(iter(by_member.values()), ()))
    arrays = [np.empty(batch, dtype=object) for _ in range(count)]
    for member, values in by_member.items():
        for array, value in zip(arrays, values, strict=True):
            array[member] = value
    return arrays
