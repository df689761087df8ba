"""Hyperbolic space: the upper half-space."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.base import Sized
from cg.support.arrays import Array, Points, Size, check_random


@dataclass(frozen=True, repr=False)
class Hyperbolic(Sized):
    r"""Hyperbolic space as the half-space :math:`y_n > 0`, with dilations and translations.

    The first field generates dilations, :math:`E_1 = y`, the others translations along the
    boundary, :math:`E_{i+1} = \partial / \partial y_i`. Their flows are isometries; the flow of
    :math:`(a, b)` is :math:`x \mapsto e^{a} x + \tfrac{e^a - 1}{a} b`,
    :math:`y_n \mapsto e^{a} y_n`.

    Parameters
    ----------
    n
        Dimension, at least 2.

    Notes
    -----
    `distance` is the geodesic distance of the metric :math:`|dy|^2 / y_n^2` [1]_.

    References
    ----------
    .. [1] J. G. Ratcliffe, *Foundations of Hyperbolic Manifolds*, Springer, 2006, chapter 4.

    Examples
    --------
    >>> import numpy as np
    >>> plane = Hyperbolic(2)
    >>> plane.flow([np.log(3.0), 0.0], [1.0, 2.0])
    array([3., 6.])
    >>> float(plane.distance([0.0, 1.0], [0.0, np.e]).round(12))
    1.0
    """

    smallest: ClassVar[int] = 2

    @property
    def dim(self) -> int:
        return self.n

    @property
    def point_shape(self) -> tuple[int, ...]:
        return (self.n,)

    def field(self, v: ArrayLike, y: ArrayLike) -> Array:
        vector, point = self._arguments(v, y)
        tangent = vector[..., :1] * point
        tangent[..., :-1] += vector[..., 1:]
        return tangent

    def flow(self, v: ArrayLike, y: ArrayLike) -> Array:
        vector, point = self._arguments(v, y)
        dilation = vector[..., :1]
        moved = np.exp(dilation) * point
        moved[..., :-1] += _expm1_quotient(dilation) * vector[..., 1:]
        return moved

    def _bracket(self, u: Array, v: Array) -> Array:
        translations = u[..., :1] * v[..., 1:] - v[..., :1] * u[..., 1:]
        return np.concatenate([np.zeros((*translations.shape[:-1], 1)), translations], axis=-1)

    def _coefficients_at(self, y: Array, tangent: Array) -> Array:
        dilation = tangent[..., -1:] / y[..., -1:]
        return np.concatenate([dilation, tangent[..., :-1] - dilation * y[..., :-1]], axis=-1)

    def exp_coordinates(self, y0: ArrayLike, y1: ArrayLike) -> Array:
        """Return the unique dilation and translation from a point to another, ``(..., n)``."""
        start, end = self._points(y0, "y0"), self._points(y1, "y1")
        with np.errstate(divide="ignore", invalid="ignore"):
            dilation = np.log(end[..., -1:] / start[..., -1:])
            shift = end[..., :-1] - start[..., :-1] * (end[..., -1:] / start[..., -1:])
            v = np.concatenate([dilation, shift / _expm1_quotient(dilation)], axis=-1)
        return np.where(np.isfinite(v).all(axis=-1, keepdims=True), v, np.nan)

    def _logarithms(self, m: Array, y: Array) -> Array:
        # The isometry that takes m to height one on the axis takes y to (a, b); the tangent of the
        # geodesic has the direction of (2 a, a^2 + b^2 - 1).
        change = (y - m) / m[..., -1:]
        across, rise = change[..., :-1], change[..., -1:]
        up = (across**2).sum(axis=-1, keepdims=True) + rise * (rise + 2.0)
        direction = np.concatenate([2.0 * across, up], axis=-1)
        length = np.linalg.norm(direction, axis=-1, keepdims=True)
        angle = self.distance(m, y)[..., None] / np.where(length > 0.0, length, 1.0)
        return self._coefficients_at(m, m[..., -1:] * angle * direction)

    def coordinate_sizes(self, y: ArrayLike) -> Array:
        """Return one for dilations, and the length of the point for translations."""
        point = self._points(y)
        sizes = np.repeat(np.linalg.norm(point, axis=-1, keepdims=True), self.n, axis=-1)
        sizes[..., 0] = 1.0
        return sizes

    def membership_error(self, y: ArrayLike) -> Array:
        """Return zero above the boundary; elsewhere one and the height below it."""
        height = self._points(y)[..., -1]
        return np.asarray(np.where(height > 0.0, 0.0, 1.0 - height))

    def _project(self, y: Points) -> Points:
        return y

    def distance(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return the hyperbolic distance, shape ``(...)``."""
        first, second = self._points(x, "x"), self._points(y)
        apart = np.linalg.norm(first - second, axis=-1)
        return np.asarray(2.0 * np.arcsinh(0.5 * apart / np.sqrt(first[..., -1] * second[..., -1])))

    def random_point(self, rng: np.random.Generator, size: Size = ()) -> Array:
        """Return normal points, with a log-normal height between 1/2 and infinity."""
        size = check_random(rng, size)
        point = rng.standard_normal((*size, self.n))
        point[..., -1] = 0.5 + np.exp(point[..., -1] - 1.0)
        return point


def _expm1_quotient(a: Array) -> Array:
    """Return ``(exp(a) - 1) / a``."""
    safe = np.where(a == 0.0, 1.0, a)
    return np.where(a == 0.0, 1.0, np.expm1(safe) / safe)
