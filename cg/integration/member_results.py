"""Results of the members of an ensemble, collected as they arrive."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from cg.frames.arrays import Array, Points
from cg.integration.ivp import warn_off_manifold
from cg.integration.loop.dense import DenseOutput, EnsembleOutput, Steps
from cg.integration.loop.messages import FINISHED, TERMINAL_EVENT, failed_members
from cg.integration.loop.record import COUNTS
from cg.integration.problem import Problem
from cg.integration.results import EnsembleSolution


@dataclass(frozen=True)
class MemberResults:
    """Results of some members: points at all times, status and counts of each, steps and events."""

    y: Points
    reached: Array
    status: Any
    counts: Any
    messages: dict[int, str]
    steps: Steps | None
    events: tuple[Any, Array, Points]


class EnsembleResults:
    """The results of all members, collected as they arrive."""

    def __init__(self, problem: Problem, out: Any) -> None:
        plan = problem.plan
        assert problem.t_eval is not None
        self._problem = problem
        self._members = members = len(problem.points)
        shape = (len(problem.t_eval), members, *plan.frame.point_shape)
        self._out = out
        if out is None:
            self._y: Any = np.full(shape, math.nan, dtype=plan.frame.dtype)
        else:
            _check_out(out, shape, plan.frame.dtype)
            self._y = out
        self._reached = np.full(members, problem.t0)
        self._status = np.full(members, -1)
        self._counts = np.zeros((members, len(COUNTS)), dtype=np.int64)
        self._messages: dict[int, str] = {}
        self._outputs: dict[int, DenseOutput] = {}
        self._table = problem.event_table() if problem.events is not None else None
        self._events: dict[int, list[tuple[Array, Points]]] = {}
        self._any_finished = False

    def add(self, members: slice, part: MemberResults) -> None:
        """Add the results of some members."""
        self._any_finished = True
        self._y[:, members] = part.y
        if len(part.y):
            warn_off_manifold(self._problem.plan, part.y[-1], stacklevel=5)
        self._reached[members] = part.reached
        self._status[members] = part.status
        self._counts[members] = part.counts
        self._messages.update((members.start + k, text) for k, text in part.messages.items())
        of, t, y = part.events
        order = np.argsort(of[:, 0], kind="stable")
        of, t, y = of[order], t[order], y[order]
        bounds = np.searchsorted(of[:, 0], np.arange(len(part.status) + 1))
        for k in range(len(part.status)) if self._table or part.steps else ():
            own = slice(bounds[k], bounds[k + 1])
            if part.steps is not None:
                point = self._problem.points[members.start + k]
                marks = t[own], y[own, 1]
                self._outputs[members.start + k] = DenseOutput(
                    part.steps.of(k), self._problem.t0, point, marks
                )
            if self._table is not None:
                which = of[own, 1]
                self._events[members.start + k] = [
                    (t[own][which == i], y[own][which == i]) for i in range(len(self._table))
                ]

    def add_failure(self, members: slice, message: str) -> None:
        """Record that the worker of some members died."""
        for member in range(members.start, members.stop):
            self._messages[member] = message
        if self._out is not None:
            self._y[:, members] = math.nan

    def solution(self) -> EnsembleSolution:
        """Return the solution of all members."""
        failures = {k: self._messages[k] for k in np.flatnonzero(self._status < 0).tolist()}
        if not self._any_finished:
            raise RuntimeError(failed_members(failures, self._members))
        problem = self._problem
        if self._out is None:
            self._y.flags.writeable = False
        assert problem.t_eval is not None
        t = problem.t_eval.copy()
        t.flags.writeable = False
        counts: dict[str, Any] = dict(zip(COUNTS, self._counts.T, strict=True))
        message = FINISHED
        if failures:
            message = failed_members(failures, self._members)
        elif (self._status == 1).all():
            message = TERMINAL_EVENT
        sol = None
        if problem.dense:
            empty = {k for k in range(self._members) if k not in self._outputs}
            for k in empty:
                self._outputs[k] = self._empty_output(k)
            sol = EnsembleOutput([self._outputs[k] for k in range(self._members)])
        return EnsembleSolution(
            t=t,
            y=self._y,
            sol=sol,
            t_end=self._reached,
            **self._event_lists(),
            status=self._status,
            **counts,
            messages=dict(sorted(self._messages.items())),
            message=message,
            success=not failures,
            method=problem.plan.method,
            frame=problem.plan.frame,
            h=problem.control.h,
        )

    def _empty_output(self, member: int) -> DenseOutput:
        """Return the continuous solution of a member whose worker died: its initial point."""
        plan = self._problem.plan
        width = plan.columns * plan.frame.dim
        none = np.empty(0, dtype=np.int64)
        steps = Steps(
            plan, none, np.empty((0, 4)), np.empty((0, 2, plan.width)), np.empty((0, width))
        )
        return DenseOutput(steps, self._problem.t0, self._problem.points[member])

    def _event_lists(self) -> dict[str, Any]:
        if self._table is None:
            return {"t_events": None, "y_events": None, "y_after": None}
        none = [(np.empty(0), np.empty((0, 2, *self._problem.plan.frame.point_shape)))]
        nothing = none * len(self._table)
        rows = [self._events.get(k, nothing) for k in range(self._members)]
        events = range(len(self._table))
        return {
            "t_events": [[row[i][0] for row in rows] for i in events],
            "y_events": [[row[i][1][:, 0] for row in rows] for i in events],
            "y_after": [[row[i][1][:, 1] for row in rows] for i in events],
        }


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
