"""User-defined frames: members of `Frame` that are functions of the user."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.base import Frame
from cg.support.arrays import Array, Points, Size, check_random, complex_array, real_array

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
        self,
        name: str,
        function: Function,
        arguments: list[tuple[Points, int]],
        shape: tuple[int, ...],
        dtype: Any = np.float64,
    ) -> Points:
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
        function = self._functions.get(name)
        if function is None:
            return None
        rank = len(self.point_shape)
        dtype = self.dtype if name in ("restore", "project") else np.float64
        return self._call(name, function, [(p, rank) for p in points], shape, dtype)

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
        return (
            np.zeros(point.shape[: point.ndim - len(self.point_shape)]) if error is None else error
        )

    def distance(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return the user's distances, by default the Euclidean ones."""
        distance = self._evaluate("distance", (), self._points(x, "x"), self._points(y))
        return super().distance(x, y) if distance is None else distance

    def exp_coordinates(self, y0: ArrayLike, y1: ArrayLike) -> Array | None:
        """Return the user's coordinates, by default None."""
        points = self._points(y0, "y0"), self._points(y1, "y1")
        return self._evaluate("exp_coordinates", (self.dim,), *points)

    def random_point(self, rng: np.random.Generator, size: Size = ()) -> Points:
        """Return points from the user's function, or normal ones where all arrays are points."""
        size = check_random(rng, size)
        function = self._functions.get("random_point")
        if function is not None:
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
