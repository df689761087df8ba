"""Ensembles whose members are integrated each by itself, on any executor."""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from cg.catalogue import munthe_kaas, packaged
from cg.frames.arrays import Array, Points, real_array
from cg.frames.base import Frame
from cg.integration.arguments import check_span, check_t_eval
from cg.integration.compiled_rhs import CompiledRhs
from cg.integration.messages import FINISHED, TERMINAL_EVENT, failed_members
from cg.integration.problem import Problem
from cg.integration.results import Solution
from cg.integration.time_grid import make_grid
from cg.method import Method
from cg.runs import ExecutorLike, check_executor, completed

__all__ = ["solve_apart"]


@dataclass(frozen=True)
class _Work:
    """What every chunk of members is integrated with; `cg.solve_ivp`'s arguments."""

    solve: Callable[..., Solution]
    f: Any
    t_span: tuple[float, float]
    frame: Frame
    options: Mapping[str, Any]
    together: bool

    def __call__(self, data: tuple[Points, Array | None]) -> list[Solution]:
        """Return the solutions of some members, or one for all of them."""
        points, parameters = data
        rows = [data]
        if not self.together:
            own = parameters if parameters is not None else [None] * len(points)
            rows = list(zip(points, own, strict=True))
        return [
            self.solve(self.f, self.t_span, y0, frame=self.frame, parameters=own, **self.options)
            for y0, own in rows
        ]


def solve_apart(
    solve: Callable[..., Solution],
    problem: Problem,
    f: Any,
    t_span: Sequence[float],
    parameters: ArrayLike | None,
    executor: ExecutorLike,
    workers: int | None,
    out: Any,
    options: Mapping[str, Any],
) -> Solution:
    """Integrate every member of an ensemble by itself.

    Parameters
    ----------
    solve
        What integrates some members or one: `cg.solve_ivp`, which calls this.
    problem
        What was checked of the arguments.
    f, t_span, parameters, executor, workers, out
        As `cg.solve_ivp` takes them.
    options
        Its other arguments.

    Raises
    ------
    TypeError, ValueError
        If an argument can't be used this way.
    """
    batch, points = problem.batch, problem.points
    executor, workers = check_executor(executor, workers)
    if not batch:
        raise ValueError("executor, workers and out are for ensembles, got a single point as y0")
    if options["dense_output"]:
        raise ValueError("dense_output must be False with an executor; t_eval asks for times")
    start, stop = check_span(t_span)
    times = _times(problem, start, stop, options["t_eval"], options["h"], out)
    if out is not None:
        shape = (len(times), math.prod(batch), *problem.frame.point_shape)
        _check_out(out, shape, points.dtype)
    if options["h"] is None:
        options = {**options, "t_eval": times}
    together = isinstance(problem.rhs, CompiledRhs) and problem.in_compiled_code
    # by its name each process knows a method once, with what was found out about it
    options = {**options, "method": _by_name(problem.method)}
    work = _Work(solve, f, (start, stop), problem.frame, options, together)
    if executor is not None and executor != "threads":
        _check_pickle(work)
    rows = points.reshape(-1, *problem.frame.point_shape)
    numbers = None
    if parameters is not None:
        numbers = real_array(parameters, "parameters").reshape(len(rows), -1)
    parts = _Parts(problem, times, out)
    run = completed(
        work,
        range(len(rows)),
        len(rows),
        workers,
        executor,
        data=lambda chunk: (rows[chunk], None if numbers is None else numbers[chunk]),
    )
    with closing(run) as running:
        for finished in running:
            members = finished.chunk
            if finished.result is None:
                parts.died(members, str(finished.failure))
            elif together:
                parts.add(members, finished.result[0])
            else:
                for member, solution in zip(members, finished.result, strict=True):
                    parts.add([member], solution)
    return parts.solution(batch)


def _times(
    problem: Problem, start: float, stop: float, t_eval: ArrayLike | None, h: object, out: Any
) -> Array:
    """Return the times at which all members are kept."""
    if t_eval is not None:
        return check_t_eval(t_eval, start, stop)
    if h is None:
        # members have steps of their own
        ends = np.unique([start, stop])
        return ends if stop >= start else ends[::-1]
    grid = make_grid((start, stop), cast(float, h))
    problem.check_grid(grid, h, every=int(out is None), between=False)
    return grid.times


