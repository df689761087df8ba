"""The special linear groups SL(n)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.arrays import Array, Points
from cg.frames.matrix_functions import (
    corrected,
    determinant_correction,
    relative_length,
    shortest_step,
)
from cg.frames.matrix_group import SizedMatrixGroup


@dataclass(frozen=True, repr=False)
class SL(SizedMatrixGroup):
    r"""Real matrices of determinant 1.

    The coefficients are the entries of :math:`\Omega`, row by row, without the last one, which
    makes the trace zero.

    Parameters
    ----------
    n
        Number of rows, at least 2.
    convention
        ``"space"``: :math:`y' = \Omega\,y` (default), ``"body"``: :math:`y' = y\,\Omega`.

    Raises
    ------
    ValueError
        If ``n`` or ``convention`` is impossible.

    Notes
    -----
    The exponential is ``scipy.linalg.expm``.  Each flow ends with the shortest step towards
    determinant 1, which is no longer than rounding of the matrix, however large that is.

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
        """``n ** 2 - 1``."""
        return self.n**2 - 1

    def _make_basis(self) -> Points:
        basis = np.eye(self.n * self.n)[:-1].reshape(-1, self.n, self.n)
        for i in range(self.n - 1):
            basis[i * (self.n + 1), -1, -1] = -1.0
        return basis

    def restore(self, y: Points) -> Points:
        """Return ``y`` after the shortest Newton step towards determinant 1."""
        return shortest_step(y, determinant_correction)

    def _project(self, y: Points) -> Points:
        # Nearest in the Frobenius norm, to the second order of the distance.
        return corrected(y, determinant_correction)

    def membership_error(self, y: ArrayLike) -> Array:
        r"""Return :math:`|\det y - 1| / n`, shape ``(...)``.

        To first order this is the smallest 2-norm of a matrix :math:`\delta` with
        :math:`y = x (I + \delta)` for a point :math:`x`.
        """
        return np.asarray(np.abs(np.linalg.det(self._points(y)) - 1.0) / self.n)

    def relative_error(self, y: ArrayLike) -> Array:
        """Return the length of the shortest step to the group, relative to that of ``y``.

        Of large matrices the determinant is rounding, however well they are known.
        """
        return relative_length(self._points(y), determinant_correction)
