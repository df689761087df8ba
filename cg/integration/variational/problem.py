"""Problems of points with their derivatives."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.arrays import Array, check_finite, real_array
from cg.frames.base import Frame
from cg.integration.problem import Problem, Rhs
from cg.integration.rhs.derivatives import derivative_of
from cg.integration.rhs.python import PythonRhs
from cg.integration.step.plan import has_brackets, plan_of
from cg.integration.variational.compiled import compiled_variation
from cg.integration.variational.events import VariationalEvents
from cg.integration.variational.field import VariationalField
from cg.integration.variational.results import SolutionMaker
from cg.method.splitting import Splitting
from cg.support.checks import check_flag

# tolerance relative to the largest entry or eigenvalue of a covariance
_ROUNDING = 1e-9


def add_derivatives(
    problem: Problem,
    jac: Any,
    df_dp: Any,
    P0: ArrayLike | None,
    control_derivatives: Any,
    moments: int | None = None,
) -> Problem:
    """Return the problem of points with derivatives, after checking the arguments.

    Further arguments are those of `cg.solve_variational`; with ``moments`` there are derivatives
    with respect to the inputs at each time, too, and as many times this time.
    """
    frame, rhs, control, events = problem.plan.frame, problem.rhs, problem.control, problem.events
    control_derivatives = check_flag("control_derivatives", control_derivatives)
    if isinstance(problem.plan.method, Splitting):
        raise ValueError(
            f"method must not be a splitting method, got {problem.plan.method!r}, which moves no "
            "derivatives"
        )
    if not has_brackets(frame):
        raise ValueError(
            "frame must know the bracket of its fields, by which derivatives move, got "
            f"{frame!r}, whose fields are no Lie algebra or none that it knows"
        )
    field = _make_field(frame, rhs, jac, df_dp, moments)
    joint: Rhs
    if rhs.vectorized:
        data = rhs.args, rhs.parameters, True, rhs.first, rhs.inputs
        joint = PythonRhs(field, field.product, *data)
    else:
        joint = compiled_variation(field, problem.plan, rhs.args, rhs.parameters, rhs.inputs)
    if control.h is None:
        control = control._replace(atol=_tolerances(problem, field, control_derivatives))
    covariance = _check_covariance(P0, frame.dim, len(problem.points) if problem.many else None)
    return replace(
        problem,
        plan=plan_of(field.product, problem.plan.method),
        rhs=joint,
        points=field.start(problem.points),
        control=control,
        events=None if events is None else VariationalEvents(events, field),
        make_solution=SolutionMaker(field, covariance),
    )


def _make_field(
    frame: Frame, rhs: Rhs, jac: Any, df_dp: Any, moments: int | None
) -> VariationalField:
    """Return the coefficients of points with derivatives, after checking functions."""
    n, numbers, vectorized, inputs = frame.dim, rhs.parameters, rhs.vectorized, rhs.inputs
    width = 0 if moments is None or inputs is None else inputs.width
    if df_dp is not None and numbers is None and not width:
        raise ValueError(f"parameters must be given with df_dp = {df_dp!r}, got None")
    if numbers is not None:
        check_finite(numbers, "parameters")
    count = width + (0 if numbers is None else numbers.shape[-1])
    return VariationalField(
        frame,
        rhs.f if isinstance(rhs, PythonRhs) else rhs,
        derivative_of(jac, "jac", frame, (n, n), vectorized, inputs),
        derivative_of(df_dp, "df_dp", frame, (n, count), vectorized, inputs),
        count,
        vectorized,
        width,
        moments or 0,
    )


def _tolerances(problem: Problem, field: VariationalField, control_derivatives: bool) -> Array:
    """Return absolute tolerances of all coordinates, infinite for those without error control."""
    plan, given = problem.plan, problem.control.atol
    n = field.frame.dim
    shape = (n,) if problem.in_algebra else field.frame.point_shape
    own = np.broadcast_to(np.asarray(given), shape).ravel()
    rows = own if problem.in_algebra else np.full(n, own.min())
    if not problem.in_algebra:
        # the norm is that of numbers here, and that of complex entries there
        own = np.repeat(own, plan.parts) / np.sqrt(plan.parts)
    if control_derivatives and not rows.min() > 0.0:
        raise ValueError(
            "atol must be positive with control_derivatives, since derivatives are zero at first, "
            f"got {given}"
        )
    others = np.repeat(rows, n + field.columns)
    return np.concatenate([own, others if control_derivatives else np.full(others.size, np.inf)])


def _check_covariance(P0: ArrayLike | None, n: int, members: int | None) -> Array | None:
    """Return the covariance of initial coordinates, or one for each member, after checking it."""
    if P0 is None:
        return None
    matrix = real_array(P0, "P0")
    shapes = [(n, n)] if members is None else [(n, n), (members, n, n)]
    if matrix.shape not in shapes:
        raise ValueError(f"P0 must have shape {' or '.join(map(str, shapes))}, got {matrix.shape}")
    check_finite(matrix, "P0")
    if not np.abs(matrix - matrix.mT).max() <= _ROUNDING * np.abs(matrix).max():
        raise ValueError(f"P0 must be symmetric, got {P0!r}")
    eigenvalues = np.linalg.eigvalsh(matrix)
    if not eigenvalues.min() >= -_ROUNDING * np.abs(eigenvalues).max():
        raise ValueError(
            f"P0 must be positive semidefinite, got one with the eigenvalue {eigenvalues.min():.3g}"
        )
    return matrix
