"""Euclidean space, where every flow is a translation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.base import Array, Frame


@dataclass(frozen=True)
class Euclidean(Frame):
    r"""The space :math:`R^n` with the frame :math:`E_i = \partial / \partial x_i`.

    All flows commute, so a Crouch-Grossman method is here the classical Runge-Kutta method of
    the same tableau.

    Parameters
    ----------
    n
        Dimension, at least 1.

    Raises
    ------
    ValueError
        If ``n`` is not a positive integer.
    """

    n: int

    def __post_init__(self) -> None:
        if isinstance(self.n, bool) or not isinstance(self.n, int) or self.n < 1:
            raise ValueError(f"n must be a positive integer, got {self.n!r}")

    def __repr__(self) -> str:
        return f"Euclidean({self.n})"

    @property
    def dim(self) -> int:
        """The dimension ``n``."""
        return self.n

    @property
    def point_shape(self) -> tuple[int, ...]:
        """The shape ``(n,)``."""
        return (self.n,)

    def field(self, v: ArrayLike, y: ArrayLike) -> Array:
        """Return ``v`` itself, broadcast against ``y``: shape ``(..., n)``."""
        vector, point = self._arguments(v, y)
        return vector + np.zeros_like(point)

    def flow(self, v: ArrayLike, y: ArrayLike) -> Array:
        """Return ``y + v``, shape ``(..., n)``."""
        vector, point = self._arguments(v, y)
        return point + vector

    def membership_error(self, y: ArrayLike) -> Array:
        """Return zeros: every array is a point."""
        return np.zeros(self._points(y).shape[:-1])

    def distance(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return the 2-norm of ``x - y``, shape ``(...)``."""
        difference = self._points(x, "x") - self._points(y)
        return np.asarray(np.linalg.norm(difference, axis=-1))

    def random_point(self, rng: np.random.Generator, size: tuple[int, ...] = ()) -> Array:
        """Return standard normal points, shape ``(*size, n)``."""
        return rng.standard_normal((*size, self.n))
