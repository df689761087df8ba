"""Euclidean space, whose flows are translations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.base import SizedFrame
from cg.frames.blocks import Blocks
from cg.support.arrays import Array, Size, check_random
from cg.support.shared_numbers import BlockKind


@dataclass(frozen=True, repr=False)
class Euclidean(SizedFrame):
    r"""The space :math:`R^n` with the frame :math:`E_i = \partial / \partial x_i`.

    All flows commute, so a Crouch-Grossman method is the classical Runge-Kutta method with the
    same tableau.

    Parameters
    ----------
    n
        Dimension, at least 1.

    Examples
    --------
    >>> Euclidean(2).flow([1.0, -2.0], [0.5, 0.5])
    array([ 1.5, -1.5])
    """

    @property
    def dim(self) -> int:
        return self.n

    @property
    def point_shape(self) -> tuple[int, ...]:
        return (self.n,)

    def field(self, v: ArrayLike, y: ArrayLike) -> Array:
        vector, point = self._arguments(v, y)
        return vector + np.zeros_like(point)

    def flow(self, v: ArrayLike, y: ArrayLike) -> Array:
        vector, point = self._arguments(v, y)
        return point + vector

    def _bracket(self, u: Array, v: Array) -> Array:
        return np.zeros(np.broadcast_shapes(u.shape, v.shape))

    def _dexpinv(self, u: Array, v: Array, order: int) -> Array:
        return v + np.zeros_like(u)

    def membership_error(self, y: ArrayLike) -> Array:
        """Return zeros: every array is a point."""
        return np.zeros(self._points(y).shape[:-1])

    def _project(self, y: Array) -> Array:
        return y

    def _coefficients_at(self, y: Array, tangent: Array) -> Array:
        return tangent

    def exp_coordinates(self, y0: ArrayLike, y1: ArrayLike) -> Array:
        """Return ``y1 - y0``, shape ``(..., n)``."""
        return np.asarray(self._points(y1, "y1") - self._points(y0, "y0"))

    def coordinate_sizes(self, y: ArrayLike) -> Array:
        """Return the coordinates' absolute values, shape ``(..., n)``."""
        return np.abs(self._points(y))

    def turning_coefficients(self) -> Array:
        return np.zeros(self.n)

    def _blocks(self) -> Blocks | None:
        return ((BlockKind.EUCLIDEAN, self.n, 0),)

    def random_point(self, rng: np.random.Generator, size: Size = ()) -> Array:
        """Return standard normal points, shape ``(*size, n)``."""
        size = check_random(rng, size)
        return rng.standard_normal((*size, self.n))
