r"""Gradients of costs of solutions by the adjoint equation.

Derivatives of a solution satisfy :math:`\xi' = A \xi + B` for each parameter. The derivative of a
cost with respect to the point at time t is a covector :math:`\lambda`, which satisfies
:math:`\lambda' = -A^H \lambda` between output times and goes backward from the end. Its value at
the start is the gradient with respect to the initial point, and :math:`\int \lambda^H B\,dt` the
gradient with respect to the parameters.

`cg.integration.derivatives.adjoint_equation` solves it on intervals, which are the steps of the
integration, divided at output times and at those of samples. The matrices of linear equations
don't depend on the solution, along which other equations are linearised.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.base import Frame
from cg.frames.facts import facts_of
from cg.frames.linear_action import LinearAction
from cg.integration.derivatives.adjoint_equation import (
    AdjointEquation,
    Gradient,
    Intervals,
    solve_intervals,
)
from cg.integration.derivatives.variational_equation import (
    count_parameters,
    parameter_differences,
    structure_constants_of,
)
from cg.integration.output.solutions import DenseOutput, Solution
from cg.integration.problem import Problem
from cg.integration.rhs.compiled import CompiledRhs, call_rhs
from cg.integration.rhs.form import templates_of
from cg.integration.rhs.function import TimeFunction
from cg.integration.rhs.python import (
    CALL_PYTHON,
    Derivative,
    Rhs,
    call_context,
    derivative_of,
    time_text,
)  # fmt: skip
from cg.support.arrays import Array, Points, check_finite, complex_array, real_array
from cg.support.frozen import changed

_FIXED_STEPS = 1e-11  # tolerance for integrations with fixed steps, which have none
# Largest share of a cotangent along fields that don't move the point: errors of differences
_ISOTROPY = 1e-3


@dataclass(frozen=True, eq=False, repr=False)
class Adjoint:
    """Gradients of functions of a solution, for ``derivatives="adjoint"``.

    Examples
    --------
    The derivative of the first coordinate of an oscillator after one second, with respect to its
    initial point and its stiffness:

    >>> import crouch_grossman as cg
    >>> solution = cg.solve_variational(
    ...     lambda t, y, p: [y[1], -p[0] * y[0]], (0, 1), [1.0, 0.0], frame=cg.frames.Euclidean(2),
    ...     parameters=[1.0], derivatives="adjoint", rtol=1e-10, atol=1e-10,
    ... )
    >>> gradient = solution.gradient([1.0, 0.0])
    >>> gradient.y0.round(6), gradient.parameters.round(6)
    (array([0.540302, 0.841471]), array([-0.420735]))
    """

    _equation: AdjointEquation
    _output: DenseOutput
    _times: Array  # times of the output
    _frame: Frame

    def __repr__(self) -> str:
        return f"Adjoint(times={len(self._times)}, shape={self._equation.shape})"

    def gradient(self, cotangent: ArrayLike) -> Gradient:
        """Return the derivatives of a cost by the initial point, parameters and inputs.

        Parameters
        ----------
        cotangent
            Derivatives of the cost with respect to the last point along the frame's fields, shape
            ``(dim,)``, or with respect to all ``y``, shape ``(len(t), dim)``. On
            `cg.frames.LinearAction` they are with respect to entries of points, shape
            ``frame.point_shape`` in place of ``(dim,)``: c if the cost changes by the real part of
            ``vdot(c, dy)``.

        Returns
        -------
        Gradient
            ``y0``, ``parameters`` and ``inputs``.

        Raises
        ------
        ValueError
            If the cotangent has another shape, isn't finite, or changes along fields that don't
            move the point, as derivatives by entries may; or if the equation is stiff, or jumps
            where there is no breakpoint, so that too many intervals would be needed.

        Notes
        -----
        The first call evaluates f and its derivatives at five points of each step, and solves for
        the covectors; others take little time.
        """
        cotangents = self._read(cotangent)
        if self._equation.generators is None:
            self._check_isotropy(cotangents[..., 0])
        return self._gradient(cotangents)

    def _gradient(self, cotangents: Points) -> Gradient:
        """Return the gradient from the cotangents at all times.

        The covector is zero after the last time and goes backward from interval to interval by
        their maps; at each output time the cotangent there is added to it.
        """
        chunks, sign = self._chunks, self._output._direction
        starts = sign * np.concatenate([intervals.start for intervals in chunks])
        order = np.argsort(starts)  # bisected intervals come after the others
        maps = np.concatenate([intervals.maps[:, 0] for intervals in chunks])[order]
        covector = np.zeros_like(cotangents[0])
        ends = np.empty((len(starts), *covector.shape), cotangents.dtype)
        # Each output time is before an interval with this number.
        intervals = np.searchsorted(starts[order], sign * self._times).tolist()
        for i in range(len(starts), -1, -1):
            while intervals and intervals[-1] == i:
                covector = covector + cotangents[len(intervals) - 1]
                intervals.pop()
            if i:
                ends[order[i - 1]] = covector
                covector = maps[i - 1] @ covector
        return self._equation.gradient(covector, chunks, ends)

    def jacobian(self) -> Gradient:
        """Return the derivatives of the last point by the initial point, parameters and inputs.

        Returns
        -------
        Gradient
            The gradients of all coordinates along a first axis: ``y0`` has the shape ``(dim,
            dim)``, ``parameters`` ``(dim, k)`` and ``inputs`` ``(dim, *values.shape)``. On
            `cg.frames.LinearAction` they are derivatives of entries, complex if these are, with
            the axes of ``frame.point_shape`` in place of ``dim``.

        Examples
        --------
        >>> import crouch_grossman as cg
        >>> solution = cg.solve_variational(
        ...     lambda t, y, u: [y[1], u], (0, 2), [1.0, 0.0], frame=cg.frames.Euclidean(2),
        ...     inputs=cg.Samples([0.0, 1.0], [0.5, -0.5]), derivatives="adjoint",
        ... )
        >>> solution.jacobian().inputs.round(6)
        array([[1.5, 0.5],
               [1. , 1. ]])
        """
        shape = self._equation.shape
        units = np.eye(math.prod(shape)).reshape(-1, *shape)

        def stacked(*rows: Points) -> Points:
            return np.reshape(rows, (*shape, *rows[0].shape))

        def gradient(unit: Points) -> Gradient:
            return self._gradient(self._read(unit))

        real = _map_arrays(stacked, *map(gradient, units))
        if not self._is_complex:
            return Gradient(*real)
        imaginary = _map_arrays(stacked, *map(gradient, 1j * units))
        both = Gradient(*_map_arrays(lambda a, b: a + 1j * b, real, imaginary))
        return both._replace(y0=real[0].conj())

    def _read(self, cotangent: ArrayLike) -> Points:
        """Return the cotangents at all times, shape ``(times, n, columns)``."""
        shape, times = self._equation.shape, len(self._times)
        array: Points = (complex_array if self._is_complex else real_array)(cotangent, "cotangent")
        check_finite("cotangent", array)
        if array.shape not in (shape, (times, *shape)):
            raise ValueError(
                f"cotangent must have shape {shape} or {(times, *shape)}, got {array.shape}"
            )
        cotangents = np.zeros((times, *shape), array.dtype)
        cotangents[... if array.ndim > len(shape) else -1] = array
        return cotangents.reshape(times, shape[0], -1)

    def _check_isotropy(self, cotangents: Array) -> None:
        """Raise ValueError unless costs are constant along fields that don't move their points."""
        points = self._output(self._times)

        def without_isotropy(v: Array) -> Array:
            return self._frame._coefficients(points, self._frame.field(v, points))[0]

        along = without_isotropy(cotangents)
        # the projection is inaccurate near singular matrices; a second one measures by how much
        error = np.linalg.norm(without_isotropy(along) - along, axis=-1)
        bound = _ISOTROPY * np.linalg.norm(cotangents, axis=-1) + 1e3 * error
        wrong = np.linalg.norm(along - cotangents, axis=-1) > bound
        if wrong.any():
            k = int(np.argmax(wrong))
            raise ValueError(
                "cotangent must be derivatives along the frame's fields, zero along those that "
                f"don't move the point; derivatives by entries are not; got {cotangents[k]} at t = "
                f"{self._times[k]:.17g}"
            )

    @property
    def _is_complex(self) -> bool:
        generators = self._equation.generators
        return generators is not None and generators.dtype.kind == "c"

    @cached_property
    def _chunks(self) -> list[Intervals]:
        """The solved intervals from the first point to the last one that is stored."""
        curves = () if self._equation.inputs is None else self._equation.inputs.curves
        edges = np.concatenate([self._output.ts, self._times, *(curve.times for curve in curves)])
        sign = self._output._direction
        edges = np.unique(sign * edges)
        start, end = sign * self._output.ts[0], sign * self._times[-1]
        edges = edges[(edges >= start) & (edges <= end)]
        if start == end:
            edges = np.repeat(edges, 2)
        return solve_intervals(self._equation, sign * edges)


