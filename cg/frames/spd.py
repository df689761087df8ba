"""Symmetric positive definite matrices."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.base import Sized
from cg.frames.gl import GL
from cg.frames.homogeneous import ConjugationSpace
from cg.frames.matrix_functions import eigh_where_finite
from cg.frames.matrix_group import MatrixGroup
from cg.support.arrays import Array, Points, Size, check_random


@dataclass(frozen=True, repr=False)
class SPD(Sized, ConjugationSpace):
    r"""Symmetric positive definite matrices, such as covariances, with the action of GL(n).

    GL(n) acts by :math:`y \mapsto g\,y\,g^T`, so that :math:`y' = \Omega(v)\,y + y\,\Omega(v)^T`,
    and the flow is :math:`e^\Omega y\, e^{\Omega^T}`: positive definite whatever the step. The
    coefficients are the entries of :math:`\Omega`, those of `GL`.

    Parameters
    ----------
    n
        Number of rows.

    Notes
    -----
    `distance` is the affine-invariant one, the root of the sum of :math:`\ln^2 \lambda_i` over the
    eigenvalues of :math:`x^{-1} y` [1]_.

    References
    ----------
    .. [1] X. Pennec, P. Fillard, N. Ayache, "A Riemannian framework for tensor computing", Int. J.
       Comput. Vision 66 (2006), 41-66.

    Examples
    --------
    A covariance that grows along one axis:

    >>> import numpy as np
    >>> SPD(2).flow([np.log(2.0), 0.0, 0.0, 0.0], np.eye(2))
    array([[4., 0.],
           [0., 1.]])
    """

    @cached_property
    def group(self) -> MatrixGroup:
        """The invertible matrices."""
        return GL(self.n, "space")

    @property
    def point_shape(self) -> tuple[int, ...]:
        return (self.n, self.n)

    def restore(self, y: Points) -> Points:
        """Return the symmetric part of ``y``."""
        return np.asarray(0.5 * (y + y.mT))

    def _coefficients_at(self, y: Points, tangent: Points) -> Array:
        # Those of least norm are x y with a symmetric x that solves x y^2 + y^2 x = y'.
        values, vectors = eigh_where_finite(y)
        row, column = values[..., :, None], values[..., None, :]
        slope = (tangent + tangent.mT) / 2
        # Points of stages may be singular or not finite. No square of a tiny eigenvalue may vanish.
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            larger = np.maximum(row, column)
            row, column = row / larger, column / larger
            solved = (vectors.mT @ slope @ vectors) / larger * (column / (row**2 + column**2))
        return self.group._algebra_projection(vectors @ solved @ vectors.mT)

    def membership_error(self, y: ArrayLike) -> Array:
        """Return the larger of the asymmetry and the negative of the least eigenvalue."""
        point = self._points(y)
        with np.errstate(invalid="ignore"):
            lowest = eigh_where_finite(self.restore(point))[0][..., 0]
            asymmetry = np.abs(point - point.mT).max(axis=(-2, -1))
        return np.asarray(np.maximum(asymmetry, -lowest))

    def relative_error(self, y: ArrayLike) -> Array:
        """Return the membership error relative to the largest entry, shape ``(...)``."""
        size = np.abs(self._points(y)).max(axis=(-2, -1))
        return np.asarray(self.membership_error(y) / np.where(size > 0.0, size, 1.0))

    def _project(self, y: Points) -> Points:
        return self.restore(y)

    def distance(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return the affine-invariant distance, shape ``(...)``; NaN off the manifold."""
        start, end = np.broadcast_arrays(self._points(x, "x"), self._points(y))
        return np.asarray(np.linalg.norm(_log_ratios(start, end)[0], axis=-1))

    def _first_coordinates(self, y0: Points, y1: Points) -> Array:
        # those of the geodesic: half the logarithm of y1 y0^-1
        logarithms, vectors, inverse = _log_ratios(y0, y1)
        with np.errstate(invalid="ignore", over="ignore"):
            generator = vectors @ (0.5 * logarithms[..., None] * inverse)
        return self.group._algebra_projection(generator)

    def random_point(self, rng: np.random.Generator, size: Size = ()) -> Points:
        """Return matrices with normal factors, and eigenvalues of at least 1/4."""
        size = check_random(rng, size)
        factor = rng.standard_normal((*size, self.n, self.n)) / np.sqrt(self.n)
        return self.restore(factor @ factor.mT + 0.25 * np.eye(self.n))


def _log_ratios(x: Points, y: Points) -> tuple[Array, Points, Points]:
    """Return logarithms of the eigenvalues of y x^-1, the eigenvectors, and their inverse.

    They are NaN off the manifold.
    """
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        values, axes = eigh_where_finite(x)
        roots = np.sqrt(values)[..., None, :]
        scaled = axes / roots
        # Eigenvalues of x^-1 y - I, from the difference to avoid cancellation
        change = scaled.mT @ (y - x) @ scaled
        ratios, turn = eigh_where_finite(0.5 * (change + change.mT))
        return np.log1p(ratios), (axes * roots) @ turn, (scaled @ turn).mT
