"""Problems of points with their derivatives."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.base import Frame
from cg.integration.problem import Problem, Rhs
from cg.integration.rhs.derivatives import derivative_of
from cg.integration.rhs.python import PythonRhs
from cg.integration.step.plan import has_brackets, plan_of
from cg.integration.variational.compiled import compiled_variation
from cg.integration.variational.events import VariationalEvents
from cg.integration.variational.field import VariationalField
from cg.integration.variational.noise import check_covariance, noise_of
from cg.integration.variational.results import SolutionMaker
from cg.support.arrays import Array, check_finite
from cg.support.checks import check_flag
from cg.tables import Kind

_LOOSE = 10.0
"""Tolerances of derivatives, in those of the solution, without ``control_derivatives``: steps are
hardly shorter, and are not too long for derivatives where the solution itself is simple."""


def add_derivatives(
    problem: Problem,
    jac: Any,
    df_dp: Any,
    P0: ArrayLike | None,
    control_derivatives: Any,
    noise: Any,
    by_inputs: bool = False,
) -> Problem:
    """Return the problem of points with derivatives, after checking the arguments.

    Further arguments are those of `cg.solve_variational`; ``by_inputs`` tells whether the values
    of inputs are parameters as well.
    """
    frame, rhs, control, events = problem.plan.frame, problem.rhs, problem.control, problem.events
    control_derivatives = check_flag("control_derivatives", control_derivatives)
    _check_problem(problem)
    field = _make_field(frame, rhs, jac, df_dp, noise_of(noise, problem), by_inputs)
    joint: Rhs
    if rhs.vectorized:
        data = rhs.args, rhs.parameters, True, rhs.first, rhs.inputs
        joint = PythonRhs(field, field.product, *data)
    else:
        plan = (
            problem.plan
            if problem.plan.compiled
            else plan_of(problem.plan.given, problem.plan.method)
        )
        joint = compiled_variation(field, plan, rhs.args, rhs.parameters, rhs.inputs)
    if control.h is None:
        absolute = _tolerances(problem, field, control_derivatives, "atol")
        relative = _tolerances(problem, field, control_derivatives, "rtol")
        control = control._replace(rtol=relative, atol=absolute)
    members = len(problem.points) if problem.many else None
    covariance = check_covariance(P0, frame.dim, members)
    return replace(
        problem,
        plan=plan_of(field.product, problem.plan.method),
        rhs=joint,
        points=field.start(problem.points),
        control=control,
        events=None if events is None else VariationalEvents(events, field),
        make_solution=SolutionMaker(field, covariance),
    )


def _check_problem(problem: Problem) -> None:
    """Raise ValueError if derivatives can't move along the solution."""
    frame = problem.plan.frame
    if problem.plan.method.kind is Kind.SPLITTING:
        raise ValueError(
            f"method must not be a splitting method, got {problem.plan.method!r}, which moves no "
            "derivatives"
        )
    if not has_brackets(frame):
        raise ValueError(
            "frame must know the bracket of its fields, by which derivatives move, got "
            f"{frame!r}, whose fields are no Lie algebra or none that it knows"
        )
    if not problem.keeps_points:
        raise ValueError(
            'store must be "all" where solutions have derivatives, which belong to points, got '
            '"observed"'
        )


def _make_field(
    frame: Frame, rhs: Rhs, jac: Any, df_dp: Any, noise: Any, by_inputs: bool
) -> VariationalField:
    """Return the coefficients of points with derivatives, after checking functions."""
    n, numbers, vectorized, inputs = frame.dim, rhs.parameters, rhs.vectorized, rhs.inputs
    width = inputs.width if by_inputs and inputs is not None else 0
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
        noise,
    )


def _tolerances(
    problem: Problem, field: VariationalField, control_derivatives: bool, name: str
) -> Array:
    """Return tolerances of all coordinates: those of derivatives are larger unless controlled."""
    plan, given, is_absolute = problem.plan, getattr(problem.control, name), name == "atol"
    n = field.frame.dim
    shape = (n,) if problem.in_coordinates else field.frame.point_shape
    own = np.broadcast_to(np.asarray(given), shape).ravel()
    rows = own if problem.in_coordinates else np.full(n, own.min())
    if not problem.in_coordinates and not is_absolute:
        own = np.repeat(own, plan.parts)
    elif not problem.in_coordinates:
        # the norm is that of numbers here, and that of complex entries there
        own = np.repeat(own, plan.parts) / np.sqrt(plan.parts)
    if control_derivatives and not rows.min() > 0.0:
        raise ValueError(
            "atol must be positive with control_derivatives, since derivatives are zero at first, "
            f"got {given}"
        )
    elif not control_derivatives:  # derivatives are of size one at first, also with atol = 0
        rows = _LOOSE * np.maximum(rows, problem.control.rtol.min())
    others = np.repeat(rows, field.columns)
    # the square of the norm of the joint error is then the sum of those of both parts
    shares = np.sqrt(np.array([own.size, others.size]) / (own.size + others.size))
    return np.concatenate([shares[0] * own, shares[1] * others])
