"""Manifolds of unit vectors, and of matrices with orthonormal columns."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.base import Frame
from cg.frames.matrix_functions import (
    distance_from_unitary,
    nearest_unitary,
    newton_schulz,
    random_unitary,
    singular_values,
)
from cg.support.arrays import Array, Points, Size, check_random


class UnitVectors(Frame):
    """A frame on the unit vectors of a Euclidean space."""

    def membership_error(self, y: ArrayLike) -> Array:
        """Return the difference of the length from one, shape ``(...)``."""
        return np.asarray(np.abs(np.linalg.norm(self._points(y), axis=-1) - 1.0))

    def _project(self, y: Points) -> Points:
        return np.asarray(y / np.linalg.norm(y, axis=-1, keepdims=True))

    def random_point(self, rng: np.random.Generator, size: Size = ()) -> Points:
        """Return points uniform on the unit sphere, shape ``(*size, *point_shape)``."""
        size = check_random(rng, size)
        return self._project(rng.standard_normal((*size, *self.point_shape)))


class OrthonormalColumns(Frame):
    """A frame on matrices with orthonormal columns; if `_special`, square with determinant 1."""

    _special: ClassVar[bool] = False

    def restore(self, y: Points) -> Points:
        """Return ``y`` after a Newton-Schulz step towards orthonormal columns."""
        return newton_schulz(y)

    def membership_error(self, y: ArrayLike) -> Array:
        """Return the 2-norm distance to the nearest point, shape ``(...)``."""
        return distance_from_unitary(self._points(y), special=self._special)

    def _project(self, y: Points) -> Points:
        if self._special and self.dtype.kind == "f":
            self._check_handedness(y)
        return nearest_unitary(y, special=self._special)

    def _check_handedness(self, y: Points) -> None:
        """Raise ValueError for left-handed matrices, and singular ones, which may be either.

        The nearest rotation of a reflection exists, but turns some axis round.
        """
        values = singular_values(y)
        singular = values[:, -1] <= y.shape[-1] * np.finfo(np.float64).eps * values[:, 0]
        wrong = np.flatnonzero(singular | (np.linalg.slogdet(y).sign < 0.0))
        if len(wrong):
            kind = "singular" if singular[wrong[0]] else "left-handed"
            raise ValueError(
                f"y must have a positive determinant for the nearest point of {self}, got "
                f"{np.linalg.det(y[wrong[0]]):.3g}, of a {kind} matrix"
            )

    def random_point(self, rng: np.random.Generator, size: Size = ()) -> Points:
        """Return points uniform under rotations or unitary matrices."""
        size = check_random(rng, size)
        point = random_unitary(rng, (*size, *self.point_shape), complex_=self.dtype.kind == "c")
        if self._special:
            # Scaling a column commutes with the action of the group from the left, so that the
            # distribution stays uniform.
            point[..., 0] /= np.linalg.det(point)[..., None]
        return self.restore(point)
