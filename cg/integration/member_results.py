"""Results of the members of an ensemble, collected as they arrive."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cg.integration.errors import FINISHED, TERMINAL_EVENT, failed_members
from cg.integration.output.solutions import (
    DenseOutput,
    EnsembleOutput,
    EnsembleSolution,
    Interpolants,
    Solution,
    member_fields,
)
from cg.integration.problem import Problem
from cg.support.arrays import Array, Points
from cg.support.frozen import filled
from cg.support.shared_records import COUNTS


class MemberResults(NamedTuple):
    """Results of some members."""

    t: Array
    y: Any  # points, shape (times, members, *point_shape), or None
    observed: Any  # shape (times, members, *shape), or None
    reached: Array  # the last time of each member
    status: NDArray[np.int64]
    counts: NDArray[np.int64]  # shape (members, 6)
    messages: dict[int, str]  # by member, where the status isn't 0
    interpolants: Interpolants | None
    events: tuple[Any, Array, Points] | None  # see `Run.events`
    warnings: list[str]


class Collector:
    """The results of all members, collected as they arrive."""

    def __init__(self, problem: Problem, out: Any) -> None:
        self.problem, self.out = problem, out
        self.members = len(problem.points)
        self._shape = self.members, *problem.plan.frame.point_shape
        self._all: MemberResults | None = None
        if out is not None:
            assert problem.t_eval is not None
            shape, dtype = self._shape, problem.plan.frame.dtype
            if problem.observer is not None and not problem.keeps_points:
                shape, dtype = (self.members, *problem.observer.shape), np.dtype(np.float64)
            _check_out(out, (len(problem.t_eval), *shape), dtype)
        self._jumps: dict[int, tuple[Array, Points]] = {}  # times and points after jumps
        self._outputs: dict[int, DenseOutput] = {}
        if problem.events is not None:  # lists by event and member, points on both sides of jumps
            count = len(problem.events)
            self._times: list[Any] = [[None] * self.members for _ in range(count)]
            self._points: list[Any] = [[None] * self.members for _ in range(count)]

    def results(self) -> MemberResults:
        """Return results of all members, with room for those that haven't arrived."""
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
            counts = np.empty((members, len(COUNTS)), dtype=np.int64)
            status, reached = np.empty(members, dtype=np.int64), np.empty(members)
            self._all = MemberResults(t, y, observed, reached, status, counts, {}, None, None, [])
        return self._all

    def add(self, members: slice, results: MemberResults) -> None:
        """Add the results of some members."""
        if results.events is not None:
            self._add_events(members.start, results)
        if results.interpolants is not None:
            problem = self.problem
            start = problem.t0, problem.direction
            for k, point in enumerate(problem.points[members], members.start):
                interpolants = results.interpolants.member(k - members.start)
                if problem.inertia is not None:
                    interpolants = replace(interpolants, plan=problem.inertia.plan(k, problem.plan))
                self._outputs[k] = DenseOutput(interpolants, *start, point, self._jumps.get(k))
        if self.out is None and len(results.status) == self.members:
            self._all = results
            return
        whole = self.results()
        for array, rows in ((whole.y, results.y), (whole.observed, results.observed)):
            if array is not None:
                array[:, members] = rows
        for name in ("reached", "status", "counts"):
            getattr(whole, name)[members] = getattr(results, name)
        whole.messages.update((members.start + k, text) for k, text in results.messages.items())
        whole.warnings.extend(results.warnings)

    def _add_events(self, first: int, results: MemberResults) -> None:
        """Add the events of some members."""
        assert results.events is not None
        assert self.problem.events is not None
        indices, t, y = results.events
        members, count = len(results.status), len(self.problem.events)
        if self.problem.dense_output:
            after = (_by_key(indices[:, 0], values, members) for values in (t, y[:, 1]))
            self._jumps.update(enumerate(zip(*after, strict=True), first))
        for lists, values in ((self._times, t), (self._points, y)):
            arrays = split_events(indices, values, members, count)
            for row, of_event in zip(lists, arrays, strict=True):
                row[first : first + members] = of_event

    def solution(self) -> EnsembleSolution:
        """Return the solution of all members."""
        problem, results = self.problem, self.results()
        messages, failures = results.messages, {}
        if messages:
            failures = {k: messages[k] for k in np.flatnonzero(results.status < 0).tolist()}
        message = failed_members(failures, self.members) if failures else FINISHED
        if not failures and len(messages) == self.members:
            message = TERMINAL_EVENT
        results.t.setflags(write=False)
        for array in (results.y, results.observed):
            if array is not None and array is not self.out:
                array.setflags(write=False)
        outputs = [self._outputs[k] for k in range(self.members)] if problem.dense_output else []
        events: dict[str, Any] = {"t_events": None, "y_events": None, "y_after": None}
        if problem.events is not None:
            sides = ([[points[:, i] for points in row] for row in self._points] for i in range(2))
            events = dict(zip(events, (self._times, *sides), strict=True))
        fields = {
            "t": results.t,
            "y": results.y,
            "sol": EnsembleOutput(outputs) if problem.dense_output else None,
            "t_end": results.reached,
            **events,
            "status": results.status,
            **dict(zip(COUNTS, results.counts.T, strict=True)),
            "messages": dict(sorted(messages.items())),
            "message": message,
            "success": not failures,
            "table": problem.plan.table,
            "frame": problem.plan.user_frame,
            "h": problem.control.h,
            "observed": results.observed,
            "_direction": problem.direction,
        }
        solution = filled(EnsembleSolution, fields)
        return problem.split_solution(problem, solution) if problem.split_solution else solution


