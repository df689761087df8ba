"""The interface of a rigid frame: vector fields whose linear combinations have known flows."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

MEMBERSHIP_TOLERANCE = 1e-8


class Frame(ABC):
    r"""Vector fields :math:`E_1, \dots, E_m` on a manifold embedded in real arrays.

    A differential equation is written in the frame as
    :math:`y' = \sum_i f_i(t, y) E_i(y)` (equation (1.1) of [1]_), and a numerical method moves
    along flows of :math:`y' = \sum_i v_i E_i(y)` with constant :math:`v` (equation (1.2)).

    A subclass is immutable, compares by value, and supplies the members marked abstract; that is
    all an integrator asks of it.  Every method works on single points and on batches: ``v`` has
    shape ``(..., dim)``, ``y`` has shape ``(..., *point_shape)``, and leading axes broadcast.

    References
    ----------
    .. [1] Z. Jackiewicz, A. Marthinsen, B. Owren, "Construction of Runge-Kutta methods of
       Crouch-Grossman type of high order", Adv. Comput. Math. 13 (2000), 405-415.
    """

    @property
    @abstractmethod
    def dim(self) -> int:
        """Number of vector fields, the length of ``v``."""

    @property
    @abstractmethod
    def point_shape(self) -> tuple[int, ...]:
        """Shape of the array that holds one point."""

    @abstractmethod
    def field(self, v: ArrayLike, y: ArrayLike) -> Array:
        r"""Return the tangent :math:`\sum_i v_i E_i(y)`, shape ``(..., *point_shape)``."""

    @abstractmethod
    def flow(self, v: ArrayLike, y: ArrayLike) -> Array:
        r"""Return the time-1 flow of :math:`\sum_i v_i E_i` through ``y``.

        Raises
        ------
        ValueError
            If the trailing axes of ``v`` or ``y`` don't match ``dim`` and ``point_shape``.
        """

    @abstractmethod
    def membership_error(self, y: ArrayLike) -> Array:
        """Return the distance of ``y`` from the manifold, shape ``(...)``."""

    @abstractmethod
    def distance(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return the distance between points of the manifold, shape ``(...)``."""

    @abstractmethod
    def random_point(self, rng: np.random.Generator, size: tuple[int, ...] = ()) -> Array:
        """Return random points, shape ``(*size, *point_shape)``."""

    def random_vector(self, rng: np.random.Generator, size: tuple[int, ...] = ()) -> Array:
        """Return standard normal coefficients, shape ``(*size, dim)``."""
        return rng.standard_normal((*size, self.dim))

    def check_point(
        self, y: ArrayLike, *, tolerance: float = MEMBERSHIP_TOLERANCE, name: str = "y"
    ) -> Array:
        """Return ``y`` as a new float64 array after checking that it is one point.

        Parameters
        ----------
        y
            The candidate, shape ``point_shape``.
        tolerance
            Largest accepted membership error.
        name
            What to call the argument in an error message.

        Raises
        ------
        ValueError
            If ``y`` is not real, has another shape, is not finite or lies off the manifold.
        """
        point = real_array(y, name)
        if point.shape != self.point_shape:
            raise ValueError(f"{name} must have shape {self.point_shape}, got {point.shape}")
        if not np.isfinite(point).all():
            raise ValueError(f"{name} must be finite, got {point}")
        off = float(self.membership_error(point))
        if not off <= tolerance:
            raise ValueError(
                f"{name} must be a point of {self}: its distance from the manifold is {off:.3g}, "
                f"more than {tolerance:.3g}"
            )
        return point

    def _arguments(self, v: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
        """Return ``v`` and ``y`` as float64 arrays whose trailing axes fit this frame."""
        vector = np.asarray(v, dtype=np.float64)
        if vector.ndim == 0 or vector.shape[-1] != self.dim:
            raise ValueError(f"v must have shape (..., {self.dim}), got {vector.shape}")
        return vector, self._points(y)

    def _points(self, y: ArrayLike, name: str = "y") -> Array:
        """Return ``y`` as a float64 array whose trailing axes are ``point_shape``."""
        points = np.asarray(y, dtype=np.float64)
        shape = self.point_shape
        if points.shape[max(points.ndim - len(shape), 0) :] != shape:
            wanted = ", ".join(map(str, shape))
            raise ValueError(f"{name} must have shape (..., {wanted}), got {points.shape}")
        return points


def real_array(value: Any, name: str) -> Array:
    """Return ``value`` as a new C-ordered float64 array; ValueError if it isn't real numbers."""
    try:
        raw = np.asarray(value)
        if raw.dtype.kind not in "biufO":
            raise TypeError(f"dtype {raw.dtype}")
        return np.array(raw, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must be an array of real numbers, got {value!r}") from error
