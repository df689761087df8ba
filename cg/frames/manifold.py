"""Points of a manifold that is embedded in arrays, and local coordinates by Gauss-Newton steps."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.support.arrays import Array, Points, Size, complex_array, is_array, real_array
from cg.support.checks import check_name, check_real

FLOAT64 = np.dtype(np.float64)
MEMBERSHIP_TOLERANCE = 1e-8
_PROJECTABLE = 10.0  # largest error of a point for which a message suggests `project`


class Manifold(ABC):
    """A manifold embedded in arrays of one shape, real or complex."""

    @property
    @abstractmethod
    def point_shape(self) -> tuple[int, ...]:
        """Shape of the array that holds one point."""

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of a point's entries: float64, or complex128."""
        return FLOAT64

    @abstractmethod
    def membership_error(self, y: ArrayLike) -> Array:
        """Return the distance of ``y`` from the manifold, shape ``(...)``."""

    def relative_error(self, y: ArrayLike) -> Array:
        """Return the membership error relative to the size of the points, shape ``(...)``.

        By default it is the membership error itself, as for rotations, which have size one.
        """
        return self.membership_error(y)

    def state_error(self, y: ArrayLike) -> Array:
        """Return the relative error of points, and of the conditions that `PhaseSpace` adds."""
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
        tolerance = check_real("tolerance", tolerance, infinite=True)
        point = self.read_points(y, name)
        if point.shape != self.point_shape:
            raise ValueError(f"{name} must have shape {self.point_shape}, got {point.shape}")
        if not np.isfinite(point).all():
            raise ValueError(f"{name} must be finite, got {point}")
        error = float(self.state_error(point))
        if not error <= tolerance:
            relative = "" if error == self.membership_error(point) else "relative "
            why = self._reason(point)
            if not why and error < _PROJECTABLE:  # a point farther away is probably another mistake
                why = self._projection_hint(point, name)
            raise ValueError(
                f"{name} must be a point of {self}: its {relative}distance from the manifold is "
                f"{error:.3g}, more than {tolerance:.3g}{why}"
            )
        return point

    def _reason(self, point: Points) -> str:
        """Return what is known about why a point is off the manifold, for a message."""
        return ""

    def _projection_hint(self, point: Points, name: str) -> str:
        """Return a hint to use `project`, for the message about a point off the manifold."""
        try:
            nearest = self.project(point)
        except NotImplementedError:
            return ""
        except ValueError as error:  # about ``y``, as `project` calls the point
            return f"; {name} {str(error).removeprefix('y ')}"
        if not np.isfinite(nearest).all() or self.relative_error(nearest) > MEMBERSHIP_TOLERANCE:
            return ""
        return f"; frame.project({name}) is the nearest point"

    def _points(self, y: ArrayLike, name: str = "y") -> Points:
        """Return ``y`` as an array of type ``dtype`` whose trailing axes are ``point_shape``."""
        points: Points = y if is_array(y, self.dtype) else self.read_points(y, name)
        shape = self.point_shape
        if points.shape[max(points.ndim - len(shape), 0) :] != shape:
            axes = ", ".join(map(str, shape))
            raise ValueError(f"{name} must have shape (..., {axes}), got {points.shape}")
        return points


Flow = Callable[[Array, Points], Points]
# Coefficients after one step of the iteration, from those before, the start, the point that they
# reach, the end, and where the derivative of the flow is used
Correction = Callable[[Array, Points, Points, Points, Array], Array]

# Singular values of a matrix of fields below this fraction of the largest count as zero.
_RANK_TOLERANCE = 1e-12
# Corrections by the fields shrink by a factor of about |v|. Where that is slow, Newton's method
# with the derivative of the flow takes over. Where it fails too, corrections lead to a point on the
# way to the end, by halves; where the nearest doesn't help, the points are too far apart.
_MAX_CORRECTIONS = 40
_SLOW = 0.1
_MIN_FRACTION = 1 / 64  # least fraction of the way
_FAR = 1e9  # largest norm of coefficients
# Relative residuals: of convergence (some twenty roundings), of a slow iteration that stops, and of
# an accepted result, at most
_REACHED, _ROUGH, _MISSED = 5e-15, 1e-14, 1e-8


