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

Coefficients = Callable[..., ArrayLike]
_JOIN = "; join parts by np.concatenate"
_COMPLEX = "; the real and the imaginary part of a complex drive are coefficients of two fields"


class StageOverflowError(OverflowError):
    """A stage exceeds the range of floating point, which isn't an error of ``f``."""


class StepTooLongError(ArithmeticError):
    """A step of a method on a Lie algebra reached coordinates beyond the radius of dexp⁻¹.

    Rotations reach it after a full turn.  An adaptive step is tried again with a smaller size;
    with fixed steps a smaller ``h`` is needed.

    Examples
    --------
    >>> import numpy as np
    >>> import cg
    >>> try:
    ...     cg.integrate(
    ...         lambda t, y: [0.0, 9.0, 9.0 * y[0, 0]], (0, 2), np.eye(3), frame=cg.frames.SO3(),
    ...         method="RKMK4", h=1.0,
    ...     )
    ... except cg.StepTooLongError as error:
    ...     print(str(error)[:46])
    the step from t = 0 is too long for a method o
    """

    def __init__(self, t: float) -> None:
        super().__init__(t)
        self.t = t

    def __str__(self) -> str:
        return (
            f"the step from t = {self.t:.17g} is too long for a method on a Lie algebra: "
            "coordinates of a stage are beyond the radius of dexp⁻¹, for rotations a full turn; "
            "take a smaller h, or a method that needs no brackets"
        )