def _map_arrays(function: Callable[..., Points], *results: Any) -> Any:
    """Return nested tuples of results of a function of arrays at the same place of each tuple."""
    if isinstance(results[0], tuple):
        return tuple(_map_arrays(function, *arrays) for arrays in zip(*results, strict=True))
    return None if results[0] is None else function(*results)


def with_adjoint(
    problem: Problem, equation_of: Callable[[DenseOutput], AdjointEquation]
) -> Problem:
    """Return the problem whose solution has gradients, after checking that it can have them."""
    if problem.events is not None:
        raise ValueError(
            "events must be None with derivatives='adjoint', which doesn't go through their jumps "
            f"and ends, got {len(problem.events)} of them"
        )
    if problem.t_eval is not None and not len(problem.t_eval):
        raise ValueError("t_eval must hold a time with derivatives='adjoint', got none")

    def with_gradients(solution: Solution) -> Solution:
        """Return a solution with dense output, with its adjoint in addition."""
        sol = solution.sol
        assert sol is not None
        adjoint = Adjoint(equation_of(sol), sol, solution.t, problem.plan.frame)
        return changed(solution, sol=sol if problem.dense_output else None, adjoint=adjoint)

    return changed(problem, dense_output=True, with_gradients=with_gradients)


def tolerance_of(problem: Problem) -> float:
    """Return the tolerance of the estimated errors of the adjoint equation.

    Where measured, estimates were at least three times the errors. So ten times the tolerance of
    the integration leaves errors below those of its steps in most problems, but not where steps are
    as long as those of linear equations.
    """
    tolerance = problem.control.tolerance
    if tolerance is None:
        return _FIXED_STEPS
    return tolerance if problem.linear else 10.0 * tolerance


