"""Ensembles: many initial value problems, integrated independently on any executor."""

from __future__ import annotations

import math
import pickle
import warnings
from collections.abc import Callable, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import LowLevelCallable

from cg.catalogue import catalogues
from cg.frames.arrays import Array, Points
from cg.frames.base import Frame
from cg.integration.arguments import check_grid, equal_steps
from cg.integration.default_method import AUTO
from cg.integration.ivp import warn_off_manifold
from cg.integration.loop.dense import DenseOutput, EnsembleOutput, Steps
from cg.integration.loop.messages import FINISHED, TERMINAL_EVENT, failed_members
from cg.integration.loop.progress import Progress
from cg.integration.loop.run import COUNTS, Output
from cg.integration.problem import Problem, make_problem, make_rhs
from cg.integration.results import EnsembleSolution
from cg.integration.rhs.function import CompiledFunction, Function
from cg.integration.rhs.python import Coefficients
from cg.integration.step.implicit import DEFAULT_STAGE_SOLVER
from cg.integration.step.plan import plan_of
from cg.method.method import Method
from cg.runs import ExecutorLike, check_executor, completed
from cg.support.checks import check_flag
from cg.support.shared_numbers import Stop

__all__ = ["solve_ensemble", "solve_members"]

_MEMBERS_PER_RUN = 1 << 14  # limits the memory of a run


def solve_ensemble(
    f: Coefficients | CompiledFunction | LowLevelCallable[Any, Any],
    t_span: Sequence[float],
    y0: ArrayLike,
    *,
    frame: Frame,
    method: str | Method = AUTO,
    rtol: float | None = None,
    atol: ArrayLike | None = None,
    h: float | None = None,
    t_eval: ArrayLike | None = None,
    dense_output: bool = False,
    events: Any = None,
    breakpoints: ArrayLike | None = None,
    args: Iterable[Any] | None = None,
    parameters: ArrayLike | None = None,
    vectorized: bool = False,
    common_steps: bool = False,
    max_step: float = math.inf,
    first_step: float | None = None,
    max_steps: int | None = None,
    stage_solver: str = DEFAULT_STAGE_SOLVER,
    jac: Function | None = None,
    executor: ExecutorLike = None,
    workers: int | None = None,
    out: Any = None,
    progress: Callable[[float, float], None] | None = None,
) -> EnsembleSolution:
    """Solve an initial value problem from many points, or with many sets of parameters.

    Each member takes the steps that it would take alone in `cg.solve_ivp`, to the bit.

    Parameters
    ----------
    f
        ``f(t, y, *args)``, or ``f(t, y, *args, row)`` with a row of ``parameters``, returns the
        coefficients of one member; see `cg.solve_ivp`.  If ``vectorized`` it is given times
        ``(k,)``, points ``(k, *frame.point_shape)`` and rows ``(k, n)`` of any subset of the
        members, and returns shape ``(k, frame.dim)``.
    t_span
        Initial and final time.
    y0
        Initial points, shape ``(members, *frame.point_shape)``; a single point serves all rows
        of ``parameters``.
    frame, method, rtol, atol, h, dense_output, events, breakpoints, args
        As for `cg.solve_ivp`.  Events are functions of one member.
    t_eval
        Times at which to store the solution; by default the ends of ``t_span``.
    parameters
        Numbers of each member, shape ``(members, n)``, which ``f`` and the events are given as
        last argument; a compiled ``f`` is given their address.
    vectorized
        Whether ``f`` takes many members at a time.
    common_steps
        Whether all members take the same steps, those that the member with the largest error
        calls for.
    max_step, first_step, max_steps, stage_solver
        As for `cg.solve_ivp`, of each member.
    jac
        As for `cg.solve_ivp`; if ``vectorized`` it takes and returns arrays of one member each,
        with the axis of members first.
    executor, workers
        Where members are integrated, and by how many workers: in this thread by default, by
        ``workers`` threads, or by any executor that `cg.search` takes.  On one machine they
        change no bit of the result.  Other processes must be able to unpickle ``f``:
        `cg.CompiledFunction` for a compiled one.
    out
        Array of shape ``(times, members, *frame.point_shape)`` that receives the points, such as
        one of NumPy on disk, of zarr or h5py; then ``y`` is ``out`` itself.
    progress
        Called with the time that was covered, summed over the members, and its total.

    Returns
    -------
    EnsembleSolution
        Members that fail are NaN after their ends, and the others go on.

    Raises
    ------
    TypeError, ValueError
        If an argument can't be used, as for `cg.solve_ivp`; an exception of ``f`` ends the call.
    RuntimeError
        If the workers of all members died.

    Warns
    -----
    UserWarning
        If members failed; it names their number and the first one.

    Examples
    --------
    >>> import numpy as np
    >>> import cg
    >>> rates = np.linspace(0.5, 1.5, 5)[:, None]
    >>> run = cg.solve_ensemble(
    ...     lambda t, y, rate: [0.0, np.sin(t), rate[0]], (0, 5), np.eye(3),
    ...     frame=cg.frames.SO3(), parameters=rates, t_eval=[0, 1, 5], rtol=1e-8, atol=1e-8,
    ... )
    >>> run.y.shape, run.success
    ((3, 5, 3, 3), True)
    """
    vectorized = check_flag("vectorized", vectorized)
    common = check_flag("common_steps", common_steps)
    problem = make_problem(
        f, t_span, y0, frame=frame, method=method, args=args, parameters=parameters, many=True,
        vectorized=vectorized, common=common, h=h, rtol=rtol, atol=atol, max_step=max_step,
        first_step=first_step, max_steps=max_steps, t_eval=t_eval, dense_output=dense_output,
        events=events, breakpoints=breakpoints, stage_solver=stage_solver, jac=jac,
    )  # fmt: skip
    return solve_members(problem, f, executor, workers, out, progress)


