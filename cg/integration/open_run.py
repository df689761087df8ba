"""The run of a stepper, which stays open from call to call."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from cg.frames.base import Frame
from cg.integration.arguments import check_stops
from cg.integration.friction import check_members
from cg.integration.loop.dense import DenseOutput, EnsembleOutput
from cg.integration.loop.drive import StepBudget
from cg.integration.loop.failures import explain_failure
from cg.integration.loop.messages import TERMINAL_EVENT, failed_members
from cg.integration.loop.run import Run
from cg.integration.problem import Problem
from cg.integration.rhs.inputs import Inputs
from cg.support.arrays import Array, Points
from cg.support.shared_numbers import Stop
from cg.support.shared_records import COUNTERS
from cg.tables import MethodTable, made

_FAR = 2.0**40  # fixed steps without a final time
_NO_LIMIT = 2**62
_STEPS = list(COUNTERS).index("steps")
_PAUSED, _FINISHED = int(Stop.PAUSED), int(Stop.FINISHED)
_FULL, _TERMINAL = int(Stop.BUFFER_FULL), int(Stop.TERMINAL_EVENT)  # much faster than members


class _Events(NamedTuple):
    """Events of a call: which ones, their times, and the points before and after jumps."""

    of: Any
    t: Array
    before: Points
    after: Points


class OpenRun:
    """A run that takes a step, or steps up to a time, in each call."""

    f: Any
    frame: Frame
    table: MethodTable
    direction: float

    @property
    def method(self) -> Any:
        """The method, a `cg.Method`."""
        return made(self.table)

    def _open(self, problem: Problem, bound: float, breakpoints: Any, first: float | None) -> None:
        """Open the run of a problem that ends where it starts."""
        start, h = problem.t0, problem.control.h
        self.frame, self.table = problem.plan.frame, problem.plan.method
        self.t_bound, self._many, self._common = bound, problem.many, problem.common
        self._first_step = first
        self._breakpoints = check_stops(breakpoints, start, self._end_from(start, h))
        self._tolerance = problem.control.tolerance
        self._stops = self._with_corners(problem.rhs.inputs, start)
        self._budget = StepBudget()
        self._failure, self._calls = "", 0
        self._found: list[_Events] = []
        self._cut_output: DenseOutput | None = None
        control = problem.control._replace(first_step=first, max_steps=_NO_LIMIT)
        self._problem = replace(problem, stops=self._stops, control=control, t_eval=None, every=0)
        self.t_old: float | None = None
        self.step_size: float | None = None
        self.status = "running" if start != bound else "finished"
        self._make_run()

    def _end_from(self, t: float, h: float | None) -> float:
        """Return the final time of a run that starts at a time."""
        endless = h is not None and math.isinf(self.t_bound)
        return t + self.direction * _FAR * h if endless and h else self.t_bound

    def _with_corners(self, inputs: Inputs | None, t: float) -> Array:
        """Return the ends of segments: breakpoints, corners of inputs from a time on, and the end.

        If inputs end before, that is their end.
        """
        stops = self._breakpoints
        if inputs is None:
            return stops
        end, sign = inputs.reach(t, self.direction), self.direction
        if sign * end < sign * stops[-1]:
            stops = np.append(stops[sign * stops < sign * end], end)
        return inputs.add_stops(stops, t, self._tolerance)

    def _set_limits(self, inputs: Inputs) -> None:
        """Set how long steps may be over new inputs, from the next restart on."""
        limits = inputs.limits(self._tolerance)
        if len(limits) or len(self._problem.limits):
            self._problem = replace(self._problem, limits=limits)
            self._run.share_limits(limits)

    def _make_run(self) -> None:
        self._run = run = Run(self._problem, keep_last=True, lanes=len(self._problem.points))
        self._core, self._target, self.t = run._core, np.empty(1), run.t0
        self._begin(run.t0, run.end, self._first_step)
        self._stops_are_set = True  # whether compiled code uses `_stops`

    def _begin(self, t: float, rows: Points, first_step: float | None) -> None:
        """Start all trajectories anew at a time, from points ``(members, width)``."""
        run = self._run
        self._core.loop_restart(run.address, t, rows.T, first_step or 0.0, run.rhs.data_address)
        if rows is not run.end:
            run.end[...] = rows
        run.reached[...] = t
        record = run.record
        record.ended = record.failed = record.raised = 0
        self._stops_are_set = False

    def _continue(self, stops: Array) -> None:
        """Continue all trajectories with new ends of segments, without those that have passed.

        An end at `t` itself is kept: ``f`` is then evaluated on the side of the last step.
        """
        record = self._run.record
        if len(stops) > 1:
            stops = stops[self.direction * (stops - self.t) >= 0.0]
        self._core.loop_continue(self._run.address, stops)
        record.ended = record.failed = record.raised = 0

    def _drive(self, target: float | None) -> str | None:
        """Take steps up to a time or, if it is None, one step; return a message if that failed."""
        run, begin = self._run, self.t
        self._cut_output, self.status = None, "running"
        start = run.end.copy() if self._many else None
        steps = int(run.counts[0, 4])
        message, is_complete = None, False
        try:
            message = self._take_step(steps) if target is None else self._take_steps()
            is_complete = message is None
        finally:
            cut = run.problem.events is not None and self._collect_events()
            if not is_complete:
                self._end_early(start, steps)
        return self._arrive(begin, target, cut) if is_complete else message

    def _take_step(self, steps: int) -> str | None:
        """Take a step after some number of them; return a message if it failed."""
        run, record, counters = self._run, self._run.record, self._run.counters
        taken = False
        while not taken or counters.item(0) == _FULL:
            record.budget = 0 if taken else run.members  # zero only to empty a buffer
            run.call()
            if record.failed:
                return self._check_failures()
            taken = counters.item(_STEPS) != steps
        return None

    def _take_steps(self) -> str | None:
        """Take steps up to the end of the last segment; return a message if one failed."""
        run, record, budget = self._run, self._run.record, self._budget
        while record.ended < run.members:
            record.budget = given = budget.start()
            run.call()
            budget.stop(max(given - record.budget, 1))
            if record.failed:
                return self._check_failures()
        return None

    def _arrive(self, begin: float, target: float | None, cut: bool) -> str | None:
        """Set the time after complete steps; return a message at an event before the target.

        ``cut`` tells whether an event ended the last step.
        """
        run = self._run
        stopped = run.problem.events is not None and run.status[0] == _TERMINAL
        if target is None or stopped:
            self.t = run.reached.item(0)
        else:
            self.t = target
        if cut:
            self._end_at_state()
            self._cut_output = self._interpolate()
        elif target is None:
            self.t_old, self.step_size = begin, abs(self.t - begin)
        else:
            self.step_size = abs(run.record.step_size)
            self.t_old = target - self.direction * self.step_size
        if self.t == self.t_bound:
            self.status = "finished"
        elif stopped:
            self.status = "event"
        self._calls += 1
        if self._calls & (self._calls - 1) == 0:  # ever more rarely
            check_members(run.plan, run.rhs, self.t, run.plan.points(run.end, (run.members,)), True)
        return TERMINAL_EVENT if stopped and self.t != target is not None else None

    def _collect_events(self) -> bool:
        """Keep the events of the run; return whether the last one ended a step."""
        run = self._run
        if not run._events:
            return False
        of, t, y = run.events()
        run._events.clear()
        self._found.append(_Events(of[:, 1], t, y[:, 0], y[:, 1]))
        table = run.problem.events
        assert table is not None
        ends = run.status[0] == _TERMINAL or table.rows[of[:, 1], 4].any()
        return bool(ends and t[-1] == run.reached[0])

    def _event_lists(self, name: str) -> list[Array] | None:
        """Return an array for each event, None without events."""
        table = self._problem.events
        if table is None:
            return None
        frame, found = self.frame, self._found
        shape, kind = ((0,), np.float64) if name == "t" else ((0, *frame.point_shape), frame.dtype)
        return [
            np.concatenate([np.empty(shape, kind), *(getattr(f, name)[f.of == i] for f in found)])
            for i in range(len(table))
        ]

    def _end_at_state(self) -> None:
        """Set the start of the last step to that in the state of the trajectory."""
        self.t_old = float(self._run.state()[0][0, 3])
        self.step_size = abs(self.t - self.t_old)

    def _end_early(self, start: Points | None, steps: int) -> None:
        """Return an ensemble to its points ``start``; set the time of the last step of one point.

        Of the members some are ahead of others. ``steps`` is the count before the call.
        """
        run = self._run
        if start is not None:
            self.t_old = None
            self._begin(self.t, start, self._first_step)
            return
        run.record.ended = run.record.failed = run.record.raised = 0
        self._stops_are_set = False
        self.t = float(run.reached[0])
        if run.counts[0, 4] > steps:
            self._end_at_state()

    def _interpolate(self) -> DenseOutput:
        run = self._run
        # f is evaluated before a breakpoint at the end of the step
        at_breakpoint = bool((self._stops[:-1] == self.t).any())
        beyond = self.t + self.direction
        self._continue(np.array([self.t, beyond] if at_breakpoint else [beyond]))
        self._stops_are_set = False
        run.allocate_interpolants(run.members)
        self._core.loop_set_output(run.address)
        self._core.loop_interpolate(run.address)
        run.record.budget = 0
        try:
            run.call()
            steps = run.interpolants()
        finally:
            run.stop_interpolants()
        begin = float(steps.t[0, 0])
        outputs = [
            DenseOutput(
                steps.of(k),
                begin,
                self.direction,
                run.plan.points(steps.of(k).y[:1, 0], (1,))[0],
            )
            for k in range(run.members)
        ]
        return EnsembleOutput(outputs) if self._many else outputs[0]

    def _check_failures(self) -> str:
        """Return the message for failed steps; raise other errors."""
        run = self._run
        bad = np.flatnonzero((run.status != _PAUSED) & (run.status != _FINISHED)).tolist()
        self.status = "failed"
        failure = explain_failure(run, bad[0])
        self._failure = str(failure)
        if isinstance(failure, Exception):
            raise failure
        if not self._many:
            return f"Failure: {failure}."
        return failed_members(dict.fromkeys(bad, self._failure), run.members)