class PythonRhs:
    """A right-hand side ``f(t, y, *args)``, or ``f(t, y, *args, parameters)``, in Python.

    Compiled code calls it through a function in C, whose data are the contexts made here.

    Parameters
    ----------
    f
        Returns the coefficients, shape ``(dim,)``; it receives a read-only ``y`` of shape
        ``point_shape``.
    frame
        The frame of the points.
    args
        Further arguments.
    parameters
        Parameters of each member, shape ``(members, k)``, or None.
    vectorized
        Whether ``f`` takes times ``(n,)`` and points ``(n, *point_shape)`` of several members,
        with the rows of their parameters, and returns shape ``(n, dim)``.  A function of time may
        get several times for one point.
    """

    def __init__(
        self,
        f: Coefficients,
        frame: Frame,
        args: tuple[Any, ...] = (),
        parameters: Array | None = None,
        vectorized: bool = False,
    ) -> None:
        self.f = f
        self.frame = frame
        self.args = args
        self.parameters = parameters
        self.vectorized = vectorized
        self._spare = [None]
        self.set_args(args)

    first: int | None = None
    """The place of the first member in the ensemble for error messages, None without one."""

    name = "f"
    """Its name in error messages."""

    def set_args(self, args: tuple[Any, ...]) -> None:
        """Replace the further arguments."""
        self.args = args
        frame, of_time = self.frame, isinstance(self.f, TimeFunction)
        f = self.f.a if isinstance(self.f, TimeFunction) else self.f
        point = frame.point_shape, frame.dtype.num
        rest = *point, (frame.rhs_dim,), self.check, self._spare, of_time
        if self.parameters is None or self.vectorized:
            self._contexts = [(f, args, *rest)]
        else:
            self._contexts = [(f, (*args, row), *rest) for row in self.parameters]
            self._pointers = np.array([id(context) for context in self._contexts])

    def arguments(self, member: int) -> tuple[Any, ...]:
        """Return the further arguments of a member."""
        if self.parameters is None:
            return self.args
        return (*self.args, self.parameters[member])

    def addresses(self) -> tuple[int, int, int]:
        """Return the addresses of the function and of the first member's data, and their stride."""
        import cg._core_r64 as core

        field, member, _ = core.function_addresses()
        if self.parameters is None or self.vectorized:
            return field, self.data_address, 0
        return member, self.data_address, 8

    @property
    def data_address(self) -> int:
        """Address of the first member's data, which changes with the further arguments."""
        if self.parameters is None or self.vectorized:
            return id(self._contexts[0])
        return int(self._pointers.ctypes.data)

    def part(self, members: slice) -> PythonRhs:
        """Return the right-hand side of some of the members."""
        own = None if self.parameters is None else self.parameters[members]
        part = PythonRhs(self.f, self.frame, self.args, own, self.vectorized)
        part.first = (self.first or 0) + members.start
        return part

    def note(self, t: float, member: int = 0) -> str:
        """Return a note to an exception at ``t`` in a member, which says how ``f`` is called."""
        count = len(self.args) + (self.parameters is not None)
        which, shape = "", str(self.frame.point_shape)
        if self.vectorized:
            shape = f"{('k', *self.frame.point_shape)}, and t of shape (k,)".replace("'", "")
        elif self.first is not None:
            which = f" in member {self.first + member}"
        extra = f", and {count} further arguments" if count else ""
        of_time = self._takes(1 + count) and not self._takes(2 + count)
        hint = "; for an f of time alone see cg.solve_linear" if of_time else ""
        return (
            f"at t = {t:.17g}{which}; f is given (t, y, ...) with y of shape {shape}{extra}{hint}"
        )

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
        own = () if self.parameters is None else (self.parameters[members],)
        try:
            value = self.f(t, y, *self.args, *own)
        except Exception as error:
            error.add_note(self.note(float(t[0])))
            raise
        return self.check(value, t, y, members=members)

    def check(self, value: Any, t: Any, y: Points, members: Any = None) -> Array:
        """Return what ``f(t, y)`` returned as an array, shape ``(dim,)`` or ``(n, dim)``.

        ValueError is raised if it has another shape, or isn't finite numbers although ``y`` is;
        compiled code detects points that aren't finite. ``members`` of a vectorized function are
        named in errors.
        """
        shape: tuple[int, ...] = (self.frame.rhs_dim,)
        if self.vectorized:
            shape = (len(t), *shape)
        try:
            # a copy, since f may return the same buffer each time
            coefficients = real_array(value, "f")
        except ValueError as error:
            expected = (
                f"an array of shape {shape}" if self.vectorized else f"{shape[0]} real numbers"
            )
            join = isinstance(value, list | tuple) and any(map(np.ndim, value))
            hint = _JOIN if join else conversion_hint(value, error)
            hint = _COMPLEX if not hint and is_complex_array(value) else hint
            raise ValueError(
                f"f must return {expected}, got {value!r} at {when(t)}{hint}"
            ) from error
        if coefficients.shape != shape:
            got = "None" if value is None else f"shape {coefficients.shape}"
            each = "time" if isinstance(self.f, TimeFunction) else "member"
            together = f", a row for each {each}, since vectorized=True" if self.vectorized else ""
            raise ValueError(
                f"f must return an array of shape {shape}{together}, got {got} at {when(t)}"
                f"{self._hint(coefficients.shape[len(shape) - 1 :])}"
            )
        # a finite sum means that all terms are finite, and takes a fraction of the time
        if not math.isfinite(coefficients.sum()) and not np.isfinite(coefficients).all():
            rows = y.reshape(len(y) if self.vectorized else 1, -1)
            wrong = np.isfinite(rows).all(axis=1) & ~np.isfinite(
                coefficients.reshape(-1, self.frame.rhs_dim)
            ).all(axis=1)
            if wrong.any():
                got = f"{coefficients} at {when(t)}"
                if self.vectorized:
                    worst, *others = np.flatnonzero(wrong).tolist()
                    got = f"{coefficients[worst]} at {when(t[worst])}"
                    if members is not None:
                        got += f" for member {(self.first or 0) + members[worst]}"
                        got += f" and {len(others)} more" if others else ""
                raise ValueError(f"f must return finite numbers, got {got}")
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


def when(t: Any) -> str:
    """Return the time of a call, or the first of many times, for a message."""
    return f"t = {np.atleast_1d(t)[0]:.17g}"
