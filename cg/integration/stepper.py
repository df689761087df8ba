"""Integration step by step, with the interface of SciPy's OdeSolver.

A `Stepper` keeps one run open in compiled code. The run has segments, which end at breakpoints and
at corners of inputs, the ``_segment_ends``, and at the time up to which the stepper goes on. The
run holds points, the last step and the events. A copy of a stepper opens another run of the same
problem, and writes the saved state of the first run into it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cg.frames.base import Frame
from cg.integration.arguments import (
    check_args,
    check_breakpoints,
    check_real_time,
    check_resolution,
    is_ensemble,
    read_starts,
)
from cg.integration.errors import TERMINAL_EVENT, failed_members
from cg.integration.mechanics import refuse_friction
from cg.integration.member_results import split_events
from cg.integration.options import StepOptions, complete_options, expand_options
from cg.integration.output.solutions import DenseOutput, EnsembleOutput
from cg.integration.problem import make_problem
from cg.integration.rhs.function import Function
from cg.integration.rhs.inputs import Inputs, check_abscissae
from cg.integration.rhs.samples import Samples
from cg.integration.run.drive import StepBudget
from cg.integration.run.failures import dropped_parts, failures_of
from cg.integration.run.run import Run
from cg.support.arrays import Array, Points, check_finite, read_only
from cg.support.checks import NO_LIMIT, check_real, short, texts_of, warn_user
from cg.support.frozen import changed
from cg.support.shared_numbers import STEP_CONTROL, EventColumn, InterpolantColumn, LoopStatus
from cg.support.shared_records import COUNTERS, COUNTS
from cg.tables import source_method

_FAR = 2.0**40  # number of fixed steps to the end of segments without a final time
_STEP_COUNTER = list(COUNTERS).index("steps")
_TERMINAL = int(LoopStatus.TERMINAL_EVENT)  # an int, which is faster
_NONE_STOPPED = np.zeros(1, dtype=np.bool_)


class Stepper:
    """An integration that advances step by step, or to given times.

    Parameters
    ----------
    f, frame
        As for `cg.solve_ivp`, as are all options that aren't listed here.
    t0, y0
        Initial time and point, shape ``frame.point_shape``, or the points of the members of an
        ensemble, which have one leading axis.
    t_bound
        Final time. By default there is none, and time increases.
    inputs
        As for `cg.solve_ivp`; they need not lead to ``t_bound``, but as far as the stepper does.
    parameters, vectorized, common_steps
        As for `cg.solve_ivp`, of an ensemble for `cg.solve_ensemble`.
    events
        As for `cg.solve_ivp`. For a single point ``step`` and ``advance`` stop at a terminal
        event, after its jump if it has one, and go on from there when they are called again; an
        event that is terminal the third time stops each third time. A member of an ensemble stays
        at its terminal event, before its jump, as in `cg.solve_ensemble`, and the others go on.

    Attributes
    ----------
    t, y
        Present time and point; ``y`` is a read-only copy.
    t_old, step_size
        Start and absolute size of the last step, None before the first one and after a restart.
    next_step
        Absolute size that the next step tries, unless its end comes before; None if it isn't chosen
        yet. Of an ensemble those of the members, shape ``(members,)``, with NaN in place of None.
    direction, n
        1.0 or -1.0, and the number of coefficients, ``frame.dim``.
    status
        ``"running"``, ``"event"`` at a terminal event, of an ensemble at those of all members,
        ``"finished"`` at ``t_bound``, or ``"failed"``.
    stopped
        Whether a terminal event has ended each member of an ensemble, shape ``(members,)``; their
        points in ``y`` are those at their events. None for a single point.
    t_events, y_events, y_after
        For each event its times so far, and the points before and after its jumps, as in a
        `Solution`, of an ensemble as in an `EnsembleSolution`; None without events.
    nfev, njev, nlu, nexp, nrejected
        Counts so far, for an ensemble summed over the members.

    Notes
    -----
    If the error estimate can't be met, ``step`` and ``advance`` return a message, and ``status`` is
    ``"failed"``. After that, or an exception or interrupt of ``f``, ``t``, ``y`` and events are
    those of the last complete step, or of an ensemble those before the call. After an exception
    further steps may be tried, and after a failure ``restart`` may be called.

    A pickle contains the present state and ``f``, which has to be a function of a module or a
    `CompiledFunction`; the copy goes on bit for bit. ``copy.copy`` takes any ``f``.

    Examples
    --------
    A control law with a sampling time of a tenth of a second:

    >>> import numpy as np
    >>> import crouch_grossman as cg
    >>> frame = cg.frames.Product(cg.frames.UnitQuaternion(), cg.frames.Euclidean(3))
    >>> def f(t, y, torque):
    ...     return np.concatenate([y[4:], torque])
    >>> stepper = cg.Stepper(
    ...     f, 0.0, [0, 0, 0, 1, 0.3, 0, 0.1], frame=frame, method="CF4", h=0.1,
    ...     args=(np.zeros(3),),
    ... )
    >>> for k in range(1, 101):
    ...     stepper.restart(args=(-0.5 * stepper.y[:3] - stepper.y[4:],))
    ...     stepper.advance(0.1 * k)
    >>> bool(np.abs(stepper.y[4:]).max() < 0.02)
    True
    """

    @expand_options()
    def __init__(
        self, f: Function, t0: float,
        y0: ArrayLike, t_bound: float = math.inf, *, frame: Frame, common_steps: bool = False,
        **options: Unpack[StepOptions],
    ) -> None:  # fmt: skip
        all_options = complete_options(Stepper.__init__, options)
        start = check_real_time("t0", t0, infinite=False)
        self.t_bound = bound = check_real_time("t_bound", t_bound)
        ensemble = is_ensemble(frame, y0)
        first, breakpoints = all_options["first_step"], all_options["breakpoints"]
        all_options["breakpoints"], all_options["common_steps"] = None, common_steps
        if all_options["h"] is None:
            all_options["first_step"] = None  # it may exceed the span here, which is empty
        problem = make_problem(
            f, (start, start), y0, frame, all_options, ensemble=ensemble, bound=bound
        )
        self.direction = problem.direction
        if problem.member_inputs:
            raise ValueError(
                "inputs must be cg.Samples, those of members with members=True, or a tuple of them "
                f"for an ensemble in steps, got {short(all_options['inputs'])}"
            )
        check_resolution(problem.control.h, start)
        parameters = problem.rhs.extra.parameters
        if parameters is not None:
            check_finite("parameters", parameters if ensemble else parameters[0])
        self.f, self.frame, self.table = f, problem.plan.frame, problem.plan.table
        self.n = self.frame.dim
        self._first_step = None if first is None else check_real("first_step", first, positive=True)
        self._breakpoints = check_breakpoints(breakpoints, start, bound)[:-1]
        if len(self._breakpoints):
            check_abscissae(self.table, "breakpoints")
        self._ensemble = ensemble
        control = problem.control._replace(first_step=self._first_step, max_steps=NO_LIMIT)
        self._problem = changed(problem, control=control, t_eval=None, every=0)
        self._find_segments(problem.rhs.extra.inputs, start)
        self.status = "running" if start != bound else "finished"
        self._calls = 0
        self._event_output: DenseOutput | None = None  # within a step that an event ended
        self._open()
        self._begin(start, self._run.end, self._first_step, self._stopped)

    def _open(self) -> None:
        """Open the run in compiled code."""
        self._run = Run(self._problem, keep_last=True, lanes=len(self._problem.points))
        self._budget = StepBudget()
        self._target: float | None = None  # the time up to which compiled code goes on, if known

    def _begin(self, t: float, rows: Array, first_step: float | None, stopped: Any) -> None:
        """Start trajectories anew from points as doubles, but for members that have stopped."""
        self._run.restart(t, rows, first_step, stopped)
        self.t, self._has_step, self._target, self._overwritten = t, False, None, False

    @property
    def t_old(self) -> float | None:
        """Start of the last step."""
        if not self._has_step:
            return None
        member = (self.direction * self._run.reached).argmax()  # others may have stopped before
        return float(self._run.state("last_start")[member])

    @property
    def step_size(self) -> float | None:
        """Absolute size of the last step."""
        return None if (t_old := self.t_old) is None else abs(self.t - t_old)

    @property
    def y(self) -> Points:
        """The present point, a read-only copy."""
        run = self._run
        return read_only(run.plan.points(run.end.copy(), (run.members,) * self._ensemble))

    def __repr__(self) -> str:
        return f"Stepper(t={self.t!r}, status={self.status!r}, method={self.table.name!r})"

    @property
    def _stopped(self) -> NDArray[np.bool_]:
        """Whether a terminal event has ended each member; a single point may go on after it."""
        stopped: NDArray[np.bool_] = self._run.status == _TERMINAL
        return stopped if self._ensemble else _NONE_STOPPED

    @property
    def stopped(self) -> NDArray[np.bool_] | None:
        """Whether a terminal event has ended each member; None for a single point."""
        return self._stopped if self._ensemble else None

    def _events(self, select: Callable[[Array, Points], Array]) -> list[Any] | None:
        """Return ``select(t, y)`` of each event, of an ensemble for each member."""
        if (table := self._problem.events) is None:
            return None
        indices, t, y = self._run.events()
        lists = split_events(indices, select(t, y), self._run.members, len(table))
        return lists if self._ensemble else [members[0] for members in lists]

    @property
    def t_events(self) -> list[Any] | None:
        """Times of each event."""
        return self._events(lambda t, y: t)

    @property
    def y_events(self) -> list[Any] | None:
        """Points before jumps at each event."""
        return self._events(lambda t, y: y[:, 0])

    @property
    def y_after(self) -> list[Any] | None:
        """Points after jumps at each event."""
        return self._events(lambda t, y: y[:, 1])

    @property
    def next_step(self) -> float | Array | None:
        """Absolute size that the next step tries."""
        h, sizes = self._run.control.h, self._run.state("next_step")
        sizes = np.where(sizes > 0.0, sizes, np.nan) if h is None else np.full(len(sizes), h)
        if self._ensemble:
            return sizes
        return None if np.isnan(sizes[0]) else float(sizes[0])

    def _count(self, name: str) -> int:
        return int(self._run.counts[:, COUNTS.index(name)].sum())

    method = property(lambda self: source_method(self.table), doc="The method, a `cg.Method`.")
    nfev = property(lambda self: self._count("nfev"), doc="Evaluations of the coefficients.")
    nexp = property(lambda self: self._count("nexp"), doc="Flows.")
    njev = property(lambda self: self._count("njev"), doc="Jacobians of stage equations.")
    nlu = property(lambda self: self._count("nlu"), doc="Factorisations of them.")
    nrejected = property(lambda self: self._count("nrejected"), doc="Rejected steps.")

    def step(self, limit: float | None = None) -> str | None:
        """Take one step, up to the first event in it that is terminal or jumps.

        Parameters
        ----------
        limit
            Time beyond ``.t`` that the step doesn't pass; by default ``t_bound``.

        Returns
        -------
        str or None
            Why the step failed, None if it was taken.

        Raises
        ------
        ValueError
            If ``limit`` isn't beyond ``.t``, or is beyond ``t_bound``.
        RuntimeError
            If the integration has ended, or its members have steps of their own.
        """
        if self._ensemble and not self._problem.common_steps:
            raise RuntimeError(
                "step is for one point or common_steps; members with steps of their own advance(t)"
            )
        self._check_running()
        target = self._end if limit is None else self._check_time(limit, "limit", self.t)
        if target == self.t and limit is not None:
            raise ValueError(f"limit must lie beyond t = {self.t:.17g}, got {limit!r}")
        if target == self.t:
            raise RuntimeError(
                f"inputs must lead beyond t = {self.t:.17g} for another step; restart with others"
            )
        return self._run_to(self._take_step, target)

    def advance(self, t: float) -> str | None:
        """Take steps up to a time, or to a terminal event.

        The last step ends there; that it is shortened doesn't shorten the next one.

        Parameters
        ----------
        t
            Time from ``.t``, for which no step is taken, to ``t_bound``.

        Returns
        -------
        str or None
            Why the time wasn't reached, None if it was.

        Raises
        ------
        RuntimeError
            If the integration has ended.
        """
        target = self._check_time(t, "t", self.t)
        if target == self.t:
            return None
        self._check_running()
        message = self._run_to(self._take_steps, target)
        return TERMINAL_EVENT if message is None and self.t != target else message

    def _check_time(self, t: float, name: str, start: float) -> float:
        """Return a time after checking that it lies between ``start`` and `t_bound`."""
        time, sign = check_real_time(name, t, infinite=False), self.direction
        if sign * (time - start) < 0.0 or sign * (time - self.t_bound) > 0.0:
            low, high, got = texts_of(start, self.t_bound, time)
            raise ValueError(f"{name} must lie between {low} and {high}, got {got}")
        return time

    def restart(
        self, *, t: float | None = None, y: ArrayLike | None = None,
        args: Iterable[Any] | None = None, parameters: ArrayLike | None = None,
        first_step: float | None = None, inputs: Samples | tuple[Samples, ...] | None = None,
    ) -> None:  # fmt: skip
        """Continue from another time or point, or with other arguments of ``f``.

        Arguments that are None stay as they are, and so do the counts, except that terminal events
        are counted anew. ``f`` isn't called before the next step, which uses no slope of earlier
        ones; only forces on a phase space that get other arguments, for a splitting method.

        Parameters
        ----------
        t, y
            Time and point. Either lets members go on that have stopped at a terminal event.
        args, parameters
            Arguments of ``f``.
        inputs
            Samples of the same shapes as before, which must cover the time.
        first_step
            Size of the next step. By default it is ``h`` or `next_step`: the size is kept. With
            a new ``t`` or without any argument, after a failure or a jump, it is the ``first_step``
            of the constructor, or chosen anew, which takes one call of ``f``. Give it where a new
            point or other arguments change the solution much faster than before.
        """
        run, time, rows = self._run, self.t, self._run.end
        if t is not None:
            time = self._check_time(t, "t", -math.inf * self.direction)
            check_resolution(run.control.h, time)
            if inputs is None and run.rhs.extra.inputs is not None:
                run.rhs.extra.inputs.check_span(time, time, "t")
        if y is not None:
            points = read_starts(run.plan, y, self._ensemble, "y")
            if len(points) != run.members:
                shape = run.members, *run.plan.point_shape
                raise ValueError(f"y must have shape {shape}, got {np.shape(y)}")
            rows = run.plan.doubles(points)
        if first_step is not None and run.control.h is not None:
            raise ValueError(f"first_step must be None with h, got {first_step!r}")
        size = self._first_step
        if first_step is not None:
            size = check_real("first_step", first_step, positive=True)
        same_f = args is None and parameters is None and inputs is None
        replaced = y is not None or not same_f
        if first_step is None and t is None and replaced and self.status != "failed":
            size = STEP_CONTROL["proposed_for_point" if same_f else "proposed_for_f"]
        self._replace_data(time, rows, args, parameters, inputs)
        self._event_output = None
        if t is not None or inputs is not None:
            self._find_segments(run.rhs.extra.inputs, time)
        goes_on = t is not None or y is not None
        self._begin(time, rows, size, np.zeros_like(self._stopped) if goes_on else self._stopped)
        self.status = "running" if self.t != self.t_bound else "finished"
        if self._ensemble and self._stopped.all():
            self.status = "event"

    def dense_output(self) -> DenseOutput:
        """Return the solution within the last step, before a jump at its end.

        It takes evaluations of ``f``. Members that have stopped are NaN.

        Raises
        ------
        RuntimeError
            If no step has been taken since the beginning, the last restart or a failure, members
            have steps of their own, or there is a thermostat.
        """
        if self._problem.thermostat is not None:
            raise RuntimeError("dense_output must not come with a thermostat: paths aren't smooth")
        shared = not self._ensemble or (self._problem.common_steps and not self._stopped.all())
        if not (self._has_step and shared) or self._overwritten:
            shared_by_all = " that all members share" * self._ensemble
            raise RuntimeError(f"dense_output must come after a step{shared_by_all}")
        return self._event_output or self._interpolate()

    def _replace_data(
        self, t: float, rows: Array, args: Any, parameters: ArrayLike | None, inputs: Any
    ) -> None:
        """Replace arguments of ``f`` other than time and point, from time t on; None keeps the old.

        ``rows`` are the points there, as doubles.
        """
        run, before = self._run, self._run.rhs.extra
        extra = before.replaced(t, parameters, inputs, run.members if self._ensemble else None)
        if args is not None:
            extra = extra._replace(args=check_args(args))
        if extra is before:
            return
        rhs = run.rhs.with_data(extra)
        refuse_friction(run.plan, rhs, [t], run.plan.points(rows, (1, run.members)))
        run.replace_rhs(rhs)
        if extra.inputs is not None and extra.inputs is not before.inputs:
            limits = extra.inputs.limits(self._problem.control.tolerance)
            if len(limits) or len(self._problem.limits):
                self._problem = changed(self._problem, limits=limits)
                run.share_limits(limits)

    def _find_segments(self, inputs: Inputs | None, t: float) -> None:
        """Set the ends of segments from a time on, and the last time of a step without a limit.

        It is `t_bound`, or far away for equal steps without one, or the end of inputs before it.
        """
        control, sign, end = self._problem.control, self.direction, self.t_bound
        if control.h is not None and math.isinf(end):
            end = t + sign * _FAR * control.h
        ends = np.append(self._breakpoints, end)
        if inputs is not None:
            first, last = inputs.span
            end = sign * min(sign * end, max(sign * t, sign * (last if sign > 0.0 else first)))
            ends = np.append(ends[sign * ends < sign * end], end)
            ends = inputs.add_corners(ends, t, control.tolerance)
        self._segment_ends, self._end = ends[:-1], end

    def _resume(self, target: float) -> None:
        """Let all trajectories continue up to a time, by the ends of segments before it.

        An end at `t` itself is kept: ``f`` is then evaluated on the side of the last step. One at
        the target is repeated, so that the step up to it ends before it.
        """
        run, inner, sign = self._run, self._segment_ends, self.direction
        if (inputs := run.rhs.extra.inputs) is not None:
            inputs.check_span(self.t, target, "t")
        check_resolution(run.control.h, target)
        ends = np.array([target])
        if len(inner):
            # the end before is kept: a step that starts there sees f after it
            inner = inner[max(int((sign * (inner - self.t) < 0.0).sum()) - 1, 0) :]
            ends = np.append(inner[sign * (inner - target) <= 0.0], target)
        run.resume(ends)
        self._target = target

    def _run_to(self, take_steps: Callable[[], str | None], target: float) -> str | None:
        """Take steps towards a time; return a message if that failed.

        After a failure an ensemble returns to the time before, since some members are ahead.
        """
        run = self._run
        if target != self._target:
            self._resume(target)
        self._event_output, self._overwritten, self.status = None, False, "running"
        start = (run.end.copy(), self._first_step, self._stopped) if self._ensemble else None
        calls = len(run.events_of_calls)
        complete = False
        try:
            message = take_steps()
            complete = message is None
        finally:
            if not complete:
                self._target = None
                if start is None:
                    self._has_step |= self.t != run.reached.item(0)
                    self._overwritten = True  # the failed step has used the memory of stages
                    self.t = run.reached.item(0)
                    late = self.direction * self.t
                    for k, rows in enumerate(run.events_of_calls[calls:], calls):
                        times = self.direction * rows[:, EventColumn.TIME]
                        run.events_of_calls[k] = rows[times <= late]  # no events of that step
                else:
                    del run.events_of_calls[calls:]
                    self._begin(self.t, *start)
        if complete:
            self._finish_steps()
        return message

    def _take_step(self) -> str | None:
        """Take a step; return a message if it failed."""
        run = self._run
        # the counters of a member that still runs
        counters = run.counters[self._stopped.argmin() if self._ensemble else 0]
        steps = counters.item(_STEP_COUNTER)
        while counters.item(_STEP_COUNTER) == steps:
            run.call(run.members)
            if run.record.failed:
                return self._fail()
        return None

    def _take_steps(self) -> str | None:
        """Take steps up to the end of the last segment; return a message if one failed."""
        run, budget = self._run, self._budget
        while run.record.ended < run.members:
            budget.stop(run.call(budget.start()))
            if run.record.failed:
                return self._fail()
        return None

    def _finish_steps(self) -> None:
        """Set time and status after complete steps."""
        run, table = self._run, self._problem.events
        stopped = table is not None and bool((run.status == _TERMINAL).all())
        self.t, self._has_step = run.reached.item(0), True
        if self._ensemble:  # some may have stopped before
            self.t = self.direction * float((self.direction * run.reached).max())
        elif table is not None and run.events_of_calls:
            rows = run.events_of_calls[-1]
            last = rows[rows[:, EventColumn.TIME] == self.t, EventColumn.NUMBER].astype(int) - 1
            if len(last) and (stopped or table.rows["jumps"][last].any()):
                self._event_output = self._interpolate()
        if self.t == self.t_bound:
            self.status = "finished"
        elif stopped:
            self.status = "event"
        for text in dropped_parts(run):
            warn_user(text)
        self._calls += 1
        if self._calls & (self._calls - 1) == 0:  # calls 1, 2, 4, 8, …, since it calls f twice
            points = run.plan.points(run.end, (1, run.members))
            refuse_friction(run.plan, run.rhs, [self.t], points)

    def _interpolate(self) -> DenseOutput:
        """Return the solution within the last step."""
        run = self._run
        # f is evaluated before the end of a segment at the end of the step
        at_segment_end, self._target = bool((self._segment_ends == self.t).any()), None
        beyond = self.t + self.direction
        run.resume(np.array([self.t, beyond] if at_segment_end else [beyond]))
        interpolants = run.last_interpolants()
        if run.record.failed:
            failure = next(iter(failures_of(run, raising=True).values()))
            raise RuntimeError(f"there is no solution within the last step: {failure}")
        begin = float(interpolants.rows[0, InterpolantColumn.START])
        outputs, nowhere = [], np.full((1, run.plan.width), math.nan)
        for member, has_stopped in enumerate(self._stopped):
            own = interpolants.member(member)
            start = nowhere if has_stopped else own.rows[:1, len(InterpolantColumn) :]
            point = run.plan.points(start[:, : run.plan.width].copy(), (1,))[0]
            outputs.append(DenseOutput(own, begin, self.direction, point))
        return EnsembleOutput(outputs) if self._ensemble else outputs[0]

    def _check_running(self) -> None:
        """Raise RuntimeError unless the integration goes on."""
        if self.status not in ("running", "event") or (self._ensemble and self.status == "event"):
            status = "stopped" if self.status == "event" else self.status
            raise RuntimeError(f"the integration has {status} at t = {self.t:.17g}; restart it")

    def _fail(self) -> str:
        """Return the message for failed steps; raise other errors."""
        self.status = "failed"
        failures = failures_of(self._run, raising=True)
        if self._ensemble:
            return failed_members(failures, self._run.members)
        return f"Failure: {failures[0]}."

    def __getstate__(self) -> dict[str, Any]:
        # the copy needs its own memory for inputs, since both may run, in two threads
        rhs = self._run.rhs.with_data(self._run.rhs.extra)
        state = {name: x for name, x in vars(self).items() if name not in ("_run", "_budget")}
        return state | {"_problem": changed(self._problem, rhs=rhs), "saved": self._run.saved()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        saved = state.pop("saved")
        vars(self).update(state)
        self._open()
        self._run.restore(saved)
