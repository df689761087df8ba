"""The adjoint equation of linear equations."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from cg.frames.arrays import Array, Points, check_finite
from cg.frames.linear_action import LinearAction
from cg.integration.adjoint import Equation, tolerance_of, with_adjoint
from cg.integration.loop.dense import DenseOutput
from cg.integration.problem import Problem
from cg.integration.rhs.compiled import CompiledRhs
from cg.integration.rhs.derivatives import Derivative, derivative_of, read_only
from cg.integration.rhs.function import TimeFunction
from cg.integration.rhs.python import PythonRhs
from cg.integration.step.plan import has_brackets
from cg.integration.variational.field import parameter_differences, structure_constants


def with_linear_adjoint(problem: Problem, da_dp: Any) -> Problem:
    """Return the problem whose solution has gradients, after checking ``da_dp``."""
    frame, rhs = problem.plan.frame, problem.rhs
    numbers = rhs.parameters
    if rhs.inputs is not None:
        raise ValueError("inputs must be None with derivatives='adjoint'")
    if not isinstance(frame, LinearAction) and not has_brackets(frame):
        raise ValueError(
            "frame must be a LinearAction or know the bracket of its fields with "
            f"derivatives='adjoint', got {frame!r}"
        )
    derivative = None
    if numbers is not None:
        check_finite(numbers, "parameters")
        if callable(da_dp):
            da_dp = TimeFunction(da_dp, rhs.vectorized)
        shape = frame.dim, numbers.shape[-1]
        derivative = derivative_of(da_dp, "da_dp", frame, shape, rhs.vectorized, None)
    elif da_dp is not None:
        raise ValueError(f"parameters must be given with da_dp = {da_dp!r}, got None")
    return with_adjoint(problem, partial(_equation, problem, derivative))


def _equation(problem: Problem, da_dp: Derivative | None, sol: DenseOutput) -> Equation:
    frame, tolerance = problem.plan.frame, tolerance_of(problem)
    numbers = problem.rhs.parameters
    count = None if numbers is None else numbers.shape[-1]
    own = partial(_linearisation, problem.rhs, da_dp, problem.points[0])
    if isinstance(frame, LinearAction):
        matrices = frame.dense()
        at = partial(own, matrices)
        return Equation(at, frame.point_shape, tolerance, count, matrices, frame.is_skew, sol)
    (i, j, k), constants = structure_constants(frame)
    brackets = np.zeros((frame.dim,) * 3)
    brackets[i, k, j] = constants
    return Equation(partial(own, brackets), (frame.dim,), tolerance, count)


def _linearisation(
    rhs: Any, da_dp: Derivative | None, point: Points, generators: Points, times: Array
) -> tuple[Points, Array | None]:
    """Return A, and the derivatives of the coefficients with respect to the parameters."""
    a = _coefficients(rhs, times, point)
    b = None if rhs.parameters is None else _parameter_derivative(rhs, da_dp, times, point)
    return np.tensordot(a, generators, 1), b


def _coefficients(rhs: Any, times: Array, point: Points) -> Array:
    """Return the coefficients at times, shape ``(times, dim)``."""
    if not isinstance(rhs, PythonRhs):
        return np.array([rhs.at_member(0, t, point) for t in times.tolist()])
    if rhs.vectorized:
        members = np.zeros(len(times), dtype=np.intp)
        return rhs.at_members(times.copy(), members, point[None].copy())
    return _each(rhs.f, rhs.check, times, point, rhs.arguments(0))


def _each(function: Any, check: Any, times: Array, point: Points, arguments: Any) -> Array:
    """Return the checked values of a function of one time at many."""
    visible = read_only(point)
    values = [function(t, visible, *arguments) for t in times.tolist()]
    try:
        together = np.array(values, dtype=np.float64)
        if together.ndim > 1 and np.isfinite(together).all():
            check(together[0], times[0], visible)
            return together
    except (TypeError, ValueError):
        pass
    return np.array([check(each, t, visible) for each, t in zip(values, times, strict=True)])


def _parameter_derivative(rhs: Any, da_dp: Derivative | None, times: Array, point: Points) -> Array:
    """Return the derivatives of the coefficients, shape ``(times, dim, k)``."""
    row = rhs.parameters[0]
    if da_dp is None:
        return parameter_differences(
            lambda moved: _coefficients(rhs.with_data(rhs.args, moved[None], None), times, point),
            row,
        )
    arguments = *rhs.args, row
    if da_dp.vectorized:
        arguments = *rhs.args, np.broadcast_to(row, (len(times), row.size))
        return da_dp(times, point[None], arguments)
    if isinstance(da_dp.function, CompiledRhs):
        data = int(rhs.parameters.ctypes.data)
        return np.array([da_dp(t, point, arguments, data) for t in times.tolist()])
    return _each(da_dp.function, da_dp.check, times, point, arguments)