def with_linear_adjoint(problem: Problem, df_dp: Any) -> Problem:
    """Return the problem whose solution has gradients, after checking ``df_dp``."""
    frame, rhs = problem.plan.frame, problem.rhs
    if not isinstance(frame, LinearAction) and not facts_of(frame).has_brackets:
        raise ValueError(
            "frame must be a LinearAction or know the bracket of its fields with "
            f"derivatives='adjoint', got {frame!r}"
        )
    shape = frame.dim, count_parameters(rhs, df_dp, True)[0]
    if callable(df_dp):
        df_dp = TimeFunction(df_dp)
    derivative = derivative_of(df_dp, "df_dp", frame, shape, rhs.vectorized, rhs.extra.inputs)
    return with_adjoint(problem, partial(_linear_equation, problem, derivative))


def _linear_equation(
    problem: Problem, df_dp: Derivative | None, sol: DenseOutput
) -> AdjointEquation:
    frame, tolerance = problem.plan.frame, tolerance_of(problem)
    count, inputs = problem.rhs.extra.parameter_count, problem.rhs.extra.inputs
    linearisation = partial(_linearisation, problem.rhs, df_dp, problem.points[0])
    if isinstance(frame, LinearAction):
        matrices = frame.dense()
        at, options = partial(linearisation, matrices), (matrices, frame.is_skew, sol)
        return AdjointEquation(at, frame.point_shape, tolerance, count, inputs, *options)
    structure, brackets = structure_constants_of(frame), np.zeros((frame.dim,) * 3)
    i, j, k = structure.index
    brackets[i, k, j] = structure.constants
    return AdjointEquation(partial(linearisation, brackets), (frame.dim,), tolerance, count, inputs)