def solve_members(
    problem: Problem,
    f: Any,
    executor: ExecutorLike,
    workers: int | None,
    out: Any,
    progress: Callable[[float, float], None] | None,
) -> EnsembleSolution:
    """Integrate the members of an ensemble.

    Parameters
    ----------
    problem
        What to integrate.
    f
        The right-hand side as the user gave it, for workers in other processes.
    executor, workers, out, progress
        As for `solve_ensemble`.
    """
    common, h = problem.common, problem.control.h
    if common and problem.event_table().jumps.any():
        raise ValueError("events must have no jumps with common_steps, which all members share")
    if problem.t_eval is None:
        ends = [problem.t0, problem.t1][: 1 + (problem.t0 != problem.t1)]
        problem = replace(problem, t_eval=np.array(ends))
    if h is not None:
        steps = equal_steps(h, [problem.t0, *problem.stops.tolist()])
        check_grid(problem.plan, h, steps * len(problem.points), 0, problem.dense)
    distributed = executor is not None or workers is not None
    executor, workers = check_executor(executor, workers)
    if distributed and common:
        raise ValueError("executor and workers must be None with common_steps")
    result = _EnsembleResults(problem, out)
    watch = Progress(progress, problem.t0, problem.t1, len(problem.points))
    if distributed:
        _distribute(problem, f, executor, workers, result, watch)
    else:
        size = len(problem.points) if common else _MEMBERS_PER_RUN
        for first in range(0, len(problem.points), size):
            members = slice(first, min(first + size, len(problem.points)))
            result.add(members, _integrate(_select_members(problem, members), watch))
            watch.count_finished(members.stop - first)
    watch.finish()
    solution = result.solution()
    if not solution.success:
        warnings.warn(solution.message, stacklevel=3)
    return solution


@dataclass(frozen=True)
class _MemberResults:
    """Results of some members: points at all times, status and counts of each, steps and events."""

    y: Points
    reached: Array
    status: Any
    counts: Any
    messages: dict[int, str]
    steps: Steps | None
    events: tuple[Any, Array, Points]


def _select_members(problem: Problem, members: slice) -> Problem:
    if members == slice(0, len(problem.points)):
        return problem
    return replace(problem, points=problem.points[members], rhs=problem.rhs.part(members))


