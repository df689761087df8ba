"""Initial value problems on manifolds, with the conventions of SciPy's solve_ivp."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import LowLevelCallable

from cg.checks import check_flag
from cg.frames.arrays import Array
from cg.frames.base import Frame
from cg.integration.arguments import (
    check_atol,
    check_max_steps,
    check_rtol,
    check_span,
    check_step,
    check_t_eval,
    check_unused,
)
from cg.integration.choice import AUTO, choose_method
from cg.integration.compiled_function import CompiledFunction
from cg.integration.error_norm import ErrorNorm
from cg.integration.events import EventLog
from cg.integration.implicit import DEFAULT_STAGE_SOLVER
from cg.integration.members import solve_apart
from cg.integration.outcome import Logs, outcome
from cg.integration.own_steps import solve_members
from cg.integration.problem import Problem, make_problem
from cg.integration.progress import Progress, check_progress
from cg.integration.python_rhs import Coefficients
from cg.integration.recorder import Recorder
from cg.integration.results import Solution
from cg.integration.stepper import AdaptiveSchedule, Stepper
from cg.integration.stop_iteration import keeping_stop_iteration
from cg.integration.time_grid import TimeGrid, make_grid
from cg.method import Method
from cg.pairs import check_order, check_pair
from cg.runs import ExecutorLike

__all__ = ["solve_ivp"]


@keeping_stop_iteration
def solve_ivp(
    f: Coefficients | CompiledFunction | LowLevelCallable[Any, Any],
    t_span: Sequence[float],
    y0: ArrayLike,
    *,
    frame: Frame,
    method: str | Method = AUTO,
    h: float | None = None,
    rtol: float | None = None,
    atol: ArrayLike | None = None,
    t_eval: ArrayLike | None = None,
    dense_output: bool = False,
    events: Any = None,
    max_step: float = math.inf,
    first_step: float | None = None,
    max_steps: int | None = None,
    args: Iterable[Any] | None = None,
    parameters: ArrayLike | None = None,
    stage_solver: str = DEFAULT_STAGE_SOLVER,
    executor: ExecutorLike = None,
    workers: int | None = None,
    out: Any = None,
    progress: Callable[[float, float], None] | None = None,
) -> Solution:
    r"""Solve :math:`y' = \sum_i f_i(t, y) E_i(y)`, :math:`y(t_0) = y_0`, on a manifold.

    Steps are chosen by an error estimate if ``method`` is a pair, or are all of size ``h`` if
    that is given.  Every point of the solution lies on the manifold, those between steps too.

    Parameters
    ----------
    f
        ``f(t, y, *args)`` returns the coefficients, shape ``(frame.dim,)``.  It is given a
        read-only ``y`` of shape ``frame.point_shape``.  An exception that it raises ends the
        call.  It may be a compiled function as for `cg.integrate`; then explicit methods run in
        compiled code on the frames named there.  Otherwise it is called from Python.
    t_span
        Initial and final time.  If the final time is smaller, integration runs backward.
    y0
        Initial point, shape ``frame.point_shape``.  It may have leading axes: an ensemble that is
        integrated at once, ``f`` then being called with all points and returning shape
        ``(*batch, frame.dim)``.  Without ``h`` all members take the same steps, those that the
        member with the largest error calls for.  Not so where adaptive steps run in compiled
        code: each member has steps of its own, and ``t`` are the times of ``t_eval``, without
        it the ends of ``t_span``.
    frame
        The frame that holds the points and supplies the flows.
    method
        Name of a method of the catalogue, or a method.  Of a pair the weights of higher order
        make the steps.  Methods of Munthe-Kaas (``"RKMK5(4)"``, `cg.MuntheKaas`) need a frame with
        brackets.  By default, ``"auto"``, the pair that costs least at equal errors, of those
        whose error estimates tell the errors.  For ``rtol`` below 1e-4 it is ``"RKMK8(5,3)"`` on
        frames with brackets and ``"CF6(5)"`` on others; else ``"RKMK5(4)"`` on frames in Python
        with brackets and ``"CF5(4)"`` on all others.  ``solution.method`` tells which it was.
    h
        Size of fixed steps, positive; the last may be shorter.  No error is estimated.
    rtol, atol
        Relative and absolute tolerance of the error in one step, by default 1e-3 and 1e-6.  The
        error is measured in the coordinates of the frame (angles for rotations) where it has
        them, else in the ambient space.  ``rtol`` is relative to :math:`|y_i|` on Euclidean
        space, to 1 for coordinates like angles; see `cg.integration.error_norm.ErrorNorm`.
        ``atol`` may be given for each coordinate, or each entry of a point where errors are
        measured in the ambient space.
    t_eval
        Times at which to store the solution, sorted in the direction of integration and within
        ``t_span``; by default those of the steps.
    dense_output
        Whether to return a continuous solution.  It is as accurate as the steps, as output at
        ``t_eval`` and events are; steps that have output in them take
        `cg.integration.interpolation.extra_evaluations` more of ``f``.
    events
        A function ``event(t, y, *args)`` or a sequence of them, whose zeros are found along the
        continuous solution.  Attributes ``terminal`` (a bool, or the number of times after which
        to stop) and ``direction`` are as in SciPy.  A zero at the initial point is no event.  Of
        an ensemble they are given one member at a time, and end that member, which is NaN from
        there on; where ``f`` is given all members, what it returns for that one is ignored.
    max_step
        Largest step size.
    first_step
        Size of the first step, by default chosen from the problem.
    max_steps
        Number of adaptive steps, rejected ones included, after which the integration ends
        without success; by default 1,000,000.
    args
        Further arguments of ``f`` and of the events.
    parameters
        For a compiled ``f``: numbers whose address it is given as its last argument, shape
        ``(*batch, k)``, those of its own member of an ensemble.
    stage_solver
        How the stages of an implicit method are found: ``"newton"`` or ``"fixed-point"``.
    executor, workers
        Where the members of an ensemble are integrated, each by itself, and by how many workers:
        threads of this process by default, or any executor that `cg.search` takes.  ``f`` is then
        called with one point, and ``t`` are the times of ``t_eval``, without it those of the
        fixed steps or else the ends of ``t_span``; a member is NaN after its end.
        On one machine, results don't depend on the executor.  Other processes must be able to
        unpickle ``f``: `cg.CompiledFunction` for a compiled one.
    out
        Array of the shape ``(times, members, *point_shape)``, all leading axes of the ensemble as
        one, that receives points as members end, such as one of NumPy on disk, of zarr or h5py;
        then ``y`` is ``out`` itself.
    progress
        Called with the time that was covered and the length of ``t_span``, at most ten times a
        second and when the integration ends; where each member of an ensemble has its own steps,
        with sums over the members.  Not where ``executor``, ``workers`` or ``out`` is given.

    Returns
    -------
    Solution
        With time as the *first* axis of ``y``.

    Raises
    ------
    TypeError
        If an argument has an impossible type.
    ValueError
        If an argument has an impossible value, arguments contradict each other, or ``f`` or an
        event returns another shape or numbers that aren't finite.
    OverflowError
        With fixed steps, if the solution exceeds the range of floating point.
    ConvergenceError
        With fixed steps, if the stages of an implicit method can't be found.
    StepTooLongError
        With fixed steps, if a step of a method on a Lie algebra is too long for dexp⁻¹.

    Warns
    -----
    UserWarning
        If ``rtol`` is too small to be attained, and is raised.

    Examples
    --------
    A body that is turned about its z axis ever faster: when has it made a full turn?

    >>> import numpy as np
    >>> import cg
    >>> def turned(t, y):
    ...     return y[1, 0]
    >>> turned.terminal, turned.direction = True, 1
    >>> solution = cg.solve_ivp(
    ...     lambda t, y: [0.0, 0.0, t], (0, 10), np.eye(3), frame=cg.frames.SO3(),
    ...     max_step=0.5, events=turned,
    ... )
    >>> solution.t_events[0].round(6)  # the root of 4π
    array([3.544908])
    >>> solution.y.shape == (solution.steps + 1, 3, 3)
    True
    """
    relative = None if h is not None else check_rtol(rtol)
    if isinstance(method, str) and method == AUTO:
        method = choose_method(frame, relative)
    problem = make_problem(
        f, frame, method, y0, args=args, parameters=parameters, stage_solver=stage_solver
    )
    check_progress(progress)
    if executor is not None or workers is not None or out is not None:
        if progress is not None:
            raise ValueError("progress must be None with executor, workers or out")
        options = {
            "method": problem.method, "h": h, "rtol": rtol if relative is None else relative,
            "atol": atol, "t_eval": t_eval, "dense_output": dense_output, "events": events,
            "max_step": max_step, "first_step": first_step, "max_steps": max_steps,
            "args": problem.args or None, "stage_solver": stage_solver,
        }  # fmt: skip
        return solve_apart(
            solve_ivp, problem, f, t_span, parameters, executor, workers, out, options
        )
    start, stop = check_span(t_span)
    wanted = None if t_eval is None else check_t_eval(t_eval, start, stop)
    dense = check_flag("dense_output", dense_output)
    logs = _event_logs(events, problem)
    largest = check_step(max_step, "max_step", infinite=True)
    schedule: TimeGrid | AdaptiveSchedule
    if h is not None:
        check_unused(rtol=rtol, atol=atol, first_step=first_step, max_steps=max_steps)
        check_order(problem.method, stacklevel=3)
        schedule = make_grid((start, stop), h)
        if float(h) > largest:
            raise ValueError(f"h must not be larger than max_step = {largest:g}, got {h!r}")
        problem.check_grid(
            schedule, h, every=int(wanted is None or dense), between=dense or bool(logs)
        )
    else:
        assert relative is not None
        if problem.method.embedded_order is None:
            raise ValueError(
                f"method must be a pair unless h gives the step size, got {method!r}, which has "
                "no embedded weights"
            )
        check_pair(problem.method, stacklevel=3)
        norm = ErrorNorm(frame, problem.points, relative, check_atol(atol))
        first = None if first_step is None else check_step(first_step, "first_step")
        if first is not None and first > abs(stop - start):
            raise ValueError(f"first_step must not exceed the length of t_span, got {first_step!r}")
        schedule = AdaptiveSchedule(start, stop, norm, largest, first, check_max_steps(max_steps))
        if problem.has_own_steps:
            watch = Progress(progress, start, stop, math.prod(problem.batch))
            return solve_members(problem, schedule, wanted, dense, logs, watch)
    watch = Progress(progress, start, stop)
    return outcome(*_record(problem, schedule, wanted, dense, logs, watch), problem, logs)


def _event_logs(events: Any, problem: Problem) -> Logs | None:
    """Return the events of every member."""
    if events is None:
        return None
    return {member: EventLog(events, problem.args) for member in np.ndindex(problem.batch)}


def _record(
    problem: Problem,
    schedule: TimeGrid | AdaptiveSchedule,
    wanted: Array | None,
    dense: bool,
    logs: Logs | None,
    watch: Progress,
) -> tuple[Stepper, Recorder]:
    """Take all steps."""
    looked_for = {member: log for member, log in (logs or {}).items() if log}
    between = dense or bool(looked_for) or wanted is not None
    stepper = problem.stepper(
        schedule, slopes=between, watched=bool(looked_for), keep=wanted is None and not looked_for
    )
    recorder = Recorder(stepper, schedule.start, problem.points, wanted, dense, looked_for)
    for block in stepper.blocks():
        ended = recorder.add(block)
        watch.reach(block.t[-1])
        if ended:
            break
    watch.finish()
    return stepper, recorder
