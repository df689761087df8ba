"""The sphere S^n with the action of rotations."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.base import Sized
from cg.frames.block_kinds import Blocks
from cg.frames.homogeneous import HomogeneousSpace
from cg.frames.matrix_group import MatrixGroup
from cg.frames.orthonormal import UnitVectors
from cg.frames.so import SO
from cg.support.arrays import Array, Points
from cg.support.shared_numbers import BlockKind

# Points are antipodal if the tangential part of their sum is less than this fraction of the sum.
_ANTIPODAL = 1e-4


@dataclass(frozen=True, repr=False)
class Sphere(Sized, UnitVectors, HomogeneousSpace):
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
        start, end = self._points(y0, "y0"), self._points(y1, "y1")
        start, end = np.broadcast_arrays(start, end)
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
