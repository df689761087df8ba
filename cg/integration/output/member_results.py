"""Results of the members of an ensemble, collected as they arrive."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from cg.integration.output.results import (
    DenseOutput,
    EnsembleOutput,
    EnsembleSolution,
    Solution,
    Steps,
    member_fields,
)
from cg.integration.problem import Problem
from cg.integration.run.messages import FINISHED, TERMINAL_EVENT, failed_members
from cg.support.arrays import Array, Points
from cg.support.caches import filled
from cg.support.shared_records import COUNTS


class MemberResults(NamedTuple):
    """Results of some members."""

    t: Array
    y: Any  # points, shape (times, members, *point_shape), or None
    observed: Any  # shape (times, members, *shape), or None
    reached: Array  # their last times
    status: Any
    counts: Any  # shape (members, 6)
    messages: dict[int, str]  # by member, of those whose status isn't 0
    steps: Steps | None
    events: tuple[Any, Array, Points] | None  # members and events, times, points before and after
    warnings: list[str]


class Results:
    """The results of all members, collected as they arrive."""

    def __init__(self, problem: Problem, out: Any) -> None:
        self.problem, self.out = problem, out
        self.members = len(problem.points)
        self._shape = self.members, *problem.plan.frame.point_shape
        self._all: MemberResults | None = None
        if out is not None:
            assert problem.t_eval is not None
            shape, kind = self._shape, problem.plan.frame.dtype
            if problem.observer is not None and not problem.keeps_points:
                shape, kind = (self.members, *problem.observer.shape), np.dtype(np.float64)
            _check_out(out, (len(problem.t_eval), *shape), kind)
        self._marks: dict[int, tuple[Array, Points]] = {}  # times and points of events, by member
        self._outputs: dict[int, DenseOutput] = {}
        self._events: dict[int, list[tuple[Array, Points]]] = {}

    def joint(self) -> MemberResults:
        """Return results of all members, those that haven't arrived being failures."""
        if self._all is None:
            problem, members = self.problem, self.members
            t, observer, y, observed = problem.t_eval, problem.observer, self.out, None
            assert t is not None
            if not problem.keeps_points:
                y, observed = None, self.out
            elif y is None:
                y = np.empty((len(t), *self._shape), dtype=problem.plan.frame.dtype)
            if observer is not None and observed is None:
                observed = np.empty((len(t), members, *observer.shape))
            counts = np.zeros((members, len(COUNTS)), dtype=np.int64)
            status = np.full(members, -1)
            reached = np.full(members, problem.t0)
            self._all = MemberResults(t, y, observed, reached, status, counts, {}, None, None, [])
        return self._all

    def add(self, members: slice, part: MemberResults) -> None:
        """Add the results of some members."""
        if part.events is not None:
            self._add_events(members.start, part)
        if part.steps is not None:
            problem = self.problem
            start = problem.t0, problem.direction
            for k, point in enumerate(problem.points[members], members.start):
                steps = part.steps.of(k - members.start)
                if problem.inertia is not None:
                    steps = replace(steps, plan=problem.inertia.plan(k, problem.plan))
                self._outputs[k] = DenseOutput(steps, *start, point, self._marks.get(k))
        if self.out is None and len(part.status) == self.members:
            self._all = part
            return
        joint = self.joint()
        for whole, rows in ((joint.y, part.y), (joint.observed, part.observed)):
            if whole is not None:
                whole[:, members] = rows
        for name in ("reached", "status", "counts"):
            getattr(joint, name)[members] = getattr(part, name)
        joint.messages.update((members.start + k, text) for k, text in part.messages.items())
        joint.warnings.extend(part.warnings)

    def _add_events(self, first: int, part: MemberResults) -> None:
        """Add the events of some members."""
        assert part.events is not None
        assert self.problem.events is not None
        of, t, y = part.events
        if self.problem.dense:
            order = np.argsort(of[:, 0], kind="stable")
            bounds = np.searchsorted(of[order, 0], np.arange(len(part.status) + 1)).tolist()
            for k, (begin, end) in enumerate(pairwise(bounds), first):
                own = order[begin:end]
                self._marks[k] = t[own], y[own, 1]
        count = len(self.problem.events)
        times, points = (split_events(of, each, len(part.status), count) for each in (t, y))
        for k in range(len(part.status)):
            self._events[first + k] = [(times[i][k], points[i][k]) for i in range(count)]

    def solution(self) -> EnsembleSolution:
        """Return the solution of all members."""
        problem, joint = self.problem, self.joint()
        failures = {}
        if joint.messages:
            failures = {k: joint.messages[k] for k in np.flatnonzero(joint.status < 0).tolist()}
        message = failed_members(failures, self.members) if failures else FINISHED
        joint.t.flags.writeable = False
        for array in (joint.y, joint.observed):
            if array is not None and array is not self.out:
                array.flags.writeable = False
        if not failures and len(joint.messages) == self.members:
            message = TERMINAL_EVENT
        fields = {
            "t": joint.t,
            "y": joint.y,
            "sol": self._output() if problem.dense else None,
            "t_end": joint.reached,
            **self._event_lists(),
            "status": joint.status,
            **dict(zip(COUNTS, joint.counts.T, strict=True)),
            "messages": dict(sorted(joint.messages.items())),
            "message": message,
            "success": not failures,
            "table": problem.plan.method,
            "frame": problem.plan.user_frame,
            "h": problem.control.h,
            "observed": joint.observed,
            "_direction": problem.direction,
        }
        solution = filled(EnsembleSolution, fields)
        return solution if problem.finish is None else problem.finish(problem, solution)

    def _output(self) -> EnsembleOutput:
        """Return the continuous solution, only initial points of members whose worker died."""
        problem, nothing = self.problem, Steps.none(self.problem.plan)
        return EnsembleOutput([
            self._outputs.get(k) or DenseOutput(nothing, problem.t0, problem.direction, point)
            for k, point in enumerate(problem.points)
        ])  # fmt: skip

    def _event_lists(self) -> dict[str, Any]:
        if self.problem.events is None:
            return {"t_events": None, "y_events": None, "y_after": None}
        events = range(len(self.problem.events))
        nothing = [(np.empty(0), np.empty((0, 2, *self._shape[1:]))) for _ in events]
        rows = [self._events.get(k, nothing) for k in range(self.members)]
        return {
            "t_events": [[row[i][0] for row in rows] for i in events],
            "y_events": [[row[i][1][:, 0] for row in rows] for i in events],
            "y_after": [[row[i][1][:, 1] for row in rows] for i in events],
        }


