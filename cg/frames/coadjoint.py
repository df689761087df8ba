"""Coadjoint orbits, the phase spaces of Lie-Poisson systems."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.base import Frame
from cg.frames.matrix_functions import combine, expm, newton_corrected
from cg.frames.matrix_group import MatrixGroup
from cg.frames.rotations import SO3, hat
from cg.support.arrays import CONVENTIONS, Array, Convention, Size, real_array
from cg.support.checks import check_choice

_ZERO = 1e-12  # relative to the largest one: errors of identities, and singular values


@dataclass(frozen=True, repr=False)
class CoadjointOrbit(Frame):
    r"""A coadjoint orbit in the dual of a Lie algebra, the phase space of a Lie-Poisson system.

    With structure constants :math:`[e_i, e_j] = \sum_k c_{ijk} e_k` the fields are
    :math:`y' = \operatorname{ad}^*_v y`, :math:`y_j' = \sum_{ik} v_i c_{ijk} y_k`. On
    :math:`so(3)^*` this is :math:`y' = y \times v`, the free rigid body if :math:`v` is the
    angular velocity that belongs to the angular momentum :math:`y`.

    Parameters
    ----------
    algebra
        A matrix group, for the structure constants of its basis; its convention is ignored.
    point
        A point of the orbit, shape ``(m,)``.
    convention
        ``"body"``: :math:`y' = \operatorname{ad}^*_v y` (default), ``"space"``:
        :math:`y' = -\operatorname{ad}^*_v y`, for systems reduced from the right.

    Notes
    -----
    The linear and the quadratic Casimir functions (on :math:`so(3)^*` the norm, on
    :math:`se(3)^*` the norm of the linear momentum and its product with the angular one) are
    computed from the structure constants. Their values at ``point`` define the manifold, each
    flow ends with a Gauss-Newton step back to them, and `membership_error` is the length of such
    a step. The flow conserves Casimirs of higher degree, such as that of su(3), to rounding, but
    they are not restored. The flow is a rotation on :math:`so(3)^*` and ``scipy.linalg.expm``
    for other algebras.

    References
    ----------
    .. [1] J. E. Marsden, T. S. Ratiu, *Introduction to Mechanics and Symmetry*, 2nd ed.,
       Springer, 1999, chapters 13 and 14.

    Examples
    --------
    >>> import numpy as np
    >>> import crouch_grossman as cg
    >>> frame = cg.frames.CoadjointOrbit(cg.frames.SO3(), (2.0, 0.0, 0.0))
    >>> frame.flow([0.0, 0.0, np.pi / 2], [2.0, 0.0, 0.0]).round(15) + 0.0
    array([ 0., -2.,  0.])
    """

    algebra: MatrixGroup
    point: tuple[float, ...]
    convention: Convention = "body"

    def __post_init__(self) -> None:
        check_choice("convention", self.convention, CONVENTIONS)
        if not isinstance(self.algebra, MatrixGroup):
            raise TypeError(f"algebra must be a MatrixGroup, got {self.algebra!r}")
        point = real_array(self.point, "point")
        if point.shape != self.point_shape or not np.isfinite(point).all():
            raise ValueError(
                f"point must be {self.dim} finite numbers, as many as the algebra has "
                f"dimensions, got {self.point!r}"
            )
        object.__setattr__(self, "point", tuple(point.tolist()))

    @property
    def dim(self) -> int:
        return self.algebra.dim

    @property
    def point_shape(self) -> tuple[int, ...]:
        return (self.dim,)

    @cached_property
    def _fields(self) -> Array:
        """The matrices of the fields, shape ``(dim, dim, dim)``."""
        constants = self.algebra.structure_constants
        return constants if self.convention == "body" else -constants

    @cached_property
    def _rotation_sign(self) -> float:
        """The sign s of fields that are s times v cross y, 0 for other fields."""
        if self.dim == 3:
            for sign in (-1.0, 1.0):
                if np.array_equal(self._fields, sign * hat(np.eye(3))):
                    return sign
        return 0.0

    def field(self, v: ArrayLike, y: ArrayLike) -> Array:
        vector, point = self._arguments(v, y)
        return np.asarray((combine(vector, self._fields) @ point[..., None])[..., 0])

    def flow(self, v: ArrayLike, y: ArrayLike) -> Array:
        vector, point = self._arguments(v, y)
        if self._rotation_sign:
            matrix = SO3("space").exponential(self._rotation_sign * vector)
        else:
            matrix = expm(combine(vector, self._fields), vector)
        return self.restore((matrix @ point[..., None])[..., 0])

    def turning_coefficients(self) -> Array:
        return self.algebra.turning_coefficients()

    def _coefficients_at(self, y: Array, tangent: Array) -> Array:
        if not self._rotation_sign or not any(self.point):
            return super()._coefficients_at(y, tangent)
        square = np.vecdot(y, y)[:, None]
        return np.asarray(self._rotation_sign / square * np.cross(y, tangent))

    def _bracket(self, u: Array, v: Array) -> Array:
        if self._rotation_sign:
            return super()._bracket(u, v)
        # The matrices of the fields are those of ad, transposed and perhaps with the other sign.
        return -np.asarray((v[..., None, :] @ combine(u, self._fields))[..., 0, :])

    @cached_property
    def linear_casimirs(self) -> Array:
        """Rows ``c`` with ``c @ y`` constant on every orbit, shape ``(count, dim)``."""
        return _null_space(self._fields.reshape(-1, self.dim, self.dim).mT)

    @cached_property
    def quadratic_casimirs(self) -> Array:
        """Symmetric ``C`` with ``y @ C @ y`` constant on orbits, shape ``(count, dim, dim)``."""
        rows, columns = np.triu_indices(self.dim)
        k = np.arange(len(rows))
        symmetric = np.zeros((len(rows), self.dim, self.dim))
        symmetric[k, rows, columns] = symmetric[k, columns, rows] = 1.0
        products = symmetric @ self._fields[:, None]
        derivatives = (products + products.mT).reshape(self.dim, len(rows), -1).mT
        return combine(_null_space(derivatives), symmetric)

    def _correction(self, y: Array) -> tuple[Array, Array]:
        """Return the Casimirs' excess over their values at ``point``, and what to subtract."""
        base_point = np.array(self.point)
        linear, quadratic = self.linear_casimirs, self.quadratic_casimirs
        difference = y - base_point
        middle = (quadratic @ (y + base_point)[..., None, :, None])[..., 0]
        excess = (middle @ difference[..., None])[..., 0]
        excess = np.concatenate([difference @ linear.T, excess], axis=-1)
        gradients = 2.0 * (quadratic @ y[..., None, :, None])[..., 0]
        constant = np.broadcast_to(linear, (*y.shape[:-1], *linear.shape))
        gradients = np.concatenate([constant, gradients], axis=-2)
        if gradients.shape[-2] == 1:
            square = np.vecdot(gradients, gradients)
            multiplier = np.divide(excess, square, out=np.zeros_like(square), where=square > 0.0)
            return excess, multiplier * gradients[..., 0, :]
        inverse = np.linalg.pinv(gradients, rcond=_ZERO)
        return excess, (inverse @ excess[..., None])[..., 0]

    def restore(self, y: Array) -> Array:
        """Return ``y`` after a Gauss-Newton step to the orbit's Casimirs."""
        finite = np.isfinite(y).all(axis=-1, keepdims=True)
        return np.asarray(y - self._correction(np.where(finite, y, self.point))[1])

    def _project(self, y: Array) -> Array:
        # Nearest up to the square of the distance; cubic Casimirs are not corrected.
        return newton_corrected(y, lambda x: -self._correction(x)[1])

    def membership_error(self, y: ArrayLike) -> Array:
        """Return the length of the step back to the orbit's Casimirs, shape ``(...)``.

        It is at least the largest excess of a Casimir, divided by twice the length of ``point`` or
        by 1, which matters where the gradients are linearly dependent.
        """
        excess, step = self._correction(self._points(y))
        scale = max(2.0 * float(np.linalg.norm(self.point)), 1.0)
        largest = np.abs(excess).max(axis=-1, initial=0.0) / scale
        return np.asarray(np.maximum(np.linalg.norm(step, axis=-1), largest))

    def relative_error(self, y: ArrayLike) -> Array:
        """Return the membership error divided by the length of ``point``, shape ``(...)``."""
        return np.asarray(self.membership_error(y) / (np.linalg.norm(self.point) or 1.0))

    def random_point(self, rng: np.random.Generator, size: Size = ()) -> Array:
        """Return ``point`` after two flows with normal coefficients."""
        y = self.flow(self.random_vector(rng, size), np.array(self.point))
        return self.flow(self.random_vector(rng, size), y)


def _null_space(matrices: Array) -> Array:
    """Return an orthonormal basis, as rows, of the common null space of a stack of matrices."""
    gram = (matrices.mT @ matrices).sum(axis=0)
    values, vectors = np.linalg.eigh(gram)
    return np.asarray(vectors.T[values <= _ZERO * max(float(values[-1]), _ZERO)])
