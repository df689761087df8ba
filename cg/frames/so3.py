"""The rotation group SO(3), as 3 x 3 matrices."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.rotations import hat
from cg.frames.so import SO
from cg.support.arrays import Array, Points, Size, check_random


@dataclass(frozen=True, repr=False)
class SO3(SO):
    r"""Rotation matrices with the frame of left- or right-invariant vector fields.

    Parameters
    ----------
    convention
        ``"body"``: :math:`y' = y\,\hat v`, coefficients are an angular velocity in body axes.
        ``"space"``: :math:`y' = \hat v\, y`, coefficients are in space axes.

    Notes
    -----
    The exponential is the rotation of a unit quaternion. Each flow ends with a step towards the
    group that removes rounding errors, as in `SO`.

    Examples
    --------
    A quarter of a turn about the third axis of the body, or of space:

    >>> import numpy as np
    >>> upright = SO3().flow([np.pi / 2, 0.0, 0.0], np.eye(3))
    >>> SO3("body").flow([0.0, 0.0, np.pi / 2], upright).round(15) + 0.0
    array([[ 0., -1.,  0.],
           [ 0.,  0., -1.],
           [ 1.,  0.,  0.]])
    >>> SO3("space").flow([0.0, 0.0, np.pi / 2], upright).round(15) + 0.0
    array([[0., 0., 1.],
           [1., 0., 0.],
           [0., 1., 0.]])
    """

    n: int = field(default=3, init=False)

    def algebra(self, v: ArrayLike) -> Points:
        """Return ``hat(v)``, shape ``(..., 3, 3)``."""
        return hat(self._vectors(v))

    _blocks = SO._blocks  # compiled too, see `Frame.compiled_blocks`

    def distance(self, x: ArrayLike, y: ArrayLike) -> Array:
        r"""Return the angle in radians between two rotations, shape ``(...)``.

        It is :math:`2\arcsin(\|x - y\|_F / \sqrt 8)`, which unlike the arc cosine of a trace is
        accurate for nearly equal rotations.
        """
        return np.asarray(2.0 * np.arcsin(np.minimum(super().distance(x, y) / np.sqrt(8.0), 1.0)))

    def random_point(self, rng: np.random.Generator, size: Size = ()) -> Array:
        """Return rotations uniform in Haar measure, shape ``(*size, 3, 3)``."""
        size = check_random(rng, size)
        q = rng.standard_normal((*size, 4))
        q /= np.linalg.norm(q, axis=-1, keepdims=True)
        axis = q[..., 1:]
        scalar = q[..., :1, None]
        outer = axis[..., :, None] * axis[..., None, :]
        identity = np.eye(3)
        return np.asarray((2.0 * scalar**2 - 1.0) * identity + 2.0 * (outer + scalar * hat(axis)))