def local_coordinates(
    flow: Flow, correct: Correction, guess: Array, start: Points, end: Points
) -> Array:
    """Return coefficients whose flow takes points to others near them, NaN where that fails.

    Points have the shape ``(count, *point_shape)``, coefficients ``(count, dim)``. The guess is
    replaced by zero where zero has a smaller residual.
    """
    v = np.nan_to_num(guess, posinf=0.0, neginf=0.0)
    y = start
    if v.any():
        y = flow(v, start)
        # The logarithm of points that are large and close may have no correct digits.
        lost = ~(norms(end - y) <= norms(end - start))
        if lost.any():
            v[lost] = 0.0
            y = np.where(lost.reshape(-1, *(1,) * (y.ndim - 1)), start, y)
    length, distance = norms(end), norms(end - y)
    v[~np.isfinite(distance)] = np.nan
    guessed = (v != 0.0).any(axis=-1)
    active = np.flatnonzero(distance > np.where(guessed, _REACHED * length, 0.0))
    reached, residual = y[active], distance[active]
    exact, fraction = np.zeros(len(active), dtype=bool), np.ones(len(active))
    for _ in range(_MAX_CORRECTIONS):
        if not len(active):
            break
        lead = fraction.reshape(-1, *(1,) * (y.ndim - 1))
        target = np.where(lead < 1.0, reached + lead * (end[active] - reached), end[active])
        candidate = correct(v[active], start[active], reached, target, exact)
        # Coefficients that diverge are reset; their residual doesn't decrease.
        far = ~(np.linalg.norm(candidate, axis=-1) < _FAR)
        candidate[far] = v[active[far]]
        moved = flow(candidate, start[active])
        size = norms(end[active] - moved)
        rough = residual > _ROUGH * length[active]
        better = size < np.where(rough, 1.0 - _SLOW * fraction, 0.5) * residual
        v[active[better]], reached[better] = candidate[better], moved[better]
        # Switch to the derivative of the flow where the fields at the end converge slowly.
        slow = ~(size < _SLOW * residual) & rough
        residual[better] = distance[active[better]] = size[better]
        fraction = np.where(
            better, np.minimum(2.0 * fraction, 1.0), np.where(exact, 0.5 * fraction, fraction)
        )
        unfinished = better | (slow & (fraction >= _MIN_FRACTION))
        active, reached, residual = active[unfinished], reached[unfinished], residual[unfinished]
        exact, fraction = (exact | slow)[unfinished], fraction[unfinished]
    v[distance > _MISSED * length] = np.nan
    return v


def usable_or_zero(v: Array) -> Array:
    """Return coefficients, zero where they aren't finite or too large for a flow."""
    v = np.nan_to_num(v, posinf=0.0, neginf=0.0)
    v[~(np.linalg.norm(v, axis=-1) < _FAR)] = 0.0
    return v


def norms(points: Points) -> Array:
    """Return the Euclidean norms of points, shape ``(count,)``."""
    rows = points.reshape(len(points), math.prod(points.shape[1:]))
    return np.asarray(np.linalg.norm(rows, axis=-1))


def minimum_norm_coefficients(
    fields: Points, tangent: Points, tolerance: float = _RANK_TOLERANCE
) -> Array:
    """Return the least-squares coefficients of minimum norm of tangents in given fields.

    Fields have the shape ``(count, dim, *point_shape)``, tangents ``(count, *point_shape)``.
    Singular values below ``tolerance`` times the largest one count as zero.
    """
    size = math.prod(fields.shape[2:])
    rows = np.ascontiguousarray(fields).reshape(*fields.shape[:2], size).view(np.float64)
    right = np.ascontiguousarray(tangent).reshape(len(tangent), size).view(np.float64)
    finite = np.asarray(np.isfinite(rows).all(axis=(1, 2)))[:, None]
    rows = np.where(finite[..., None], rows, 0.0)  # the SVD fails for non-finite entries
    inverse = np.linalg.pinv(rows.mT, rcond=tolerance)
    return np.where(finite, (inverse @ right[..., None])[..., 0], np.nan)