def split_events(of: Any, values: Array, members: int, events: int) -> list[list[Array]]:
    """Return values of events, of each event those of each member.

    ``of`` are the member and the event of each value.
    """
    keys = members * of[:, 1] + of[:, 0]
    order = np.argsort(keys, kind="stable")
    values = values[order]
    bounds = np.searchsorted(keys[order], np.arange(members * events + 1)).tolist()
    parts = [values[begin:end] for begin, end in pairwise(bounds)]
    return [parts[members * i : members * (i + 1)] for i in range(events)]


def solution_of(problem: Problem, part: MemberResults) -> Solution:
    """Return the solution of a problem of one point."""
    if problem.events is not None or problem.dense or problem.finish is not None:
        result = Results(problem, None)
        result.add(slice(0, 1), part)
        return result.solution()[0]
    part.t.setflags(write=False)
    ends = problem.direction, part.reached.item(0), part.status[0], part.counts[0].tolist()
    return filled(Solution, {
        **member_fields(part, 0, *ends), "sol": None, "t_events": None, "y_events": None,
        "y_after": None, "table": problem.plan.method, "frame": problem.plan.user_frame,
        "h": problem.control.h,
    })  # fmt: skip


def _check_out(out: Any, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
    """Raise TypeError or ValueError unless an array can hold all points."""
    try:
        actual, kind = tuple(out.shape), np.dtype(out.dtype)
    except (AttributeError, TypeError):
        raise TypeError(
            f"out must be an array, such as one of NumPy, zarr or h5py, got {out!r}"
        ) from None
    if actual != shape:
        raise ValueError(f"out must have shape {shape}, got {actual}")
    if kind.kind not in "fc" or not np.can_cast(dtype, kind, "same_kind"):
        raise ValueError(f"out must be able to hold numbers of type {dtype}, got one of {kind}")
    flags = getattr(out, "flags", None)
    file = getattr(out, "file", None)
    if (
        not getattr(flags, "writeable", True)
        or getattr(out, "read_only", False)
        or getattr(file, "mode", "") == "r"
    ):
        raise ValueError(f"out must be writable, got {type(out).__name__} that is read-only")
