"""Right-hand sides that are functions in Python, and checks of their results."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.arrays import Array, Points, conversion_hint, is_complex_array, real_array
from cg.frames.base import Frame
from cg.frames.homogeneous import HomogeneousSpace
from cg.frames.matrix_group import MatrixGroup
from cg.integration.rhs.function import TimeFunction
from cg.integration.rhs.inputs import Inputs, WithInput, arguments_of

Coefficients = Callable[..., ArrayLike]
_JOIN = "; join parts by np.concatenate"
_COMPLEX = "; the real and the imaginary part of a complex drive are coefficients of two fields"


class Check:
    """The check of what a function in Python returns."""

    def __init__(
        self, f: Any, frame: Frame, vectorized: bool = False, first: int | None = None
    ) -> None:
        self.frame, self.vectorized, self.first = frame, vectorized, first
        self.of_time = isinstance(f, TimeFunction)
        self.name = "a" if self.of_time else "f"  # in error messages

    def __call__(self, value: Any, t: Any, y: Points, members: Any = None) -> Array:
        """Return what ``f(t, y)`` returned as an array, shape ``(dim,)`` or ``(n, dim)``.

        ValueError is raised if it has another shape, or isn't finite numbers although ``y`` is;
        compiled code detects points that aren't finite. ``members`` of a vectorized function are
        named in errors.
        """
        n, shape = self.frame.rhs_dim, self.frame.rhs_shape
        if self.vectorized:
            shape = (len(t), *shape)
        try:
            # a copy, since f may return the same buffer each time
            coefficients = real_array(value, self.name)
        except ValueError as error:
            expected = (
                f"an array of shape {shape}" if len(shape) > 1 else f"{shape[0]} real numbers"
            )
            join = isinstance(value, list | tuple) and any(map(np.ndim, value))
            hint = _JOIN if join else conversion_hint(value, error)
            hint = _COMPLEX if not hint and is_complex_array(value) else hint
            raise ValueError(
                f"{self.name} must return {expected}, got {value!r} at {when(t)}{hint}"
            ) from error
        if coefficients.shape != shape:
            got = "None" if value is None else f"shape {coefficients.shape}"
            each = "time" if self.of_time else "member"
            together = f", a row for each {each}, since vectorized=True" if self.vectorized else ""
            raise ValueError(
                f"{self.name} must return an array of shape {shape}{together}, got {got} at "
                f"{when(t)}{self._hint(coefficients.shape[self.vectorized :])}"
            )
        # a finite sum means that all terms are finite, and takes a fraction of the time
        if not math.isfinite(coefficients.sum()) and not np.isfinite(coefficients).all():
            rows = y.reshape(len(y) if self.vectorized else 1, -1)
            answers = np.isfinite(coefficients.reshape(-1, n)).all(axis=1)
            wrong = np.isfinite(rows).all(axis=1) & ~answers
            if wrong.any():
                got = f"{coefficients} at {when(t)}"
                if self.vectorized:
                    worst, *others = np.flatnonzero(wrong).tolist()
                    got = f"{coefficients[worst]} at {when(t[worst])}"
                    if members is not None:
                        got += f" for member {(self.first or 0) + members[worst]}"
                        got += f" and {len(others)} more" if others else ""
                raise ValueError(f"{self.name} must return finite numbers, got {got}")
        return coefficients

    def _hint(self, shape: tuple[int, ...]) -> str:
        """Return a hint if ``f`` returned a matrix of the Lie algebra, or a derivative."""
        group = self.frame.group if isinstance(self.frame, HomogeneousSpace) else self.frame
        flat = isinstance(group, MatrixGroup) and shape == (math.prod(group.point_shape),)
        if not isinstance(group, MatrixGroup) or not (flat or shape == group.point_shape):
            if shape != self.frame.point_shape:
                return _JOIN if len(shape) > 1 and math.prod(shape) == self.frame.rhs_dim else ""
            return "; f returns coefficients of the frame's fields, not the derivative of y"
        name = "frame.coefficients" if group is self.frame else "frame.group.coefficients"
        return f"; {name}(matrix) are those of a matrix in the Lie algebra"


class PythonRhs:
    """A right-hand side ``f(t, y, *args)``, or ``f(t, y, *args, parameters)``, in Python.

    Compiled code calls it through a function in C, whose data are the contexts made here.

    Parameters have the shape ``(members, k)``. A ``vectorized`` function takes times ``(n,)``,
    points ``(n, *point_shape)`` and rows of parameters of several members, and returns shape
    ``(n, dim)``; one of time alone may get several times for one point.
    ``first`` is the place of the first member in the ensemble for error messages.
    """

    def __init__(
        self,
        f: Coefficients,
        frame: Frame,
        args: tuple[Any, ...] = (),
        parameters: Array | None = None,
        vectorized: bool = False,
        first: int | None = None,
        inputs: Inputs | None = None,
    ) -> None:
        self.f, self.frame, self.args, self.parameters = f, frame, args, parameters
        self.vectorized, self.first, self.inputs = vectorized, first, inputs
        self.check = Check(f, frame, vectorized, first)
        self.name = self.failed_name = self.check.name
        function = f.a if isinstance(f, TimeFunction) else f
        rest = frame, frame.rhs_shape, self.check, self.check.of_time
        own = None if inputs is None else inputs.members
        if parameters is not None:
            own = len(parameters)
        self._by_member = own is not None and not vectorized
        members = range(own if own is not None and self._by_member else 1)
        self._contexts = [context_of(function, self.arguments(k), *rest) for k in members]
        if self._by_member:
            self._pointers = np.array([id(context) for context in self._contexts])

    def __reduce__(self) -> tuple[Any, ...]:
        state = self.f, self.frame, self.args, self.parameters, self.vectorized, self.first
        return PythonRhs, (*state, self.inputs)

    def with_data(
        self,
        args: tuple[Any, ...],
        parameters: Array | None,
        inputs: Inputs | None,
        first: int | None = None,
    ) -> PythonRhs:
        """Return the right-hand side with other further arguments, or of other members."""
        return PythonRhs(self.f, self.frame, args, parameters, self.vectorized, first, inputs)

    def arguments(self, member: Any) -> tuple[Any, ...]:
        """Return the further arguments of a member, or of an array of members."""
        return arguments_of(self.inputs, self.args, self.parameters, member)

    def addresses(self) -> tuple[int, int, int]:
        """Return the addresses of the function and of the first member's data, and their stride."""
        import cg._core_r64 as core

        field, member, _ = core.function_addresses()
        if not self._by_member:
            return field, self.data_address, 0
        return member, self.data_address, 8

    @property
    def data_address(self) -> int:
        """Address of the first member's data, which changes with the further arguments."""
        if not self._by_member:
            return id(self._contexts[0])
        return int(self._pointers.ctypes.data)

    def note(self, t: float, member: int = 0) -> str:
        """Return a note to an exception at ``t`` in a member, which says how ``f`` is called."""
        count = len(self.args) + (self.parameters is not None)
        extra = f", and {count} further arguments" if count else ""
        which, shape = "", str(self.frame.point_shape)
        if self.vectorized:
            shape = f"{('k', *self.frame.point_shape)}, and t of shape (k,)".replace("'", "")
        elif self.first is not None:
            which = f" in member {self.first + member}"
        u = "" if self.inputs is None else "u, "
        if self.check.of_time:
            return f"at t = {t:.17g}{which}; a is given (t, {u}...){extra[1:]}"
        of_time = self._takes(1 + count) and not self._takes(2 + count)
        hint = "; for an f of time alone see cg.solve_linear" if of_time else ""
        given = f"f is given (t, y, {u}...) with y of shape {shape}"
        return f"at t = {t:.17g}{which}; {given}{extra}{hint}"

    def _takes(self, count: int) -> bool:
        try:
            inspect.signature(self.f).bind(*range(count))
        except (TypeError, ValueError):  # the latter where it has no signature
            return False
        return True

    def at_member(self, member: int, t: float, y: Points) -> Array:
        """Return the coefficients of a member as a new array, after checking them."""
        return self.frame.complete_rhs(self.answer(member, t, y), y)

    def answer(self, member: int, t: float, y: Points) -> Array:
        """Return what ``f`` returns for a member as a new array, after checking it."""
        if self.vectorized:
            row: Array = self.at_members(np.array([t]), np.array([member]), y[None])[0]
            return row
        visible = y.view()
        visible.flags.writeable = False
        value = self.f(t, visible, *self.arguments(member))
        return self.check(value, t, visible)

    def at_members(self, t: Array, members: Any, y: Points) -> Array:
        """Return the coefficients of several members, shape ``(n, dim)``, after checking them."""
        t.flags.writeable = y.flags.writeable = False
        try:
            value = self.f(t, y, *self.arguments(members))
        except Exception as error:
            error.add_note(self.note(float(t[0])))
            raise
        return self.check(value, t, y, members=members)


def context_of(
    function: Any, args: tuple[Any, ...], frame: Frame, shape: tuple[int, ...], check: Any,
    of_time: bool = False,
) -> tuple[Any, ...]:  # fmt: skip
    """Return what ``fortran/interface/python_field.c`` reads to call a function."""
    with_input = isinstance(function, WithInput)
    if with_input:
        function, args = function.function, (args[0].at_times(), *args[1:])
    rest = frame.point_shape, frame.dtype.num, shape, check, [None], of_time, with_input
    return function, args, *rest


def when(t: Any) -> str:
    """Return the time of a call, or the first of many times, for a message."""
    return f"t = {np.atleast_1d(t)[0]:.17g}"
