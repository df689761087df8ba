"""The Lie algebra of a frame's fields: brackets, and derivatives of exponential coordinates."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.block_kinds import SPACE_AXES
from cg.frames.compiled import dexpinv
from cg.frames.dexpinv import series_dexpinv
from cg.support.arrays import Array, is_array, real_array
from cg.support.checks import check_integer
from cg.support.shared_numbers import BlockKind

# Largest dimension for which brackets by structure constants are faster than products of matrices.
MAX_CONSTANTS = 16
_MAX_ORDER = 200  # largest accepted order of a Runge-Kutta method


class FieldAlgebra(ABC):
    """The Lie algebra that the fields of a frame span, with bracket and dexpinv."""

    @property
    @abstractmethod
    def dim(self) -> int:
        """Number of vector fields, the length of ``v``."""

    def bracket(self, u: ArrayLike, v: ArrayLike) -> Array:
        r"""Return the coefficients of the commutator of two fields.

        The sign is that of the Baker-Campbell-Hausdorff series of the time-1 flows
        :math:`\Phi_v` of :math:`\sum_i v_i E_i`,

        .. math:: \Phi_u \circ \Phi_v = \Phi_w, \qquad w = u + v + \tfrac12 [u, v] + \dots,

        so that the commutator of fields U and V is :math:`DU\,V - DV\,U`. Where flows act from
        the left (``convention="space"``, homogeneous spaces) the matrix of :math:`[u, v]` is
        :math:`\Omega(u) \Omega(v) - \Omega(v) \Omega(u)`; where they act from the right
        (``"body"``) it is the negative.

        Raises
        ------
        NotImplementedError
            If the frame does not define a bracket, or its fields do not span a Lie algebra.

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
        r"""Return the derivative of the exponential coordinates u of a point with velocity v.

        If :math:`\Phi_{u(t)}(y_0)` solves :math:`y' = \sum_i v_i E_i(y)`, then :math:`u' =
        \operatorname{dexp}_u^{-1} v`; see `cg.frames.dexpinv`. Rotations, quaternions, SU(2),
        rigid motions, the 2-sphere and Euclidean space use closed forms.

        Parameters
        ----------
        order
            Order of the Runge-Kutta method that uses the result. Other frames sum the series up to
            the power ``order`` of u.

        Returns
        -------
        ndarray
            Shape ``(..., dim)``; NaN where the infinite series diverges, as for rotation angles of
            :math:`2\pi` or more, unless u and v commute.

        Raises
        ------
        NotImplementedError
            If the frame has no `bracket`.
        """
        order = check_integer("order", order, 1, _MAX_ORDER)
        return self._dexpinv(self._vectors(u, "u"), self._vectors(v), order)

    def _dexpinv(self, u: Array, v: Array, order: int) -> Array:
        """Return dexpinv of checked coefficients, in closed form or as a series."""
        if sign := self._rotation_sign:
            return dexpinv((BlockKind.SO3, 3, SPACE_AXES if sign > 0.0 else 0), u, v)
        if self.dim <= MAX_CONSTANTS:
            flat = u @ self._adjoint_basis.reshape(self.dim, -1)
            matrix = flat.reshape(*u.shape, self.dim)
            bound = np.asarray(np.linalg.matrix_norm(matrix))
            return series_dexpinv(lambda w: (w[..., None, :] @ matrix)[..., 0, :], v, order, bound)
        bound = np.asarray(np.linalg.matrix_norm(self._bracket(u[..., None, :], np.eye(self.dim))))
        return series_dexpinv(lambda w: self._bracket(u, w), v, order, bound)

    @cached_property
    def _adjoint_basis(self) -> Array:
        """The brackets of all pairs of basis elements, shape ``(dim, dim, dim)``."""
        basis = np.eye(self.dim)
        return np.ascontiguousarray(self._bracket(basis[:, None], basis))

    def _vectors(self, v: ArrayLike, name: str = "v") -> Array:
        """Return ``v`` as a float64 array whose last axis has length ``dim``."""
        vector = v if is_array(v, np.float64) else real_array(v, name)
        if vector.ndim == 0 or vector.shape[-1] != self.dim:
            raise ValueError(f"{name} must have shape (..., {self.dim}), got {vector.shape}")
        return vector
