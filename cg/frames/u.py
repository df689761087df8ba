"""The unitary groups U(n)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from cg.frames.block_kinds import Blocks, convention_option
from cg.frames.entries import Entries
from cg.frames.logarithms import unitary_log1p
from cg.frames.manifold import MEMBERSHIP_TOLERANCE
from cg.frames.matrix_group_kinds import SizedMatrixGroup, UnitaryMatrixGroup
from cg.support.arrays import Array, Points
from cg.support.shared_numbers import BlockKind


@dataclass(frozen=True, repr=False)
class U(UnitaryMatrixGroup, SizedMatrixGroup):
    r"""Unitary complex matrices.

    The generators are :math:`B_k = -\tfrac{i}{2} \lambda_k` with Hermitian :math:`\lambda_k`,
    :math:`\operatorname{tr} \lambda_j \lambda_k = 2 \delta_{jk}`: first those of `SU`, last
    :math:`\sqrt{2/n}\, I`. With ``convention="space"`` a point is the propagator of
    :math:`i \psi' = H \psi`, :math:`H = \tfrac12 \sum_k v_k \lambda_k`.

    Parameters
    ----------
    n
        Number of rows, at least 1.

    Notes
    -----
    The exponential is a Taylor polynomial with scaling and squaring, in compiled code. Every pair
    of points has `exp_coordinates`. Each flow ends with a step towards the group that removes
    rounding errors.

    Examples
    --------
    >>> import numpy as np
    >>> U(1).flow([np.pi / 2 ** 0.5], np.eye(1)).round(15) + 0.0
    array([[0.-1.j]])
    """

    @property
    def dtype(self) -> np.dtype[Any]:
        return np.dtype(np.complex128)

    @property
    def dim(self) -> int:
        return self.n**2

    def _make_basis(self) -> Entries:
        special, diagonal = gell_mann(self.n), np.arange(self.n) * (self.n + 1)
        phase = np.full_like(diagonal, self.dim - 1), diagonal
        values = np.full(self.n, -0.5j * np.sqrt(2.0 / self.n))
        return Entries(*map(np.concatenate, zip(special, (*phase, values), strict=True)))

    def _explain_distance(self, matrix: Points) -> str:
        off = MEMBERSHIP_TOLERANCE * np.abs(matrix).max()
        if np.abs(matrix - matrix.conj().T).max() <= off:
            return (
                "; it is Hermitian, and the equation of a Hamiltonian H needs the factor: -1j * H"
            )
        trace = np.trace(matrix)
        if self._special and np.abs(matrix + matrix.conj().T).max() <= off:
            return f"; its trace {trace:.3g} must be zero; matrices with a trace need U({self.n})"
        return ""

    def _blocks(self) -> Blocks | None:
        return ((BlockKind.U, self.n, convention_option(self.convention)),)

    def _log1p(self, difference: Points) -> Array:
        # Angles of the eigenvalues are in (-pi, pi], and in SU add up to zero.
        return self._algebra_projection(unitary_log1p(difference, special=self._special))


def gell_mann(n: int) -> Entries:
    r"""Return the ``n * n - 1`` generalised Gell-Mann matrices of size ``n`` times -i/2.

    :math:`\operatorname{tr} \lambda_j \lambda_k = 2\delta_{jk}`. For each ``j`` from 1: for each
    ``i < j`` the symmetric and the antisymmetric matrix of that pair, then the diagonal one with
    ``j + 1`` entries. For ``n = 2`` these are the Pauli matrices, for ``n = 3`` Gell-Mann's in his
    order.
    """
    j, i = np.tril_indices(n, -1)
    pair, ones = j**2 - 1 + 2 * i, np.ones(len(i))
    last, entry = np.tril_indices(n)
    last, entry = last[1:], entry[1:]  # without the identity
    scale = np.sqrt(2.0 / (last * (last + 1.0)))
    diagonal = np.where(entry == last, -last * scale, scale)
    parts = [
        (pair, i, j, ones),
        (pair, j, i, ones),
        (pair + 1, i, j, -1j * ones),
        (pair + 1, j, i, 1j * ones),
        ((last + 1) ** 2 - 2, entry, entry, diagonal),
    ]
    fields, rows, columns, values = map(np.concatenate, zip(*parts, strict=True))
    return Entries(fields, rows * n + columns, -0.5j * values)
