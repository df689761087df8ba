"""Derivatives of event times and of jumps: saltation matrices."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from cg.frames.base import Frame
from cg.frames.checking import CENTRAL_STEPS, CENTRAL_WEIGHTS
from cg.frames.manifold import MEMBERSHIP_TOLERANCE
from cg.integration.derivatives.variational_equation import VariationalEquation, parameter_steps
from cg.integration.rhs.compiled import CompiledRhs
from cg.integration.rhs.events import EventTable
from cg.integration.rhs.form import RhsForm
from cg.integration.rhs.inputs import Reader, data_at
from cg.support.arrays import Array, Points

_STEP = float(np.finfo(np.float64).eps) ** (1 / 5)
# the difference of order four to one side
_ONE_SIDED_STEPS = np.arange(5.0)
_ONE_SIDED_WEIGHTS = np.array([-25.0, 48.0, -36.0, 16.0, -3.0]) / 12.0
# Central differences need no bound of a segment within their short steps. If the distances to both
# bounds have a smaller ratio than this, long steps to one side have smaller rounding errors.
_MIN_CENTRAL = 2e-3
# a derivative that is smaller than this, relative to slopes between values, is rounding
_MIN_RATE = 1e-8
# largest distance of an event from the bound that causes it, relative to its time or the span
_SAME_TIME = 64.0 * float(np.finfo(np.float64).eps)

_EVENT = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p)


class _Derivatives(NamedTuple):
    """Derivatives of a function with m values at a point of a solution."""

    by_fields: Array  # shape (n, m)
    along: Array  # along the solution, shape (m,)
    by_parameters: Array  # shape (k, m)
    max_slope: float  # largest slope between two values along the solution
    span: float  # largest difference between two values along the solution


class VariationalEvents(EventTable):
    r"""The events of a solution with its derivatives.

    Let :math:`g(t, y) = 0` at an event, :math:`\dot g` be the derivative of g along the solution,
    and :math:`\xi` the coordinates of a derivative of y just before. The time of the event has
    the derivative :math:`\delta t = -(\partial g\,\xi + \partial_p g) / \dot g`, and after a jump
    :math:`y^+ = J(t, y)`

    .. math:: \xi^+ = \partial J\,\xi + \partial_p J + (\dot J - f^+)\,\delta t,

    where :math:`\dot J` are the coordinates of the derivative of J along the solution before, and
    :math:`f^+` the coefficients after it [1]_. Derivatives of g and J are central differences of
    order four. Those by time are found between the neighbouring ``bounds``: the ends of the span
    and the times where inputs or the right-hand side may jump, in increasing order.

    References
    ----------
    .. [1] N. J. Kong, J. J. Payne, J. Zhu, A. M. Johnson, "Saltation matrices: the essential tool
       for linearizing hybrid dynamical systems", Proc. IEEE 112 (2024), 585-608.
    """

    def __init__(self, table: EventTable, equation: VariationalEquation, bounds: Array) -> None:
        events, flags = table._arguments
        super().__init__(events, table.frame, **flags)
        self.table, self.equation, self.bounds = table, equation, bounds
        if not equation.parameter_count and isinstance(equation.f, CompiledRhs):
            self.rows["data"][self.rows["data"] == 0] = equation.f.user_address
        self._callable = [
            None if source is None else _EVENT(source.address) for source in table.compiled
        ]

    def __reduce__(self) -> tuple[Any, ...]:
        return VariationalEvents, (self.table, self.equation, self.bounds)

    def on_frame(self, frame: Frame) -> VariationalEvents:
        """Return the events on another frame of the same points without derivatives."""
        equation = replace(self.equation, form=RhsForm(frame))
        return VariationalEvents(self.table.on_frame(frame), equation, self.bounds)

    def value(self, index: int, t: float, y: Points, arguments: tuple[Any, ...]) -> float:
        """Return the value of a function at a point with derivatives."""
        return self.table.value(index, t, self.equation.split(y)[0], arguments)

    def values(self, index: int, t: Array, y: Points, arguments: tuple[Any, ...]) -> Array:
        """Return the values of a vectorized function at points with derivatives."""
        return self.table.values(index, t, self.equation.split(y)[0], arguments)

    def jump(
        self, index: int, t: float, y: Points, arguments: tuple[Any, ...],
        tolerance: float = MEMBERSHIP_TOLERANCE,
    ) -> Points:  # fmt: skip
        """Return the point after a jump with its derivatives."""
        equation = self.equation
        before, x = equation.split(y)
        after = self.table.jump(index, t, before, arguments, tolerance)
        rate, delta = self._time_derivative(index, t, before, x, arguments)
        if not np.isfinite(delta).all():
            raise ValueError(
                f"events[{index}] must change its sign where it jumps, for the solution to have "
                f"derivatives; its derivative along the solution is {rate:g} at t = {t:.17g}"
            )

        n, m = self.frame.dim, equation.direction_count

        def jumped(time: float, point: Points, extra: tuple[Any, ...]) -> Array:
            # a point nearby may open the joints of a phase space
            landed = self.table.jump(index, time, point, extra, math.inf)
            return self.frame.local_coordinates(after, landed)

        derivatives = self._differentiate(jumped, t, before, arguments)
        jump_of_rate = derivatives.along - self._coefficients(t, after, arguments)
        transformed = derivatives.by_fields.T @ x
        if equation.parameter_count:
            transformed[:, :m] += equation.along_directions(derivatives.by_parameters.T)
        transformed += np.outer(jump_of_rate, delta)
        if equation.noise is not None:
            # a covariance is multiplied by the saltation matrix from both sides
            unit = np.eye(n, equation.column_count)
            local = self._time_derivative(index, t, before, unit, arguments)[1][:n]
            matrix = derivatives.by_fields.T + np.outer(jump_of_rate, local)
            transformed[:, m:] = matrix @ x[:, m:] @ matrix.T
        return equation.product.join(after, transformed.ravel())

    def time_derivatives(
        self, index: int, times: Array, z: Array, arguments: tuple[Any, ...]
    ) -> Array:
        """Return derivatives of an event's times, shape ``(times, directions)``.

        ``z`` are the points before. Where the solution touches the event without crossing it,
        derivatives aren't finite.
        """
        derivatives = np.empty((len(times), self.equation.direction_count))
        for row, t, y, x in zip(derivatives, times.tolist(), *self.equation.split(z), strict=True):
            row[:] = self._time_derivative(index, t, y, x, arguments)[1][: row.size]
        return derivatives

    def _time_derivative(
        self, index: int, t: float, y: Points, x: Array, arguments: tuple[Any, ...]
    ) -> tuple[float, Array]:
        """Return the derivatives of a function along the solution and of the time of its zero."""

        def value(time: float, point: Points, extra: tuple[Any, ...]) -> Array:
            return np.array([self._value_of(index, time, point, extra)])

        derivatives, equation = self._differentiate(value, t, y, arguments), self.equation
        rate = float(derivatives.along[0])
        rate = rate if abs(rate) > _MIN_RATE * derivatives.max_slope else 0.0
        if self._jumps_over_zero(value, t, y, arguments, derivatives.span):
            return rate, np.zeros(x.shape[1])
        gradient = derivatives.by_fields[:, 0] @ x
        if equation.parameter_count:
            along = equation.along_directions(derivatives.by_parameters[:, 0])
            gradient[: equation.direction_count] += along
        with np.errstate(divide="ignore", invalid="ignore"):
            return rate, -gradient / np.float64(rate)

    def _jumps_over_zero(
        self, value: Callable[..., Array], t: float, y: Points, arguments: tuple[Any, ...],
        span: float,
    ) -> bool:  # fmt: skip
        """Return whether a function has another sign after a bound, at which the event stays.

        This is the case where an input jumps. A difference far below ``span`` is rounding.
        """
        bound = float(self.bounds[np.abs(self.bounds - t).argmin()])
        if abs(bound - t) > _SAME_TIME * max(abs(t), float(np.ptp(self.bounds))):
            return False
        sides = (math.nextafter(bound, side) for side in (-math.inf, math.inf))
        before, after = (float(value(side, y, arguments)[0]) for side in sides)
        return before * after < 0.0 and abs(before - after) > _MIN_RATE * span

    def _value_of(self, index: int, t: float, y: Points, arguments: tuple[Any, ...]) -> float:
        if (function := self._callable[index]) is None:
            return self.table.value(index, t, y, arguments)
        point = np.ascontiguousarray(y)
        numbers = data_at(t, arguments, self.equation.parameter_count > 0)
        data = max(int(self.rows["data"][index]), 0) or (
            None if numbers is None else numbers.ctypes.data
        )
        return self.wrapped(index, float(function(t, point.ctypes.data, data)))

    def _coefficients(self, t: float, y: Points, arguments: tuple[Any, ...]) -> Array:
        """Return the coefficients of one member."""
        equation = self.equation
        if not equation.vectorized:
            return equation.coefficients(t, y, arguments, whole=True)
        if equation.parameter_count:
            arguments = (*arguments[:-1], arguments[-1][None])
        return np.asarray(equation.coefficients(np.array([t]), y[None], arguments, True)[0])

    def _differentiate(
        self, function: Callable[[float, Points, tuple[Any, ...]], Array], t: float, y: Points,
        arguments: tuple[Any, ...],
    ) -> _Derivatives:  # fmt: skip
        """Return derivatives of ``function(t, y, arguments)``, which has m values."""
        frame, n = self.frame, self.frame.dim
        sizes = np.maximum(frame.coordinate_sizes(y), 1.0)
        slope = self._coefficients(t, y, arguments)
        # the solution moves by the sizes of its coordinates in a unit of this time
        unit = 1.0 / max(float(np.abs(slope / sizes).max()), np.finfo(np.float64).tiny)
        unit = min(unit, float(np.ptp(self.bounds)) or max(abs(t), 1.0))

        def values_along(v: Array, time: float = 0.0, steps: Array = CENTRAL_STEPS) -> Array:
            pairs = [(t + s * time, frame.flow(s * v, y)) for s in _STEP * steps]
            return np.array([function(*pair, arguments) for pair in pairs])

        by_fields = [
            CENTRAL_WEIGHTS @ values_along(size * e) / (_STEP * size)
            for size, e in zip(sizes, np.eye(n), strict=True)
        ]
        by_parameters = np.empty((self.equation.parameter_count, len(by_fields[0])))
        if self.equation.parameter_count:
            *others, row = arguments
            for i, (change, size) in enumerate(parameter_steps(row, _STEP)):
                values = [function(t, y, (*others, row + s * change)) for s in CENTRAL_STEPS]
                by_parameters[i] = CENTRAL_WEIGHTS @ np.array(values) / size
        unit, steps, weights = self._steps_in_time(t, unit, arguments)
        ahead = values_along(unit * slope, unit, steps)
        span, size = float(np.ptp(ahead)), _STEP * unit
        along, max_slope = weights @ ahead / size, span / abs(size)
        return _Derivatives(np.array(by_fields), along, by_parameters, max_slope, span)

    def _steps_in_time(
        self, t: float, unit: float, arguments: tuple[Any, ...]
    ) -> tuple[float, Array, Array]:
        """Return the unit of differences by time, at most ``unit``, their steps and weights."""
        steps, weights = CENTRAL_STEPS, CENTRAL_WEIGHTS
        elapsed, remaining = self._times_to_bounds(t, arguments)
        near, far = sorted((elapsed, remaining))
        # steps reach two units to both sides, or four units to one, and stay a hundredth within
        if near >= _MIN_CENTRAL * far:
            unit = min(unit, near / (2.02 * _STEP))
        else:  # near a bound
            steps, weights = _ONE_SIDED_STEPS, _ONE_SIDED_WEIGHTS
            unit = min(unit, far / (4.04 * _STEP))
            unit = unit if remaining > elapsed else -unit
        unit = ((t + _STEP * unit) - t) / _STEP or unit  # without rounding of times
        return unit, steps, weights

    def _times_to_bounds(self, t: float, arguments: tuple[Any, ...]) -> tuple[float, float]:
        """Return the times since the last bound and to the next, or to the ends of the inputs."""
        bounds = self.bounds
        elapsed = t - float(bounds[bounds < t].max(initial=-math.inf))
        remaining = float(bounds[bounds > t].min(initial=math.inf)) - t
        reader = arguments[0] if arguments else None
        if not isinstance(reader, Reader):
            return elapsed, remaining
        start, end = reader.inputs.span
        return min(elapsed, max(t - start, 0.0)), min(remaining, max(end - t, 0.0))
