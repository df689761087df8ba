"""Initial value problems on manifolds, with the conventions of SciPy's solve_ivp."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, Never, Unpack

from numpy.typing import ArrayLike
from scipy import LowLevelCallable

from cg.frames.base import Frame
from cg.integration.ensemble import solve_one
from cg.integration.options import Options, complete_options, expand_options
from cg.integration.problem import make_problem
from cg.integration.results import Solution
from cg.integration.rhs.function import CompiledFunction, Function
from cg.integration.rhs.python import Coefficients
from cg.integration.rhs.samples import Samples
from cg.integration.step.implicit import DEFAULT_STAGE_SOLVER
from cg.support.checks import check_integer
from cg.tables import HasTable


@expand_options
def solve_ivp(
    f: Coefficients | CompiledFunction | LowLevelCallable[Any, Any],
    t_span: Sequence[float],
    y0: ArrayLike,
    *rest: Never,
    frame: Frame,
    stage_solver: str = DEFAULT_STAGE_SOLVER,
    jac: Function | ArrayLike | None = None,
    progress: Callable[[float, float], None] | None = None,
    **options: Unpack[Options],
) -> Solution:
    r"""Solve :math:`y' = \sum_i f_i(t, y) E_i(y)`, :math:`y(t_0) = y_0`, on a manifold.

    Steps are chosen by an error estimate if ``method`` is a pair, or are all of size ``h`` if
    that is given. All points of the solution lie on the manifold, also those between steps.
    `cg.solve_ensemble` integrates many points, `cg.Stepper` takes steps one at a time.

    Parameters
    ----------
    f
        ``f(t, y, *args)`` returns the coefficients, shape ``(frame.dim,)``, on a
        `cg.frames.PhaseSpace` the forces, or with ``rhs="derivative"`` the derivative of ``y``. It
        is given a read-only ``y`` of shape
        ``frame.point_shape``. An exception that it raises ends the
        call. It may be a compiled function as for `cg.integrate`.
    t_span
        Initial and final time. If the final time is smaller, integration runs backward. It may
        be infinite with a terminal event; steps then turn by no more than a full turn.
    y0
        Initial point, shape ``frame.point_shape``.
    frame
        The frame that holds the points and supplies the flows.
    method
        Name of a method of the catalogue, or a method. The result of higher order of a pair is
        used. Methods of Munthe-Kaas (``"RKMK5(4)"``, `cg.MuntheKaas`) need a frame with brackets.
        The default, ``"auto"``, is the fastest in the benchmarks of the pairs with reliable error
        estimates: ``"RKMK8(5,3)"`` on frames with brackets, on others ``"CF5(4)"``, and
        ``"DOP853"`` for ``rtol`` below 1e-4. With ``h`` it is ``"CF5(4)"``. ``"RadauIIA5"`` is
        for stiff equations, with Newton's method.
        ``solution.method`` is the method used.
    h
        Size of fixed steps, positive; the last may be shorter. No error is estimated.
    rtol, atol
        Relative and absolute tolerance of the error in one step, by default 1e-3 and 1e-6. The
        error is measured in the coordinates of the frame (angles for rotations) where it has
        them, else in the ambient space. ``rtol`` is relative to :math:`|y_i|` on Euclidean
        space, to 1 for coordinates like angles; see `cg.frames.Frame.coordinate_sizes`.
        Both may be given for each coordinate, or each entry of a point where errors are
        measured in the ambient space.
    t_eval
        Times at which to store the solution, sorted in the direction of integration and within
        ``t_span``; by default those of the steps. Times beyond an end by four roundings or
        less are moved to it.
    dense_output
        Whether to return a continuous solution. It is as accurate as the steps, as output at
        ``t_eval`` and events are; steps that have output in them take more evaluations of ``f``.
        That of ``"RadauIIA5"`` has order three only.
    events
        A function ``event(t, y, *args)`` or a `cg.Event`, or a sequence of them, whose zeros are
        found along the continuous solution. A zero at the initial point is no event.
    observe
        ``observe(t, y, *args)`` returns numbers, a float or an array of fixed shape, that are
        stored at output times: those of ``t_eval``, or the ends of steps. It may be compiled as
        an event may, or a list of such functions, whose values form a vector.
    store
        ``"all"``, or ``"observed"`` to store no points: they are never in memory together, and
        ``y`` is None.
    breakpoints
        Times within ``t_span`` at which ``f`` or its derivatives jump, sorted in the direction of
        integration. A step ends at each: the step before it sees ``f`` just before that time, the
        step after it just after.
    inputs
        `cg.Samples` of a function of time, or a tuple of several, each with times of its own.
        ``f`` becomes ``f(t, y, u, *args)``, and so do ``jac``, events and jumps; ``u`` is the
        value at ``t``, for a tuple one of values. A compiled function gets the values behind its
        parameters. Steps end where a curve or its derivative jumps, as at ``breakpoints``.
        Methods with stages outside the step are refused.
    max_step
        Largest step size.
    first_step
        Size of the first step, by default chosen from the problem.
    max_steps
        Number of adaptive steps, rejected ones included, after which the integration ends
        without success; by default 1,000,000.
    args
        Further arguments of ``f``, of ``jac`` and of the events.
    parameters
        Numbers, shape ``(k,)``, passed to ``f`` and the events as last argument; a compiled
        ``f`` receives their address.
    rhs
        ``"coefficients"``, or ``"derivative"`` if ``f`` returns the derivative of ``y`` in its
        shape, as for SciPy, a compiled one its numbers. A part that no field has, such as one
        normal to the manifold, is dropped, with a warning if it is larger than rounding. ``jac``
        stays that of the coefficients, see `cg.frames.Frame.coefficients`.
    stage_solver
        Iteration for the stages of an implicit method: ``"newton"``, whose matrices take ``dim``
        evaluations and :math:`dim^3` operations, or ``"fixed-point"``, which is faster for more
        than some 30 coefficients, unless an equation is stiff.
    jac
        Function, for ``"RadauIIA5"`` only: ``jac(t, y, *args)`` returns the derivatives of the
        coefficients along the frame's fields, shape ``(dim, dim)``, as for
        `cg.solve_variational`, or a sparse matrix of SciPy; or the matrix itself if it is
        constant. By default they are differences, which take ``dim`` evaluations of ``f``.
    progress
        Called with the time covered so far and the length of ``t_span``, at most ten times a
        second and when the integration ends.

    Returns
    -------
    Solution
        With time as the *first* axis of ``y``.

    Raises
    ------
    TypeError
        If an argument has an impossible type.
    ValueError
        If an argument has an impossible value, arguments contradict each other, ``f`` or an event
        returns another shape, or numbers that aren't finite, ``f`` at the start. Later ones of
        ``f`` reject adaptive steps; where these can't get shorter, and fixed ones, end with the
        status -1 and the solution so far.
    OverflowError
        With fixed steps, if the solution exceeds the range of floating point.
    ConvergenceError
        With fixed steps, if the iteration for implicit stages doesn't converge.
    StepTooLongError
        With fixed steps, if a step of a method on a Lie algebra is too long for dexp⁻¹.

    Warns
    -----
    UserWarning
        If ``rtol`` is too small to be attained, and is raised; or, during the integration, after
        thousands of steps, if the equation is stiff or ``f`` is discontinuous near the solution; or
        if most of thousands of steps are rejected, as happens where ``f`` has kinks that aren't
        named as ``breakpoints``; or if the last point is off the manifold, as may happen with a
        frame of your own; or if ``h`` is far too large, as for `integrate`.

    Examples
    --------
    A body rotates faster and faster about its z axis. The event is its first full turn.

    >>> import numpy as np
    >>> import crouch_grossman as cg
    >>> turned = cg.Event(lambda t, y: y[1, 0], terminal=True, direction=1)
    >>> solution = cg.solve_ivp(
    ...     lambda t, y: [0.0, 0.0, t], (0, 10), np.eye(3), frame=cg.frames.SO3(),
    ...     max_step=0.5, events=turned,
    ... )
    >>> solution.t_events[0].round(6)  # the root of 4π
    array([3.544908])
    >>> solution.y.shape == (solution.steps + 1, 3, 3)
    True
    """
    problem = make_problem(
        f, t_span, y0, frame=frame, options=complete_options(solve_ivp, rest, options),
        stage_solver=stage_solver, jac=jac,
    )  # fmt: skip
    return solve_one(problem, progress)


def integrate(
    f: Coefficients | CompiledFunction | LowLevelCallable[Any, Any],
    t_span: Sequence[float],
    y0: ArrayLike,
    *,
    frame: Frame,
    method: str | HasTable,
    h: float,
    inputs: Samples | tuple[Samples, ...] | None = None,
    args: Iterable[Any] | None = None,
    parameters: ArrayLike | None = None,
    rhs: str = "coefficients",
    stage_solver: str = DEFAULT_STAGE_SOLVER,
    jac: Function | ArrayLike | None = None,
    save_every: int = 1,
    observe: Any = None,
    store: str = "all",
    progress: Callable[[float, float], None] | None = None,
) -> Solution:
    r"""Integrate :math:`y' = \sum_i f_i(t, y) E_i(y)` with a fixed step.

    A step of an explicit method follows its points: with :math:`F_k` the vector field whose
    coefficients are frozen at stage :math:`k`,

    .. math:: y_m = \exp\Bigl(h \sum_k \alpha_{m,k} F_k\Bigr) y_{\mathrm{parent}(m)} ,

    which for a Crouch-Grossman method is equation (2.2) of [1]_; for an implicit one it is (2.3).
    The flow of the lowest stage is applied first, the coefficients of stage :math:`i` are taken
    at :math:`t_k + c_i h`, and a coefficient that is exactly zero costs no flow. Steps of
    methods on Lie algebras are those of `cg.MuntheKaas`.

    Parameters
    ----------
    f
        As for `cg.solve_ivp`. It may also be a compiled function ``int f(double t, const double
        *y, double *f, void *user_data)``, given as a `scipy.LowLevelCallable`, a function pointer
        of ctypes, a ``numba.cfunc``, or a `cg.CompiledFunction`. It writes the coefficients, and
        returns zero, or else ends the call. The integration is then compiled as a whole, without
        Python's lock, on SO(n), SU(n), U(n) up to n = 12, unit quaternions, SE(3), the sphere in
        space, Euclidean space and their products, isospectral orbits of real matrices up to
        n = 12, and linear actions of sparse matrices.
    t_span, y0, frame, method
        As for `cg.solve_ivp`.
    h
        Step size, positive whatever the direction. If it doesn't divide the span, the last
        step is shorter.
    inputs, args, parameters, rhs, stage_solver, jac, progress
        As for `cg.solve_ivp`.
    save_every
        Number of steps between stored points; the initial and the final point are always stored.
    observe, store
        As for `cg.solve_ivp`.

    Returns
    -------
    Solution

    Raises
    ------
    TypeError, ValueError, OverflowError, ConvergenceError, StepTooLongError
        As for `cg.solve_ivp` with fixed steps; or if the steps need more memory than there is.
    RuntimeError
        If a compiled ``f`` returns another number than zero.

    Warns
    -----
    UserWarning
        If ``h`` is far too large for another method: if ``h f`` changes by more than the radius of
        dexp⁻¹, for rotations a full turn, between the stages of the last step.

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
    if h is None:
        raise TypeError(f"h must be a real number, got {h!r}")
    every = min(check_integer("save_every", save_every, 1), 2**62)
    options: Options = {
        "method": method, "h": h, "inputs": inputs, "args": args, "parameters": parameters,
        "observe": observe, "store": store, "rhs": rhs,
    }  # fmt: skip
    problem = make_problem(
        f, t_span, y0, frame=frame, options=complete_options(integrate, (), options),
        stage_solver=stage_solver, jac=jac, every=every,
    )  # fmt: skip
    return solve_one(problem, progress)
