"""The rotation groups SO(n), as matrices."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.block_kinds import Blocks, convention_option
from cg.frames.entries import Entries, entries_of
from cg.frames.logarithms import rotation_log1p
from cg.frames.matrix_group import MAX_DENSE
from cg.frames.matrix_group_kinds import SizedMatrixGroup, UnitaryMatrixGroup
from cg.frames.rotations import is_rotation
from cg.support.arrays import Array, Convention, Points
from cg.support.shared_numbers import BlockKind

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation


@dataclass(frozen=True, repr=False)
class SO(UnitaryMatrixGroup, SizedMatrixGroup):
    r"""Rotations of :math:`R^n`: orthogonal matrices of determinant 1.

    The coefficients are the entries :math:`(-1)^{i+j+1}\,\Omega_{ji}` of the skew matrix
    :math:`\Omega` for all pairs :math:`i < j`, the last pair first. With these signs the
    coefficients of ``SO(3)`` are the rotation vector, as for `SO3`, and that of ``SO(2)`` is the
    angle.

    Parameters
    ----------
    n
        Number of rows, at least 2.

    Notes
    -----
    The exponential is a closed form for n = 2 and 3, and computed as for `U` otherwise. Every pair
    of points has `exp_coordinates`: a closed form there too, otherwise from the real Schur form.
    Each flow ends with a step towards the group that removes rounding errors [1]_.

    References
    ----------
    .. [1] N. J. Higham, *Functions of Matrices*, SIAM, 2008, section 8.3.

    Examples
    --------
    >>> import numpy as np
    >>> SO(4).dim
    6
    >>> SO(2).flow([np.pi / 2], np.eye(2)).round(15) + 0.0
    array([[ 0., -1.],
           [ 1.,  0.]])
    """

    convention: Convention = "body"

    smallest: ClassVar[int] = 2
    _special: ClassVar[bool] = True

    @property
    def dim(self) -> int:
        return self.n * (self.n - 1) // 2

    def _make_basis(self) -> Entries:
        i, j = (indices[::-1] for indices in np.triu_indices(self.n, 1))
        sign = np.where((i + j) % 2, 1.0, -1.0)
        return entries_of(self.n, (j, i, sign), (i, j, -sign))

    # Right-hand sides convert a matrix at each stage; for many rows this is faster than products
    # with sparse matrices.
    @cached_property
    def _places(self) -> tuple[Any, Any, Array]:
        """The places of the entries of all coefficients below and above the diagonal, and signs."""
        entries = self._make_basis()
        below, above = entries.places.reshape(2, -1)
        return below, above, entries.values[: self.dim]

    def _combine(self, v: Array) -> Points:
        if self.n <= MAX_DENSE:
            return super()._combine(v)
        below, above, signs = self._places
        flat = np.zeros((*v.shape[:-1], self.n**2))
        flat[..., below] = signs * v
        flat[..., above] = -signs * v
        return flat.reshape(*v.shape[:-1], *self.point_shape)

    def _algebra_projection(self, matrices: Points) -> Array:
        if self.n <= MAX_DENSE:
            return super()._algebra_projection(matrices)
        below, above, signs = self._places
        flat = matrices.reshape(*matrices.shape[:-2], self.n**2)
        return np.asarray(0.5 * signs * (flat.take(below, -1) - flat.take(above, -1)))

    def _log1p(self, difference: Points) -> Array:
        # Angles are at most pi.
        if self.n == 2:
            sine = difference[..., 1, 0] - difference[..., 0, 1]
            cosine = 2.0 + np.trace(difference, axis1=-2, axis2=-1)
            return np.asarray(np.arctan2(sine, cosine)[..., None])
        return self._algebra_projection(rotation_log1p(difference))

    @property
    def _rotation_sign(self) -> float:
        return self._side if self.n == 3 else 0.0

    def _blocks(self) -> Blocks | None:
        kind = BlockKind.SO3 if self.n == 3 else BlockKind.SO
        return ((kind, self.n, convention_option(self.convention)),)

    def read_points(self, value: Any, name: str = "y") -> Points:
        """Return arrays of numbers, and for n = 3 the matrices of ``Rotation`` of SciPy."""
        if self.n == 3 and is_rotation(value):
            return np.array(value.as_matrix(), dtype=np.float64, order="C")
        return super().read_points(value, name)

    def as_rotation(self, y: ArrayLike) -> Rotation:
        """Return a point or a stack, n = 3 only, as ``scipy.spatial.transform.Rotation``."""
        if self.n != 3:
            raise ValueError(f"as_rotation requires n = 3, got {self!r}")
        from scipy.spatial.transform import Rotation

        return Rotation.from_matrix(np.array(self._points(y)))  # SciPy 1.15 wants it writeable
