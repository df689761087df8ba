"""Powers of a frame: the product of equal factors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.base import Frame, check_frame
from cg.frames.block_kinds import Blocks
from cg.support.arrays import Array, Points, Size, check_random
from cg.support.checks import check_integer


@dataclass(frozen=True, repr=False)
class Power(Frame):
    """The product of n equal frames, for n spins, links of a lattice or bodies.

    Unlike those of `Product`, points keep their shape, and all flows are computed in one batch.

    Parameters
    ----------
    factor
        The frame of each point.
    n
        Number of factors, at least 1.

    Examples
    --------
    >>> import numpy as np
    >>> from cg.frames import Sphere
    >>> spins = Power(Sphere(2), 100)
    >>> spins.dim, spins.point_shape
    (300, (100, 3))
    >>> y = np.tile([0.0, 0.0, 1.0], (100, 1))
    >>> spins.flow(np.tile([np.pi / 2, 0.0, 0.0], 100), y)[99].round(15) + 0.0
    array([ 0., -1.,  0.])
    """

    factor: Frame
    n: int

    def __post_init__(self) -> None:
        check_frame(self.factor, "factor")
        object.__setattr__(self, "n", check_integer("n", self.n, 1))

    @property
    def dim(self) -> int:
        return self.n * self.factor.dim

    @property
    def point_shape(self) -> tuple[int, ...]:
        return (self.n, *self.factor.point_shape)

    @property
    def dtype(self) -> np.dtype[Any]:
        return self.factor.dtype

    def read_points(self, value: Any, name: str = "y") -> Points:
        """Return arrays of numbers, and whatever else the factor takes for a stack of points."""
        return self.factor.read_points(value, name)

    def field(self, v: ArrayLike, y: ArrayLike) -> Points:
        vector, point = self._arguments(v, y)
        return self.factor.field(self._split_vector(vector), point)

    def flow(self, v: ArrayLike, y: ArrayLike) -> Points:
        vector, point = self._arguments(v, y)
        return self.factor.flow(self._split_vector(vector), point)

    def _moved_by_derivatives(self) -> Frame:
        return Power(self.factor._moved_by_derivatives(), self.n)

    def _coefficients_at(self, y: Points, tangent: Points) -> Array:
        rows = (x.reshape(-1, *self.factor.point_shape) for x in (y, tangent))
        return self.factor._coefficients_at(*rows).reshape(-1, self.dim)

    def _bracket(self, u: Array, v: Array) -> Array:
        each = self.factor._bracket(self._split_vector(u), self._split_vector(v))
        return self._join_vectors(each)

    def _dexpinv(self, u: Array, v: Array, order: int) -> Array:
        each = self.factor._dexpinv(self._split_vector(u), self._split_vector(v), order)
        return self._join_vectors(each)

    def without_isotropy(self, v: ArrayLike, y: ArrayLike) -> Array:
        vector, point = self._arguments(v, y)
        return self._join_vectors(self.factor.without_isotropy(self._split_vector(vector), point))

    def _project(self, y: Points) -> Points:
        return self.factor.project(y)

    def membership_error(self, y: ArrayLike) -> Array:
        """Return the largest of all membership errors, shape ``(...)``."""
        return np.asarray(np.max(self.factor.membership_error(self._points(y)), axis=-1))

    def relative_error(self, y: ArrayLike) -> Array:
        """Return the largest of all relative errors, shape ``(...)``."""
        return np.asarray(np.max(self.factor.relative_error(self._points(y)), axis=-1))

    def distance(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return the root of the sum of all squared distances, shape ``(...)``."""
        each = self.factor.distance(self._points(x, "x"), self._points(y))
        return np.asarray(np.linalg.norm(each, axis=-1))

    def exp_coordinates(self, y0: ArrayLike, y1: ArrayLike) -> Array | None:
        """Return the coordinates of all points, ``(..., dim)``; None if the factor has none."""
        v = self.factor.exp_coordinates(self._points(y0, "y0"), self._points(y1, "y1"))
        return None if v is None else self._join_vectors(v)

    def local_coordinates(self, y0: ArrayLike, y1: ArrayLike) -> Array:
        start, end = self._points(y0, "y0"), self._points(y1, "y1")
        return self._join_vectors(self.factor.local_coordinates(start, end))

    def _logarithms(self, m: Points, y: Points) -> Array:
        return self._join_vectors(self.factor._logarithms(m, y))

    def _nearest_coordinates(self, y0: ArrayLike, y1: ArrayLike) -> Array:
        start, end = self._points(y0, "y0"), self._points(y1, "y1")
        return self._join_vectors(self.factor._nearest_coordinates(start, end))

    def _composed(self, path: Array) -> Array:
        each = path.reshape(len(path), self.n, self.factor.dim).swapaxes(0, 1)
        return np.concatenate([self.factor._composed(flows) for flows in each])

    def coordinate_sizes(self, y: ArrayLike) -> Array:
        return self._join_vectors(self.factor.coordinate_sizes(self._points(y)))

    def random_point(self, rng: np.random.Generator, size: Size = ()) -> Points:
        """Return random points, shape ``(*size, n, *factor.point_shape)``."""
        return self.factor.random_point(rng, (*check_random(rng, size), self.n))

    def _blocks(self) -> Blocks | None:
        blocks = self.factor.compiled_blocks()
        return None if blocks is None else blocks * self.n

    def _split_vector(self, vector: Array) -> Array:
        """Return the coefficients of each point, shape ``(..., n, factor.dim)``."""
        return vector.reshape(*vector.shape[:-1], self.n, self.factor.dim)

    def _join_vectors(self, vectors: Array) -> Array:
        return np.asarray(vectors.reshape(*vectors.shape[:-2], self.dim))
