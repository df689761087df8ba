"""Stiefel manifolds: orthonormal k-frames in R^n."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.arrays import Array, Points, Size, check_random
from cg.frames.homogeneous import HomogeneousSpace
from cg.frames.matrix_functions import (
    distance_from_unitary,
    nearest_unitary,
    newton_schulz,
    random_unitary,
)
from cg.frames.matrix_group import MatrixGroup
from cg.frames.so import SO
from cg.support.checks import check_integer


@dataclass(frozen=True, repr=False)
class Stiefel(HomogeneousSpace):
    r"""Matrices of k orthonormal columns, with the action of SO(n): :math:`y' = \Omega(v)\,y`.

    The coefficients are those of `SO`.

    Parameters
    ----------
    n
        Number of rows, at least 2.
    k
        Number of columns, from 1 to ``n``.

    Raises
    ------
    TypeError, ValueError
        If ``n`` or ``k`` isn't an integer or is out of range.

    Notes
    -----
    The flow is that of `SO`, followed by a Newton-Schulz step towards the polar factor [1]_.
    There are no `exp_coordinates`: the rotation between two points is not unique, and the one
    of least norm has no closed form.

    References
    ----------
    .. [1] N. J. Higham, *Functions of Matrices*, SIAM, 2008, section 8.3.

    Examples
    --------
    >>> import numpy as np
    >>> frame = Stiefel(5, 2)
    >>> y = frame.flow(np.arange(10.0), np.eye(5, 2))
    >>> bool(frame.membership_error(y) < 1e-15)
    True
    """

    n: int
    k: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "n", check_integer("n", self.n, 2))
        object.__setattr__(self, "k", check_integer("k", self.k, 1, self.n))

    @cached_property
    def group(self) -> MatrixGroup:
        """The rotations of the ambient space."""
        return SO(self.n, "space")

    @property
    def point_shape(self) -> tuple[int, ...]:
        """The shape ``(n, k)``."""
        return (self.n, self.k)

    def _act(self, x: Points, y: Points) -> Points:
        return np.asarray(x @ y)

    def _act_infinitesimally(self, omega: Points, y: Points) -> Points:
        return np.asarray(omega @ y)

    def restore(self, y: Points) -> Points:
        """Return ``y`` after a Newton-Schulz step towards orthonormal columns."""
        return newton_schulz(y, y.mT)

    def _coefficients_at(self, y: Points, tangent: Points) -> Array:
        # The skew matrix of least norm whose product with y is X = tangent, since y^T X is skew:
        # X y^T - y X^T - y (y^T X) y^T.
        mixed = y.mT @ tangent
        along = 0.5 * (mixed - mixed.mT)
        across = tangent - y @ mixed
        left = (across + 0.5 * (y @ along)) @ y.mT
        return self.group._algebra_projection(left - left.mT)

    def membership_error(self, y: ArrayLike) -> Array:
        """Return the 2-norm distance to the nearest orthonormal columns, shape ``(...)``."""
        return distance_from_unitary(self._points(y), special=False)

    def _project(self, y: Points) -> Points:
        return nearest_unitary(y, special=False)

    def random_point(self, rng: np.random.Generator, size: Size = ()) -> Points:
        """Return points uniform under rotations, shape ``(*size, n, k)``."""
        size = check_random(rng, size)
        return self.restore(random_unitary(rng, (*size, *self.point_shape)))
