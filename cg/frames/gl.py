"""The general linear groups GL(n)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.entries import Entries
from cg.frames.matrix_functions import singular_values
from cg.frames.matrix_group_kinds import SizedMatrixGroup
from cg.support.arrays import Array, Points


@dataclass(frozen=True, repr=False)
class GL(SizedMatrixGroup):
    r"""Invertible real matrices.

    The coefficients are the entries of :math:`\Omega`, row by row.

    Parameters
    ----------
    n
        Number of rows, at least 1.

    Notes
    -----
    The exponential is ``scipy.linalg.expm``. Two points have `exp_coordinates` where their
    quotient has no eigenvalue on the negative real axis.

    Examples
    --------
    >>> import numpy as np
    >>> GL(2).flow([0.0, 1.0, 0.0, 0.0], np.eye(2))
    array([[1., 1.],
           [0., 1.]])
    """

    @property
    def dim(self) -> int:
        return self.n**2

    def _make_basis(self) -> Entries:
        places = np.arange(self.n**2)
        return Entries(places, places, np.ones(len(places)))

    def _project(self, y: Points) -> Points:
        # A singular matrix has no nearest invertible one.
        return y

    def membership_error(self, y: ArrayLike) -> Array:
        """Return zero for invertible matrices, infinity for numerically singular ones."""
        singular = singular_values(self._points(y))
        smallest = self.n * np.finfo(np.float64).eps * singular[..., 0]
        return np.where(singular[..., -1] > smallest, 0.0, np.inf)
