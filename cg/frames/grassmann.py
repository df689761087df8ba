"""Grassmann manifolds: subspaces of R^n."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.base import Sized
from cg.frames.block_kinds import Blocks
from cg.frames.isospectral import Orbit
from cg.frames.logarithms import rotation_log1p
from cg.frames.matrix_functions import eigh_where_finite, random_unitary
from cg.frames.matrix_group import MatrixGroup
from cg.frames.so import SO
from cg.support.arrays import Array, Points, Size, check_random
from cg.support.checks import check_integer
from cg.support.shared_numbers import BlockKind


@dataclass(frozen=True, repr=False)
class Grassmann(Sized, Orbit):
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

    k: int

    smallest: ClassVar[int] = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "k", check_integer("k", self.k, 1, self.n - 1))

    @cached_property
    def group(self) -> MatrixGroup:
        """The rotations of the ambient space."""
        return SO(self.n, "space")

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
        # those of the geodesic: two reflections turn by twice the principal angles
        turn = 2.0 * (y1 - y0) @ (2.0 * y0 - np.eye(self.n))
        finite = np.isfinite(turn).all(axis=(-2, -1), keepdims=True)
        return self.group._algebra_projection(0.5 * rotation_log1p(np.where(finite, turn, 0.0)))

    def _project(self, y: Points) -> Points:
        values, vectors = np.linalg.eigh(0.5 * (y + y.mT))
        basis = vectors[..., self.n - self.k :]
        unique = values[..., self.n - self.k] > values[..., self.n - self.k - 1]
        return np.where(unique[..., None, None], basis @ basis.mT, np.nan)

    def distance(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return the root of the sum of the squared principal angles, shape ``(...)``."""
        with np.errstate(invalid="ignore"):
            difference = self._points(x, "x") - self._points(y)
        # The eigenvalues are plus and minus the sines of the principal angles.
        sines = eigh_where_finite(difference)[0][..., -min(self.k, self.n - self.k) :]
        return np.asarray(np.linalg.norm(np.arcsin(np.clip(sines, 0.0, 1.0)), axis=-1))

    def random_point(self, rng: np.random.Generator, size: Size = ()) -> Points:
        """Return subspaces uniform under rotations, shape ``(*size, n, n)``."""
        size = check_random(rng, size)
        basis = random_unitary(rng, (*size, self.n, self.k))
        return self.restore(basis @ basis.mT)
