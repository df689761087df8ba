"""Homogeneous spaces: manifolds on which a matrix group acts."""

from __future__ import annotations

from abc import abstractmethod
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.base import Frame
from cg.frames.manifold import usable_or_zero
from cg.frames.matrix_group import MatrixGroup
from cg.support.arrays import Array, Points


class HomogeneousSpace(Frame):
    r"""A manifold on which a matrix group acts linearly from the left.

    The fields are those of the action, :math:`y' = \tfrac{d}{ds} e^{s\Omega(v)} \cdot y` at
    :math:`s = 0`, and their flow is :math:`e^{\Omega(v)} \cdot y`. The coefficients are those of
    the group; usually there are more of them than the manifold has dimensions, so that different
    coefficients may have the same tangent.

    A subclass defines

    - ``group``: the `MatrixGroup` that acts, with ``convention="space"``;
    - ``_act(x, y)``: the point to which the group element ``x`` takes ``y``, for batches;
    - ``_act_infinitesimally(omega, y)``: the derivative of ``_act(exp(s omega), y)`` by s at zero,
      where ``omega`` is a matrix of the Lie algebra;
    - ``restore(y)``: the point without rounding errors normal to the manifold;
    - ``point_shape``, ``membership_error`` and ``random_point``, which are abstract in `Frame`.

    Brackets and dexp⁻¹ are those of the group. `cg.frames.check` verifies that the members are
    consistent.

    References
    ----------
    .. [1] A. Iserles, H. Z. Munthe-Kaas, S. P. Norsett, A. Zanna, "Lie-group methods", Acta
       Numerica 9 (2000), 215-365.

    Examples
    --------
    Symmetric matrices with the action of rotations by conjugation:

    >>> import numpy as np
    >>> import crouch_grossman as cg
    >>> class Symmetric(cg.frames.HomogeneousSpace):
    ...     group = cg.frames.SO(3, "space")
    ...     point_shape = (3, 3)
    ...
    ...     def _act(self, x, y):
    ...         return x @ y @ x.mT
    ...
    ...     def _act_infinitesimally(self, omega, y):
    ...         return omega @ y - y @ omega
    ...
    ...     def restore(self, y):
    ...         return 0.5 * (y + y.mT)
    ...
    ...     def membership_error(self, y):
    ...         return np.abs(y - y.mT).max(axis=(-2, -1))
    ...
    ...     def random_point(self, rng, size=()):
    ...         return self.restore(rng.standard_normal((*np.atleast_1d(size).astype(int), 3, 3)))
    >>> space = Symmetric()
    >>> cg.frames.check(space)
    >>> space.flow([np.pi / 2, 0.0, 0.0], np.diag([1.0, 2.0, 3.0])).diagonal().round(12)
    array([1., 3., 2.])
    """

    @property
    @abstractmethod
    def group(self) -> MatrixGroup:
        """The group that acts."""

    @property
    def dim(self) -> int:
        return self.group.dim

    @abstractmethod
    def _act(self, x: Points, y: Points) -> Points:
        """Return the point to which the group element ``x`` takes ``y``."""

    @abstractmethod
    def _act_infinitesimally(self, omega: Points, y: Points) -> Points:
        """Return the tangent at ``y`` of the element ``omega`` of the Lie algebra."""

    def _correct(self, v: Array, start: Points, y: Points, end: Points, exact: Any) -> Array:
        # The logarithm of the product of group elements composes the two flows exactly.
        further = self.group.exponential(usable_or_zero(self._coefficients_at(y, end - y)))
        return self.group.logarithm(further @ self.group.exponential(v))

    def _composed(self, flows: Array) -> Array:
        if self.compiled_blocks() is not None:  # in a product as alone in compiled code
            return super()._composed(flows)
        with np.errstate(over="ignore", invalid="ignore"):
            product = reduce(lambda x, y: y @ x, self.group.exponential(flows))
            return self.group.logarithm(product)

    def _bracket(self, u: Array, v: Array) -> Array:
        # The group acts from the left, like its fields of the convention "space".
        return self.group._bracket(u, v)

    def _dexpinv(self, u: Array, v: Array, order: int) -> Array:
        return self.group._dexpinv(u, v, order)

    @abstractmethod
    def restore(self, y: Points) -> Points:
        """Return ``y`` without the rounding errors normal to the manifold."""

    def field(self, v: ArrayLike, y: ArrayLike) -> Points:
        vector, point = self._arguments(v, y)
        return self._act_infinitesimally(self.group.algebra(vector), point)

    @np.errstate(over="ignore", invalid="ignore")
    def flow(self, v: ArrayLike, y: ArrayLike) -> Points:
        vector, point = self._arguments(v, y)
        return self.restore(self._act(self.group.exponential(vector), point))


class ConjugationSpace(HomogeneousSpace):
    r"""Matrices on which a group acts by :math:`y \mapsto x\,y\,x^*`."""

    @property
    def point_shape(self) -> tuple[int, ...]:
        return self.group.point_shape

    def _act(self, x: Points, y: Points) -> Points:
        return np.asarray(x @ y @ x.mT.conj())

    def _act_infinitesimally(self, omega: Points, y: Points) -> Points:
        return np.asarray(omega @ y + y @ omega.mT.conj())
