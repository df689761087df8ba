"""Runs: trajectories of any number of members, which compiled code takes to their ends."""

from __future__ import annotations

import ctypes
import math
import weakref
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.frames.arrays import Array, Points
from cg.integration.callbacks import Callbacks
from cg.integration.compiled_rhs import CompiledRhs
from cg.integration.dense import Steps
from cg.integration.events import EventTable
from cg.integration.implicit import DEFAULT_STAGE_SOLVER, ImplicitStages
from cg.integration.messages import (
    failure,
    flow_not_finite,
    no_progress,
    too_many_steps,
    too_small_a_step,
)
from cg.integration.plan import Plan
from cg.integration.python_rhs import PythonRhs, StageOverflowError
from cg.integration.step_budget import StepBudget
from cg.memory import reserved
from cg.parallel import raise_if_stopped
from cg.shared_numbers import RECORD, Stop
from cg.tableau import Tableau

__all__ = ["Control", "Output", "Run"]

_KINDS: dict[str, Any] = {
    "integer": ctypes.c_int64,
    "real": ctypes.c_double,
    "address": ctypes.c_void_p,
}
COUNTS = ("nfev", "nexp", "njev", "nlu", "steps", "nrejected")
"""What is counted of each member, in the order of compiled code."""

_FEW, _MANY = 64, 2048  # steps that a buffer has room for, at first and at most
_LANES = 1024  # members on their way at the same time for a function of many points


# arrays can't be empty: the direction says that there are none
_NO_EVENTS = np.zeros((2, 1), dtype=np.int64), np.array([2]), np.array([0]), np.array([0])


class _Record(ctypes.Structure):
    _fields_ = [(name, _KINDS[kind]) for name, kind in RECORD.items()]


@dataclass(frozen=True)
class Control:
    """How the sizes of steps are found.

    Attributes
    ----------
    h
        Size of equal steps, or None if an error estimate chooses them.
    rtol, atol
        Tolerances, ``atol`` of shape () or that of `Plan.tolerance_shape`.
    max_step, first_step
        Largest size, and the first one, None to choose it.
    max_steps
        Largest number of chosen steps, rejected ones included.
    """

    h: float | None = None
    rtol: float = 1e-3
    atol: Array | None = None
    max_step: float = math.inf
    first_step: float | None = None
    max_steps: int = 10**6


@dataclass(frozen=True)
class Output:
    """What is kept of trajectories.

    Attributes
    ----------
    times
        Times at which to keep points, or None.
    every
        How many steps there are between those whose ends are kept, 0 to keep none.
    dense
        Whether to keep the solution within steps.
    y
        Where points at ``times`` are written, shape ``(times, members, width)``, or None.
    capacity
        The number of steps that are kept, 0 if it isn't known.
    """

    times: Array | None = None
    every: int = 0
    dense: bool = False
    y: Array | None = None
    capacity: int = 0