def split_events(indices: Any, values: Array, members: int, events: int) -> list[list[Array]]:
    """Return for each event the values of each member; a row of ``indices`` is (member, event)."""
    rows = _by_key(members * indices[:, 1] + indices[:, 0], values, members * events)
    return [rows[members * i : members * (i + 1)] for i in range(events)]


def _by_key(keys: Any, values: Array, count: int) -> list[Array]:
    """Return the values with each key from 0 to ``count - 1``, in their order."""
    order = np.argsort(keys, kind="stable")
    values = values[order]
    bounds = np.searchsorted(keys[order], np.arange(count + 1)).tolist()
    return [values[begin:end] for begin, end in pairwise(bounds)]


def solution_of(problem: Problem, results: MemberResults) -> Solution:
    """Return the solution of a problem of one point."""
    if problem.events is not None or problem.dense_output or problem.split_solution is not None:
        collector = Collector(problem, None)
        collector.add(slice(0, 1), results)
        solution = collector.solution()[0]
        return solution if problem.with_gradients is None else problem.with_gradients(solution)
    results.t.setflags(write=False)
    end, status = results.reached.item(0), results.status.item(0)
    fields = member_fields(results, 0, problem.direction, end, status, results.counts[0].tolist())
    fields |= {
        "sol": None, "t_events": None, "y_events": None, "y_after": None,
        "table": problem.plan.table, "frame": problem.plan.user_frame, "h": problem.control.h,
    }  # fmt: skip
    return filled(Solution, fields)


def _check_out(out: Any, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
    """Raise TypeError or ValueError unless an array can hold all points."""
    try:
        actual, stored = tuple(out.shape), np.dtype(out.dtype)
    except (AttributeError, TypeError):
        raise TypeError(
            f"out must be an array, such as one of NumPy, zarr or h5py, got {out!r}"
        ) from None
    if actual != shape:
        raise ValueError(f"out must have shape {shape}, got {actual}")
    if stored.kind not in "fc" or not np.can_cast(dtype, stored, "same_kind"):
        raise ValueError(f"out must be able to hold numbers of type {dtype}, got one of {stored}")
    if not getattr(getattr(out, "flags", None), "writeable", True):
        raise ValueError(f"out must be writable, got {type(out).__name__} that is read-only")
