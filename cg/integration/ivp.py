"""Initial value problems on manifolds, with the conventions of SciPy's solve_ivp."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Unpack

from numpy.typing import ArrayLike

from cg.frames.base import Frame
from cg.integration.member_results import solution_of
from cg.integration.members import add_derivatives, check_output_size, integrate_members
from cg.integration.options import Options, complete_options, expand_options
from cg.integration.output.solutions import Solution
from cg.integration.problem import Problem, make_problem
from cg.integration.rhs.function import Function
from cg.integration.run.drive import Progress
from cg.support.checks import check_count, warn_user


@expand_options()
def solve_ivp(
    f: Function, t_span: Sequence[float],
    y0: ArrayLike, *, frame: Frame, **options: Unpack[Options],
) -> Solution:  # fmt: skip
    r"""Solve :math:`y' = \sum_i f_i(t, y) E_i(y)`, :math:`y(t_0) = y_0`, on a manifold.

    Steps are chosen by an error estimate if ``method`` is a pair, or are all of size ``h`` if
    that is given. All points of the solution lie on the manifold, also those between steps.
    `cg.solve_ensemble` integrates many points, `cg.Stepper` takes steps one at a time. Equations
    whose coefficients depend on time alone are solved with ``linear=True``, and derivatives of the
    solution with ``derivatives``; see `cg.solve_linear` and `cg.solve_variational`.

    Parameters
    ----------
    f
        ``f(t, y, *args)`` returns the coefficients, shape ``(frame.dim,)``, on a
        `cg.frames.PhaseSpace` the forces, or with ``rhs="derivative"`` the derivative of ``y``. It
        is given a read-only ``y`` of shape ``frame.point_shape``. An exception that it raises ends
        the call.

        It may also be a compiled function ``int f(double t, const double *y, double *f, void
        *user_data)``, given as a `scipy.LowLevelCallable`, a function pointer of ctypes, a
        ``numba.cfunc``, or a `cg.CompiledFunction`. It writes the coefficients, and returns zero,
        or else ends the call. The integration is then compiled as a whole, without Python's lock,
        on the frames that ``docs/howto/compiled.md`` lists.
    t_span
        Initial and final time. If the final time is smaller, integration runs backward. It may
        be infinite with a terminal event; steps then turn by no more than a full turn.
    y0
        Initial point, shape ``frame.point_shape``.
    frame
        The frame that holds the points and supplies the flows.
    method
        Name of a method of the catalogue, the path of a file, or a method. The result of higher
        order of a pair is used. Methods of Munthe-Kaas (``"RKMK5(4)"``, `cg.MuntheKaas`) need a
        frame with brackets. The default, ``"auto"``, is the fastest in the benchmarks of the pairs
        with reliable error estimates: ``"RKMK8(5,3)"`` on frames with brackets, on others
        ``"CF5(4)"``, and ``"DOP853"`` for ``rtol`` below 1e-4. With ``h`` it is ``"CF5(4)"``.
        ``"RadauIIA5"`` is for stiff equations, with Newton's method. ``solution.method`` is the
        method used.

        With ``linear`` also a `cg.MagnusMethod`. The default is ``"CFM8(4)"`` where flows are in
        closed form (Euclidean space, rotations, quaternions, rigid motions, the sphere, SU(2)) or
        no `Frame.bracket` is known. It is the nine nodes of Lobatto's formula on
        `cg.frames.LinearAction`, and ``"Magnus8(4)"`` elsewhere. Other methods take the same steps
        as without ``linear``, but compute no points of stages, so that those of Munthe-Kaas need
        one flow per step.
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
        The continuous solution of ``"RadauIIA5"`` has order three only.
    events
        A function ``event(t, y, *args)`` or a `cg.Event`, or a sequence of them, whose zeros are
        found along the continuous solution. A zero at the initial point is no event. With
        ``derivatives`` a jump must be a function of its arguments alone, and is called for points
        nearby too. If ``f`` changes where an event happens, let it depend on a coordinate that the
        jump changes, and not on the sign of the event's function.
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
        ``f`` becomes ``f(t, y, u, *args)``, and so do all other functions; ``u`` is the
        value at ``t``, for a tuple one of values. A compiled function gets the values after its
        parameters. Steps end where a curve or its derivative jumps, as at ``breakpoints``.
        Methods with stages outside the step are refused.
    max_step
        Largest step size.
    first_step
        Size of the first step, by default chosen from the problem.
    max_steps
        Number of adaptive steps, rejected ones included, or of steps by a ``step_function``,
        after which the integration ends without success; by default 1,000,000.
    args
        Further arguments of ``f`` and of all other functions.
    parameters
        Numbers, shape ``(k,)``, passed to all functions as last argument; a compiled ``f``
        receives their address. Derivatives of the solution are also with respect to them.
    rhs
        ``"coefficients"``, or ``"derivative"`` if ``f`` returns the derivative of ``y`` in its
        shape, as for SciPy, a compiled one its numbers. A part that no field has, such as one
        normal to the manifold, is dropped, with a warning if it is larger than rounding. ``jac``
        stays that of the coefficients, see `cg.frames.Frame.coefficients`.
    stage_solver
        Iteration for the stages of an implicit method: ``"newton"``, whose matrices take ``dim``
        evaluations and :math:`dim^3` operations, or ``"fixed-point"``, which is faster for more
        than some 30 coefficients, unless an equation is stiff; not for ``"RadauIIA5"``.
    jac
        ``jac(t, y, *args)`` returns shape ``(dim, dim)``: entry ``[i, j]`` is the derivative of
        ``f[i]`` along the frame's field j, that of ``f(t, frame.flow(s * e_j, y))[i]`` by s at
        zero. It may return a sparse matrix of SciPy. A constant matrix may be given in place of the
        function. A compiled ``jac`` writes the rows one after the other.

        By default ``"RadauIIA5"`` takes differences, with ``dim`` evaluations of ``f``. With
        ``derivatives`` it serves for these, with any method, and by default they are central
        differences with steps of :math:`\epsilon^{1/3} \max(1, s_j) \approx 6 \cdot 10^{-6} \max(1,
        s_j)` along field j, where :math:`s_j` is `Frame.coordinate_sizes`: they take 2 dim
        evaluations of ``f``. On compiled frames they are one-sided, half as many, where ``rtol`` is
        at least 1e-7, with ``control_derivatives`` 1e-6, or this times :math:`|t_0|` over the span.
    step_function
        ``step_function(t, y, *args)`` returns a positive number s, a smooth function of the
        configuration alone, for symmetric splitting methods: steps are about ``h s``. They stay
        reversible, so that errors of the energy don't grow, by the method of Hairer and Söderlind
        (SIAM J. Sci. Comput. 26 (2005), 1838-1851). It may be compiled as an event may.
    thermostat
        A heat bath on a `cg.frames.PhaseSpace`, for symmetric splitting methods: `cg.Langevin`.
        Steps end at the times of ``t_eval`` then. Events are found along smooth motion, before and
        after the noise in the middle of a step.
    linear
        Whether the coefficients depend on time alone. Then ``f`` is ``f(t, *args)``, without
        ``y``, and a compiled one that reads the point it gets is refused. Steps are chosen by the
        differences from two results of lower order, on `cg.frames.LinearAction` by the last
        coefficients of the polynomial that interpolates ``f`` at the nodes of the method.
    vectorized
        For one point only with ``linear``: whether ``f`` takes times of shape ``(k,)``, with rows
        of parameters of shape ``(k, p)``, and returns shape ``(k, frame.dim)``. It is called once
        per step, with the times of all stages but a first one at the start, which is known from the
        step before. Starts and nodes of dense output are single times.
    derivatives
        ``"forward"`` computes derivatives of the solution with respect to ``y0`` and the
        parameters with it, see `cg.solve_variational`; ``solution.transition``, ``sensitivity``,
        ``covariance`` and ``dt_events`` hold them.

        ``"adjoint"`` computes none during the integration, but stores the steps, and
        ``solution.gradient`` goes backward from the derivatives of one number: for many parameters,
        or values of ``inputs``, see `cg.Adjoint`. It takes no ``events``. With ``linear`` it is the
        only choice, and is meant for `cg.frames.LinearAction` of up to some 50 dimensions, since
        matrices are dense.
    derivatives_by
        With ``"forward"``, directions in place of all derivatives: ``"point"``, ``"parameters"``,
        or a matrix with a column for each direction and rows for the coordinates of ``y0``, then
        the parameters. Derivatives are the columns of ``solution.sensitivity``, by ``"point"`` of
        ``solution.transition``. Each costs one or two evaluations of ``f``, see ``jac``, if neither
        ``jac`` nor ``df_dp`` is given, or as many as all if it is ``vectorized``.
    df_dp
        ``df_dp(t, y, *args, parameters)`` returns shape ``(dim, k)``, the derivatives of ``f``
        with respect to the parameters, of the adjoint also the inputs after them. It has the
        arguments of ``f`` and may be compiled. By default differences as for ``jac``, with steps by
        :math:`\epsilon^{1/3} |p_i|`, or :math:`\epsilon^{1/3}` where :math:`p_i` is zero.
    P0
        Covariance of the coordinates of ``y0``, shape ``(dim, dim)``.
    noise
        Spectral density Q of white noise w in the equation :math:`\xi' = A \xi + w` of small
        deviations, in the coordinates of the frame, shape ``(dim, dim)``; or a function of the
        arguments of ``f`` that returns it, which may be compiled. Then the covariance P satisfies
        :math:`P' = A P + P A^T + Q`, and is zero at first without ``P0``. Step sizes account for
        it with ``control_derivatives`` only. Backward in time it is refused, since it would make
        variances negative.
    control_derivatives
        Whether the derivatives have the tolerances of the solution (of row i those of coordinate
        i), in place of ten times these, or of ten times ``rtol`` if that is larger.
    progress
        Called with the time covered so far and the length of ``t_span``, at most ten times a
        second and when the integration ends.

    Returns
    -------
    Solution
        With time as the *first* axis of ``y``. Its ``nfev`` counts evaluations of ``f`` and its
        derivatives together, with ``linear`` the times at which ``f`` was evaluated.

    Raises
    ------
    ValueError
        If an argument has an impossible value, arguments contradict each other, derivatives are
        asked for on a frame that knows no bracket, a function returns another shape, or ``f``
        returns numbers that aren't finite at the start, another function anywhere. Where ``f``
        does so later, adaptive steps become shorter; if they can't, and with fixed steps, the
        integration ends with the status -1 and the solution so far.
    OverflowError
        With fixed steps, if the solution exceeds the range of floating point, or if derivatives do.
    RuntimeError
        If a compiled ``f`` returns another number than zero.
    ConvergenceError
        With fixed steps, if the iteration for implicit stages doesn't converge.
    StepTooLongError
        With fixed steps, if a step of a method on a Lie algebra is too long for dexp⁻¹.
    ArithmeticError
        With fixed steps, if joints of a phase space can't be kept closed: a step is too long, or
        constraints depend on each other.

    Warns
    -----
    UserWarning
        If ``rtol`` is too small to be attained, and is raised; or, during the integration, after
        thousands of steps, if the equation is stiff, or if many steps are rejected, as happens
        where ``f`` has kinks or jumps that aren't named as ``breakpoints``; or if the last point is
        off the manifold, as may happen with a frame of your own.

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
    all_options = complete_options(solve_ivp, options)
    return solve_one(make_problem(f, t_span, y0, frame, all_options), all_options)


