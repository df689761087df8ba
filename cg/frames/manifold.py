"""Points of a manifold that is embedded in arrays: their shape, checks, projection, distance."""

from __future__ import annotations

from abc import ABC, abstractmethod
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.support.arrays import Array, Points, Size, check_name, complex_array, is_array, real_array

MEMBERSHIP_TOLERANCE = 1e-8
_NEAR = 10.0  # error of points of which messages say that they may be projected


class Manifold(ABC):
    """A manifold embedded in arrays of one shape, real or complex."""

    @property
    @abstractmethod
    def point_shape(self) -> tuple[int, ...]:
        """Shape of the array that holds one point."""

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of a point's entries: float64, or complex128."""
        return np.dtype(np.float64)

    @abstractmethod
    def membership_error(self, y: ArrayLike) -> Array:
        """Return the distance of ``y`` from the manifold, shape ``(...)``."""

    def relative_error(self, y: ArrayLike) -> Array:
        """Return the membership error relative to the size of the points, shape ``(...)``.

        By default it is the membership error itself, as for rotations, which have size one.
        """
        return self.membership_error(y)

    def state_error(self, y: ArrayLike) -> Array:
        """Return the relative error of points that are states, as far as these have conditions."""
        return self.relative_error(y)

    def project(self, y: ArrayLike) -> Points:
        """Return the points of the manifold that are nearest to arrays near it.

        `check_point` rejects points that were stored in single precision; their projections are
        accepted.

        Parameters
        ----------
        y
            Shape ``(..., *point_shape)``.

        Returns
        -------
        ndarray
            Of type ``dtype``, shape ``(..., *point_shape)``; NaN where the nearest point does not
            exist or is not unique, as for zero and a sphere.

        Raises
        ------
        NotImplementedError
            If the frame does not define a projection.
        ValueError
            If a matrix for a group of rotations has no positive determinant, as left-handed axes.
        """
        point = self._points(y)
        rows = point.reshape(-1, *self.point_shape)
        axes = tuple(range(1, rows.ndim))
        valid = np.asarray(np.isfinite(rows).all(axis=axes))
        projected = np.full(rows.shape, np.nan, dtype=self.dtype)
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            projected[valid] = self._project(rows[valid])
            valid = np.asarray(np.isfinite(projected).all(axis=axes))
            valid[valid] = self.relative_error(projected[valid]) <= MEMBERSHIP_TOLERANCE
        projected[~valid] = np.nan
        return projected.reshape(point.shape)

    def _project(self, y: Points) -> Points:
        """Return the nearest points to finite arrays, shape ``(count, *point_shape)``."""
        raise NotImplementedError(f"{self!r} has no projection onto its manifold")

    @abstractmethod
    def random_point(self, rng: np.random.Generator, size: Size = ()) -> Points:
        """Return random points, shape ``(*size, *point_shape)``.

        Parameters
        ----------
        rng
            Random generator, such as ``numpy.random.default_rng(seed)``.
        size
            The leading axes; an integer is one axis.
        """

    def distance(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return the distance of points, shape ``(...)``; by default the Euclidean distance."""
        difference = self._points(x, "x") - self._points(y)
        axes = tuple(range(-len(self.point_shape), 0))
        return np.asarray(np.sqrt((np.abs(difference) ** 2).sum(axis=axes)))

    def read_points(self, value: Any, name: str = "y") -> Points:
        """Convert points to a new C-ordered array of type ``dtype``.

        Neither the shape nor the membership is checked. Errors call the argument ``name``. Some
        frames also accept other representations, such as ``Rotation`` of SciPy.
        """
        check_name(name)
        return (real_array if self.dtype.kind == "f" else complex_array)(value, name)

    def check_point(
        self, y: ArrayLike, *, tolerance: float = MEMBERSHIP_TOLERANCE, name: str = "y"
    ) -> Points:
        """Return ``y`` as a new array of type ``dtype`` after checking that it is one point.

        ValueError if it isn't numeric (real, unless points are complex), has another shape, isn't
        finite or has a larger `state_error` than ``tolerance``; it calls the argument ``name``.
        """
        check_name(name)
        if isinstance(tolerance, bool) or not isinstance(tolerance, Real) or not tolerance >= 0.0:
            raise ValueError(f"tolerance must be a non-negative number, got {tolerance!r}")
        point = self.read_points(y, name)
        if point.shape != self.point_shape:
            raise ValueError(
                f"{name} must have shape {self.point_shape}, got {point.shape}"
                f"{self._shape_hint(point.shape)}"
            )
        if not np.isfinite(point).all():
            raise ValueError(f"{name} must be finite, got {point}")
        error = float(self.state_error(point))
        if not error <= tolerance:
            relative = "" if error == self.membership_error(point) else "relative "
            why = self._reason(point)
            if not why and error < _NEAR:  # else it isn't this point that was meant
                why = self._projection_hint(point, name)
            raise ValueError(
                f"{name} must be a point of {self}: its {relative}distance from the manifold is "
                f"{error:.3g}, more than {tolerance:.3g}{why}"
            )
        return point

    def _shape_hint(self, shape: tuple[int, ...]) -> str:
        """Return a hint for the message about a point of another shape."""
        return ""

    def _reason(self, point: Points) -> str:
        """Return what is known about why a point is off the manifold, for a message."""
        return ""

    def _projection_hint(self, point: Points, name: str) -> str:
        """Return a hint to use `project`, for the message about a point off the manifold."""
        try:
            nearest = self.project(point)
        except NotImplementedError:
            return ""
        except ValueError as error:
            return f"; {error}"
        if not np.isfinite(nearest).all() or self.relative_error(nearest) > MEMBERSHIP_TOLERANCE:
            return ""
        argument = "it" if "(" in name else name.partition("[")[0]
        return f"; frame.project({argument}) is the nearest point"

    def _points(self, y: ArrayLike, name: str = "y") -> Points:
        """Return ``y`` as an array of type ``dtype`` whose trailing axes are ``point_shape``."""
        points: Points = y if is_array(y, self.dtype) else self.read_points(y, name)
        shape = self.point_shape
        if points.shape[max(points.ndim - len(shape), 0) :] != shape:
            axes = ", ".join(map(str, shape))
            raise ValueError(f"{name} must have shape (..., {axes}), got {points.shape}")
        return points
