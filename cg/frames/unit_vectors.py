"""Manifolds of unit vectors: spheres and unit quaternions."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.arrays import Array, Points, Size, check_random
from cg.frames.base import Frame


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
