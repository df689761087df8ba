"""The general linear groups GL(n), SL(n), Sp(2n), and the unitary groups U(n), SU(n)."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.base import SizedFrame
from cg.frames.blocks import Blocks, convention_option
from cg.frames.matrix_functions import (
    newton_corrected,
    singular_values,
    symplectic_correction,
    two_norm,
    unitary_log1p,
)
from cg.frames.matrix_group import Entries, MatrixGroup, entries_of
from cg.frames.orthonormal import OrthonormalColumns
from cg.support.arrays import CONVENTIONS, Array, Convention, Points
from cg.support.checks import check_choice
from cg.support.shared_numbers import BlockKind


class UnitaryMatrixGroup(OrthonormalColumns, MatrixGroup):
    """A group of unitary or orthogonal matrices, whose inverses are their adjoints."""

    def _checked_coordinates(self, v: Array, start: Points, end: Points) -> Array:
        return v  # logarithms from eigenvalues are accurate

    def inverse(self, x: ArrayLike) -> Points:
        return np.asarray(self._points(x, "x").mT.conj())


@dataclass(frozen=True, repr=False)
class SizedMatrixGroup(SizedFrame, MatrixGroup):
    """A matrix group with the number of rows as its parameter."""

    convention: Convention = "space"

    def __post_init__(self) -> None:
        super().__post_init__()
        check_choice("convention", self.convention, CONVENTIONS)

    @property
    def size(self) -> int:
        return self.n


class NoncompactMatrixGroup(SizedMatrixGroup):
    """A group whose elements may be large, restored by the Newton step of least norm."""

    @abstractmethod
    def _correction(self, y: Points) -> Points:
        """Return the change of least norm that takes matrices to the group, to first order."""

    def restore(self, y: Points) -> Points:
        r"""Return ``y`` after the Newton step of least norm towards the group.

        Solutions on such a group may grow. A matrix of norm :math:`g` has rounding errors of
        :math:`\epsilon g`, and a constraint such as :math:`\det y - 1` has those times its
        derivative. The step of least norm divides by that derivative, so its length is
        :math:`\epsilon g`, like the rounding of the flow itself. A step along the group, such as
        one of Newton and Schulz with the group's involution, multiplies y by a matrix of norm
        :math:`\epsilon g^2`: at :math:`g = 10^8` no digit would be left.
        """
        finite = np.isfinite(y).all(axis=(-2, -1), keepdims=True)
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            restored = y + self._correction(np.where(finite, y, np.eye(self.n)))
        computed = np.isfinite(restored).all(axis=(-2, -1), keepdims=True)
        return np.where(finite & computed, restored, y)

    def _project(self, y: Points) -> Points:
        # Nearest in the Frobenius norm, up to the square of the distance.
        return newton_corrected(y, self._correction)

    def relative_error(self, y: ArrayLike) -> Array:
        """Return the norm of the correction to the group, relative to the norm of ``y``.

        The membership error of a large matrix is dominated by rounding.
        """
        point = self._points(y)
        finite = np.isfinite(point).all(axis=(-2, -1), keepdims=True)
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            change = self._correction(np.where(finite, point, np.eye(self.n)))
            return np.asarray(two_norm(np.where(finite, change, np.nan)) / two_norm(point))


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
        indices = np.arange(self.n**2)
        return Entries(indices, indices, np.ones(len(indices)))

    def _project(self, y: Points) -> Points:
        # A singular matrix has no nearest invertible one.
        return y

    def membership_error(self, y: ArrayLike) -> Array:
        """Return zero for invertible matrices, infinity for numerically singular ones."""
        singular = singular_values(self._points(y))
        smallest = self.n * np.finfo(np.float64).eps * singular[..., 0]
        return np.where(singular[..., -1] > smallest, 0.0, np.inf)


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

    min_n: ClassVar[int] = 2

    @property
    def dim(self) -> int:
        return self.n**2 - 1

    def _make_basis(self) -> Entries:
        rows, columns = np.divmod(np.arange(self.n**2 - 1), self.n)
        corner = np.full_like(rows, self.n - 1)
        diagonal = np.where(rows == columns, -1.0, 0.0)
        ones = np.ones(len(rows))
        return entries_of(self.n, (rows, columns, ones), (corner, corner, diagonal))

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

    min_n: ClassVar[int] = 2

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
        terms = [
            (np.where(row < half, row + half, row - half), column, np.where(row < half, -1.0, 1.0))
            for row, column in ((i, j), (j, i))
        ]
        return entries_of(self.n, terms[0], (*terms[1][:2], below * terms[1][2]))

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
    terms = [
        (pair, i, j, ones),
        (pair, j, i, ones),
        (pair + 1, i, j, -1j * ones),
        (pair + 1, j, i, 1j * ones),
        ((last + 1) ** 2 - 2, entry, entry, diagonal),
    ]
    fields, rows, columns, values = map(np.concatenate, zip(*terms, strict=True))
    return Entries(fields, rows * n + columns, -0.5j * values)


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

    min_n: ClassVar[int] = 2
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

    def _blocks(self) -> Blocks | None:
        kind, size = (BlockKind.SU2, 3) if self.n == 2 else (BlockKind.SU, self.n)
        return ((kind, size, convention_option(self.convention)),)
