r"""The Lie algebra of a frame's fields: brackets, and derivatives of exponential coordinates.

If :math:`y(t) = \exp(\sigma(t))\, y_0` solves :math:`y' = \sum_i f_i E_i(y)`, then

.. math::

    \sigma' = \operatorname{dexp}^{-1}_\sigma f = \sum_k \frac{B_k}{k!} \operatorname{ad}_\sigma^k f
    = f - \tfrac12 [\sigma, f] + \tfrac1{12} [\sigma, [\sigma, f]] - \dots

with the Bernoulli numbers and the bracket of `Frame.bracket`, for flows from either side. The
series converges if the powers of :math:`\operatorname{ad}_\sigma` applied to :math:`f` grow by a
factor less than :math:`2\pi`, the distance to the nearest zero of :math:`\operatorname{dexp}`;
where it diverges the results are NaN. For rotations the radius is a full turn. The result is
:math:`f` if :math:`f` and :math:`\sigma` commute.

References
----------
.. [1] A. Iserles, H. Z. Munthe-Kaas, S. P. Norsett, A. Zanna, "Lie-group methods", Acta
   Numerica 9 (2000), 215-365, section 2.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from fractions import Fraction
from functools import cache, cached_property, partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cg.frames.blocks import Blocks, dexpinv
from cg.support.arrays import Array, is_array, real_array
from cg.support.checks import check_integer
from cg.support.shared_numbers import COMMUTING_ROUNDINGS, BlockKind, BlockOption

# Largest dimension for which brackets by structure constants are faster than products of matrices.
MAX_CONSTANTS = 16
_MAX_ORDER = 200  # largest accepted order of a Runge-Kutta method
_MIN_SIZE = 1e-150  # its square doesn't underflow
RADIUS = 2.0 * math.pi  # where the series of dexpinv ceases to converge
POWERS = 20  # number of powers of ad_u; the latter half gives the rate of growth


@cache
def bernoulli_terms(count: int) -> tuple[Fraction, ...]:
    """Return B_k / k! for k = 0, …, count."""
    terms = [Fraction(1)]
    for k in range(1, count + 1):
        terms.append(-sum((terms[j] / math.factorial(k + 1 - j) for j in range(k)), Fraction(0)))
    return tuple(terms)


def series_dexpinv(
    adjoint: Callable[[Array], Array], v: Array, order: int, bound: Array | None = None, *,
    axes: int = 1,
) -> Array:  # fmt: skip
    """Return the dexpinv series, truncated for a Runge-Kutta method of a given order.

    ``adjoint`` returns the bracket of u with its argument; v are coefficients, shape ``(...,
    dim)``, or other elements of a linear space with ``axes`` axes. Powers are taken up to
    ``order``. The order of a step needs powers up to ``order - 2``, since the coefficients of
    stages differ from multiples of u by the square of the step; but then errors of long steps
    exceed their estimates by far. The result is NaN where the infinite series diverges by
    ``bound``, shape ``(...)``, of the eigenvalues of ``adjoint``.
    """
    total, power = v, v
    terms = series_terms(order)
    for term in terms:
        power = adjoint(power)
        if term:
            total = total + term * power
    if terms and bound is not None and (far := bound >= RADIUS).any():
        growth, commuting = _growth(adjoint, v, bound, axes)
        far = far.reshape(*far.shape, *[1] * axes)
        finite = np.isfinite(bound).reshape(far.shape)  # after overflow, growth is unknown
        sums = ~far | (finite & (growth < RADIUS))
        total = np.where(far & finite & commuting, v, np.where(sums, total, np.nan))
    return total


def _growth(
    adjoint: Callable[[Array], Array], v: Array, bound: Array, axes: int
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the growth factor of high powers of `adjoint` on ``v``, and whether they commute."""
    size = partial(np.linalg.vector_norm, axis=tuple(range(-axes, 0)), keepdims=True)
    rounding = COMMUTING_ROUNDINGS * np.finfo(np.float64).eps * bound
    rounding = rounding.reshape(*bound.shape, *[1] * axes)
    power = v / np.maximum(size(v), _MIN_SIZE)
    factors = []
    for _ in range(POWERS):
        power = adjoint(power)
        factor = size(power)
        factors.append(np.where(factor > rounding, factor, 0.0))
        power = np.where(factor > rounding, power / np.where(factor > 0.0, factor, 1.0), 0.0)
    later = factors[POWERS // 2 :]
    return np.prod(later, axis=0) ** (1.0 / len(later)), factors[0] == 0.0


@cache
def series_terms(order: int) -> tuple[float, ...]:
    """Return the coefficients of the powers 1, 2, ... up to the last nonzero one."""
    terms = [float(term) for term in bernoulli_terms(max(order, 0))[1:]]
    while terms and not terms[-1]:
        terms.pop()
    return tuple(terms)


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
        >>> import crouch_grossman as cg
        >>> cg.frames.SO3("space").bracket([1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
        array([0., 0., 1.])
        """
        return self._bracket(self._vectors(u, "u"), self._vectors(v))

    @property
    def _rotation_sign(self) -> float:
        """The sign s of a bracket that is s times the cross product, 0 for other brackets."""
        match self._blocks():
            case ((BlockKind.SO3 | BlockKind.SU2 | BlockKind.QUATERNION, _, options),):
                return 1.0 if options & BlockOption.SPACE_AXES else -1.0
        return 0.0

    def _blocks(self) -> Blocks | None:
        """Return the blocks of an instance of exactly this class; compiled frames define it."""
        return None

    def _bracket(self, u: Array, v: Array) -> Array:
        """Return the brackets of checked coefficients."""
        if sign := self._rotation_sign:
            return np.asarray(sign * np.cross(u, v))
        raise NotImplementedError(f"{self!r} has no bracket of its fields")

    def dexpinv(self, u: ArrayLike, v: ArrayLike, *, order: int = 8) -> Array:
        r"""Return the derivative of the exponential coordinates u of a point with velocity v.

        If :math:`\Phi_{u(t)}(y_0)` solves :math:`y' = \sum_i v_i E_i(y)`, then :math:`u' =
        \operatorname{dexp}_u^{-1} v`; see `cg.frames.algebra`. Rotations, quaternions, SU(2),
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
            options = BlockOption.SPACE_AXES if sign > 0.0 else 0
            return dexpinv(((BlockKind.SO3, 3, options),), u, v)
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
