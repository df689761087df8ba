"""User-defined frames: fields and members of `Frame` that are functions of the user."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.base import Frame
from cg.support.arrays import Array, Points, Size, check_random, complex_array, real_array
from cg.support.checks import check_integer

Function = Callable[..., Any]


class UserFrame(Frame):
    """A frame with members that are functions of the user.

    The functions are called with single points, also for batches, and their results are checked.
    """

    _functions: dict[str, Function]

    def _store_functions(self, **functions: Function | None) -> None:
        for name, function in functions.items():
            if function is not None and not callable(function):
                raise TypeError(f"{name} must be a function or None, got {function!r}")
        present = {name: function for name, function in functions.items() if function is not None}
        object.__setattr__(self, "_functions", present)

    def _key(self) -> tuple[Any, ...]:
        """Return the values that equal frames share."""
        return (self.point_shape, self.dtype, tuple(sorted(self._functions.items())))

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and other._key() == self._key()

    def __hash__(self) -> int:
        return hash(self._key())

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"a {type(self).__name__} is immutable: {name} can't be set")

    def _call(
        self, name: str, function: Function, arguments: list[tuple[Points, int]],
        shape: tuple[int, ...], dtype: Any = np.float64,
    ) -> Points:  # fmt: skip
        """Call ``function`` for every entry of a batch, and stack the results.

        Each of ``arguments`` is an array with the number of trailing axes of one argument;
        ``shape`` and ``dtype`` are those of one result.
        """
        leads = [a.shape[: a.ndim - axes] for a, axes in arguments]
        lead = np.broadcast_shapes(*leads)
        spread = [np.broadcast_to(a, lead + a.shape[a.ndim - axes :]) for a, axes in arguments]
        result = np.empty(lead + shape, dtype=dtype)
        convert = complex_array if result.dtype.kind == "c" else real_array
        for index in np.ndindex(lead):
            value = convert(function(*(a[index] for a in spread)), f"the value of {name}")
            if value.shape != shape:
                raise ValueError(f"{name} must return shape {shape}, got shape {value.shape}")
            result[index] = value
        return result

    def _evaluate(self, name: str, shape: tuple[int, ...], *points: Points) -> Points | None:
        """Return the results of the user's function of that name, None if there is none."""
        if (function := self._functions.get(name)) is None:
            return None
        axes = len(self.point_shape)
        dtype = self.dtype if name in ("restore", "project") else np.float64
        return self._call(name, function, [(p, axes) for p in points], shape, dtype)

    def restore(self, y: Points) -> Points:
        """Return ``y`` after the user's ``restore``, if there is one."""
        restored = self._evaluate("restore", self.point_shape, y)
        return y if restored is None else restored

    def _project(self, y: Points) -> Points:
        projected = self._evaluate("project", self.point_shape, y)
        if projected is not None:
            return projected
        if "membership_error" in self._functions:
            raise NotImplementedError(f"{self!r} has a membership_error, but no project")
        return y

    def membership_error(self, y: ArrayLike) -> Array:
        """Return the user's errors; by default zeros, since every array is a point."""
        point = self._points(y)
        error = self._evaluate("membership_error", (), point)
        zeros = np.zeros(point.shape[: point.ndim - len(self.point_shape)])
        return zeros if error is None else error

    def exp_coordinates(self, y0: ArrayLike, y1: ArrayLike) -> Array | None:
        """Return the user's coordinates, by default None."""
        points = self._points(y0, "y0"), self._points(y1, "y1")
        return self._evaluate("exp_coordinates", (self.dim,), *points)

    def random_point(self, rng: np.random.Generator, size: Size = ()) -> Points:
        """Return points from the user's function, or normal ones where all arrays are points."""
        size = check_random(rng, size)
        if (function := self._functions.get("random_point")) is not None:
            # A batch of empty arguments, so that the function is called once for each point.
            empty = np.empty((*size, 0))
            return self._call(
                "random_point", lambda _: function(rng), [(empty, 1)], self.point_shape, self.dtype
            )
        if "membership_error" in self._functions:
            raise NotImplementedError(f"{self!r} has a membership_error, but no random_point")
        normal = rng.standard_normal((*size, *self.point_shape))
        if self.dtype.kind == "c":
            return normal + 1j * rng.standard_normal(normal.shape)
        return normal


