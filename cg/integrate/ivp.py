"""Initial value problems on manifolds, with the conventions of SciPy's solve_ivp."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Sequence
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import LowLevelCallable

from cg.catalogue import methods
from cg.frames.base import Array, Frame, Points, real_array
from cg.integrate.adaptive import AdaptiveSteps, ErrorNorm, StepSizeError
from cg.integrate.dense import DenseOutput, Segment
from cg.integrate.events import EventLog
from cg.integrate.external import CompiledRhs, compiled_rhs, integrate_compiled
from cg.integrate.fixed import check_points, check_problem, check_span, fixed_steps, time_grid
from cg.integrate.implicit import DEFAULT_STAGE_SOLVER
from cg.integrate.result import Solution, Trajectory
from cg.integrate.step import Coefficients, Step
from cg.tableau import Tableau

DEFAULT_METHOD = next(name for name in ("CG4(3)", "CG2(3)") if name in methods)
"""The pair that is used unless another method is named."""

_RTOL, _ATOL = 1e-3, 1e-6
_FINISHED = "The end of t_span was reached."
_SMALLEST_RTOL = 100.0 * float(np.finfo(np.float64).eps)


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
        compiled code if all steps have size ``h`` and nothing between them is asked for.
    t_span
        Initial and final time.  If the final time is smaller, integration runs backward.
    y0
        Initial point, shape ``frame.point_shape``.  With ``h`` it may have leading axes: an
        ensemble that is integrated at once, ``f`` then being called with all points and
        returning shape ``(*batch, frame.dim)``.
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
        space, to 1 for coordinates like angles; see `cg.integrate.adaptive.ErrorNorm`.
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
    wanted = None if t_eval is None else _check_t_eval(t_eval, start, stop)
    extra = _check_args(args)
    log = EventLog(events, extra)
    if log and batch:
        raise ValueError("events must be None for an ensemble")

    coefficients = _coefficients(f, rhs, frame, extra)
    step = Step(coefficients, frame, tableau, batch=batch, stage_solver=stage_solver)
    largest = _check_step(max_step, "max_step", infinite=True)
    steps: Iterable[tuple[float, Points]]
    adaptive: AdaptiveSteps | None = None
    if h is not None:
        _check_unused(rtol=rtol, atol=atol, first_step=first_step)
        times = time_grid((start, stop), h)
        if h > largest:
            raise ValueError(f"h must not be larger than max_step = {largest:g}, got {h!r}")
        if rhs is not None and tableau.explicit and wanted is None and not (dense_output or log):
            return _solution_of(
                integrate_compiled(
                    rhs, (start, stop), point, frame=frame, tableau=tableau, h=float(h)
                )
            )
        steps = fixed_steps(step, times, float(h), point)
    else:
        if tableau.embedded_weights is None:
            raise ValueError(
                f"method must be a pair unless h gives the step size, got {method!r}, which has "
                "no embedded weights"
            )
        if batch:
            raise ValueError(
                f"h must be given for an ensemble, got y0 of shape {point.shape}: its members "
                "have no common error"
            )
        norm = ErrorNorm(frame, point, _check_rtol(rtol), _check_atol(atol))
        first = None if first_step is None else _check_step(first_step, "first_step")
        if first is not None and first > abs(stop - start):
            raise ValueError(f"first_step must not exceed the length of t_span, got {first_step!r}")
        steps = adaptive = AdaptiveSteps(
            step, norm, start, stop, point, max_step=largest, first_step=first
        )

    out = _Output(step, start, point, wanted, bool(dense_output), log)
    status, message = 0, _FINISHED
    try:
        for t, reached in steps:
            if out.add(t, reached):
                status, message = 1, "A terminal event ended the integration."
                break
    except StepSizeError as error:
        status, message = -1, f"Failure: {error}."
    return out.solution(status, message, 0 if adaptive is None else adaptive.rejected)


class _Output:
    """What is kept of the steps of an integration."""

    def __init__(
        self,
        step: Step,
        t: float,
        point: Points,
        wanted: Array | None,
        dense: bool,
        log: EventLog,
    ) -> None:
        self.step = step
        self.wanted = wanted
        self.dense = dense
        self.log = log
        self.start = point
        self.last = t, point
        self.steps = 0
        self.ends = [t]
        self.segments: list[Segment] = []
        self.t = [np.array([t])]
        self.y = [point[None]]
        self.used = 0
        if wanted is not None:
            self.used = int((wanted == t).sum())
            self.t = [wanted[: self.used]]
            self.y = [np.repeat(point[None], self.used, axis=0)]
        log.start(t, point)

    def add(self, t: float, point: Points) -> bool:
        """Keep one step; return whether an event ends the integration in it."""
        self.steps += 1
        segment: Segment | None = None
        terminal = None
        before, self.last = self.last, (t, point)
        if self.dense or self.log:
            segment = Segment(self.step, *before, t, point)
            terminal = self.log.record(segment)
            if terminal is not None:
                t, point = terminal, segment(np.array([terminal]))[0]
        if self.dense and segment is not None:
            self.segments.append(segment)
            self.ends.append(t)
        if self.wanted is None:
            self.t.append(np.array([t]))
            self.y.append(point[None])
        else:
            # Sorted in the direction of integration, so that those reached come first.
            rest = self.wanted[self.used :]
            reached = rest[: int(((rest - t) * np.sign(t - before[0]) <= 0.0).sum())]
            if len(reached) == 1 and reached[0] == t:
                self.t.append(reached)
                self.y.append(point[None])
            elif len(reached):
                segment = segment or Segment(self.step, *before, *self.last)
                self.t.append(reached)
                self.y.append(segment(reached))
            self.used += len(reached)
        return terminal is not None

    def solution(self, status: int, message: str, rejected: int) -> Solution:
        """Return the result."""
        t, y = np.concatenate(self.t), np.concatenate(self.y)
        t.flags.writeable = y.flags.writeable = False
        dense = DenseOutput(self.ends, self.segments, self.start) if self.dense else None
        return Solution(
            t=t,
            y=y,
            sol=dense,
            t_events=self.log.times(),
            y_events=self.log.points(self.start),
            nfev=self.step.nfev,
            njev=self.step.njev,
            nlu=self.step.nlu,
            nexp=self.step.nexp,
            steps=self.steps,
            nrejected=rejected,
            status=status,
            message=message,
            success=status >= 0,
            method=self.step.tableau,
        )


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


def _check_unused(**arguments: object) -> None:
    for name, value in arguments.items():
        if value is not None:
            raise ValueError(f"{name} must not be given together with h, got {value!r}")


def _check_t_eval(t_eval: ArrayLike, start: float, stop: float) -> Array:
    """Return the times to store the solution at, after checking them."""
    times = real_array(t_eval, "t_eval")
    if times.ndim != 1:
        raise ValueError(f"t_eval must have one axis, got shape {times.shape}")
    low, high = min(start, stop), max(start, stop)
    # Written so that a NaN is refused.
    if not ((times >= low) & (times <= high)).all():
        raise ValueError(f"t_eval must lie within t_span, {low:g} to {high:g}, got {t_eval!r}")
    if not (np.sign(stop - start) * np.diff(times) > 0.0).all():
        raise ValueError(
            f"t_eval must be strictly sorted in the direction of integration, got {t_eval!r}"
        )
    return times


def _check_args(args: Any) -> tuple[Any, ...]:
    if args is None:
        return ()
    try:
        return tuple(args)
    except TypeError:
        raise TypeError(
            f"args must be a tuple of further arguments, such as (x,) for one, got {args!r}"
        ) from None


def _check_step(value: Any, name: str, *, infinite: bool = False) -> float:
    if isinstance(value, bool) or not isinstance(value, Real):
        raise TypeError(f"{name} must be a real number, got {value!r}")
    size = _as_float(value)
    if not size > 0.0 or (math.isinf(size) and not infinite):
        raise ValueError(
            f"{name} must be positive{'' if infinite else ' and finite'}, got {value!r}"
        )
    return size


def _as_float(number: Any) -> float:
    """Return an int or a fraction beyond all doubles as an infinity, which the caller judges."""
    try:
        return float(number)
    except OverflowError:
        return math.inf if number > 0 else -math.inf


def _check_rtol(rtol: Any) -> float:
    if rtol is None:
        return _RTOL
    if isinstance(rtol, bool) or not isinstance(rtol, Real):
        raise TypeError(f"rtol must be a real number, got {rtol!r}")
    value = _as_float(rtol)
    if not (math.isfinite(value) and value >= 0.0):
        raise ValueError(f"rtol must be finite and not negative, got {rtol!r}")
    if value < _SMALLEST_RTOL:
        warnings.warn(
            f"rtol = {value:g} is too small to be attained and is raised to {_SMALLEST_RTOL:.3g}",
            stacklevel=3,
        )
    return max(value, _SMALLEST_RTOL)


def _check_atol(atol: ArrayLike | None) -> Array:
    value = np.array(_ATOL) if atol is None else real_array(atol, "atol")
    if not (np.isfinite(value).all() and (value >= 0.0).all()):
        raise ValueError(f"atol must be finite and not negative, got {atol!r}")
    return value
