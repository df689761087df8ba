"""Symmetric positive definite matrices, and symmetric or Hermitian ones with given eigenvalues."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.base import SizedFrame
from cg.frames.blocks import Blocks
from cg.frames.homogeneous import ConjugationSpace
from cg.frames.manifold import MEMBERSHIP_TOLERANCE
from cg.frames.matrix_functions import eigh_where_finite, two_norm
from cg.frames.matrix_group import MatrixGroup
from cg.frames.matrix_groups import GL, SU
from cg.frames.rotations import SO
from cg.support.arrays import Array, Points, Size, check_random, number_array, real_array
from cg.support.checks import check_flag
from cg.support.shared_numbers import BlockKind


@dataclass(frozen=True, repr=False)
class SPD(SizedFrame, ConjugationSpace):
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
    eigenvalues of :math:`x^{-1} y` [1]_. Singular matrices, at distance zero from the
    manifold, are accepted as points; flows keep their rank.

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

    def restore(self, y: Points) -> Points:
        """Return the symmetric part of ``y``."""
        return np.asarray(0.5 * (y + y.mT))

    def _coefficients_at(self, y: Points, tangent: Points) -> Array:
        # The generator of least norm is x y, where a symmetric x solves x y^2 + y^2 x = y'.
        values, vectors = eigh_where_finite(y)
        row, column = values[..., :, None], values[..., None, :]
        slope = (tangent + tangent.mT) / 2
        # Points of stages may be singular or not finite. No square of a tiny eigenvalue may vanish.
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            larger = np.maximum(row, column)
            row, column = row / larger, column / larger
            x = (vectors.mT @ slope @ vectors) / larger * (column / (row**2 + column**2))
        return self.group._algebra_projection(vectors @ x @ vectors.mT)

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
        # The geodesic has half the logarithm of y1 y0^-1.
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


class Orbit(ConjugationSpace):
    """Symmetric or Hermitian matrices with the same eigenvalues, given in increasing order."""

    @property
    @abstractmethod
    def _eigenvalues(self) -> Array: ...

    def membership_error(self, y: ArrayLike) -> Array:
        """Return the larger of the skew part's norm and the eigenvalues' error, shape ``(...)``.

        By Weyl's inequality the latter is the 2-norm distance of the symmetric part from the
        orbit.
        """
        point = self._points(y)
        with np.errstate(invalid="ignore"):
            symmetric, skew = (0.5 * (point + sign * point.mT.conj()) for sign in (1.0, -1.0))
        eigenvalues, _ = eigh_where_finite(symmetric)
        error = np.abs(eigenvalues - self._eigenvalues).max(axis=-1)
        return np.asarray(np.maximum(two_norm(skew), error))

    def _project(self, y: Points) -> Points:
        # The eigenvectors of the symmetric part give the nearest matrix with these eigenvalues, by
        # the Hoffman-Wielandt inequality. It is not unique where eigenvalues coincide whose
        # prescribed values differ.
        values, vectors = np.linalg.eigh(0.5 * (y + y.mT.conj()))
        rounding = y.shape[-1] * np.finfo(np.float64).eps
        close, prescribed = (
            np.diff(x) <= rounding * np.abs(x).max(axis=-1)[..., None]
            for x in (values, self._eigenvalues)
        )
        unique = (~close | prescribed).all(axis=-1)
        return np.where(unique[..., None, None], self._with_eigenvectors(vectors), np.nan)

    def _with_eigenvectors(self, vectors: Points) -> Points:
        product = (vectors * self._eigenvalues) @ vectors.mT.conj()
        return np.asarray(0.5 * (product + product.mT.conj()))


@dataclass(frozen=True, repr=False)
class IsospectralOrbit(Orbit):
    r"""Matrices with given eigenvalues, with the action :math:`y \mapsto e^{\Omega} y e^{-\Omega}`.

    The fields are :math:`y' = [\Omega(v), y]`: real symmetric matrices with the skew
    :math:`\Omega` of `SO`, as in Toda's and Brockett's flows, or Hermitian matrices with the
    traceless skew-Hermitian :math:`\Omega` of `SU`, as for a density matrix.

    Parameters
    ----------
    spectrum
        The real eigenvalues, at least two, in any order; they are stored in increasing order.
    hermitian
        Whether the points are complex.

    Notes
    -----
    After each flow the eigenvalues of the result are replaced by ``spectrum``, to remove rounding
    errors. There are no `exp_coordinates`: for close eigenvalues they would be large even for
    points nearby.

    References
    ----------
    .. [1] M. P. Calvo, A. Iserles, A. Zanna, "Numerical solution of isospectral flows", Math.
       Comp. 66 (1997), 1461-1486.

    Examples
    --------
    >>> import numpy as np
    >>> y0 = np.array([[1.0, 1.0], [1.0, 1.0]])
    >>> frame = IsospectralOrbit.through(y0)
    >>> frame.flow([np.pi / 4], y0).round(15) + 0.0
    array([[0., 0.],
           [0., 2.]])
    """

    spectrum: tuple[float, ...]
    hermitian: bool = field(default=False, kw_only=True)

    def __post_init__(self) -> None:
        values = real_array(self.spectrum, "spectrum")
        if values.ndim != 1 or len(values) < 2 or not np.isfinite(values).all():
            raise ValueError(
                f"spectrum must be at least two finite real numbers, got {self.spectrum!r}"
            )
        object.__setattr__(self, "hermitian", check_flag("hermitian", self.hermitian))
        object.__setattr__(self, "spectrum", tuple(sorted(values.tolist())))

    @classmethod
    def through(cls, y0: ArrayLike) -> IsospectralOrbit:
        """Return the orbit of a matrix, symmetric, or Hermitian if complex, ``(n, n)``."""
        point = number_array(y0, "y0")
        if point.ndim != 2 or point.shape[0] != point.shape[1] or not np.isfinite(point).all():
            raise ValueError(f"y0 must be a finite square matrix, got {y0!r}")
        largest = np.abs(point).max(initial=0.0)
        if np.abs(point - point.mT.conj()).max(initial=0.0) > MEMBERSHIP_TOLERANCE * largest:
            raise ValueError(f"y0 must be symmetric, or Hermitian if complex, got {y0!r}")
        frame = cls(tuple(np.linalg.eigvalsh(point).tolist()), hermitian=np.iscomplexobj(point))
        frame.check_point(point, name="y0")
        return frame

    @cached_property
    def group(self) -> MatrixGroup:
        """The rotations, or special unitary matrices, that act by conjugation."""
        n = len(self.spectrum)
        return SU(n, "space") if self.hermitian else SO(n, "space")

    @cached_property
    def _eigenvalues(self) -> Array:
        return np.array(self.spectrum)

    @property
    def dtype(self) -> np.dtype[Any]:
        """Complex where ``hermitian``."""
        return self.group.dtype

    def _blocks(self) -> Blocks | None:
        if self.hermitian:
            return None
        return ((BlockKind.ISOSPECTRAL, len(self.spectrum), 0, *self.spectrum),)

    def restore(self, y: Points) -> Points:
        """Return ``y`` with the eigenvalues replaced by ``spectrum``."""
        finite = np.isfinite(y).all(axis=(-2, -1), keepdims=True)
        _, vectors = np.linalg.eigh(np.where(finite, y, np.eye(len(self.spectrum))))
        return np.where(finite, self._with_eigenvectors(vectors), y)

    def _coefficients_at(self, y: Points, tangent: Points) -> Array:
        # In eigenvectors entry (i, j) of the tangent is that of the generator times the gap.
        gaps = self._eigenvalues - self._eigenvalues[:, None]
        rounding = len(gaps) * np.finfo(np.float64).eps * np.abs(self._eigenvalues).max()
        apart = np.abs(gaps) > rounding
        weights = np.divide(1.0, gaps, out=np.zeros_like(gaps), where=apart)
        _, vectors = eigh_where_finite(y)
        generator = weights * (vectors.mT.conj() @ tangent @ vectors)
        return self.group._algebra_projection(vectors @ generator @ vectors.mT.conj())

    def relative_error(self, y: ArrayLike) -> Array:
        """Return the membership error divided by the largest eigenvalue, shape ``(...)``."""
        return np.asarray(self.membership_error(y) / (np.abs(self.spectrum).max() or 1.0))

    def random_point(self, rng: np.random.Generator, size: Size = ()) -> Points:
        """Return the spectrum in uniformly distributed orthonormal bases."""
        return self._with_eigenvectors(self.group.random_point(rng, size))