def _integrate(problem: Problem, watch: Progress | None) -> _MemberResults:
    """Integrate members in this thread."""
    plan, times = problem.plan, problem.t_eval
    assert times is not None
    members = len(problem.points)
    y = np.full((len(times), members, plan.width), math.nan)
    table = problem.event_table()
    run = problem.run(Output(times, 0, problem.dense, y), table if len(table) else None)
    run.drive(watch.update if watch is not None and watch.function is not None else None)
    messages = {}
    for member in np.flatnonzero(run.status != Stop.FINISHED).tolist():
        failure = run.failure(member)
        if isinstance(failure, MemoryError):
            raise failure
        messages[member] = TERMINAL_EVENT if failure is None else f"{failure}".removesuffix(".")
    status = np.select(
        [run.status == Stop.FINISHED, run.status == Stop.TERMINAL_EVENT], [0, 1], default=-1
    )
    points = plan.points(y, (len(times), members))
    steps = run.interpolants() if problem.dense else None
    return _MemberResults(points, run.reached, status, run.counts, messages, steps, run.events())


@dataclass(frozen=True)
class _MemberTask:
    """The task of a worker: integrate some members of a problem."""

    problem: Problem
    f: Any

    def __call__(self, data: tuple[Points, Array | None]) -> _MemberResults:
        """Integrate some members, given their points and parameters."""
        points, numbers = data
        problem = self.problem
        rhs, _ = make_rhs(
            self.f, problem.plan.frame, problem.args or None, numbers, problem.rhs.vectorized,
            len(points),
        )  # fmt: skip
        return _integrate(replace(problem, points=points, rhs=rhs), None)

    def __getstate__(self) -> dict[str, Any]:
        # a method is sent by its name, so that each process has one instance with its cached data
        problem, method = self.problem, self.problem.plan.method
        known = any(own.get(method.name) is method for own in catalogues.values())
        plan = problem.plan.frame, method.name if known else method
        parts = {name: value for name, value in vars(problem).items() if name != "plan"}
        vectorized = problem.rhs.vectorized
        parts |= {"rhs": vectorized, "points": None}
        return {"f": self.f, "plan": plan, "kind": type(problem), "parts": parts}

    def __setstate__(self, state: dict[str, Any]) -> None:
        from cg.catalogue import resolve_method

        frame, method = state["plan"]
        parts = state["parts"]
        parts["rhs"], _ = make_rhs(state["f"], frame, parts["args"] or None, None, parts["rhs"], 1)
        problem = state["kind"](plan_of(frame, resolve_method(method)), **parts)
        object.__setattr__(self, "problem", problem)
        object.__setattr__(self, "f", state["f"])


def _distribute(
    problem: Problem, f: Any, executor: Any, workers: Any, result: _EnsembleResults, watch: Progress
) -> None:
    """Integrate members on an executor."""
    work = _MemberTask(problem, f)
    if executor is not None and executor != "threads":
        _check_pickle(work)
    points, numbers = problem.points, problem.rhs.parameters
    run = completed(
        work,
        range(len(points)),
        len(points),
        workers,
        executor,
        data=lambda chunk: (points[chunk], None if numbers is None else numbers[chunk]),
    )
    with closing(run) as running:
        for finished in running:
            members = slice(finished.chunk[0], finished.chunk[-1] + 1)
            if finished.result is None:
                result.add_failure(members, str(finished.failure))
            else:
                result.add(members, finished.result)
            watch.count_finished(members.stop - members.start)
            watch.update(0.0)


def _check_pickle(work: _MemberTask) -> None:
    try:
        pickle.dumps(work)
    except Exception as error:
        raise TypeError(
            "f, frame and all other arguments must be such that other processes can be told of "
            "them (pickled); functions must be those of a module, a compiled one "
            f"cg.CompiledFunction(path, symbol); got {work.f!r}: {error}"
        ) from error


class _EnsembleResults:
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

    def add(self, members: slice, part: _MemberResults) -> None:
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