def _check_out(out: Any, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
    """Raise TypeError or ValueError unless an array can hold all points."""
    try:
        found, kind = tuple(out.shape), np.dtype(out.dtype)
    except (AttributeError, TypeError):
        raise TypeError(
            f"out must be an array, such as one of NumPy, zarr or h5py, got {out!r}"
        ) from None
    if found != shape:
        raise ValueError(f"out must have shape {shape}, got {found}")
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


def _by_name(method: Method) -> str | Method:
    """Return the name of a method that comes with the package, others as they are."""
    known = any(own.get(method.name) is method for own in (packaged, munthe_kaas))
    return method.name if known else method


def _check_pickle(work: _Work) -> None:
    try:
        pickle.dumps(work)
    except Exception as error:
        raise TypeError(
            "f, frame and all other arguments must be such that other processes can be told of "
            "them (pickled); functions must be those of a module, a compiled one "
            f"cg.CompiledFunction(path, symbol); got {work.f!r}: {error}"
        ) from error


class _Parts:
    """What members came to, put together as it comes."""

    def __init__(self, problem: Problem, times: Array, out: Any) -> None:
        self._problem = problem
        self._total = math.prod(problem.batch)
        self._t = times
        self._out = out
        self._any = False
        if out is None:
            shape = (len(times), self._total, *problem.frame.point_shape)
            self._y: Any = np.full(shape, math.nan, dtype=problem.points.dtype)
        else:
            self._y = out
        self._events: tuple[list[Array], list[Array]] | None = None
        self._counts = dict.fromkeys(("nfev", "njev", "nlu", "nexp", "steps", "nrejected"), 0)
        self._statuses: list[int] = []
        self._failures: dict[tuple[int, ...], str] = {}

    def add(self, members: list[int], solution: Solution) -> None:
        """Take the solution of some members, or of one alone."""
        alone = solution.y.ndim == 1 + len(self._problem.frame.point_shape)
        self._any = True
        reached = self._reached(solution.t)
        y = solution.y[:reached, None] if alone else solution.y[:reached]
        part = slice(members[0], members[-1] + 1)
        self._y[:reached, part] = y
        self._leave_out(reached, part)
        for name in self._counts:
            self._counts[name] += getattr(solution, name)
        self._statuses.append(solution.status)
        if alone and not solution.success:
            self._failures[self._index(members[0])] = solution.message
        for (place,), message in [] if alone else solution.failures.items():
            self._failures[self._index(members[place])] = message
        if solution.t_events is not None and solution.y_events is not None:
            self._add_events(members, solution, alone)

    def died(self, members: list[int], message: str) -> None:
        """Take that the worker of some members died."""
        for member in members:
            self._failures[self._index(member)] = message
        self._leave_out(0, slice(members[0], members[-1] + 1))
        self._statuses.append(-1)

    def solution(self, batch: tuple[int, ...]) -> Solution:
        """Return the whole."""
        if not self._any:
            raise RuntimeError(failed_members(self._failures, self._total))
        y = self._y
        if self._out is None:
            y = y.reshape(len(self._t), *batch, *self._problem.frame.point_shape)
            y.flags.writeable = False
        t = np.array(self._t)
        t.flags.writeable = False
        status, message = 0, FINISHED
        if self._failures:
            status, message = -1, failed_members(self._failures, self._total)
        elif all(each == 1 for each in self._statuses):
            status, message = 1, TERMINAL_EVENT
        times, places = self._events or (None, None)
        return Solution(
            t=t,
            y=y,
            sol=None,
            t_events=None if times is None else [array.reshape(batch) for array in times],
            y_events=None if places is None else [array.reshape(batch) for array in places],
            **self._counts,
            status=status,
            message=message,
            success=status >= 0,
            method=self._problem.method,
            failures=dict(sorted(self._failures.items())),
            frame=self._problem.frame,
        )

    def _index(self, member: int) -> tuple[int, ...]:
        return tuple(map(int, np.unravel_index(member, self._problem.batch)))

    def _reached(self, t: Array) -> int:
        """Return at how many of the times a solution has points: an event adds its own."""
        if t.size and abs(t[-1] - self._t[len(t) - 1]) > 4.0 * np.spacing(abs(t[-1])):
            return len(t) - 1
        return len(t)

    def _leave_out(self, reached: int, part: slice) -> None:
        """Write NaN where members didn't come to."""
        if self._out is not None and reached < len(self._t):
            self._y[reached:, part] = math.nan

    def _add_events(self, members: list[int], solution: Solution, alone: bool) -> None:
        assert solution.t_events is not None
        assert solution.y_events is not None
        count = len(solution.t_events)
        if self._events is None:
            self._events = (
                [np.empty(self._total, dtype=object) for _ in range(count)],
                [np.empty(self._total, dtype=object) for _ in range(count)],
            )
        for kept, found in zip(self._events, (solution.t_events, solution.y_events), strict=True):
            for array, values in zip(kept, found, strict=True):
                for place, member in enumerate(members):
                    array[member] = values if alone else values[place]
