"""Ensembles: many initial value problems, integrated independently on any executor."""

from __future__ import annotations

import math
import pickle
import warnings
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any, Never, Unpack

import numpy as np
from numpy.typing import ArrayLike
from scipy import LowLevelCallable

from cg.executors import ExecutorLike, check_executor, completed
from cg.frames.arrays import Array, Points
from cg.frames.base import Frame
from cg.integration.arguments import check_grid, equal_steps
from cg.integration.loop.failures import explain_failure
from cg.integration.loop.messages import TERMINAL_EVENT
from cg.integration.loop.progress import Progress
from cg.integration.loop.record import Output
from cg.integration.member_results import EnsembleResults, MemberResults
from cg.integration.options import Options, check_no_more, expand_options
from cg.integration.problem import Problem, make_problem, make_rhs
from cg.integration.results import EnsembleSolution
from cg.integration.rhs.function import CompiledFunction, Function
from cg.integration.rhs.python import Coefficients, PythonRhs
from cg.integration.step.implicit import DEFAULT_STAGE_SOLVER
from cg.support.checks import check_flag
from cg.support.parallel import single_threads
from cg.support.shared_numbers import Stop

_MEMBERS_PER_RUN = 1 << 14  # limits the memory of a run


@expand_options
def solve_ensemble(
    f: Coefficients | CompiledFunction | LowLevelCallable[Any, Any],
    t_span: Sequence[float],
    y0: ArrayLike,
    *rest: Never,
    frame: Frame,
    vectorized: bool = False,
    common_steps: bool = False,
    stage_solver: str = DEFAULT_STAGE_SOLVER,
    jac: Function | None = None,
    executor: ExecutorLike = None,
    workers: int | None = None,
    out: Any = None,
    progress: Callable[[float, float], None] | None = None,
    **options: Unpack[Options],
) -> EnsembleSolution:
    """Solve an initial value problem from many points, or with many sets of parameters.

    Each member takes the steps that it would take alone in `cg.solve_ivp`, to the bit.

    Parameters
    ----------
    f
        ``f(t, y, *args)``, or ``f(t, y, *args, row)`` with a row of ``parameters``, returns the
        coefficients of one member; see `cg.solve_ivp`.  If ``vectorized`` it is given times
        ``(k,)``, points ``(k, *frame.point_shape)`` and rows ``(k, n)`` of any subset of the
        members, and returns shape ``(k, frame.dim)``, on a `cg.frames.PhaseSpace` ``(k, forces)``.
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
        change no bit of the result, since BLAS has one thread in all cases.  Other processes must
        be able to unpickle ``f``: `cg.CompiledFunction` for a compiled one.
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
        If members failed; it names their number and the first one.  Or, while members take
        thousands of steps, for the reasons of `cg.solve_ivp`.

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
    check_no_more(rest)
    vectorized = check_flag("vectorized", vectorized)
    common = check_flag("common_steps", common_steps)
    problem = make_problem(
        f, t_span, y0, frame=frame, options=options, many=True, vectorized=vectorized,
        common=common, stage_solver=stage_solver, jac=jac,
    )  # fmt: skip
    return solve_members(problem, executor, workers, out, progress)


def solve_members(
    problem: Problem,
    executor: ExecutorLike,
    workers: int | None,
    out: Any,
    progress: Callable[[float, float], None] | None,
) -> EnsembleSolution:
    """Integrate the members of an ensemble; further arguments are those of `solve_ensemble`."""
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
    if isinstance(problem.rhs, PythonRhs):
        problem.rhs.first = 0
    result = EnsembleResults(problem, out)
    watch = Progress(progress, problem.t0, problem.t1, len(problem.points))
    if distributed:
        _distribute(problem, executor, workers, result, watch)
    else:
        size = len(problem.points) if common else _MEMBERS_PER_RUN
        with single_threads():  # as with workers, so that they change no bit
            for first in range(0, len(problem.points), size):
                members = slice(first, min(first + size, len(problem.points)))
                result.add(members, _integrate(_select_members(problem, members), watch))
                watch.count_finished(members.stop - first)
    watch.finish()
    solution = result.solution()
    if not solution.success:
        warnings.warn(solution.message, stacklevel=3)
    return solution


def _select_members(problem: Problem, members: slice) -> Problem:
    if members == slice(0, len(problem.points)):
        return problem
    return replace(problem, points=problem.points[members], rhs=problem.rhs.part(members))


def _integrate(problem: Problem, watch: Progress | None) -> MemberResults:
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
        failure = explain_failure(run, member)
        if isinstance(failure, MemoryError):
            raise failure
        messages[member] = TERMINAL_EVENT if failure is None else f"{failure}".removesuffix(".")
    status = np.select(
        [run.status == Stop.FINISHED, run.status == Stop.TERMINAL_EVENT], [0, 1], default=-1
    )
    points = plan.points(y, (len(times), members))
    steps = run.interpolants() if problem.dense else None
    return MemberResults(points, run.reached, status, run.counts, messages, steps, run.events())


@dataclass(frozen=True)
class _MemberTask:
    """The task of a worker: integrate some members of a problem, of which it has only the first."""

    problem: Problem

    def __call__(self, data: tuple[int, Points, Array | None]) -> MemberResults:
        """Integrate some members, given the first one's place, their points and parameters."""
        first, points, numbers = data
        problem = self.problem
        rhs, _ = make_rhs(
            problem.f, problem.plan.frame, problem.args or None, numbers, problem.rhs.vectorized,
            len(points),
        )  # fmt: skip
        if isinstance(rhs, PythonRhs):
            rhs.first = first
        return _integrate(replace(problem, points=points, rhs=rhs), None)


def _distribute(
    problem: Problem, executor: Any, workers: Any, result: EnsembleResults, watch: Progress
) -> None:
    """Integrate members on an executor."""
    work = _MemberTask(_select_members(problem, slice(0, 1)))
    if executor is not None and executor != "threads":
        _check_pickle(work)
    points, numbers = problem.points, problem.rhs.parameters
    run = completed(
        work,
        range(len(points)),
        len(points),
        workers,
        executor,
        data=lambda chunk: (chunk[0], points[chunk], None if numbers is None else numbers[chunk]),
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
            "f, frame and all other arguments must be such that they can be pickled for other "
            "processes; functions must be those of a module, a compiled one "
            f"cg.CompiledFunction(path, symbol); got {work.problem.f!r}: {error}"
        ) from error
