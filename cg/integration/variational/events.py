"""Derivatives of event times and of jumps: saltation matrices."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

import numpy as np

from cg.frames.arrays import Array, Points
from cg.integration.rhs.compiled import compiled_event
from cg.integration.rhs.events import EventTable
from cg.integration.variational.field import VariationalField, parameter_steps

_STEP = float(np.finfo(np.float64).eps) ** (1 / 5)
# weights of the central difference of order four
_STEPS = np.array([-2.0, -1.0, 1.0, 2.0])
_WEIGHTS = np.array([1.0, -8.0, 8.0, -1.0]) / 12.0
# a derivative that is smaller than this, relative to slopes between values, is rounding
_ROUNDING = 1e-8

_EVENT = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p)


class VariationalEvents(EventTable):
    r"""The events of a solution with its derivatives.

    Let :math:`g(t, y) = 0` at an event, :math:`\dot g` be the derivative of g along the solution,
    and :math:`\xi` the coordinates of a derivative of y just before.  The time of the event has
    the derivative :math:`\delta t = -(\partial g\,\xi + \partial_p g) / \dot g`, and behind a jump
    :math:`y^+ = J(t, y)`

    .. math:: \xi^+ = \partial J\,\xi + \partial_p J + (\dot J - f^+)\,\delta t,

    where :math:`\dot J` are the coordinates of the derivative of J along the solution before, and
    :math:`f^+` the coefficients after it [1]_.  Derivatives of g and J are central differences of
    order four.

    Parameters
    ----------
    events
        As for `EventTable`.
    arguments
        ``arguments(member)`` returns the further arguments of the functions, with the parameters
        last.
    field
        The right-hand side.

    References
    ----------
    .. [1] N. J. Kong, J. J. Payne, J. Zhu, A. M. Johnson, "Saltation matrices: the essential tool
       for linearizing hybrid dynamical systems", Proc. IEEE 112 (2024), 585-608.
    """

    def __init__(
        self,
        events: Any,
        arguments: Callable[[int], tuple[Any, ...]],
        field: VariationalField,
    ) -> None:
        super().__init__(events, field.frame, arguments)
        self._field = field
        if not field.count:
            self.functions[self.functions[:, 1] == 0, 1] = field.data_address(())
        self._callable = [
            None if compiled_event(event.function) is None else _EVENT(int(address))
            for event, address in zip(self.events, self.functions[:, 0], strict=True)
        ]

    def value(self, index: int, member: int, t: float, y: Points) -> float:
        """Return the value of a function at a point with derivatives."""
        return super().value(index, member, t, self._field.split(y)[0])

    def jump(self, index: int, member: int, t: float, y: Points) -> Points:
        """Return the point after a jump with its derivatives."""
        field, arguments = self._field, self.arguments(member)
        before, x = field.split(y)
        after = self.jump_with(index, t, before, arguments)
        rate, delta = self._time_derivative(index, t, before, x, arguments)
        if not np.isfinite(delta).all():
            raise ValueError(
                f"events[{index}] must change its sign where it jumps, for the solution to have "
                f"derivatives; its derivative along the solution is {rate:g} at t = {t:.17g}"
            )

        def jumped(time: float, point: Points, extra: tuple[Any, ...]) -> Array:
            return self.frame.local_coordinates(after, self.jump_with(index, time, point, extra))

        by_fields, along, by_parameters, _ = self._derivatives(jumped, t, before, arguments)
        moved = by_fields.T @ x
        moved[:, self.frame.dim :] += by_parameters.T
        slope = self._coefficients(t, after, arguments)
        moved += np.outer(along - slope, delta)
        return field.product.join(after, moved.ravel())

    def time_derivatives(self, index: int, member: int, t: float, z: Array) -> Array:
        """Return derivatives of an event's time, shape ``(dim + k,)``; z is the point before.

        They aren't finite where the solution touches the event without crossing it.
        """
        y, x = self._field.split(z)
        return self._time_derivative(index, t, y, x, self.arguments(member))[1]

    def _time_derivative(
        self, index: int, t: float, y: Points, x: Array, arguments: tuple[Any, ...]
    ) -> tuple[float, Array]:
        """Return the derivative of a function along the solution, and those of its zero's time."""

        def value(time: float, point: Points, extra: tuple[Any, ...]) -> Array:
            return np.array([self._value_of(index, time, point, extra)])

        by_fields, along, by_parameters, largest = self._derivatives(value, t, y, arguments)
        rate = float(along[0]) if abs(along[0]) > _ROUNDING * largest else 0.0
        gradient = by_fields[:, 0] @ x
        gradient[self.frame.dim :] += by_parameters[:, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            return rate, -gradient / np.float64(rate)

    def _value_of(self, index: int, t: float, y: Points, arguments: tuple[Any, ...]) -> float:
        function = self._callable[index]
        if function is None:
            return self.value_with(index, t, y, arguments)
        point = np.ascontiguousarray(y)
        data = int(self.functions[index, 1])
        if not data:
            data = self._field.data_address(arguments)
        return float(function(t, point.ctypes.data, data or None))

    def _coefficients(self, t: float, y: Points, arguments: tuple[Any, ...]) -> Array:
        """Return the coefficients of one member."""
        field = self._field
        if not field.vectorized:
            return field.coefficients(t, y, arguments)
        if field.count:
            arguments = (*arguments[:-1], arguments[-1][None])
        row: Array = field.coefficients(np.array([t]), y[None], arguments)[0]
        return row

    def _derivatives(
        self,
        function: Callable[[float, Points, tuple[Any, ...]], Array],
        t: float,
        y: Points,
        arguments: tuple[Any, ...],
    ) -> tuple[Array, Array, Array, float]:
        """Return derivatives of ``function(t, y, arguments)``, which has m values.

        They are those along fields ``(n, m)``, the solution ``(m,)`` and parameters ``(k, m)``,
        then the largest slope between any two values along the solution.
        """
        frame, n = self.frame, self.frame.dim
        sizes = np.maximum(frame.coordinate_sizes(y), 1.0)
        slope = self._coefficients(t, y, arguments)
        # in a unit of this time the solution moves by the sizes of its coordinates
        unit = 1.0 / max(float(np.abs(slope / sizes).max()), np.finfo(np.float64).tiny)
        unit = min(unit, max(abs(t), 1.0))

        def values_along(v: Array, time: float = 0.0) -> Array:
            return np.array(
                [
                    function(t + s * _STEP * time, frame.flow(s * _STEP * v, y), arguments)
                    for s in _STEPS
                ]
            )

        by_fields = [
            _WEIGHTS @ values_along(size * e) / (_STEP * size)
            for size, e in zip(sizes, np.eye(n), strict=True)
        ]
        by_parameters = np.empty((self._field.count, len(by_fields[0])))
        if self._field.count:
            for i, (moved, size) in enumerate(parameter_steps(arguments[-1], _STEP)):
                values = [function(t, y, (*arguments[:-1], moved(s))) for s in _STEPS]
                by_parameters[i] = _WEIGHTS @ np.array(values) / size
        ahead = values_along(unit * slope, unit) / (_STEP * unit)
        return np.array(by_fields), _WEIGHTS @ ahead, by_parameters, float(np.ptp(ahead))
