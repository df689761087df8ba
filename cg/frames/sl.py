"""The special linear groups SL(n)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.entries import Entries, entries_of
from cg.frames.matrix_group_kinds import NoncompactMatrixGroup
from cg.support.arrays import Array, Points


@dataclass(frozen=True, repr=False)
class SL(NoncompactMatrixGroup):
    r"""Real matrices of determinant 1.

    The coefficients are the entries of :math:`\Omega`, row by row, except the last one, which
    follows from the zero trace.

    Parameters
    ----------
    n
        Number of rows, at least 2.

    Notes
    -----
    The exponential is ``scipy.linalg.expm``. Each flow ends with the step of least norm towards
    determinant 1, which is no larger than the rounding errors of the matrix.

    Examples
    --------
    >>> import numpy as np
    >>> SL(2).flow([np.log(2.0), 0.0, 0.0], np.eye(2)).round(15)
    array([[2. , 0. ],
           [0. , 0.5]])
    """

    smallest: ClassVar[int] = 2

    @property
    def dim(self) -> int:
        return self.n**2 - 1

    def _make_basis(self) -> Entries:
        rows, columns = np.divmod(np.arange(self.n**2 - 1), self.n)
        corner = np.full_like(rows, self.n - 1)
        diagonal = np.where(rows == columns, -1.0, 0.0)
        ones = np.ones(len(rows))
        return entries_of(self.n, (rows, columns, ones), (corner, corner, diagonal))

    def _explain_distance(self, matrix: Points) -> str:
        return f"; its trace {np.trace(matrix):.3g} must be zero; other matrices need GL({self.n})"

    def _correction(self, y: Points) -> Points:
        # To first order it is a multiple of the gradient, the matrix of cofactors. The singular
        # value decomposition gives it without cancellation or overflow.
        left, singular, right = np.linalg.svd(y)
        # Where the sign depends on rounding, the change is no larger than rounding.
        sign = np.where(np.linalg.det(y) < 0.0, -1.0, 1.0)
        smallest = singular[..., -1:]
        # Singular values below rounding are replaced by the rounding, to avoid division by them.
        others = np.maximum(singular, np.finfo(np.float64).eps * singular[..., :1])
        # The cofactors, products of all singular values but one, relative to the largest one
        cofactors = smallest / others
        cofactors[..., -1] = 1.0
        excess = smallest - sign[..., None] / others[..., :-1].prod(axis=-1, keepdims=True)
        change = (-excess / np.vecdot(cofactors, cofactors)[..., None]) * cofactors
        return np.asarray((left * change[..., None, :]) @ right)

    def membership_error(self, y: ArrayLike) -> Array:
        r"""Return :math:`|\det y - 1| / n`, shape ``(...)``.

        To first order this is the smallest 2-norm of a matrix :math:`\delta` with
        :math:`y = x (I + \delta)` for a point :math:`x`.
        """
        return np.asarray(np.abs(np.linalg.det(self._points(y)) - 1.0) / self.n)
