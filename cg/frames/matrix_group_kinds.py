"""Kinds of matrix groups: unitary ones, those that are not compact, and those of any size."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.base import Sized
from cg.frames.matrix_functions import minimum_norm_step, newton_corrected, relative_correction
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
        """Return ``y`` after the Newton step of least norm towards the group."""
        return minimum_norm_step(y, self._correction)

    def _project(self, y: Points) -> Points:
        # Nearest in the Frobenius norm, up to the square of the distance.
        return newton_corrected(y, self._correction)

    def relative_error(self, y: ArrayLike) -> Array:
        """Return the norm of the correction to the group, relative to the norm of ``y``.

        The membership error of a large matrix is dominated by rounding.
        """
        return relative_correction(self._points(y), self._correction)
