"""The Lie algebra of a frame's fields: brackets, and derivatives of exponential coordinates."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.arrays import Array, is_array, real_array
from cg.frames.dexpinv import frobenius, rotation_dexpinv, series_dexpinv
from cg.support.checks import check_integer

# Up to this dimension products of coefficients with structure constants take less time than those
# of matrices.
MAX_CONSTANTS = 16
_MAX_ORDER = 200  # of a Runge-Kutta method, which all the terms of the series serve


class FieldAlgebra(ABC):
    """What a frame knows of the commutators of its fields."""

    @property
    @abstractmethod
    def dim(self) -> int:
        """Number of vector fields, the length of ``v``."""

    def bracket(self, u: ArrayLike, v: ArrayLike) -> Array:
        r"""Return the coefficients of the commutator of two fields.

        With :math:`\Phi_v` the time-1 flow of :math:`\sum_i v_i E_i`, it is the one in

        .. math:: \Phi_u \circ \Phi_v = \Phi_w, \qquad w = u + v + \tfrac12 [u, v] + \dots,

        the series of Baker, Campbell, Hausdorff, and for fields U and V it is :math:`DU\,V -
        DV\,U`.  Where flows act from the left (``convention="space"``, homogeneous spaces) the
        matrix of :math:`[u, v]` is :math:`\Omega(u) \Omega(v) - \Omega(v) \Omega(u)`; where they
        act from the right (``"body"``) it is the negative.

        Parameters
        ----------
        u, v
            Coefficients, shape ``(..., dim)``; leading axes broadcast.

        Returns
        -------
        ndarray
            Shape ``(..., dim)``.

        Raises
        ------
        NotImplementedError
            If the fields of this frame are no Lie algebra, or none that is known.
        ValueError
            If a last axis hasn't length ``dim``.

        Examples
        --------
        >>> from cg.frames import SO3
        >>> SO3("space").bracket([1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
        array([0., 0., 1.])
        """
        return self._bracket(self._vectors(u, "u"), self._vectors(v))

    @property
    def _rotation_sign(self) -> float:
        """The sign s of a bracket that is s times the cross product, 0 for other brackets."""
        return 0.0

    def _bracket(self, u: Array, v: Array) -> Array:
        """Return the brackets of checked coefficients."""
        if sign := self._rotation_sign:
            return np.asarray(sign * np.cross(u, v))
        raise NotImplementedError(f"{self!r} has no bracket of its fields")

    def dexpinv(self, u: ArrayLike, v: ArrayLike, *, order: int = 8) -> Array:
        r"""Return the derivative of the coordinates u of a point that moves with coefficients v.

        If :math:`\Phi_{u(t)}(y_0)` solves :math:`y' = \sum_i v_i E_i(y)`, then :math:`u' =
        \operatorname{dexp}_u^{-1} v`; see `cg.frames.dexpinv`.  It is exact on rotations,
        quaternions, SU(2), rigid motions, the sphere in space and Euclidean space.

        Parameters
        ----------
        u, v
            Coefficients, shape ``(..., dim)``; leading axes broadcast.
        order
            Elsewhere the series is summed as far as a Runge-Kutta method of this order needs it,
            up to the power ``order - 2`` of u.

        Returns
        -------
        ndarray
            Shape ``(..., dim)``, NaN where the series to infinite order diverges: for rotations by
            a turn or more, unless they commute with v.

        Raises
        ------
        NotImplementedError
            If the frame has no `bracket`.
        ValueError
            If a last axis hasn't length ``dim``, or ``order`` is no positive integer.
        """
        order = check_integer("order", order, 1, _MAX_ORDER)
        return self._dexpinv(self._vectors(u, "u"), self._vectors(v), order)

    def _dexpinv(self, u: Array, v: Array, order: int) -> Array:
        """Return dexpinv of checked coefficients, in closed form or as a series."""
        if sign := self._rotation_sign:
            return rotation_dexpinv(u, v, sign)
        if self.dim <= MAX_CONSTANTS:
            flat = u @ self._adjoint_basis.reshape(self.dim, -1)
            matrix = flat.reshape(*u.shape, self.dim)
            bound = frobenius(matrix)
            return series_dexpinv(lambda w: (w[..., None, :] @ matrix)[..., 0, :], v, order, bound)
        bound = frobenius(self._bracket(u[..., None, :], np.eye(self.dim)))
        return series_dexpinv(lambda w: self._bracket(u, w), v, order, bound)

    @cached_property
    def _adjoint_basis(self) -> Array:
        """The brackets of basis elements with all others, shape ``(dim, dim, dim)``."""
        basis = np.eye(self.dim)
        return np.ascontiguousarray(self._bracket(basis[:, None], basis))

    def _vectors(self, v: ArrayLike, name: str = "v") -> Array:
        """Return ``v`` as a float64 array whose last axis has length ``dim``."""
        vector = v if is_array(v, np.float64) else real_array(v, name)
        if vector.ndim == 0 or vector.shape[-1] != self.dim:
            raise ValueError(f"{name} must have shape (..., {self.dim}), got {vector.shape}")
        return vector
