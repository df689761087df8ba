"""Problems of points with their derivatives."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.arrays import Array, check_finite, real_array
from cg.integration.problem import Problem, Rhs
from cg.integration.rhs.derivatives import derivative_of
from cg.integration.rhs.python import PythonRhs
from cg.integration.step.plan import has_brackets, plan_of
from cg.integration.variational.compiled import compiled_variation
from cg.integration.variational.events import VariationalEvents
from cg.integration.variational.field import VariationalField
from cg.integration.variational.results import SolutionMaker
from cg.support.checks import check_flag

# tolerance relative to the largest entry or eigenvalue of a covariance
_ROUNDING = 1e-9


def add_derivatives(
    problem: Problem, jac: Any, df_dp: Any, P0: ArrayLike | None, control_derivatives: Any
) -> Problem:
    """Return the problem of points with derivatives, after checking the arguments.

    Further arguments are those of `cg.solve_variational`.
    """
    frame, rhs, control, events = problem.plan.frame, problem.rhs, problem.control, problem.events
    control_derivatives = check_flag("control_derivatives", control_derivatives)
    if not has_brackets(frame):
        raise ValueError(
            "frame must know the bracket of its fields, by which derivatives move, got "
            f"{frame!r}, whose fields are no Lie algebra or none that it knows"
        )
    n, numbers, vectorized = frame.dim, rhs.parameters, rhs.vectorized
    if not problem.keeps_points:
        raise ValueError(
            'store must be "all" where solutions have derivatives, which belong to points, got '
            '"observed"'
        )
    if df_dp is not None and numbers is None:
        raise ValueError(f"parameters must be given with df_dp = {df_dp!r}, got None")
    if numbers is not None:
        check_finite(numbers, "parameters")
    count = 0 if numbers is None else numbers.shape[-1]
    field = VariationalField(
        frame,
        rhs.f if isinstance(rhs, PythonRhs) else rhs,
        derivative_of(jac, "jac", frame, (n, n), vectorized),
        derivative_of(df_dp, "df_dp", frame, (n, count), vectorized),
        count,
        vectorized,
    )
    joint: Rhs
    if vectorized:
        joint = PythonRhs(field, field.product, rhs.args, numbers, vectorized, rhs.first)
    else:
        joint = compiled_variation(field, problem.plan, rhs.args, numbers)
    if control.h is None:
        absolute = _tolerances(problem, field, control_derivatives, "atol")
        relative = _tolerances(problem, field, control_derivatives, "rtol")
        control = control._replace(rtol=relative, atol=absolute)
    covariance = _check_covariance(P0, n, len(problem.points) if problem.many else None)
    return replace(
        problem,
        plan=plan_of(field.product, problem.plan.method),
        rhs=joint,
        points=field.start(problem.points),
        control=control,
        events=None if events is None else VariationalEvents(events, field),
        make_solution=SolutionMaker(field, covariance),
    )


def _tolerances(
    problem: Problem, field: VariationalField, control_derivatives: bool, name: str
) -> Array:
    """Return tolerances of all coordinates, absolute ones infinite without error control."""
    plan, given, is_absolute = problem.plan, getattr(problem.control, name), name == "atol"
    n = field.frame.dim
    shape = (n,) if problem.in_algebra else field.frame.point_shape
    own = np.broadcast_to(np.asarray(given), shape).ravel()
    rows = own if problem.in_algebra else np.full(n, own.min())
    if not problem.in_algebra and not is_absolute:
        own = np.repeat(own, plan.parts)
    elif not problem.in_algebra:
        # the norm is that of numbers here, and that of complex entries there
        own = np.repeat(own, plan.parts) / np.sqrt(plan.parts)
    if control_derivatives and not rows.min() > 0.0:
        raise ValueError(
            "atol must be positive with control_derivatives, since derivatives are zero at first, "
            f"got {given}"
        )
    others = np.repeat(rows, n + field.count)
    controlled = control_derivatives or not is_absolute
    return np.concatenate([own, others if controlled else np.full(others.size, np.inf)])


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