@expand_options(linear=True)
def solve_linear(
    f: Function, t_span: Sequence[float],
    y0: ArrayLike, *, frame: Frame, **options: Unpack[Options],
) -> Solution:  # fmt: skip
    r"""Solve :math:`y' = \sum_i f_i(t) E_i(y)`, :math:`y(t_0) = y_0`: `cg.solve_ivp`, linear.

    The coefficients depend on time alone: a prescribed angular velocity, or a Schrödinger equation
    with controls. A Magnus method with brackets takes a step of order eight with one flow.
    Commutator-free ones take one of order six with four or six flows and one of order eight with
    eight, where commutator-free Runge–Kutta methods of the catalogue need at least 13 and 39. On
    `cg.frames.LinearAction` a step is one flow, along the polynomial that interpolates the
    coefficients at the nodes of the method.

    Parameters
    ----------
    f
        ``f(t, *args)`` returns the coefficients, shape ``(frame.dim,)``.
    t_span, y0, frame
        As for `cg.solve_ivp` with ``linear=True``, as are all options.

    Examples
    --------
    A driven two-level system:

    >>> import numpy as np
    >>> import crouch_grossman as cg
    >>> def f(t):  # a spin in a constant field and one that rotates in resonance with it
    ...     return [0.5 * np.cos(4 * t), 0.5 * np.sin(4 * t), 4.0]
    >>> frame = cg.frames.SU(2)
    >>> solution = cg.solve_linear(f, (0, np.pi), np.eye(2), frame=frame, rtol=1e-10, atol=1e-10)
    >>> solution.success, abs(solution.y[-1][1, 0]).round(8)
    (True, np.float64(0.70710678))
    """
    all_options = complete_options(solve_linear, options)
    return solve_one(make_problem(f, t_span, y0, frame, all_options), all_options)


