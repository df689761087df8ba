"""Crouch-Grossman methods with a fixed step."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from numbers import Real
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike
from scipy import LowLevelCallable

from cg.frames.base import Array, Frame, Points, complex_array, real_array
from cg.frames.product import Product
from cg.integration.arguments import as_float, check_count, check_joined, check_memory
from cg.integration.implicit import DEFAULT_STAGE_SOLVER
from cg.integration.result import Trajectory
from cg.integration.step import Coefficients, Step
from cg.tableau import Tableau

__all__ = [
    "Coefficients",
    "Trajectory",
    "check_points",
    "check_problem",
    "check_span",
    "fixed_steps",
    "integrate",
    "last_step",
    "resolve_method",
    "step_count",
    "time_grid",
]

# A step number must be an exact float, or the times would not be distinct.
_MOST_STEPS = 2**53


def integrate(
    f: Coefficients | LowLevelCallable[Any, Any],
    t_span: Sequence[float],
    y0: ArrayLike,
    *,
    frame: Frame,
    method: str | Tableau,
    h: float,
    stage_solver: str = DEFAULT_STAGE_SOLVER,
    save_every: int = 1,
    workers: int = 1,
) -> Trajectory:
    r"""Integrate :math:`y' = \sum_i f_i(t, y) E_i(y)` with a fixed step.

    One step from :math:`p = y_k` is equation (2.2) of [1]_, or (2.3) for an implicit method:
    with :math:`F_j` the vector field whose coefficients are frozen at stage :math:`j`,

    .. math::

        Y_i = e^{h a_{is} F_s} \cdots e^{h a_{i1} F_1} p, \qquad
        y_{k+1} = e^{h b_s F_s} \cdots e^{h b_1 F_1} p .

    The flow of the lowest stage is applied first, the coefficients of stage :math:`i` are taken
    at :math:`t_k + c_i h`, and a coefficient that is exactly zero costs no flow.

    Parameters
    ----------
    f
        ``f(t, y)`` returns the coefficients, shape ``(*batch, frame.dim)``.  It is given a
        read-only ``y`` of shape ``(*batch, *frame.point_shape)``.  An exception that it raises
        ends the call.

        It may also be a compiled function ``int f(double t, const double *y, double *f,
        void *user_data)``, given as a `scipy.LowLevelCallable`, a function pointer of ctypes, or
        a ``numba.cfunc``.  It is given one point, writes the coefficients, and returns zero, or
        else ends the call.  Explicit methods then run wholly in compiled code, without Python's
        lock, on SO(3), unit quaternions, SU(2), SE(3), the sphere in space, Euclidean space and
        their products.
    t_span
        Initial and final time.  If the final time is smaller, integration runs backward.
    y0
        Initial point, shape ``frame.point_shape``; or with any number of leading axes, an
        ensemble of initial points that are integrated at once.
    frame
        The frame that holds the points and supplies the flows.
    method
        Name of a method of the catalogue, or a tableau.
    h
        Step size, positive whatever the direction.  If it doesn't divide the span, the last
        step is shorter.
    stage_solver
        How the stages of an implicit method are found: ``"newton"`` or ``"fixed-point"``.
    save_every
        Store the result of every so many steps, besides the initial and the final point.
    workers
        Number of threads over which a compiled ``f`` spreads an ensemble; it must allow that.

    Returns
    -------
    Trajectory

    Raises
    ------
    TypeError
        If ``f`` isn't callable, ``frame`` isn't a `Frame`, ``method`` is neither a name nor a
        tableau, or ``h`` isn't a real number.
    ValueError
        If ``t_span``, ``y0``, ``method`` or ``h`` has an impossible value, or if ``f`` returns
        another shape or numbers that aren't finite; or if the steps need more memory than there
        is.
    OverflowError
        If the solution exceeds the range of floating point.
    ConvergenceError
        If the stages of an implicit method can't be found.
    RuntimeError
        If a compiled ``f`` returns another number than zero.

    References
    ----------
    .. [1] Z. Jackiewicz, A. Marthinsen, B. Owren, "Construction of Runge-Kutta methods of
       Crouch-Grossman type of high order", Adv. Comput. Math. 13 (2000), 405-415.

    Examples
    --------
    A rotation about a fixed body axis is solved exactly by any method.

    >>> import numpy as np
    >>> from cg.frames import SO3
    >>> from cg.integration import integrate
    >>> turn = lambda t, y: [0.0, 0.0, np.pi / 2]
    >>> solution = integrate(turn, (0, 1), np.eye(3), frame=SO3(), method="CG3", h=0.25)
    >>> solution.y[-1].round(12)[:, 0]
    array([0., 1., 0.])
    """
    from cg.integration.external import (
        compiled_rhs,
        integrate_compiled,
        stored_count,
        stored_steps,
    )

    rhs = compiled_rhs(f)
    tableau = check_problem(f if rhs is None else rhs, frame, method)
    save_every = check_count(save_every, "save_every")
    workers = check_count(workers, "workers")
    if rhs is not None:
        return integrate_compiled(
            rhs,
            t_span,
            y0,
            frame=frame,
            tableau=tableau,
            h=h,
            save_every=save_every,
            workers=workers,
        )
    if workers != 1:
        raise ValueError(f"workers must be 1 unless f is compiled, got {workers!r}")
    steps = step_count(t_span, h)
    point = check_points(frame, y0)
    check_memory(h, steps, point.nbytes * stored_count(steps, save_every))
    times = time_grid(t_span, h)
    batch = point.shape[: point.ndim - len(frame.point_shape)]
    step = Step(cast(Coefficients, f), frame, tableau, batch=batch, stage_solver=stage_solver)
    kept = stored_steps(steps, save_every)
    points = np.empty((len(kept), *point.shape), dtype=point.dtype)
    points[0] = point
    for k, (_, reached) in enumerate(fixed_steps(step, times, float(h), point), start=1):
        if k % save_every == 0 or k == kept[-1]:
            points[-(-k // save_every)] = reached
    times = times[kept]
    times.flags.writeable = points.flags.writeable = False
    return Trajectory(times, points, step.nfev, step.nexp, tableau, float(h))


def fixed_steps(
    step: Step, times: Array, h: float, point: Points
) -> Iterator[tuple[float, Points]]:
    """Give time and point at the end of each step of a fixed-step integration.

    Parameters
    ----------
    step
        The step function.
    times
        The grid, as `time_grid` makes it.
    h
        Step size, positive.
    point
        The initial point or points.

    Raises
    ------
    OverflowError
        If the solution exceeds the range of floating point.
    """
    grid: list[float] = times.tolist()
    # Full steps take h itself, not differences of rounded times, so that all are equal.
    size = math.copysign(h, grid[-1] - grid[0])
    for k in range(1, len(grid)):
        if k == len(grid) - 1:
            size = last_step(grid[-2], grid[-1], size)
        point = step(grid[k - 1], point, size)
        if not np.isfinite(point).all():
            raise OverflowError(f"the solution is no longer finite at t = {grid[k]:.17g}")
        yield grid[k], point


def check_problem(f: object, frame: object, method: str | Tableau) -> Tableau:
    """Return the tableau after checking what every integration begins with.

    Raises
    ------
    TypeError
        If ``f`` isn't callable, ``frame`` isn't a `Frame`, or ``method`` is neither a name nor a
        tableau.
    ValueError
        If no method has that name.
    """
    if not callable(f):
        raise TypeError(f"f must be callable as f(t, y), got {f!r}")
    if not isinstance(frame, Frame):
        raise TypeError(f"frame must be a Frame such as SO3(), got {frame!r}")
    return resolve_method(method)


def check_points(frame: Frame, y0: ArrayLike) -> Points:
    """Return an initial point, or an ensemble of them, as a new array after checking it.

    Parameters
    ----------
    frame
        The frame that is to hold the points.
    y0
        Shape ``(*batch, *frame.point_shape)``.

    Raises
    ------
    ValueError
        If a point has another shape, isn't finite, lies off the manifold, or there is none.
    """
    if isinstance(frame, Product):
        check_joined(frame, y0)
    points = (real_array if frame.dtype.kind == "f" else complex_array)(y0, "y0")
    rank = len(frame.point_shape)
    batch = points.shape[: max(points.ndim - rank, 0)]
    if not batch or points.shape[len(batch) :] != frame.point_shape:
        return frame.check_point(y0, name="y0")
    if points.size == 0:
        raise ValueError(f"y0 must hold at least one point, got shape {points.shape}")
    finite = np.isfinite(points).all(axis=tuple(range(-rank, 0)))
    # The worst one alone gets the full check, whose message names what is wrong with it.
    errors = frame.relative_error(points) if finite.all() else ~finite
    worst = np.unravel_index(np.argmax(errors), batch)
    frame.check_point(points[worst], name=f"y0[{', '.join(map(str, worst))}]")
    return points


def resolve_method(method: str | Tableau) -> Tableau:
    """Return the tableau that ``method`` is or names.

    Parameters
    ----------
    method
        A tableau, or the name of one in the catalogue.

    Returns
    -------
    Tableau

    Raises
    ------
    ValueError
        If no method of the catalogue has that name; the message lists those there are.
    TypeError
        If ``method`` is neither a name nor a tableau.
    """
    if isinstance(method, Tableau):
        return method
    if not isinstance(method, str):
        raise TypeError(f"method must be a name or a Tableau, got {method!r}")
    from cg.catalogue import methods

    if method not in methods:
        raise ValueError(f"method must be one of {', '.join(methods)}, got {method!r}")
    return methods[method]


def check_span(t_span: Sequence[float]) -> tuple[float, float]:
    """Return initial and final time; ValueError unless they are finite and so is their distance."""
    try:
        if isinstance(t_span, Mapping):
            raise ValueError("not a sequence")
        times = real_array(t_span, "t_span")
        # in an array of numbers, a bool among others is one
        if times.shape != (2,) or any(isinstance(t, bool | np.bool_) for t in t_span):
            raise ValueError("not two numbers")
        start, stop = times.tolist()
    except ValueError as error:
        raise ValueError(f"t_span must be two numbers, got {t_span!r}") from error
    if not (math.isfinite(start) and math.isfinite(stop)):
        raise ValueError(f"t_span must be finite, got {t_span!r}")
    if not math.isfinite(stop - start):
        raise ValueError(f"t_span must have a finite length, got {t_span!r}")
    return start, stop


def time_grid(t_span: Sequence[float], h: float) -> Array:
    """Return the times of a fixed-step integration.

    Parameters
    ----------
    t_span
        Initial and final time.
    h
        Step size, positive.

    Returns
    -------
    ndarray
        Shape ``(steps + 1,)``.  It starts and ends with ``t_span``; all steps have length ``h``
        except that the last may be shorter.

    Raises
    ------
    TypeError
        If ``h`` isn't a real number.
    ValueError
        If ``t_span`` isn't two finite numbers, or ``h`` isn't positive and finite, or so small
        that the times can't be told apart.
    """
    start, stop = check_span(t_span)
    steps = step_count((start, stop), h)
    if steps == 0:
        return np.array([start])
    numbers = np.arange(steps + 1, dtype=np.float64)
    times: Array = start + math.copysign(float(h), stop - start) * numbers
    times[-1] = stop
    return times


def step_count(t_span: Sequence[float], h: float) -> int:
    """Return the number of steps of a fixed-step integration; raises what `time_grid` does."""
    start, stop = check_span(t_span)
    if isinstance(h, bool) or not isinstance(h, Real):
        raise TypeError(f"h must be a real number, got {h!r}")
    size = as_float(h)
    if not 0.0 < size < math.inf:
        raise ValueError(f"h must be positive and finite, got {h!r}")
    span = abs(stop - start)
    if span == 0.0:
        return 0
    largest = max(abs(start), abs(stop))
    ratio = span / size
    if ratio > _MOST_STEPS or (ratio > 1.0 and size < math.ulp(largest)):
        raise ValueError(f"h is too small for t_span {t_span!r}: its times coincide, got {h!r}")
    # The ratio carries the rounding of the two ends and of h.  Within that, h divides the span.
    nearest = round(ratio)
    slack = 2.0 * (math.ulp(largest) / size + math.ulp(ratio))
    return max(1, nearest if abs(ratio - nearest) <= slack else math.ceil(ratio))


def last_step(t: float, stop: float, h: float) -> float:
    """Return ``h`` if it leads from ``t`` to ``stop`` up to rounding, else the shorter rest."""
    rest = stop - t
    slack = 4.0 * (math.ulp(max(abs(t), abs(stop))) + math.ulp(h))
    return h if abs(rest - h) <= slack else rest
