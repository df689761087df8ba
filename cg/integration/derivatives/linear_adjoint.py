"""The adjoint equation of linear equations."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from cg.frames.linear_action import LinearAction
from cg.integration.derivatives.adjoint import tolerance_of, with_adjoint
from cg.integration.derivatives.adjoint_equation import Equation
from cg.integration.derivatives.field import parameter_differences, structure_constants
from cg.integration.output.dense import DenseOutput
from cg.integration.plan.plan import has_brackets
from cg.integration.problem import Problem
from cg.integration.rhs.checks import when
from cg.integration.rhs.compiled import CompiledRhs, call_field
from cg.integration.rhs.function import TimeFunction
from cg.integration.rhs.given_derivatives import Derivative, derivative_of
from cg.integration.rhs.python import context_of
from cg.support.arrays import Array, Points, check_finite


def with_linear_adjoint(problem: Problem, df_dp: Any) -> Problem:
    """Return the problem whose solution has gradients, after checking ``df_dp``."""
    frame, rhs = problem.plan.frame, problem.rhs
    numbers, inputs = rhs.parameters, rhs.inputs
    if not isinstance(frame, LinearAction) and not has_brackets(frame):
        raise ValueError(
            "frame must be a LinearAction or know the bracket of its fields with "
            f"derivatives='adjoint', got {frame!r}"
        )
    derivative = None
    if numbers is not None:
        check_finite(numbers, "parameters")
    count = (0 if numbers is None else numbers.shape[-1]) + (inputs.width if inputs else 0)
    if count:
        if callable(df_dp):
            df_dp = TimeFunction(df_dp)
        shape = frame.dim, count
        derivative = derivative_of(df_dp, "df_dp", frame, shape, rhs.vectorized, inputs)
    elif df_dp is not None:
        raise ValueError(f"parameters must be given with df_dp = {df_dp!r}, got None")
    return with_adjoint(problem, partial(_equation, problem, derivative))


def _equation(problem: Problem, df_dp: Derivative | None, sol: DenseOutput) -> Equation:
    frame, tolerance = problem.plan.frame, tolerance_of(problem)
    numbers, inputs = problem.rhs.parameters, problem.rhs.inputs
    count = None if numbers is None else numbers.shape[-1]
    own = partial(_linearisation, problem.rhs, df_dp, problem.points[0])
    if isinstance(frame, LinearAction):
        matrices = frame.dense()
        at, rest = partial(own, matrices), (matrices, frame.is_skew, sol)
        return Equation(at, frame.point_shape, tolerance, count, inputs, *rest)
    (i, j, k), constants = structure_constants(frame)
    brackets = np.zeros((frame.dim,) * 3)
    brackets[i, k, j] = constants
    return Equation(partial(own, brackets), (frame.dim,), tolerance, count, inputs)


def _linearisation(
    rhs: Any, df_dp: Derivative | None, point: Points, generators: Points, times: Array
) -> tuple[Points, Array | None]:
    """Return A, and the derivatives of the coefficients by the parameters and inputs."""
    a = _coefficients(rhs, times, point)
    if not np.isfinite(a).all():
        raise ValueError(f"f must return finite numbers, got others from {when(times)} on")
    fixed = rhs.parameters is None and rhs.inputs is None
    b = None if fixed else _derivative(rhs, df_dp, times, point)
    return np.tensordot(a, generators, 1), b


def _coefficients(rhs: Any, times: Array, point: Points) -> Array:
    """Return the coefficients at times, shape ``(times, dim)``."""
    values: Array = rhs.at_times(times, np.broadcast_to(point, (len(times), *point.shape)))
    return values


def _derivative(rhs: Any, df_dp: Derivative | None, times: Array, point: Points) -> Array:
    """Return the derivatives of the coefficients, shape ``(times, dim, k)``."""
    import cg._core_r64 as core

    if df_dp is None:
        return _differences(rhs, times, point)
    arguments = rhs.arguments(np.zeros(len(times), dtype=np.intp) if df_dp.vectorized else 0)
    if df_dp.vectorized:
        return df_dp(times, point[None], arguments)
    function, inputs, frame, shape = df_dp.function, rhs.inputs, df_dp.frame, df_dp.shape
    points = np.broadcast_to(point, (len(times), *point.shape))
    if not isinstance(function, CompiledRhs):
        context = context_of(function, arguments, frame, shape, df_dp.check)
        address = core.function_addresses()[0]
        return call_field(rhs, address, id(context), frame, times, points, shape)
    data = rhs.parameters if inputs is None else inputs.data_with(rhs.parameters)
    own = function.user_data
    table = () if inputs is None or own else inputs.table(rhs.parameters)
    values = function.values(frame, own or data.ctypes.data, times, points, shape, table)
    return np.array([df_dp.check(each, t) for each, t in zip(values, times, strict=True)])


def _differences(rhs: Any, times: Array, point: Points) -> Array:
    """Return central differences of the coefficients by the parameters and the inputs."""
    inputs = rhs.inputs
    row = np.zeros(0) if rhs.parameters is None else rhs.parameters[0]
    count, width = len(row), 0 if inputs is None else inputs.width

    def moved(numbers: Array) -> Array:
        own = numbers[None, :count] if count else None
        curves = inputs.shifted(numbers[count:]) if width else None
        return _coefficients(rhs.with_data(rhs.args, own, curves), times, point)

    scales = np.concatenate([np.zeros(count), inputs.scales]) if width else np.zeros(count)
    return parameter_differences(moved, np.append(row, np.zeros(width)), scales)
