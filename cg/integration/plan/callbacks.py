"""Callbacks from compiled code: flows in Python, Jacobians, events and jumps."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, cast

import numpy as np

from cg.frames.base import FlowOverflowError
from cg.frames.facts import Dexpinv, dexpinv_of
from cg.frames.manifold import usable_or_zero
from cg.integration.plan.plan import Plan
from cg.integration.rhs.events import EventTable
from cg.integration.rhs.python import Jacobian, PythonRhs, Rhs
from cg.support.arrays import Array, Points
from cg.support.shared_numbers import Operation


class Callbacks:
    """The functions of Python that one run may call, by `cg.support.shared_numbers.Operation`.

    Compiled code calls ``callbacks(operation, a, b)`` with two vectors of doubles; the result is
    a vector.

    ``last_error`` is the last exception that compiled code treats as a step that is too long.
    ``failed_event`` has the name of an event's function that raised an exception, the time, and the
    member, which is None if the function took several members.
    """

    def __init__(
        self, plan: Plan, rhs: Rhs | None = None, events: EventTable | None = None,
        jacobian: Jacobian | None = None,
    ) -> None:  # fmt: skip
        self.plan, self.frame = plan, plan.frame
        # compiled code calls only operations whose object was given
        self.rhs = cast(Rhs, rhs)
        self.events, self.jacobian = cast(EventTable, events), cast(Jacobian, jacobian)
        self.last_error: Exception | None = None
        self.failed_event: tuple[str, float, int | None] | None = None

    @cached_property
    def _dexpinv(self) -> Dexpinv:
        return dexpinv_of(self.frame, self.plan.step_table.output.series)

    def __call__(self, operation: int, a: Array, b: Array) -> Array | float:
        """Return the result of an operation on two vectors, as a vector of doubles or a float."""
        result = HANDLERS[operation](self, a, b)
        if isinstance(result, float):
            return result
        result = np.ascontiguousarray(result)
        return result.reshape(-1).view(np.float64) if result.dtype.kind == "c" else result.ravel()

    def _point(self, y: Array) -> Points:
        return y.view(self.frame.dtype).reshape(self.frame.point_shape)

    def _points(self, y: Array) -> Points:
        return y.view(self.frame.dtype).reshape(-1, *self.frame.point_shape)

    def _flow(self, v: Array, y: Array) -> Points:
        point = self._point(y)
        try:
            for coefficients in v.reshape(-1, self.frame.dim):
                point = self.frame.flow(coefficients, point)
            return point
        except FlowOverflowError as error:  # an adaptive step is tried again with a smaller size
            self.last_error = error
            return np.full(self.frame.point_shape, np.nan, dtype=self.frame.dtype)

    def _coordinates(self, x: Array, y: Array) -> Array:
        v = self.frame.exp_coordinates(self._point(x), self._point(y))
        return np.full(self.frame.dim, np.nan) if v is None else v

    def _nearby(self, x: Array, y: Array) -> Array:
        if not (np.isfinite(x).all() and np.isfinite(y).all()):
            return np.full(self.frame.dim, np.nan)
        return self.frame.local_coordinates(self._point(x), self._point(y))

    def _nearest(self, a: Array, end: Array) -> Array:
        # `a` holds a point, and flows from it that lead to the end or near it
        frame = self.frame
        if not (np.isfinite(a).all() and np.isfinite(end).all()):
            return np.full(frame.dim, np.nan)
        point, flows = self._point(a[: len(end)]), a[len(end) :].reshape(-1, frame.dim)
        v = np.zeros(frame.dim)
        if len(flows) and (composed := usable_or_zero(frame._composed(flows))).any():
            moved = self._flow(composed, point.view(np.float64).ravel())
            if np.isfinite(moved).all():
                point, v = moved, composed
        return v + frame._nearest_coordinates(point, self._point(end))

    def _coefficients(self, y: Array, dy: Array) -> Array:
        if not (np.isfinite(y).all() and np.isfinite(dy).all()):
            return np.full(self.frame.dim + 1, np.nan)
        v, dropped = self.frame._coefficients(self._point(y), self._point(dy))
        return np.append(v, dropped * np.linalg.norm(dy))

    def _evaluate_jacobian(self, a: Array, y: Array) -> Any:
        t, member = a[:2].tolist()
        return self.jacobian.evaluate(self.rhs, int(member), t, self._point(y.copy()), a[2:])

    def _factor(self, a: Array, _: Array) -> Any:
        member, gamma, real, imaginary = a.tolist()
        return self.jacobian.factor(int(member), (gamma, complex(real, imaginary)))

    def _evaluate(self, a: Array, y: Array) -> Array:
        assert isinstance(self.rhs, PythonRhs)
        t, members = a.reshape(2, -1)
        return self.rhs.results(t, members.astype(np.intp), self._points(y))

    def _call_vectorized_event(self, a: Array, y: Array) -> Array:
        event, (t, members) = int(a[0]), a[1:].reshape(2, -1)
        members = members.astype(np.intp)
        try:
            return self.events.values(event, t, self._points(y), self.rhs.extra.arguments(members))
        except Exception:
            member = int(members[0]) if len(t) == 1 else None
            self.failed_event = f"events[{event}]", float(t[0]), member
            raise

    def _call_event(self, a: Array, y: Array, is_jump: bool) -> Any:
        t, member, event = a.tolist()
        member, event = int(member), int(event)
        function = self.events.jump if is_jump else self.events.value
        try:
            return function(event, t, self._point(y), self.rhs.extra.arguments(member))
        except Exception:
            self.failed_event = f"events[{event}]{'.jump' * is_jump}", t, member
            raise


HANDLERS: dict[int, Callable[[Callbacks, Array, Array], Any]] = {
    Operation.FLOW: Callbacks._flow,
    Operation.COORDINATES: Callbacks._coordinates,
    Operation.NEARBY: Callbacks._nearby,
    Operation.NEAREST: Callbacks._nearest,
    Operation.SIZES: lambda self, _, y: self.frame.coordinate_sizes(self._point(y)),
    Operation.COEFFICIENTS: Callbacks._coefficients,
    Operation.TANGENT: lambda self, v, y: self.frame.field(v, self._point(y)),
    Operation.WITHOUT_ISOTROPY: lambda self, v, y: self.frame.without_isotropy(v, self._point(y)),
    Operation.DEXPINV: lambda self, u, v: self._dexpinv(u, v),
    Operation.BRACKET: lambda self, u, v: self.frame.bracket(u, v),
    Operation.RHS: Callbacks._evaluate,
    Operation.EVENT: lambda self, a, y: self._call_event(a, y, False),
    Operation.EVENTS: Callbacks._call_vectorized_event,
    Operation.JUMP: lambda self, a, y: self._call_event(a, y, True),
    Operation.JACOBIAN: Callbacks._evaluate_jacobian,
    Operation.FACTOR: Callbacks._factor,
    Operation.SOLVE: lambda self, a, b: self.jacobian.solve(int(a[0]), b),
}
