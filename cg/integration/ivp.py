"""Initial value problems on manifolds, with the conventions of SciPy's solve_ivp."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

from numpy.typing import ArrayLike
from scipy import LowLevelCallable

from cg.catalogue import methods
from cg.checks import check_flag
from cg.frames.base import Frame, Points
from cg.integration.adaptive import AdaptiveSteps, ErrorNorm, StepCountError, StepSizeError
from cg.integration.arguments import (
    check_args,
    check_atol,
    check_max_steps,
    check_memory,
    check_rtol,
    check_step,
    check_t_eval,
    check_unused,
)
from cg.integration.blocks import is_compiled
from cg.integration.events import EventLog
from cg.integration.external import CompiledRhs, compiled_rhs, integrate_compiled
from cg.integration.external_ivp import solve_compiled
from cg.integration.external_task import adaptive_task, fixed_task
from cg.integration.fixed import (
    check_points,
    check_problem,
    check_span,
    fixed_steps,
    step_count,
    time_grid,
)
from cg.integration.implicit import DEFAULT_STAGE_SOLVER
from cg.integration.output import Output
from cg.integration.result import Solution, Trajectory
from cg.integration.step import Coefficients, Step
from cg.tableau import Tableau

DEFAULT_METHOD = next(name for name in ("CG4(3)", "CG2(3)") if name in methods)
"""The pair that is used unless another method is named."""

_FINISHED = "The end of t_span was reached."


def solve_ivp(
    f: Coefficients | LowLevelCallable[Any, Any],
    t_span: Sequence[float],
    y0: ArrayLike,
    *,
    frame: Frame,
    method: str | Tableau = DEFAULT_METHOD,
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
    stage_solver: str = DEFAULT_STAGE_SOLVER,
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
        Name of a method of the catalogue, or a tableau.  Of a pair the weights of higher order
        make the steps.
    h
        Size of fixed steps, positive; the last may be shorter.  No error is estimated.
    rtol, atol
        Relative and absolute tolerance of the error in one step, by default 1e-3 and 1e-6.  The
        error is measured in the coordinates of the frame (angles for rotations) where it has
        them, else in the ambient space.  ``rtol`` is relative to :math:`|y_i|` on Euclidean
        space, to 1 for coordinates like angles; see `cg.integration.adaptive.ErrorNorm`.
        ``atol`` may be given for each coordinate.
    t_eval
        Times at which to store the solution, sorted in the direction of integration and within
        ``t_span``; by default those of the steps.
    dense_output
        Whether to return a continuous solution.  It has local order four and costs one more
        evaluation of ``f`` in all.
    events
        A function ``event(t, y, *args)`` or a sequence of them, whose zeros are found along the
        continuous solution.  Attributes ``terminal`` (a bool, or the number of times after which
        to stop) and ``direction`` are as in SciPy.  A zero at the initial point is no event.
    max_step
        Largest step size.
    first_step
        Size of the first step, by default chosen from the problem.
    max_steps
        Number of adaptive steps, rejected ones included, after which the integration ends
        without success; by default 1,000,000.
    args
        Further arguments of ``f`` and of the events.
    stage_solver
        How the stages of an implicit method are found: ``"newton"`` or ``"fixed-point"``.

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
    rhs = compiled_rhs(f)
    tableau = check_problem(f if rhs is None else rhs, frame, method)
    start, stop = check_span(t_span)
    point = check_points(frame, y0)
    batch = point.shape[: point.ndim - len(frame.point_shape)]
    wanted = None if t_eval is None else check_t_eval(t_eval, start, stop)
    extra = check_args(args)
    dense = check_flag("dense_output", dense_output)
    log = EventLog(events, extra)
    if log and batch:
        raise ValueError("events must be None for an ensemble")

    coefficients = _coefficients(f, rhs, frame, extra)
    step = Step(coefficients, frame, tableau, batch=batch, stage_solver=stage_solver)
    single = Step(coefficients, frame, tableau, stage_solver=stage_solver)
    fast = rhs if tableau.explicit and is_compiled(frame) else None
    largest = check_step(max_step, "max_step", infinite=True)
    steps: Iterable[tuple[float, Points]]
    adaptive: AdaptiveSteps | None = None
    if h is not None:
        check_unused(rtol=rtol, atol=atol, first_step=first_step, max_steps=max_steps)
        count = step_count((start, stop), h)
        if float(h) > largest:
            raise ValueError(f"h must not be larger than max_step = {largest:g}, got {h!r}")
        if fast is not None:
            if wanted is None and not (dense or log):
                return _solution_of(
                    integrate_compiled(
                        fast, (start, stop), point, frame=frame, tableau=tableau, h=float(h)
                    )
                )
            task = fixed_task(
                fast, single, (start, stop), count, float(h), point,
                keep=wanted is None, dense=dense,
            )  # fmt: skip
            return solve_compiled(task, start, point, batch, wanted, log)
        check_memory(h, count, point.nbytes * (count if wanted is None or dense else 0))
        steps = fixed_steps(step, time_grid((start, stop), h), float(h), point)
    else:
        if tableau.embedded_weights is None:
            raise ValueError(
                f"method must be a pair unless h gives the step size, got {method!r}, which has "
                "no embedded weights"
            )
        norm = ErrorNorm(frame, point, check_rtol(rtol), check_atol(atol))
        first = None if first_step is None else check_step(first_step, "first_step")
        if first is not None and first > abs(stop - start):
            raise ValueError(f"first_step must not exceed the length of t_span, got {first_step!r}")
        most = check_max_steps(max_steps)
        if fast is not None:
            task = adaptive_task(
                fast, single, stop, norm, max_step=largest, first_step=first, max_steps=most,
                keep=wanted is None and not batch, dense=dense,
            )  # fmt: skip
            return solve_compiled(task, start, point, batch, wanted, log)
        steps = adaptive = AdaptiveSteps(
            step, norm, start, stop, point, max_step=largest, first_step=first, max_steps=most
        )

    out = Output(step, start, point, wanted, dense, log)
    status, message = 0, _FINISHED
    try:
        for t, reached in steps:
            if out.add(t, reached):
                status, message = 1, "A terminal event ended the integration."
                break
    except (StepSizeError, StepCountError) as error:
        status, message = -1, f"Failure: {error}."
    return out.solution(status, message, 0 if adaptive is None else adaptive.rejected)


def _coefficients(
    f: Any, rhs: CompiledRhs | None, frame: Frame, args: tuple[Any, ...]
) -> Coefficients:
    """Return ``f``, or the compiled function that it is, as a function of time and point."""
    if rhs is not None:
        if args:
            raise ValueError(f"args must be None for a compiled f, got {args!r}")
        return rhs.on(frame)
    function: Coefficients = f

    def with_args(t: float, y: Points) -> ArrayLike:
        return function(t, y, *args)

    return with_args if args else function


def _solution_of(trajectory: Trajectory) -> Solution:
    """Return a trajectory of the compiled integrator as a solution."""
    return Solution(
        t=trajectory.t,
        y=trajectory.y,
        sol=None,
        t_events=None,
        y_events=None,
        nfev=trajectory.nfev,
        njev=0,
        nlu=0,
        nexp=trajectory.nexp,
        steps=len(trajectory.t) - 1,
        nrejected=0,
        status=0,
        message=_FINISHED,
        success=True,
        method=trajectory.method,
    )
