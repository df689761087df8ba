"""Runs: trajectories of any number of members, advanced by compiled code.

Python passes numbers and addresses in one record (`RUN` of `cg.support.shared_records`). A call
of compiled code returns when all members have ended, or the budget of steps is used up; then Python
collects what is stored of steps and calls again.
"""

from __future__ import annotations

import ctypes
import re
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.integration.output.solutions import Interpolants
from cg.integration.plan.callbacks import Callbacks
from cg.integration.problem import Problem
from cg.integration.rhs.compiled import CompiledRhs
from cg.integration.rhs.python import PythonRhs, Rhs
from cg.support.arrays import Array, Points, address_of
from cg.support.memory import check_memory
from cg.support.shared_numbers import (
    EventColumn,
    InterpolantColumn,
    JacobianKind,
    LoopStatus,
    RhsFlag,
    Stored,
)
from cg.support.shared_records import COUNTERS, COUNTS, RUN, STATE, fields_of
from cg.tables import Kind

_READ_ONLY = re.compile("read-?only|not writ")  # in messages of NumPy and of Cython
_MIN_CHECKED_BYTES = 1 << 20  # below, a check of memory takes longer than the integration
_LANES = 1024  # largest number of members integrated at the same time by a vectorized function
_STEPS, _INTERPOLANTS, _EVENTS = map(int, Stored)
_ALL = slice(None)
_INTERPOLANT_COLUMNS, _EVENT_COLUMNS = len(InterpolantColumn), len(EventColumn)
_FAILED = {RhsFlag.OBSERVER_FAILED: "observe", RhsFlag.STEP_FUNCTION_FAILED: "step_function"}


class RunRecord(ctypes.Structure):
    """The record of a run in compiled code."""

    _fields_ = fields_of(RUN)


