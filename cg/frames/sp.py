"""The real symplectic groups Sp(2n)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.entries import Entries, entries_of
from cg.frames.matrix_functions import symplectic_correction, two_norm
from cg.frames.matrix_group_kinds import NoncompactMatrixGroup
from cg.support.arrays import Array, Points


@dataclass(frozen=True, repr=False)
class Sp(NoncompactMatrixGroup):
    r"""Real symplectic matrices: :math:`y^T J y = J`, :math:`J = \binom{\;0\;\;I}{-I\;0}`.

    The Lie algebra consists of the matrices :math:`\Omega = J S` with symmetric :math:`S`, those of
    linear Hamiltonian systems with energy :math:`\tfrac12 x^T S x`. The coefficients are the
    entries of :math:`S` on and above the diagonal, row by row.

    Parameters
    ----------
    n
        Number of rows, even: ``Sp(2)``, ``Sp(4)``, ...

    Notes
    -----
    The exponential is ``scipy.linalg.expm``. Each flow ends with the step of least norm towards
    the group, which is no larger than the rounding errors of the matrix.

    Examples
    --------
    A harmonic oscillator, after a quarter of its period:

    >>> import numpy as np
    >>> Sp(2).flow(np.pi / 2 * np.array([1.0, 0.0, 1.0]), np.eye(2)).round(15) + 0.0
    array([[ 0.,  1.],
           [-1.,  0.]])
    """

    smallest: ClassVar[int] = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.n % 2:
            raise ValueError(f"n must be even, got {self.n!r}")

    @cached_property
    def _form(self) -> Array:
        half = self.n // 2
        return np.asarray(np.kron([[0.0, 1.0], [-1.0, 0.0]], np.eye(half)), dtype=np.float64)

    @property
    def dim(self) -> int:
        return self.n * (self.n + 1) // 2

    def _make_basis(self) -> Entries:
        # The form times symmetric matrices: it moves a row to another one, with a sign.
        half = self.n // 2
        i, j = np.triu_indices(self.n)
        below = np.where(i == j, 0.0, 1.0)
        parts = [
            (np.where(row < half, row + half, row - half), column, np.where(row < half, -1.0, 1.0))
            for row, column in ((i, j), (j, i))
        ]
        return entries_of(self.n, parts[0], (*parts[1][:2], below * parts[1][2]))

    def inverse(self, x: ArrayLike) -> Points:
        return np.asarray(-self._form @ self._points(x, "x").mT @ self._form)

    def _correction(self, y: Points) -> Points:
        return symplectic_correction(y, self._form)

    def membership_error(self, y: ArrayLike) -> Array:
        r"""Return :math:`\tfrac12 \|y^* y - I\|_2`, shape ``(...)``.

        To first order this is the smallest 2-norm of a matrix :math:`\delta` with
        :math:`y = x (I + \delta)` for a point :math:`x`.
        """
        point = self._points(y)
        with np.errstate(over="ignore", invalid="ignore"):
            residual = self.inverse(point) @ point - np.eye(self.n)
        return 0.5 * two_norm(residual)
