"""Initial value problems with the derivatives of their solutions."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Never, Unpack, cast

import numpy as np
from numpy.typing import ArrayLike
from scipy import LowLevelCallable

from cg.executors import ExecutorLike
from cg.frames.base import Frame
from cg.integration.adjoint import check_derivatives, tolerance_of, with_adjoint
from cg.integration.adjoint_equation import Equation
from cg.integration.ensemble import solve_members, solve_one
from cg.integration.loop.dense import DenseOutput
from cg.integration.options import Options, complete_options, expand_options
from cg.integration.problem import Problem, make_problem
from cg.integration.rhs.function import CompiledFunction, Function
from cg.integration.rhs.python import Coefficients
from cg.integration.step.implicit import DEFAULT_STAGE_SOLVER
from cg.integration.variational.problem import add_derivatives
from cg.integration.variational.results import EnsembleVariationalSolution, VariationalSolution
from cg.support.arrays import Array, Points
from cg.support.checks import check_flag

_ONE_SIDED = 9e-7  # least tolerance of the adjoint for which one-sided differences are exact enough


@expand_options
def solve_variational(
    f: Coefficients | CompiledFunction | LowLevelCallable[Any, Any],
    t_span: Sequence[float],
    y0: ArrayLike,
    *rest: Never,
    frame: Frame,
    jac: Function | None = None,
    df_dp: Function | None = None,
    P0: ArrayLike | None = None,
    noise: ArrayLike | Function | None = None,
    control_derivatives: bool = False,
    derivatives: str | None = None,
    stage_solver: str = DEFAULT_STAGE_SOLVER,
    progress: Callable[[float, float], None] | None = None,
    **options: Unpack[Options],
) -> VariationalSolution:
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
        As for `cg.solve_ivp`.
    jac
        ``jac(t, y, *args)`` returns shape ``(dim, dim)``: entry ``[i, j]`` is the derivative of
        ``f[i]`` along the frame's field j, that of ``f(t, frame.flow(s * e_j, y))[i]`` by s at
        zero. It has the same further arguments as ``f``, and may be compiled as ``f`` may; it
        writes its rows one after the other. By default central differences with steps of
        :math:`\epsilon^{1/3} \max(1, s_j) \approx 6 \cdot 10^{-6} \max(1, s_j)` along field j,
        where :math:`s_j` is `Frame.coordinate_sizes`: they take 2 dim evaluations of ``f``.
    df_dp
        ``df_dp(t, y, *args, parameters)`` returns shape ``(dim, k)``, the derivatives of ``f``
        with respect to the parameters; it may be compiled. By default central differences with
        steps of :math:`\epsilon^{1/3} |p_i|`, or :math:`\epsilon^{1/3}` where :math:`p_i` is zero.
    parameters
        Numbers, shape ``(k,)``, that ``f``, ``jac``, ``df_dp`` and the events are given as last
        argument, and with respect to which there are derivatives.
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
    derivatives
        ``"adjoint"`` computes no derivatives during the integration, and returns an
        `AdjointSolution`, whose method ``gradient`` goes backward from the derivatives of one
        number: for many parameters, or values of ``inputs``, whose derivatives ``df_dp`` then
        returns behind those with respect to the parameters. Differences are one-sided where the
        tolerances allow that. It takes no ``P0``, ``noise``, ``control_derivatives`` and
        ``events``.
    method, h, rtol, atol, t_eval, dense_output, breakpoints, inputs
        As for `cg.solve_ivp`; ``jac`` and ``df_dp`` get the values of ``inputs`` as ``f`` does.
    events
        As for `cg.solve_ivp`. A jump must be a function of its arguments alone, and is called for
        points nearby too. If ``f`` changes where an event happens, let it depend on a coordinate
        that the jump changes, and not on the sign of the event's function.
    max_step, first_step, max_steps, args, stage_solver, observe, progress
        As for `cg.solve_ivp`.

    Returns
    -------
    VariationalSolution or AdjointSolution
        A `Solution` with ``transition``, ``sensitivity``, ``covariance`` and ``dt_events``. Its
        ``nfev`` counts evaluations of ``f`` and its derivatives together.

    Raises
    ------
    TypeError, ValueError
        As `cg.solve_ivp`; or if the frame knows no bracket, ``jac`` or ``df_dp`` isn't callable or
        returns another shape or numbers that aren't finite, ``P0`` or ``noise`` is no covariance,
        or ``df_dp`` is given without ``parameters``.
    OverflowError
        If derivatives exceed the range of floating point.

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
    problem = make_problem(
        f, t_span, y0, frame=frame, options=complete_options(solve_variational, rest, options),
        stage_solver=stage_solver,
    )  # fmt: skip
    adjoint = check_derivatives(derivatives)
    if adjoint:
        controlled = check_flag("control_derivatives", control_derivatives) or None
        others = {"P0": P0, "noise": noise, "control_derivatives": controlled}
        for name, value in others.items():
            if value is not None:
                raise ValueError(
                    f"{name} must not be given with derivatives='adjoint', got {value!r}"
                )
    joint = add_derivatives(problem, jac, df_dp, P0, control_derivatives, noise, adjoint)
    if adjoint:
        joint = with_adjoint(problem, partial(_equation_along, joint))
    return cast(VariationalSolution, solve_one(joint, progress))


@expand_options
def solve_variational_ensemble(
    f: Coefficients | CompiledFunction | LowLevelCallable[Any, Any],
    t_span: Sequence[float],
    y0: ArrayLike,
    *rest: Never,
    frame: Frame,
    jac: Function | None = None,
    df_dp: Function | None = None,
    P0: ArrayLike | None = None,
    noise: ArrayLike | Function | None = None,
    control_derivatives: bool = False,
    vectorized: bool = False,
    common_steps: bool = False,
    stage_solver: str = DEFAULT_STAGE_SOLVER,
    executor: ExecutorLike = None,
    workers: int | None = None,
    progress: Callable[[float, float], None] | None = None,
    **options: Unpack[Options],
) -> EnsembleVariationalSolution:
    """Solve an initial value problem from many points, with the derivatives of each solution.

    Each member takes the steps that it would take alone in `cg.solve_variational`.

    Parameters
    ----------
    f, t_span, y0, frame, parameters
        As for `cg.solve_ensemble`.
    jac, df_dp, noise, control_derivatives
        As for `cg.solve_variational`. If ``vectorized`` they take times ``(k,)``, points
        ``(k, *frame.point_shape)`` and rows of parameters of any members, as ``f`` does, and
        return shapes ``(k, dim, dim)``, of ``df_dp`` ``(k, dim, parameters)``.
    P0
        Covariance of the coordinates of ``y0``, shape ``(dim, dim)``, or one for each member,
        ``(members, dim, dim)``.
    method, rtol, atol, h, t_eval, dense_output, breakpoints, inputs, args, vectorized, common_steps
        As for `cg.solve_ensemble`.
    events
        As for `cg.solve_variational`.
    max_step, first_step, max_steps, stage_solver, observe, executor, workers, progress
        As for `cg.solve_ensemble`.

    Returns
    -------
    EnsembleVariationalSolution
        Members that fail are NaN after their ends, and the others go on.

    Raises
    ------
    TypeError, ValueError
        If an argument can't be used, as for `cg.solve_variational`; an exception of ``f``, ``jac``
        or ``df_dp`` ends the call.
    RuntimeError
        If the workers of all members died.

    Examples
    --------
    >>> import numpy as np
    >>> import crouch_grossman as cg
    >>> solution = cg.solve_variational_ensemble(
    ...     lambda t, y, rate: [rate[0] * y[0]], (0, 1), [1.0], frame=cg.frames.Euclidean(1),
    ...     parameters=[[0.5], [1.0]], rtol=1e-9, atol=1e-9,
    ... )
    >>> solution.transition[-1].ravel().round(6)
    array([1.648721, 2.718282])
    """
    problem = make_problem(
        f, t_span, y0, frame=frame, many=True, vectorized=vectorized, common=common_steps,
        options=complete_options(solve_variational_ensemble, rest, options),
        stage_solver=stage_solver,
    )  # fmt: skip
    joint = add_derivatives(problem, jac, df_dp, P0, control_derivatives, noise)
    solution = solve_members(joint, progress, executor, workers)
    return cast(EnsembleVariationalSolution, solution)


def _equation_along(joint: Problem, sol: DenseOutput) -> Equation:
    """Return the equation of the problem with derivatives, along a solution without them."""
    rhs: Any = joint.rhs
    if tolerance_of(joint) >= _ONE_SIDED:
        for record in rhs.records:
            record.one_sided, record.step = 1, math.sqrt(np.finfo(float).eps)
    count = None if rhs.parameters is None else rhs.parameters.shape[-1]
    shape, along = (rhs.plan.frame.dim,), partial(_along, rhs, sol)
    return Equation(along, shape, tolerance_of(joint), count, rhs.inputs)


def _along(rhs: Any, sol: DenseOutput, times: Array) -> tuple[Points, Array | None]:
    """Return A and B along a solution, from derivatives that are unit vectors."""
    variational = rhs.variational
    n = variational.frame.dim
    values = rhs.at_times(times, variational.start(sol(times)))
    if not np.isfinite(values).all():
        raise ValueError("f and its derivatives must return finite numbers")
    slopes = values[:, n:].reshape(len(times), n, -1)
    return slopes[..., :n], slopes[..., n:] if variational.count else None