class Run:
    """Trajectories that start at the same time, and their output.

    Points at ``t_eval`` are written into ``y``, shape ``(times, members, width)``, and what is
    observed into ``observed``, shape ``(times, members, count)``. With ``keep_last`` the
    interpolant of the last step may be requested. By default one member at a time is integrated, or
    up to 1024 by a vectorized function.

    Each member has its last point ``end`` as doubles, shape ``(members, width)``, and the time
    ``reached`` of that point; a `LoopStatus` as ``status``; as ``detail`` the error code of a
    compiled function, an `RhsFlag`, or the number of the event or of the iterations that the status
    is about; and ``counts``, shape ``(members, 6)``, see `COUNTS`.
    """

    address = 0  # address of the run in compiled code

    def __init__(
        self, problem: Problem, *, y: Array | None = None, observed: Array | None = None,
        keep_last: bool = False, lanes: int | None = None,
    ) -> None:  # fmt: skip
        self.problem, self.rhs = problem, problem.rhs
        self.plan = plan = problem.plan
        self._core, self.control, self.t0 = plan.core, problem.control, problem.t0
        self.members = members = len(problem.points)
        if lanes is None:
            lanes = members if problem.common_steps else _LANES if problem.vectorized else 1
        self._lanes = min(lanes, members)
        events, jacobian = problem.events, problem.jacobian
        self._event_count = 0 if events is None else len(events)
        if jacobian is not None:
            jacobian = replace(jacobian, lanes=self._lanes, kept={})  # with matrices of its own
        self.callbacks = Callbacks(plan, self.rhs, events, jacobian)
        self.record = self._make_record(keep_last)
        solver_size = 0
        if not plan.step_table.explicit:
            self.record.jacobian = self._jacobian_kind()
            solver_size = self._solver_size()
        self._buffers: dict[str, Any] = {}
        # the rows that calls have stored, in which members and events are counted from 1
        ends, count = 2 * plan.width, 0 if problem.observer is None else problem.observer.count
        point = 1 + plan.width * problem.keeps_points
        self._bounds = point, point + count  # where points and observations end
        width = _INTERPOLANT_COLUMNS + ends + plan.interpolant_vectors * plan.dim
        self._widths = point + count, width, _EVENT_COLUMNS + ends
        self._stored: tuple[list[Array], ...] = [], [], []
        self.events_of_calls = self._stored[_EVENTS]
        self._share_members(plan.doubles(problem.points))
        for name, array in (("y", y), ("observed", observed)):
            if array is not None and len(array):
                self.record.outputs = len(array)
                self._share("times", np.array(problem.t_eval))
                self._share(name, array)
        self._share_problem()
        self._open(solver_size)

    def _make_record(self, keep_last: bool) -> RunRecord:
        plan, problem, control, events = self.plan, self.problem, self.control, self.problem.events
        record = RunRecord()  # setting its entries takes half the time of arguments by keyword
        record.members, record.lanes = self.members, self._lanes
        record.first_member, record.common = problem.first_member, problem.common_steps
        record.keep_last, record.goes_on = keep_last, keep_last and not problem.ensemble
        record.t0, record.segments = problem.t0, len(problem.segment_ends)
        record.function, record.data, record.data_stride = self.rhs.addresses()
        record.of_time, record.vectorized = problem.linear, self.rhs.vectorized
        record.context = id(self.callbacks)
        if events is not None:
            record.event_functions, record.event_width = self._event_count, events.width
        in_coordinates = record.in_coordinates = control.h is not None or problem.in_coordinates
        record.reals_per_entry = 1 if in_coordinates else plan.reals_per_entry
        if control.rtol.ndim:
            record.rtol = control.rtol.min()
        else:
            record.rtol, record.atol = control.rtol.item(), control.atol.item()
        record.h, record.first_step = control.h or 0.0, control.first_step or 0.0
        record.max_step, record.max_steps = control.max_step, control.max_steps
        record.every, record.exponent = problem.every, plan.step_table.exponent
        record.keeps_points, record.dense = problem.keeps_points, problem.dense_output
        if problem.thermostat is not None:
            record.heated = True
            for name, number in vars(problem.thermostat).items():
                setattr(record, name, number)
        return record

    def _jacobian_kind(self) -> JacobianKind:
        """Return how the Jacobian for implicit stages is evaluated."""
        problem, kind, jacobian = self.problem, self.plan.step_table.kind, self.problem.jacobian
        if jacobian is not None:
            return JacobianKind.OUTSIDE if jacobian.sparse else JacobianKind.MATRIX
        iterated = problem.stage_solver == "fixed-point" and kind is not Kind.COLLOCATION
        return JacobianKind.OUTSIDE if iterated else JacobianKind.DIFFERENCES

    def _solver_size(self) -> int:
        """Return how many doubles are kept to solve implicit stages, most of them in matrices."""
        plan, stages = self.plan, self.plan.table.stages
        factors = plan.dim if self.record.jacobian != JacobianKind.OUTSIDE else 0
        if plan.step_table.kind is Kind.COLLOCATION:
            return 4 * (stages - 1 + factors) * plan.dim
        blocks = plan.step_table.record.blocks
        return (factors * stages**2 // blocks + stages) * plan.dim if factors and blocks else 0

    def _open(self, solver_size: int) -> None:
        """Open the run in compiled code, which allocates memory for the members in its lanes.

        ``solver_size`` is the number of doubles that the solver of implicit stages keeps.
        """
        plan, problem, record, lanes = self.plan, self.problem, self.record, self._lanes
        interpolates = record.dense or record.outputs or self._event_count or record.keep_last
        if interpolates and problem.in_coordinates:
            record.unique_flows = plan.unique_flows(problem.points[0])
        vectors = plan.step_table.kept_vectors + 4 * plan.step_table.kept_nodes
        vectors += 2 * plan.interpolant_vectors if interpolates else 0
        # bytes of points and coefficients at the stages, and of the matrices of Newton's method
        needed = lanes * 8 * (vectors * (plan.width + 2 * plan.dim) + solver_size)
        if problem.inertia is not None:  # its copy, and a record of less than 1 KiB for each body
            needed += problem.inertia.constants.nbytes + (problem.inertia.signed_columns.size << 10)
        self._check_memory(needed)
        self.address = self._core.run_open(plan.address, ctypes.addressof(record))
        if not self.address:
            raise MemoryError(f"there is not enough memory for {lanes} trajectories at a time")

    def _check_memory(self, needed: int) -> None:
        if self._lanes > 1 or needed > _MIN_CHECKED_BYTES:
            check_memory(needed, f"{self._lanes} trajectories of {self.plan.width} numbers")

    def __del__(self) -> None:
        if self.address:
            self._core.run_close(self.address)

    def _share_members(self, doubles: Array) -> None:
        """Share arrays for the state and the counts of each member."""
        members, width = doubles.shape
        self._states = states = self._share("states", np.empty((members, width + len(STATE))))
        counters = self._share("counters", np.empty((members, len(COUNTERS)), dtype=np.int64))
        self.end = states[:, :width]
        self.reached = self.state("reached")
        self.counters, self.counts = counters, counters[:, 2:]
        self.status, self.detail = counters[:, 0], counters[:, 1]
        self.end[...] = doubles

    def state(self, name: str) -> Array:
        """Return a number of each member, see `STATE`."""
        column: Array = self._states[:, self.plan.width + STATE.index(name)]
        return column

    def _share(self, name: str, array: Any) -> Any:
        """Put the address of an array into the record, and keep the array alive."""
        self._buffers[name] = array
        if array.size:
            setattr(self.record, name, address_of(array))
        return array

    def _share_problem(self) -> None:
        """Share the arrays and the functions of the problem."""
        problem, control = self.problem, self.control
        self._share("stops", problem.segment_ends)
        if problem.limits.size:
            self.share_limits(problem.limits)
        self._share_functions()
        if problem.inertia is not None:
            self.record.constants_per_member = problem.inertia.constants.shape[1]
            self._share("bodies", problem.inertia.signed_columns)
            self._share("body_constants", problem.inertia.constants)
        if control.rtol.ndim:
            count = self.plan.dim if self.record.in_coordinates else self.plan.width
            tolerances = np.array([control.rtol, control.atol]).reshape(2, -1)
            self._share("tolerances", tolerances.repeat(count // tolerances.shape[1], axis=1))
        if problem.events is not None and self._event_count:
            self._share("event_table", problem.events.rows)

    def _share_functions(self) -> None:
        """Share functions along the solution, and the table of inputs of compiled functions."""
        rhs, problem = self.rhs, self.problem
        for function in (problem.observer, problem.step_function):
            if function is not None:
                record = self._buffers[function.name] = function.make_record(rhs)
                setattr(self.record, function.entry, ctypes.addressof(record))
        parameters, inputs = rhs.extra.parameters, rhs.extra.inputs
        if inputs is not None and isinstance(rhs, CompiledRhs):
            self.record.curves = len(self._share("inputs", inputs.table(parameters)))

    def share_limits(self, limits: Array) -> None:
        """Share the limits of steps, which compiled code reads when a run opens or restarts."""
        self.record.limited = len(self._share("limits", limits))

    def call(self, steps: int) -> int:
        """Let compiled code try some steps, collect its output, and return how many were tried."""
        self.record.budget = steps
        # bytes of what one step of each lane stores: points, times, slopes and events
        self._check_memory(32 * self._lanes * (self.plan.width + self.plan.dim + 2))
        try:
            self._core.run_drive(self.address)
        except Exception as error:
            self._add_note(error)
            raise
        finally:
            self._collect()
        record, jacobian = self.record, self.problem.jacobian
        if jacobian is not None and jacobian.constant:
            self.counts[:, COUNTS.index("njev")] = 0
        if record.raised:
            names = [name for flag, name in _FAILED.items() if (self.detail == flag).any()]
            name = (*names, "events")[0]
            kind = "positive" if name == "step_function" else "finite"
            t = self.state("failed_at")[self.status == LoopStatus.RAISED][0]
            raise ValueError(
                f"{name} must return {kind} numbers, got one that isn't {kind} at t = {t:.17g}"
            )
        return max(steps - int(record.budget), 1)

    def _add_note(self, error: Exception) -> None:
        """Add to an exception of a function of the user when it happened, and in which member."""
        rhs, call, self.callbacks.failed_event = self.rhs, self.callbacks.failed_event, None
        raised = np.flatnonzero(self.status == LoopStatus.RAISED).tolist()
        failed_members = np.flatnonzero(np.isin(self.detail, list(_FAILED))).tolist()
        if call is None and failed_members:
            k = failed_members[0]
            call = _FAILED[RhsFlag(self.detail[k])], float(self.state("failed_at")[k]), k
        if call is not None:
            name, t, member = call
            u, first = "" if rhs.extra.inputs is None else "u, ", rhs.extra.first_member
            in_member = "" if first is None or member is None else f" in member {first + member}"
            error.add_note(f"in {name}(t, y, {u}...) at t = {t:.17g}{in_member}")
        elif isinstance(rhs, PythonRhs) and raised and not rhs.vectorized:
            error.add_note(rhs.note(float(self.state("failed_at")[raised[0]]), raised[0]))
        if isinstance(error, ValueError) and _READ_ONLY.search(str(error)):
            error.add_note("points are read-only: y = y.copy() first")

    def _collect(self) -> None:
        """Collect the rows that a call has stored."""
        counts = self.record.steps, self.record.interpolants, self.record.events
        for kind, count in enumerate(counts):
            if count:
                rows = np.empty((count, self._widths[kind]))
                self._core.run_rows(self.address, kind, rows.T)
                self._stored[kind].append(rows)

    def _stored_rows(self, kind: int, columns: Any = _ALL) -> Array:
        """Return columns of all stored rows of a kind, a `Stored`, as a new array."""
        calls = self._stored[kind]
        if len(calls) == 1:
            return calls[0][:, columns].copy()
        start = np.empty((0, self._widths[kind]))
        return np.concatenate([rows[:, columns] for rows in (start, *calls)])

    def steps(self) -> tuple[Array, Array | None, Array | None]:
        """Return times, points as doubles and observations of the start and all stored steps."""
        point, end = self._bounds
        y = self._stored_rows(_STEPS, slice(1, point)) if point > 1 else None
        observed = self._stored_rows(_STEPS, slice(point, end)) if end > point else None
        return self._stored_rows(_STEPS, 0), y, observed

    def interpolants(self) -> Interpolants:
        """Return the stored interpolants in the order of the members."""
        rows = self._stored_rows(_INTERPOLANTS)
        members = rows[:, InterpolantColumn.MEMBER]
        if (np.diff(members) < 0).any():
            rows = rows[np.argsort(members, kind="stable")]
        return Interpolants(self.plan, rows)

    def last_interpolants(self) -> Interpolants:
        """Return the interpolants of the last step, which ``keep_last`` keeps."""
        self._core.run_continue(self.address, True)
        try:
            self.call(0)
            return self.interpolants()
        finally:
            self._stored[_INTERPOLANTS].clear()

    def restart(
        self, t: float, rows: Array, first_step: float | None, stopped: NDArray[np.bool_]
    ) -> None:
        """Start trajectories anew at a time, from points as doubles, except those that stopped."""
        self.record.data = self.rhs.data_address
        self._core.run_restart(self.address, t, rows.T, first_step or 0.0, stopped.view(np.int8))

    def resume(self, segment_ends: Array) -> None:
        """Continue trajectories with other ends of segments."""
        self.record.segments = len(self._share("stops", segment_ends))
        self._core.run_continue(self.address, False)

    def saved(self) -> dict[str, Any]:
        """Return the state that another run of the same problem needs to go on."""
        states = np.empty((self._lanes, self.record.state_size), np.int8)
        self._core.run_state(self.address, False, states.T)
        jacobian = self.callbacks.jacobian
        kept = {} if jacobian is None else jacobian.kept
        return {
            "states": states,
            "events": list(self.events_of_calls),
            "matrices": {member: matrix for member, (matrix, *_) in kept.items()},
        }

    def restore(self, saved: dict[str, Any]) -> None:
        """Go on from the state that another run has saved."""
        if (jacobian := self.callbacks.jacobian) is not None:
            jacobian.kept.update((k, [matrix]) for k, matrix in saved["matrices"].items())
        self._core.run_state(self.address, True, saved["states"].T)
        self.events_of_calls[:] = saved["events"]

    def replace_rhs(self, rhs: Rhs) -> None:
        """Replace the right-hand side by another one of the same kind."""
        self.rhs = self.callbacks.rhs = rhs
        self._share_functions()
        if self.callbacks.jacobian is not None:
            self.callbacks.jacobian.kept.clear()

    def events(self) -> tuple[NDArray[np.int64], Array, Points]:
        """Return all events: indices of member and event ``(n, 2)``, times ``(n,)``, points.

        The points before and after each have the shape ``(n, 2, *point_shape)``.
        """
        plan = self.plan
        rows = self._stored_rows(_EVENTS)
        indices = rows[:, [EventColumn.MEMBER, EventColumn.NUMBER]].astype(np.int64) - 1
        points = np.ascontiguousarray(rows[:, _EVENT_COLUMNS:])
        return indices, rows[:, EventColumn.TIME].copy(), plan.points(points, (len(rows), 2))
