"""Runs: trajectories of any number of members, which compiled code takes to their ends."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cg.frames.arrays import Array, Points
from cg.integration.loop.dense import Steps
from cg.integration.loop.messages import (
    failure,
    flow_not_finite,
    no_progress,
    too_many_steps,
    too_small_a_step,
)
from cg.integration.loop.step_budget import StepBudget
from cg.integration.rhs.compiled import CompiledRhs
from cg.integration.rhs.events import EventTable
from cg.integration.rhs.python import PythonRhs, StageOverflowError
from cg.integration.step.callbacks import Callbacks
from cg.integration.step.implicit import DEFAULT_STAGE_SOLVER, ImplicitStages
from cg.integration.step.plan import Plan
from cg.method.tableau import Tableau
from cg.support.memory import reserved
from cg.support.parallel import raise_if_stopped
from cg.support.shared_numbers import RECORD, Stop

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


class _Record(ctypes.Structure):
    _fields_ = [(name, _KINDS[kind]) for name, kind in RECORD.items()]


class Control(NamedTuple):
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
    atol: Array = np.array([1e-6])
    max_step: float = math.inf
    first_step: float | None = None
    max_steps: int = 10**6


class Output(NamedTuple):
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

    address = 0  # of what compiled code has of it

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
        self._core = plan.core
        self.plan = plan
        self.rhs = rhs
        self.control = control
        self.output = output
        self.members = members = len(points)
        if lanes is None:
            lanes = members if common else _LANES if rhs.together else 1
        self._lanes = lanes = min(lanes, members)
        self._functions = 0 if events is None else len(events)
        plan.look_at(points[0])
        self.callbacks = self._callbacks(events, stage_solver, lanes)
        in_entries = control.h is None and not plan.in_algebra
        function, data, stride = rhs.addresses()
        self.record = record = _Record(
            members=members, lanes=lanes, common=common, keep_last=keep_last,
            t0=t0, segments=len(stops),
            context=id(self.callbacks), function=function, together=rhs.together, data=data,
            data_stride=stride, functions=self._functions,
            h=control.h or 0.0, rtol=control.rtol, tolerances=control.atol.size,
            in_entries=in_entries, parts=plan.parts if in_entries else 1, exponent=plan.exponent,
            max_step=control.max_step, first_step=control.first_step or 0.0,
            max_steps=control.max_steps,
            every=max(output.every, 1), dense=output.dense,
        )  # fmt: skip
        self._buffers: dict[str, Any] = {}
        self._dense: list[tuple[Array, ...]] = []
        self._steps: list[tuple[Array, ...]] = []
        self._events: list[tuple[Array, ...]] = []
        self._give_members(plan.doubles(points))
        self.t0 = t0
        if output.times is not None and output.y is not None and len(output.times):
            self.record.wanted = len(output.times)
            self._give("times", np.array(output.times))
            self._give("y", output.y)
        self._capacity = output.capacity or _FEW
        self._make_buffers(self._capacity)
        self._give("stops", np.array(stops))
        self._give("atol", control.atol.flatten())
        if events is not None and len(events):
            columns = *events.functions.T, events.direction, events.most, events.jumps
            self._give("event_table", np.stack(columns, axis=-1, dtype=np.int64))
        needed = 1 << 16 if lanes == 1 else 0
        within = output.dense or record.wanted or self._functions
        rows = plan.method.stages + 2 * (plan.columns if within else 0)
        record.free = bool(within or keep_last) and plan.is_free(points[0])
        needed += lanes * 8 * rows * (plan.width + 2 * plan.frame.dim)
        with reserved(needed, f"{members} trajectories of {plan.width} numbers"):
            self.address = self._core.loop_open(plan.address, ctypes.addressof(record))
        if not self.address:
            raise MemoryError(f"there is not enough memory for {lanes} trajectories at a time")

    def __del__(self) -> None:
        if self.address:
            self._core.loop_close(self.address)

    def _give_members(self, doubles: Array) -> None:
        """Give compiled code memory for what it tells of each member."""
        members, width = doubles.shape
        places = self._give("places", np.empty((members, width + 2)))
        tallies = self._give("tallies", np.empty((members, 2 + len(COUNTS)), dtype=np.int64))
        self.end, self.reached, self.failed_at = places[:, :width], places[:, -2], places[:, -1]
        self.status, self.flag, self.counts = tallies[:, 0], tallies[:, 1], tallies[:, 2:]
        self.end[...] = doubles

    def _give(self, name: str, array: Any) -> Any:
        """Tell compiled code where an array is, which is kept alive."""
        self._buffers[name] = array
        if array.size:  # much faster than array.ctypes
            setattr(self.record, name, ctypes.addressof(ctypes.c_char.from_buffer(array)))
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
            block = self._give("step_t", np.empty(capacity * (1 + width)))
            self._buffers["step_y"] = block[capacity:].reshape(capacity, width)
            self.record.step_y = self.record.step_t + 8 * capacity
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
        self._give("dense_t", np.empty((capacity, 4)))
        self._give("dense_y", np.empty((capacity, 2, plan.width)))
        self._give("dense_field", np.empty((capacity, plan.columns * plan.frame.dim)))

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
        if record.steps:
            self._take(self._steps, record.steps, "step_t", "step_y")
        if record.interpolants:
            parts = ("dense_member", "dense_t", "dense_y", "dense_field")
            self._take(self._dense, record.interpolants, *parts)
        if record.events:
            self._take(self._events, record.events, "event_of", "event_t", "event_y")
        if record.ended < self.members and (
            record.steps == record.step_capacity > 0
            or (record.dense and record.interpolants + self._lanes > record.dense_capacity)
            or record.events + self._functions * self._lanes > record.event_capacity
        ):
            self._capacity = min(4 * self._capacity, _MANY)
            self._make_buffers(self._capacity)
            self._core.loop_set_output(self.address)

    def _take(self, taken: list[tuple[Array, ...]], count: int, *names: str) -> None:
        """Keep what buffers hold, as copies where more is to come."""
        parts = [self._buffers[name][:count] for name in names]
        if self.record.ended < self.members:
            parts = [part.copy() for part in parts]
        taken.append(tuple(parts))

    def steps(self) -> tuple[Array, Points]:
        """Return the initial time and point and those of all steps that were kept."""
        t, rows = map(np.concatenate, zip(*self._steps, strict=True))
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
            shapes = (4,), (2, plan.width), (plan.columns * plan.frame.dim,)
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
