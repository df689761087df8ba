"""Kinds of matrix groups: unitary ones, those that are not compact, and those of any size."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.base import Sized
from cg.frames.matrix_functions import newton_corrected, two_norm
from cg.frames.matrix_group import MatrixGroup
from cg.frames.orthonormal import OrthonormalColumns
from cg.support.arrays import Array, Convention, Points, check_convention


class UnitaryMatrixGroup(OrthonormalColumns, MatrixGroup):
    """A group of unitary or orthogonal matrices, whose inverses are their adjoints."""

    def _checked_coordinates(self, v: Array, start: Points, end: Points) -> Array:
        return v  # logarithms from eigenvalues are accurate

    def inverse(self, x: ArrayLike) -> Points:
        return np.asarray(self._points(x, "x").mT.conj())


@dataclass(frozen=True, repr=False)
class SizedMatrixGroup(Sized, MatrixGroup):
    """A matrix group with the number of rows as its parameter."""

    convention: Convention = "space"

    def __post_init__(self) -> None:
        super().__post_init__()
        check_convention(self.convention)

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
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            try:
                restored = y + self._correction(y)
                if np.isfinite(restored.sum()):
                    return np.asarray(restored)
            except np.linalg.LinAlgError:  # raised for matrices that are not finite
                pass
            finite = np.isfinite(y).all(axis=(-2, -1), keepdims=True)
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