@expand_options(derivatives="forward")
def solve_variational(
    f: Function, t_span: Sequence[float],
    y0: ArrayLike, *, frame: Frame, **options: Unpack[Options],
) -> Solution:  # fmt: skip
    r"""Solve :math:`y' = \sum_i f_i(t, y) E_i(y)` together with the derivatives of the solution.

    A derivative of the solution is a tangent :math:`\sum_i \xi_i E_i(y)`, and its coordinates
    :math:`\xi` move with the solution by the variational equation

    .. math:: \xi' = \frac{\partial f}{\partial y} \xi + [f, \xi] ,

    where the first term is the derivative of f along the frame's fields and the bracket is that of
    `Frame.bracket`: :math:`\xi' = Df\,\xi - f \times \xi` for rotations in body axes,
    :math:`Df\,\xi + f \times \xi` in axes of space [1]_. The columns of the transition matrix are
    its solutions from unit vectors; a parameter adds the derivative of f with respect to it.

    Parameters
    ----------
    f, t_span, y0, frame
        As for `cg.solve_ivp` with ``derivatives="forward"``, as are all options.

    Returns
    -------
    Solution
        With ``transition``, ``sensitivity``, ``covariance`` and ``dt_events``.

    Notes
    -----
    Where a frame has more fields than the manifold has dimensions (spheres and other homogeneous
    spaces), coordinates of a tangent aren't unique. The transition matrix then acts on the Lie
    algebra, and its columns are determined up to fields that vanish at the point (the isotropy);
    tangents ``frame.field(transition @ xi, y)`` are unique.

    At a jump derivatives are multiplied by the saltation matrix, which takes into account that the
    time of the event changes as well [2]_.

    References
    ----------
    .. [1] A. Iserles, H. Z. Munthe-Kaas, S. P. Norsett, A. Zanna, "Lie-group methods", Acta
       Numerica 9 (2000), 215-365.
    .. [2] N. J. Kong, J. J. Payne, J. Zhu, A. M. Johnson, "Saltation matrices: the essential tool
       for linearizing hybrid dynamical systems", Proc. IEEE 112 (2024), 585-608.

    Examples
    --------
    The derivative of the solution of a linear equation is the matrix exponential.

    >>> import crouch_grossman as cg
    >>> solution = cg.solve_variational(
    ...     lambda t, y: [y[1], -y[0]], (0, 1), [1.0, 0.0], frame=cg.frames.Euclidean(2),
    ...     jac=lambda t, y: [[0.0, 1.0], [-1.0, 0.0]], rtol=1e-10, atol=1e-10,
    ... )
    >>> solution.transition[-1].round(8)
    array([[ 0.54030231,  0.84147098],
           [-0.84147098,  0.54030231]])
    """
    all_options = complete_options(solve_variational, options)
    return solve_one(make_problem(f, t_span, y0, frame, all_options), all_options)


