"""Isospectral orbits: symmetric or Hermitian matrices with given eigenvalues."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.block_kinds import Blocks
from cg.frames.homogeneous import ConjugationSpace
from cg.frames.manifold import MEMBERSHIP_TOLERANCE
from cg.frames.matrix_functions import eigh_where_finite, two_norm
from cg.frames.matrix_group import MatrixGroup
from cg.frames.so import SO
from cg.frames.su import SU
from cg.support.arrays import Array, Points, Size, complex_array, is_complex_array, real_array
from cg.support.shared_numbers import BlockKind


class Orbit(ConjugationSpace):
    """Symmetric or Hermitian matrices with the same eigenvalues, given in increasing order."""

    @property
    @abstractmethod
    def _eigenvalues(self) -> Array: ...

    @property
    def point_shape(self) -> tuple[int, ...]:
        return self.group.point_shape

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
        if not isinstance(self.hermitian, bool):
            raise ValueError(f"hermitian must be True or False, got {self.hermitian!r}")
        object.__setattr__(self, "spectrum", tuple(sorted(values.tolist())))

    @classmethod
    def through(cls, y0: ArrayLike) -> IsospectralOrbit:
        """Return the orbit of a matrix, symmetric, or Hermitian if complex, ``(n, n)``."""
        is_complex = is_complex_array(y0)
        point: Points = complex_array(y0, "y0") if is_complex else real_array(y0, "y0")
        if point.ndim != 2 or point.shape[0] != point.shape[1] or not np.isfinite(point).all():
            raise ValueError(f"y0 must be a finite square matrix, got {y0!r}")
        largest = np.abs(point).max(initial=0.0)
        if np.abs(point - point.mT.conj()).max(initial=0.0) > MEMBERSHIP_TOLERANCE * largest:
            raise ValueError(f"y0 must be symmetric, or Hermitian if complex, got {y0!r}")
        frame = cls(tuple(np.linalg.eigvalsh(point).tolist()), hermitian=is_complex)
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
        apart = (
            np.abs(gaps) > len(gaps) * np.finfo(np.float64).eps * np.abs(self._eigenvalues).max()
        )
        weights = np.divide(1.0, gaps, out=np.zeros_like(gaps), where=apart)
        _, vectors = eigh_where_finite(y)
        turned = weights * (vectors.mT.conj() @ tangent @ vectors)
        return self.group._algebra_projection(vectors @ turned @ vectors.mT.conj())

    def _project(self, y: Points) -> Points:
        # The eigenvectors of the symmetric part give the nearest matrix with these eigenvalues, by
        # the Hoffman-Wielandt inequality. It is not unique where eigenvalues coincide whose
        # prescribed values differ.
        symmetric, n = 0.5 * (y + y.mT.conj()), len(self.spectrum)
        close, prescribed = (
            np.diff(values) <= n * np.finfo(np.float64).eps * np.abs(values).max(axis=-1)[..., None]
            for values in (np.linalg.eigvalsh(symmetric), self._eigenvalues)
        )
        unique = (~close | prescribed).all(axis=-1)
        return np.where(unique[..., None, None], self.restore(symmetric), np.nan)

    def _with_eigenvectors(self, vectors: Points) -> Points:
        product = (vectors * self._eigenvalues) @ vectors.mT.conj()
        return np.asarray(0.5 * (product + product.mT.conj()))

    def relative_error(self, y: ArrayLike) -> Array:
        """Return the membership error divided by the largest eigenvalue, shape ``(...)``."""
        return np.asarray(self.membership_error(y) / (np.abs(self.spectrum).max() or 1.0))

    def random_point(self, rng: np.random.Generator, size: Size = ()) -> Points:
        """Return the spectrum in uniformly distributed orthonormal bases."""
        return self._with_eigenvectors(self.group.random_point(rng, size))