def _linearisation(
    rhs: Rhs, df_dp: Derivative | None, point: Points, generators: Points, times: Array
) -> tuple[Points, Array | None]:
    """Return A, and the derivatives of the coefficients by the parameters and inputs."""
    a = _coefficients(rhs, times, point)
    if not np.isfinite(a).all():
        raise ValueError(f"f must return finite numbers, got others from {time_text(times)} on")
    fixed = rhs.extra.parameters is None and rhs.extra.inputs is None
    b = None if fixed else _derivative(rhs, df_dp, times, point)
    return np.tensordot(a, generators, 1), b


def _coefficients(rhs: Rhs, times: Array, point: Points) -> Array:
    """Return the coefficients at times, shape ``(times, dim)``."""
    return np.asarray(rhs.at_times(times, np.broadcast_to(point, (len(times), *point.shape))))


def _derivative(rhs: Rhs, df_dp: Derivative | None, times: Array, point: Points) -> Array:
    """Return the derivatives of the coefficients, shape ``(times, dim, k)``."""
    if df_dp is None:
        return _differences(rhs, times, point)
    arguments = rhs.extra.arguments(np.zeros(len(times), dtype=np.intp) if df_dp.vectorized else 0)
    if df_dp.vectorized:
        return df_dp(times, point[None], arguments)
    function, parameters, inputs = df_dp.function, rhs.extra.parameters, rhs.extra.inputs
    points = np.broadcast_to(point, (len(times), *point.shape))
    if not isinstance(function, CompiledRhs):
        templates = templates_of(df_dp.frame, df_dp.shape)
        context = call_context(function, arguments, templates, df_dp.check)
        address, data = CALL_PYTHON, np.array(id(context))
        return call_rhs(rhs, address, data.ctypes.data, df_dp, times, points)
    numbers = parameters if inputs is None else inputs.data_with(parameters)
    assert numbers is not None
    user_address = function.user_address
    table = () if inputs is None or user_address else inputs.table(parameters)
    values = function.values(df_dp, user_address or numbers.ctypes.data, times, points, table)
    return np.array([df_dp.check(value, t) for value, t in zip(values, times, strict=True)])


def _differences(rhs: Rhs, times: Array, point: Points) -> Array:
    """Return central differences of the coefficients by the parameters and the inputs."""
    inputs, parameters = rhs.extra.inputs, rhs.extra.parameters
    row = np.zeros(0) if parameters is None else parameters[0]
    count, width = len(row), 0 if inputs is None else inputs.width

    def coefficients(numbers: Array) -> Array:
        own_parameters = numbers[None, :count] if count else None
        curves = None if inputs is None else inputs.shifted(numbers[count:])
        shifted = rhs.with_data(rhs.extra._replace(parameters=own_parameters, inputs=curves))
        return _coefficients(shifted, times, point)

    scales = np.zeros(count) if inputs is None else np.append(np.zeros(count), inputs.scales)
    return parameter_differences(coefficients, np.append(row, np.zeros(width)), scales)
