"""Subspaces of R^n, the Grassmann manifolds, and their orthonormal bases, the Stiefel manifolds."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.base import CompiledFlow, Frame, SizedFrame
from cg.frames.blocks import Blocks
from cg.frames.homogeneous import HomogeneousSpace
from cg.frames.matrix_functions import eigh_where_finite, random_unitary, rotation_log1p
from cg.frames.matrix_group import MatrixGroup
from cg.frames.orthonormal import OrthonormalColumns
from cg.frames.rotations import SO
from cg.frames.symmetric import Orbit
from cg.support.arrays import Array, Points, Size, check_random
from cg.support.checks import check_integer
from cg.support.shared_numbers import BlockKind


@dataclass(frozen=True, repr=False)
class _Subspaces(SizedFrame):
    """A manifold of k-dimensional subspaces of R^n, or of bases of them."""

    k: int

    min_n: ClassVar[int] = 2
    _codimension: ClassVar[int] = 0  # the smallest one

    def __post_init__(self) -> None:
        super().__post_init__()
        largest = self.n - self._codimension
        object.__setattr__(self, "k", check_integer("k", self.k, 1, largest))

    @cached_property
    def group(self) -> MatrixGroup:
        """The rotations of the ambient space."""
        return SO(self.n, "space")


class _Columns(_Subspaces, OrthonormalColumns):
    @property
    def point_shape(self) -> tuple[int, ...]:
        return (self.n, self.k)


@dataclass(frozen=True, repr=False)
class Stiefel(_Columns, HomogeneousSpace):
    r"""Matrices of k orthonormal columns, with the action of SO(n): :math:`y' = \Omega(v)\,y`.

    The coefficients are those of `SO`.

    Parameters
    ----------
    n
        Number of rows, at least 2.
    k
        Number of columns, from 1 to ``n``.

    Notes
    -----
    The flow is that of `SO`, followed by a Newton-Schulz step towards the polar factor [1]_.
    There are no `exp_coordinates`: the rotation between two points is not unique, and the one
    of least norm has no closed form.

    Right-hand sides that return derivatives (``rhs="derivative"``) move the columns along other
    fields, in :math:`n k^2` operations a flow in place of :math:`n^3`, and without brackets: for
    many rows, also for subspaces, by an orthonormal basis. Derivatives of solutions, and methods
    with brackets that are given, need the fields of this frame and take them.

    References
    ----------
    .. [1] N. J. Higham, *Functions of Matrices*, SIAM, 2008, section 8.3.

    Examples
    --------
    >>> import numpy as np
    >>> frame = Stiefel(5, 2)
    >>> y = frame.flow(np.arange(10.0), np.eye(5, 2))
    >>> bool(frame.membership_error(y) < 1e-15)
    True
    """

    def _act(self, x: Points, y: Points) -> Points:
        return np.asarray(x @ y)

    def _act_infinitesimally(self, omega: Points, y: Points) -> Points:
        return self._act(omega, y)

    def _coefficients_at(self, y: Points, tangent: Points) -> Array:
        return self.group._algebra_projection(min_norm_generator(y, tangent))

    def for_derivatives(self) -> Frame:
        return LowRankStiefel(self.n, self.k)


def min_norm_generator(y: Points, tangent: Points) -> Points:
    """Return the skew matrix of least norm whose product with y is a tangent X.

    It is X y^T - y X^T - y (y^T X) y^T, since y^T X is skew. The arrays may be those of JAX.
    """
    mixed = y.mT @ tangent
    along = 0.5 * (mixed - mixed.mT)
    left = (tangent - y @ mixed + 0.5 * (y @ along)) @ y.mT
    generator: Points = left - left.mT
    return generator


@dataclass(frozen=True, repr=False)
class LowRankStiefel(CompiledFlow, _Columns):
    r"""The fields that move columns along derivatives in :math:`n k^2` operations a flow.

    The coefficients are the entries of a matrix v, row by row, with the fields :math:`y' = v - y
    v^T y`; those of a derivative X are :math:`v = X - \tfrac12 y\,y^T X` [1]_. The flow is that of
    a matrix of rank 2k, which acts by linear fractional transformations:
    :math:`y \mapsto x z^{-1}` with

    .. math::

        z = \cosh\sqrt m + s\,a, \quad x = y + v\,(s + d\,a), \quad a = v^T y,\ m = v^T v,
        \quad s = \frac{\sinh\sqrt m}{\sqrt m},\ d = \frac{\cosh\sqrt m - 1}{m} .

    The fields do not span a Lie algebra, so that there are no brackets.

    References
    ----------
    .. [1] E. Celledoni, B. Owren, "On the implementation of Lie group methods on the Stiefel
       manifold", Numer. Algorithms 32 (2003), 163-183.
    """

    @property
    def dim(self) -> int:
        return self.n * self.k

    def _blocks(self) -> Blocks | None:
        return ((BlockKind.STIEFEL, self.n, 0, self.k),)

    def _coefficients_at(self, y: Points, tangent: Points) -> Array:
        v = np.asarray(tangent - 0.5 * (y @ (y.mT @ tangent)))
        return v.reshape(*v.shape[:-2], self.dim)

    def field(self, v: ArrayLike, y: ArrayLike) -> Points:
        vector, point = self._arguments(v, y)
        matrix = vector.reshape(*vector.shape[:-1], *self.point_shape)
        return np.asarray(matrix - point @ (matrix.mT @ point))


@dataclass(frozen=True, repr=False)
class Grassmann(_Subspaces, Orbit):
    r"""Subspaces of dimension k of :math:`R^n`, with the action of SO(n).

    A point is the orthogonal projector on the subspace, a symmetric matrix :math:`P = P^2` of rank
    k: ``basis @ basis.T`` for any matrix ``basis`` of orthonormal columns that span it. The
    field is :math:`P' = \Omega(v) P - P\,\Omega(v)`, with the coefficients of `SO`.

    Parameters
    ----------
    n
        Dimension of the ambient space, at least 2.
    k
        Dimension of the subspaces, from 1 to ``n - 1``.

    Notes
    -----
    The flow is :math:`e^\Omega P e^{-\Omega}`, and a last step :math:`3 P^2 - 2 P^3` towards the
    projectors, which removes rounding errors [1]_. `distance` is the root of the sum of the
    squares of the principal angles.

    References
    ----------
    .. [1] R. McWeeny, "Some recent advances in density matrix theory", Rev. Mod. Phys. 32 (1960),
       335-369.

    Examples
    --------
    The plane of the first two axes turns about the first one.

    >>> import numpy as np
    >>> frame = Grassmann(3, 2)
    >>> frame.flow([np.pi / 2, 0.0, 0.0], np.diag([1.0, 1.0, 0.0])).round(12) + 0.0
    array([[1., 0., 0.],
           [0., 0., 0.],
           [0., 0., 1.]])
    """

    _codimension: ClassVar[int] = 1

    @cached_property
    def _eigenvalues(self) -> Array:
        return np.repeat([0.0, 1.0], [self.n - self.k, self.k])

    def _blocks(self) -> Blocks | None:
        return ((BlockKind.ISOSPECTRAL, self.n, 0, self._eigenvalues),)

    def restore(self, y: Points) -> Points:
        """Return ``y`` after a step towards the projectors."""
        symmetric = 0.5 * (y + y.mT)
        square = symmetric @ symmetric
        return np.asarray(3.0 * square - 2.0 * square @ symmetric)

    def _coefficients_at(self, y: Points, tangent: Points) -> Array:
        return self.group._algebra_projection(tangent @ y - y @ tangent)

    def _first_coordinates(self, y0: Points, y1: Points) -> Array:
        # Two reflections turn by twice the angles of the geodesic, the principal ones.
        turn = 2.0 * (y1 - y0) @ (2.0 * y0 - np.eye(self.n))
        finite = np.isfinite(turn).all(axis=(-2, -1), keepdims=True)
        return self.group._algebra_projection(0.5 * rotation_log1p(np.where(finite, turn, 0.0)))

    def distance(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return the root of the sum of the squared principal angles, shape ``(...)``."""
        with np.errstate(invalid="ignore"):
            difference = self._points(x, "x") - self._points(y)
        # The eigenvalues are plus and minus the sines of the principal angles.
        sines = eigh_where_finite(difference)[0][..., -min(self.k, self.n - self.k) :]
        return np.asarray(np.linalg.norm(np.arcsin(np.clip(sines, 0.0, 1.0)), axis=-1))

    def random_point(self, rng: np.random.Generator, size: Size = ()) -> Points:
        """Return subspaces uniform under rotations, shape ``(*size, n, n)``."""
        basis = random_unitary(rng, (*check_random(rng, size), self.n, self.k))
        return self.restore(basis @ basis.mT)