class Run:
    """Trajectories from the same time, each with what it needs to go on.

    Parameters
    ----------
    plan
        The frame and the method.
    rhs
        The right-hand side.
    points
        Initial points, shape ``(members, *point_shape)``.
    t0
        Initial time.
    stops
        Times at which steps end and the right-hand side may change: breakpoints, then the end.
    control
        How steps are chosen.
    output
        What is kept.
    events
        Functions whose zeros are looked for.
    common
        Whether all members take the same steps.
    stage_solver
        How implicit stages are found.
    keep_last
        Whether the interpolant of the last step may be asked for.
    lanes
        How many members are on their way at the same time, by default as few as serve.

    Attributes
    ----------
    end, reached
        The last points as doubles, shape ``(members, width)``, and their times.
    status, flag, failed_at
        Of each member a `Stop`, what a compiled function returned, and when it failed.
    counts
        Of each member, shape ``(members, 6)``; see `COUNTS`.
    """

    def __init__(
        self,
        plan: Plan,
        rhs: CompiledRhs | PythonRhs,
        points: Points,
        t0: float,
        stops: Array,
        control: Control,
        output: Output,
        *,
        events: EventTable | None = None,
        common: bool = False,
        stage_solver: str = DEFAULT_STAGE_SOLVER,
        keep_last: bool = False,
        lanes: int | None = None,
    ) -> None:
        import cg._external as core

        self._core = core
        self.plan = plan
        self.rhs = rhs
        self.control = control
        self.output = output
        self.members = members = len(points)
        self.record = _Record(members=members, every=max(output.every, 1), dense=output.dense)
        self._buffers: dict[str, Any] = {}
        self._dense: list[tuple[Array, ...]] = []
        self._steps: list[tuple[Array, ...]] = []
        self._events: list[tuple[Array, ...]] = []
        self._give_members(plan.doubles(points), t0)
        self.t0 = t0
        self.span = abs(float(stops[-1]) - t0)
        if output.times is not None and output.y is not None and len(output.times):
            self.record.wanted = len(output.times)
            self._give("times", np.ascontiguousarray(output.times))
            self._give("y", output.y)
        if lanes is None:
            lanes = members if common else _LANES if rhs.together else 1
        self._lanes = lanes = min(lanes, members)
        self._functions = 0 if events is None else len(events)
        self._capacity = output.capacity or _FEW
        self._make_buffers(self._capacity)
        self.callbacks = self._callbacks(events, stage_solver, lanes)
        functions, direction, most, jumps = _NO_EVENTS
        if events is not None and len(events):
            functions, direction = events.functions.T, events.direction
            most, jumps = events.most, events.jumps
        plan.look_at(points[0])
        shape = plan.tolerance_shape if control.h is None else ()
        atol = np.broadcast_to(1.0 if control.atol is None else control.atol, shape).ravel()
        in_entries = control.h is None and not plan.in_algebra
        parts = plan.parts if in_entries else 1
        needed = 1 << 16 if lanes == 1 else 0
        needed += lanes * 8 * (plan.method.stages + plan.nodes) * (plan.width + 2 * plan.frame.dim)
        with reserved(needed, f"{members} trajectories of {plan.width} numbers"):
            self.address: int = core.loop_open(
                plan.address, ctypes.addressof(self.record), id(self.callbacks), *rhs.addresses(),
                lanes, rhs.together, common, keep_last, t0, stops,
                control.h or 0.0, np.repeat(atol, parts), control.rtol, in_entries, parts,
                plan.exponent, control.max_step, control.first_step or 0.0, control.max_steps,
                functions, direction, most, jumps,
            )  # fmt: skip
        if not self.address:
            raise MemoryError(f"there is not enough memory for {lanes} trajectories at a time")
        self.close = weakref.finalize(self, core.loop_close, self.address)

    def _give_members(self, doubles: Array, t0: float) -> None:
        """Give compiled code memory for what it tells of each member."""
        members, size = self.members, doubles.size
        numbers = self._give("reached", np.empty(2 * members + 2 * size))
        self.reached, self.failed_at = numbers[:members], numbers[members : 2 * members]
        self.start = numbers[2 * members : 2 * members + size].reshape(doubles.shape)
        self.end = numbers[2 * members + size :].reshape(doubles.shape)
        numbers[: 2 * members] = t0
        self.start[...] = self.end[...] = doubles
        integers = self._give("status", np.zeros(8 * members, dtype=np.int64))
        self.status, self.flag = integers[:members], integers[members : 2 * members]
        self.status[...] = int(Stop.PAUSED)
        self.counts = integers[2 * members :].reshape(members, len(COUNTS))
        record = self.record
        record.failed_at = record.reached + 8 * members
        record.start = record.failed_at + 8 * members
        record.end = record.start + 8 * size
        record.flag = record.status + 8 * members
        record.counts = record.flag + 8 * members

    def _give(self, name: str, array: Any) -> Any:
        """Tell compiled code where an array is, which is kept alive."""
        self._buffers[name] = array
        setattr(self.record, name, array.ctypes.data if array.size else None)
        return array

    def _callbacks(self, events: EventTable | None, stage_solver: str, lanes: int) -> Callbacks:
        plan, rhs = self.plan, self.rhs
        method = plan.method
        stages = None
        if isinstance(method, Tableau) and not method.explicit:
            stages = ImplicitStages(rhs.at_member, plan.frame, method, stage_solver, lanes)
        return Callbacks(
            plan, stages, rhs.at_members if isinstance(rhs, PythonRhs) and rhs.together else None,
            None if events is None else events.value, None if events is None else events.jump,
        )  # fmt: skip

    def _make_buffers(self, capacity: int) -> None:
        """Give compiled code memory for what so many steps bring."""
        output, width = self.output, self.plan.width
        if output.every:
            self.record.step_capacity = capacity
            self._give("step_t", np.empty(capacity))
            self._give("step_y", np.empty((capacity, width)))
        more = min(capacity, _MANY)
        if self._functions:
            self.record.event_capacity = self._functions * self._lanes + more
            self._give_events(self.record.event_capacity)
        if output.dense:
            self.give_dense(self._lanes + more)

    def _give_events(self, capacity: int) -> None:
        width = self.plan.width
        self._give("event_of", np.empty((capacity, 2), dtype=np.int64))
        self._give("event_t", np.empty(capacity))
        self._give("event_y", np.empty((capacity, 2, width)))

    def give_dense(self, capacity: int) -> None:
        """Give compiled code memory for so many interpolants."""
        plan = self.plan
        self.record.dense_capacity = capacity
        self._give("dense_member", np.empty(capacity, dtype=np.int64))
        self._give("dense_t", np.empty((capacity, 3)))
        self._give("dense_y", np.empty((capacity, 2, plan.width)))
        self._give("dense_field", np.empty((capacity, (plan.nodes + 1) * plan.frame.dim)))

    def drive(self, watch: Callable[[float], None] | None = None) -> None:
        """Take all members to their ends.

        Parameters
        ----------
        watch
            Is given the time that was covered, summed over all members.
        """
        budget = StepBudget()
        while self.record.ended < self.members:
            given = budget.start()
            self.record.budget = given
            self.call()
            raise_if_stopped()
            budget.stop(max(given - self.record.budget, 1))
            if watch is not None:
                watch(float(np.abs(self.reached - self.t0).sum()))

    def call(self) -> None:
        """Go on in compiled code until something has to be done here, and take its output."""
        if self._lanes == 1:
            self._core.loop_drive(self.address)
        else:
            needed = 32 * self._lanes * (self.plan.width + self.plan.frame.dim + 2)
            with reserved(needed, f"a step of {self._lanes} members"):
                self._core.loop_drive(self.address)
        record = self.record
        if record.raised:
            raise ValueError(
                "events must return finite numbers, got another one at "
                f"t = {float(self.failed_at.max()):.17g}"
            )
        full = record.steps == record.step_capacity > 0
        if record.steps:
            self._steps.append(self._taken(record.steps, full, "step_t", "step_y"))
        if record.interpolants:
            full = full or record.interpolants + self._lanes > record.dense_capacity
            parts = ("dense_member", "dense_t", "dense_y", "dense_field")
            self._dense.append(self._taken(record.interpolants, full, *parts))
        if record.events:
            most = self._functions * self._lanes
            full = full or record.events + most > record.event_capacity
            names = ("event_of", "event_t", "event_y")
            self._events.append(self._taken(record.events, full, *names))
        if full and record.ended < self.members:
            self._make_buffers(min(4 * self._capacity, _MANY))
            self._core.loop_set_output(self.address)

    def _taken(self, count: int, full: bool, *names: str) -> tuple[Array, ...]:
        """Return what buffers hold, which get other memory if they are full."""
        parts = tuple(self._buffers[name][:count] for name in names)
        return parts if full else tuple(part.copy() for part in parts)

    def steps(self) -> tuple[Array, Points]:
        """Return the initial time and point and those of all steps that were kept."""
        t = np.concatenate([[self.t0], *(t for t, _ in self._steps)])
        if not self._steps:
            rows = self.start
        else:
            rows = np.concatenate([self.start, *(y for _, y in self._steps)])
        return t, self.plan.points(rows, (len(t),))

    def interpolants(self) -> Steps:
        """Return the solution within all steps that were kept, in the order of the members."""
        plan = self.plan
        if self._dense:
            member, *arrays = (np.concatenate(parts) for parts in zip(*self._dense, strict=True))
            order = np.argsort(member, kind="stable")
            if (np.diff(order) != 1).any():
                member, arrays = member[order], [array[order] for array in arrays]
        else:
            shapes = (3,), (2, plan.width), ((plan.nodes + 1) * plan.frame.dim,)
            member, arrays = np.empty(0, dtype=np.int64), [np.empty((0, *s)) for s in shapes]
        return Steps(plan, member - 1, *arrays)

    def forget_interpolants(self) -> None:
        """Take no more interpolants."""
        self._dense.clear()
        self.record.dense_capacity = 0

    def replace_rhs(self, rhs: CompiledRhs | PythonRhs) -> None:
        """Take another right-hand side of the same kind, whose addresses compiled code is told."""
        self.rhs = rhs
        if self.callbacks.stages is not None:
            self.callbacks.stages.rhs = rhs.at_member
        if isinstance(rhs, PythonRhs) and rhs.together:
            self.callbacks.fields = rhs.at_members

    def events(self) -> tuple[NDArray[np.int64], Array, Points]:
        """Return which event of which member happened when and where.

        Returns
        -------
        of
            Members and events, shape ``(n, 2)``.
        t
            Times, shape ``(n,)``.
        y
            Points before and after it, shape ``(n, 2, *point_shape)``.
        """
        plan = self.plan
        if not self._events:
            empty = plan.points(np.empty((0, plan.width)), (0, 2))
            return np.empty((0, 2), dtype=np.int64), np.empty(0), empty
        of, t, y = (np.concatenate(parts) for parts in zip(*self._events, strict=True))
        return of - 1, t, plan.points(y, (len(t), 2))

    def trouble(self, member: int) -> Exception | str | None:  # noqa: PLR0911
        """Return why a member ended early: an exception, or what to say of chosen steps."""
        stop, t = Stop(self.status[member]), float(self.failed_at[member])
        match stop:
            case Stop.FINISHED | Stop.PAUSED | Stop.TERMINAL_EVENT:
                return None
            case Stop.STEP_TOO_SMALL:
                return self._why_no_step(member, t)
            case Stop.TOO_MANY_STEPS:
                return too_many_steps(self.control.max_steps, t)
            case Stop.JUMPS_WITHOUT_PROGRESS:
                return no_progress(t)
            case Stop.STAGES_NOT_SOLVED:
                return self.callbacks.trouble
            case Stop.SLOPE_NOT_FINITE:
                point = self.plan.points(self.end[member], ())
                return failure(stop, 0, t, self.rhs.at_member(member, t, point))
            case Stop.STAGE_NOT_FINITE if self.callbacks.trouble is not None:
                return StageOverflowError(str(self.callbacks.trouble))
        return failure(stop, int(self.flag[member]), t, name=self.rhs.name)

    def _why_no_step(self, member: int, t: float) -> str:
        """Return what to say where no step is small enough."""
        plan = self.plan
        point = plan.points(self.end[member].copy(), ())
        try:
            slope = self.rhs.at_member(member, t, point)
            moved = plan.frame.flow(self.record.step_size * slope, point)
        except (ValueError, ArithmeticError, RuntimeError):
            return too_small_a_step(t)
        return too_small_a_step(t) if np.isfinite(moved).all() else flow_not_finite(plan.frame, t)
