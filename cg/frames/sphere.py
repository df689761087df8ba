"""The sphere S^n, moved by rotations."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.arrays import Array, Points, Size, check_random
from cg.frames.block_kinds import BlockKind, Blocks
from cg.frames.homogeneous import HomogeneousSpace
from cg.frames.matrix_functions import unit_step
from cg.frames.matrix_group import MatrixGroup
from cg.frames.so import SO
from cg.support.checks import check_integer

# Of the distance from the opposite point, the least part that must be along the sphere
_OPPOSITE = 1e-4


@dataclass(frozen=True, repr=False)
class Sphere(HomogeneousSpace):
    r"""Unit vectors of :math:`R^{n+1}`, moved by SO(n+1): :math:`y' = \Omega(v)\,y`.

    The coefficients are those of `SO`; on :math:`S^2` they are the rotation vector,
    :math:`y' = v \times y`.

    Parameters
    ----------
    n
        Dimension of the sphere, at least 1.

    Raises
    ------
    TypeError
        If ``n`` isn't an integer.
    ValueError
        If ``n`` is less than 1.

    Notes
    -----
    The flow is that of `SO`, a closed form on the circle and on :math:`S^2`, and a last step
    towards length one.  The `exp_coordinates` turn the plane of the two points and nothing else;
    opposite points have none, since every plane would do.

    Examples
    --------
    >>> import numpy as np
    >>> Sphere(2).flow([0.0, 0.0, np.pi / 2], [1.0, 0.0, 0.0]).round(15) + 0.0
    array([0., 1., 0.])
    """

    n: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "n", check_integer("n", self.n, 1))

    @cached_property
    def group(self) -> MatrixGroup:
        """The rotations of the space around."""
        return SO(self.n + 1, "space")

    @property
    def point_shape(self) -> tuple[int, ...]:
        """The shape ``(n + 1,)``."""
        return (self.n + 1,)

    def _act(self, x: Points, y: Points) -> Points:
        return np.asarray((x @ y[..., None])[..., 0])

    def _act_infinitesimally(self, omega: Points, y: Points) -> Points:
        return self._act(omega, y)

    def restore(self, y: Points) -> Points:
        """Return ``y`` after a step towards length one."""
        return unit_step(y)

    def membership_error(self, y: ArrayLike) -> Array:
        """Return how far the length is from one, shape ``(...)``."""
        return np.asarray(np.abs(np.linalg.norm(self._points(y), axis=-1) - 1.0))

    def _blocks(self) -> Blocks | None:
        return ((BlockKind.SPHERE, 3, 0),) if self.n == 2 else None

    def _project(self, y: Points) -> Points:
        return np.asarray(y / np.linalg.norm(y, axis=-1, keepdims=True))

    def distance(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return the angle in radians between two points, shape ``(...)``."""
        return np.asarray(2.0 * np.arcsin(np.minimum(super().distance(x, y) / 2.0, 1.0)))

    def exp_coordinates(self, y0: ArrayLike, y1: ArrayLike) -> Array:
        """Return the shortest rotation that takes ``y0`` to ``y1``, NaN if they are opposite."""
        start, end = self._points(y0, "y0"), self._points(y1, "y1")
        start, end = np.broadcast_arrays(start, end)
        # A multiple of the start added to the end changes nothing, and leaves what is short.
        cosine = np.vecdot(start, end)
        short = end - np.copysign(1.0, cosine)[..., None] * start
        wedge = short[..., :, None] * start[..., None, :]
        turn = self.group._algebra_projection(wedge - wedge.mT)
        # The coefficients have the norm of sin(angle).
        sine = np.linalg.norm(turn, axis=-1)
        angle = np.arctan2(sine, cosine)
        quotient = np.divide(angle, sine, out=np.where(cosine > 0.0, 1.0, np.nan), where=sine > 0.0)
        # Opposite but for the rounding of their lengths
        opposite = (cosine < 0.0) & (sine <= _OPPOSITE * np.linalg.norm(short, axis=-1))
        quotient = np.where(opposite, np.nan, quotient)
        return np.asarray(quotient[..., None] * turn)

    def shortest(self, v: ArrayLike, y: ArrayLike) -> Array:
        """Return ``v`` without the rotations that leave ``y`` where it is."""
        vector, point = self._arguments(v, y)
        wedge = self.field(vector, point)[..., :, None] * point[..., None, :]
        return self.group._algebra_projection(wedge - wedge.mT)

    def random_point(self, rng: np.random.Generator, size: Size = ()) -> Array:
        """Return points uniform on the sphere, shape ``(*size, n + 1)``."""
        size = check_random(rng, size)
        y = rng.standard_normal((*size, self.n + 1))
        return np.asarray(y / np.linalg.norm(y, axis=-1, keepdims=True))
