"""The unitary groups U(n)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.arrays import Array, Points
from cg.frames.block_kinds import MAX_MATRIX, Blocks, convention_option
from cg.frames.logarithms import unitary_log1p
from cg.frames.matrix_functions import unitary_exponential
from cg.frames.matrix_group import SizedMatrixGroup, UnitaryMatrixGroup
from cg.support.shared_numbers import BlockKind


@dataclass(frozen=True, repr=False)
class U(UnitaryMatrixGroup, SizedMatrixGroup):
    r"""Unitary complex matrices.

    The generators are :math:`B_k = -\tfrac{i}{2} \lambda_k` with Hermitian :math:`\lambda_k`,
    :math:`\operatorname{tr} \lambda_j \lambda_k = 2 \delta_{jk}`: first those of `SU`, last
    :math:`\sqrt{2/n}\, I`.  With ``convention="space"`` a point is the propagator of
    :math:`i \psi' = H \psi`, :math:`H = \tfrac12 \sum_k v_k \lambda_k`.

    Parameters
    ----------
    n
        Number of rows, at least 1.
    convention
        ``"space"``: :math:`y' = \Omega\,y` (default), ``"body"``: :math:`y' = y\,\Omega`.

    Raises
    ------
    TypeError
        If ``n`` isn't an integer.
    ValueError
        If ``n`` is too small, or ``convention`` is neither of the two.

    Notes
    -----
    The exponential is a Taylor polynomial with scaling and squaring, ``scipy.linalg.expm`` for more
    than 16 rows, and computed from eigenvalues for large angles.  Every pair of points has
    `exp_coordinates`.  Each flow ends with a step towards the group that removes rounding errors.

    Examples
    --------
    >>> import numpy as np
    >>> U(1).flow([np.pi / 2 ** 0.5], np.eye(1)).round(15) + 0.0
    array([[0.-1.j]])
    """

    @property
    def dtype(self) -> np.dtype[Any]:
        """Complex."""
        return np.dtype(np.complex128)

    @property
    def dim(self) -> int:
        """``n ** 2``."""
        return self.n**2

    def _make_basis(self) -> Points:
        phase = np.sqrt(2.0 / self.n) * np.eye(self.n)
        return -0.5j * np.concatenate([gell_mann(self.n), phase[None]])

    def exponential(self, v: ArrayLike) -> Points:
        r"""Return :math:`e^{\Omega(v)}`, shape ``(..., n, n)``."""
        return unitary_exponential(self.algebra(v), special=self._special)

    def _blocks(self) -> Blocks | None:
        if self.n > MAX_MATRIX:
            return None
        return ((BlockKind.U, self.n, convention_option(self.convention)),)

    def _log1p(self, difference: Points) -> Array:
        # Angles of the eigenvalues are in (-pi, pi], and in SU add up to zero.
        return self._algebra_projection(unitary_log1p(difference, special=self._special))


def gell_mann(n: int) -> Points:
    r"""Return the generalised Gell-Mann matrices of size ``n``.

    Parameters
    ----------
    n
        Number of rows, at least 1.

    Returns
    -------
    ndarray
        Shape ``(n * n - 1, n, n)``, with :math:`\operatorname{tr} \lambda_j \lambda_k =
        2\delta_{jk}`.  For each ``j`` from 1: for each ``i < j`` the symmetric and the
        antisymmetric matrix of that pair, then the diagonal one with ``j + 1`` entries.  For
        ``n = 2`` these are the Pauli matrices, for ``n = 3`` Gell-Mann's in his order.
    """
    matrices = np.zeros((n * n - 1, n, n), dtype=np.complex128)
    k = 0
    for j in range(1, n):
        for i in range(j):
            matrices[k, i, j] = matrices[k, j, i] = 1.0
            matrices[k + 1, i, j], matrices[k + 1, j, i] = -1j, 1j
            k += 2
        matrices[k] = np.sqrt(2.0 / (j * (j + 1))) * np.diag([1.0] * j + [-j] + [0.0] * (n - j - 1))
        k += 1
    return matrices