@expand_options()
def integrate(
    f: Function, t_span: Sequence[float],
    y0: ArrayLike, *, frame: Frame, save_every: int = 1, **options: Unpack[Options],
) -> Solution:  # fmt: skip
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
    f, t_span, y0, frame, method
        As for `cg.solve_ivp`, as are all options that aren't listed here.
    h
        Step size, positive whatever the direction. If it doesn't divide the span, the last
        step is shorter.
    save_every
        Number of steps between stored points; the initial and the final point are always stored.

    References
    ----------
    .. [1] Z. Jackiewicz, A. Marthinsen, B. Owren, "Construction of Runge-Kutta methods of
       Crouch-Grossman type of high order", Adv. Comput. Math. 13 (2000), 405-415.

    Examples
    --------
    A rotation about a fixed body axis is solved exactly by any method.

    >>> import numpy as np
    >>> import crouch_grossman as cg
    >>> turn = lambda t, y: [0.0, 0.0, np.pi / 2]
    >>> run = cg.integrate(turn, (0, 1), np.eye(3), frame=cg.frames.SO3(), method="CG3", h=0.25)
    >>> run.y[-1].round(12)[:, 0]
    array([0., 1., 0.])
    """
    all_options = complete_options(integrate, options)
    if all_options["h"] is None:
        raise TypeError("h must be given; cg.solve_ivp chooses steps by rtol and atol")
    every = check_count("save_every", save_every)
    if every != 1 and options.get("t_eval") is not None:
        raise ValueError(f"save_every must be 1 with t_eval, got {every}")
    return solve_one(make_problem(f, t_span, y0, frame, all_options, every=every), all_options)


def solve_one(problem: Problem, options: Options) -> Solution:
    """Integrate one point."""
    problem, function = add_derivatives(problem, options), options["progress"]
    progress = None if function is None else Progress(function, problem.t0, problem.t1)
    check_output_size(problem)
    results = integrate_members(problem, progress)
    if progress is not None:
        progress.finish()
    solution = solution_of(problem, results)
    for text in results.warnings:
        warn_user(text)
    return solution
