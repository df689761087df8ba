"""The sphere S^n with the action of rotations, and hyperbolic space as the upper half-space."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.base import SizedFrame
from cg.frames.blocks import Blocks
from cg.frames.homogeneous import HomogeneousSpace
from cg.frames.matrix_group import MatrixGroup
from cg.frames.orthonormal import UnitVectors
from cg.frames.rotations import SO
from cg.support.arrays import Array, Points, Size, check_random
from cg.support.shared_numbers import BlockKind

# Points are antipodal if the tangential part of their sum is less than this fraction of the sum.
_ANTIPODAL = 1e-4


@dataclass(frozen=True, repr=False)
class Sphere(SizedFrame, UnitVectors, HomogeneousSpace):
    r"""Unit vectors of :math:`R^{n+1}` with the action of SO(n+1): :math:`y' = \Omega(v)\,y`.

    The coefficients are those of `SO`; on :math:`S^2` they are the rotation vector,
    :math:`y' = v \times y`.

    Parameters
    ----------
    n
        Dimension of the sphere, at least 1.

    Notes
    -----
    The flow is that of `SO`, a closed form on the circle and on :math:`S^2`, followed by a step
    towards length one. The `exp_coordinates` are a rotation in the plane of the two points;
    antipodal points have none, since the plane is not unique.

    Examples
    --------
    >>> import numpy as np
    >>> Sphere(2).flow([0.0, 0.0, np.pi / 2], [1.0, 0.0, 0.0]).round(15) + 0.0
    array([0., 1., 0.])
    """

    @cached_property
    def group(self) -> MatrixGroup:
        """The rotations of the ambient space."""
        return SO(self.n + 1, "space")

    @property
    def point_shape(self) -> tuple[int, ...]:
        return (self.n + 1,)

    def _act(self, x: Points, y: Points) -> Points:
        return np.asarray((x @ y[..., None])[..., 0])

    def _act_infinitesimally(self, omega: Points, y: Points) -> Points:
        return self._act(omega, y)

    def restore(self, y: Points) -> Points:
        """Return ``y`` after a step towards length one."""
        return np.asarray((1.5 - 0.5 * np.vecdot(y, y))[..., None] * y)

    def _blocks(self) -> Blocks | None:
        return ((BlockKind.SPHERE, 3, 0),) if self.n == 2 else None

    def distance(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return the angle in radians between two points, shape ``(...)``."""
        return np.asarray(2.0 * np.arcsin(np.minimum(super().distance(x, y) / 2.0, 1.0)))

    def exp_coordinates(self, y0: ArrayLike, y1: ArrayLike) -> Array:
        """Return the shortest rotation that takes ``y0`` to ``y1``, NaN if they are antipodal."""
        start, end = np.broadcast_arrays(self._points(y0, "y0"), self._points(y1, "y1"))
        # Subtracting a multiple of the start from the end leaves the wedge product unchanged and
        # avoids cancellation.
        cosine = np.vecdot(start, end)
        short = end - np.copysign(1.0, cosine)[..., None] * start
        wedge = short[..., :, None] * start[..., None, :]
        turn = self.group._algebra_projection(wedge - wedge.mT)
        # The coefficients have the norm of sin(angle).
        sine = np.linalg.norm(turn, axis=-1)
        angle = np.arctan2(sine, cosine)
        quotient = np.divide(angle, sine, out=np.where(cosine > 0.0, 1.0, np.nan), where=sine > 0.0)
        # Antipodal up to the rounding of the lengths
        antipodal = (cosine < 0.0) & (sine <= _ANTIPODAL * np.linalg.norm(short, axis=-1))
        quotient = np.where(antipodal, np.nan, quotient)
        return np.asarray(quotient[..., None] * turn)

    def without_isotropy(self, v: ArrayLike, y: ArrayLike) -> Array:
        """Return ``v`` without the rotations that fix ``y``."""
        vector, point = self._arguments(v, y)
        return self._coefficients_at(point, self.field(vector, point))

    def _coefficients_at(self, y: Points, tangent: Points) -> Array:
        wedge = tangent[..., :, None] * y[..., None, :]
        return self.group._algebra_projection(wedge - wedge.mT)


@dataclass(frozen=True, repr=False)
class Hyperbolic(SizedFrame):
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

    min_n: ClassVar[int] = 2

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