class FieldFrame(UserFrame):
    r"""Vector fields given as functions, together with the flow of their combinations.

    Parameters
    ----------
    fields
        Functions ``E(y)`` of one point that return a tangent.
    flow
        Function ``flow(v, y)`` of coefficients of shape ``(m,)`` and one point that returns the
        time-1 flow of :math:`\sum_i v_i E_i` through it.
    point_shape
        Shape of a point, an integer for vectors.
    dtype
        ``float`` or ``complex``, the type of a point's entries.
    membership_error
        Function of one point that returns its distance from the manifold. Without it every
        array is a point.
    restore
        Function that returns a point without rounding errors normal to the manifold; called after
        each flow.
    project
        Function of an array near the manifold that returns the nearest point.
    exp_coordinates
        Function of two points that returns ``v`` with ``flow(v, y0) == y1``.
    random_point
        Function of a random generator that returns one point.
    bracket
        Function ``bracket(u, v)`` that returns the coefficients of the commutator, see
        `Frame.bracket`. Munthe-Kaas methods need it unless there is only one field.

    Notes
    -----
    Functions are called with one point at a time, in a loop over batches. Use `check` to verify
    that ``flow`` and the other functions are consistent with ``fields``.

    Examples
    --------
    The hyperbolas ``y[0] * y[1] == constant``:

    >>> import numpy as np
    >>> squeeze = FieldFrame(
    ...     [lambda y: np.array([y[0], -y[1]])],
    ...     lambda v, y: np.array([y[0] * np.exp(v[0]), y[1] * np.exp(-v[0])]),
    ...     point_shape=2,
    ... )
    >>> squeeze.flow([np.log(2.0)], [1.0, 1.0])
    array([2. , 0.5])
    """

    _fields: tuple[Function, ...]
    _flow: Function
    _point_shape: tuple[int, ...]
    _dtype: np.dtype[Any]

    def __init__(
        self, fields: Sequence[Function], flow: Function, *, point_shape: int | Sequence[int],
        dtype: Any = float, membership_error: Function | None = None,
        restore: Function | None = None, project: Function | None = None,
        exp_coordinates: Function | None = None, random_point: Function | None = None,
        bracket: Function | None = None,
    ) -> None:  # fmt: skip
        if callable(fields) or not np.iterable(fields):
            raise TypeError(f"fields must be a sequence of functions, got {fields!r}")
        functions = tuple(fields)
        if not functions:
            raise ValueError("fields must hold at least one function, got none")
        named = {f"fields[{i}]": function for i, function in enumerate(functions)}
        for name, value in {**named, "flow": flow}.items():
            if not callable(value):
                raise TypeError(f"{name} must be a function, got {value!r}")
        lengths = point_shape if np.iterable(point_shape) else (point_shape,)
        shape = tuple(check_integer("point_shape", length, 1) for length in lengths)
        kinds = (float, complex, np.float64, np.complex128)
        if not isinstance(dtype, type | np.dtype) or dtype not in kinds:
            raise ValueError(f"dtype must be float or complex, got {dtype!r}")
        vars(self).update(_fields=functions, _flow=flow, _point_shape=shape, _dtype=np.dtype(dtype))
        self._store_functions(
            membership_error=membership_error, restore=restore, project=project,
            exp_coordinates=exp_coordinates, random_point=random_point, bracket=bracket,
        )  # fmt: skip

    def __repr__(self) -> str:
        names = ", ".join(getattr(f, "__name__", repr(f)) for f in self._fields)
        return f"FieldFrame([{names}], point_shape={self._point_shape})"

    def _key(self) -> tuple[Any, ...]:
        return (*super()._key(), self._fields, self._flow)

    @property
    def dim(self) -> int:
        return len(self._fields)

    @property
    def point_shape(self) -> tuple[int, ...]:
        return self._point_shape

    @property
    def dtype(self) -> np.dtype[Any]:
        return self._dtype

    def _bracket(self, u: Array, v: Array) -> Array:
        if self.dim == 1:
            return np.zeros(np.broadcast_shapes(u.shape, v.shape))
        if (function := self._functions.get("bracket")) is None:
            raise NotImplementedError(
                f"{self!r} has no bracket: if its fields span a Lie algebra, pass "
                "FieldFrame(..., bracket=...)"
            )
        return self._call("bracket", function, [(u, 1), (v, 1)], (self.dim,))

    def field(self, v: ArrayLike, y: ArrayLike) -> Points:
        vector, point = self._arguments(v, y)
        axes = len(self._point_shape)
        tangent = np.zeros((), dtype=self.dtype)
        for i, function in enumerate(self._fields):
            arguments = [(point, axes)]
            value = self._call(f"fields[{i}]", function, arguments, self.point_shape, self.dtype)
            coefficient = vector[..., i].reshape(vector.shape[:-1] + (1,) * axes)
            tangent = tangent + coefficient * value
        return tangent

    def flow(self, v: ArrayLike, y: ArrayLike) -> Points:
        vector, point = self._arguments(v, y)
        arguments = [(vector, 1), (point, len(self._point_shape))]
        moved = self._call("flow", self._flow, arguments, self.point_shape, self.dtype)
        return self.restore(moved)
