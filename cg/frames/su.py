"""The special unitary groups SU(n)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cg.frames.block_kinds import Blocks, convention_option
from cg.frames.entries import Entries
from cg.frames.u import U, gell_mann
from cg.support.arrays import Points
from cg.support.shared_numbers import BlockKind


@dataclass(frozen=True, repr=False)
class SU(U):
    r"""Unitary complex matrices of determinant 1.

    The generators are :math:`B_k = -\tfrac{i}{2} \lambda_k` with the generalised Gell-Mann
    matrices :math:`\lambda_k`; for n = 2 these are Pauli's, and the coefficients
    are the rotation vector on the Bloch sphere, as for `UnitQuaternion`.

    Parameters
    ----------
    n
        Number of rows, at least 2.

    Notes
    -----
    For n = 2, :math:`\Omega^2 = -\tfrac14 |v|^2 I`, so that the exponential is
    :math:`\cos x\, I + \Omega \sin(x) / x` with :math:`x = |v| / 2`; for larger n it is computed
    as for `U`. Every pair of points has `exp_coordinates`.

    Examples
    --------
    A pulse about the first axis inverts a two-level system.

    >>> import numpy as np
    >>> SU(2).flow([np.pi, 0.0, 0.0], np.eye(2)).round(15) + 0.0
    array([[0.+0.j, 0.-1.j],
           [0.-1.j, 0.+0.j]])
    """

    smallest: ClassVar[int] = 2
    _special: ClassVar[bool] = True

    @property
    def dim(self) -> int:
        return self.n**2 - 1

    def _make_basis(self) -> Entries:
        return gell_mann(self.n)

    def restore(self, y: Points) -> Points:
        """Return ``y`` after a step towards unitary matrices and one towards determinant 1."""
        unitary = super().restore(y)
        with np.errstate(invalid="ignore"):
            excess = np.linalg.det(unitary) - 1.0
        return np.asarray(unitary * (1.0 - excess / self.n)[..., None, None])

    @property
    def _rotation_sign(self) -> float:
        return self._side if self.n == 2 else 0.0

    def _blocks(self) -> Blocks | None:
        kind, size = (BlockKind.SU2, 3) if self.n == 2 else (BlockKind.SU, self.n)
        return ((kind, size, convention_option(self.convention)),)
