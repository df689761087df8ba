"""What all matrix groups share: a basis of the Lie algebra, the flow, and its inverse."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.algebra import MAX_CONSTANTS
from cg.frames.arrays import (
    Array,
    Convention,
    Points,
    Size,
    check_convention,
    check_random,
)
from cg.frames.base import MEMBERSHIP_TOLERANCE, Frame
from cg.frames.dexpinv import frobenius, series_dexpinv
from cg.frames.logarithms import real_log1p
from cg.frames.matrix_functions import (
    MAX_EXPONENT,
    combine,
    distance_from_unitary,
    expm,
    nearest_unitary,
    newton_schulz,
    random_unitary,
)
from cg.support.checks import check_integer, total_memory

# Where the terms of an equation cancel, as at rest, rounding is all that is left of its matrix,
# and is large relative to it. It turns a point by no more than this in a unit of time.
_ALGEBRA_ROUNDING = 1e-12


class MatrixGroup(Frame):
    r"""A group of square matrices with the frame of its left- or right-invariant fields.

    With :math:`\Omega(v) = \sum_i v_i B_i` for a basis :math:`B_i` of the Lie algebra,
    ``convention="body"`` has the fields :math:`y' = y\,\Omega(v)` and ``convention="space"`` has
    :math:`y' = \Omega(v)\,y`.  A group supplies ``dim``, ``size``, ``convention``,
    ``_make_basis`` and ``membership_error``, and closed forms where it has them.

    Examples
    --------
    >>> import numpy as np
    >>> from cg.frames import SU
    >>> group = SU(2)
    >>> isinstance(group, MatrixGroup), group.dim, group.size
    (True, 3, 2)
    >>> group.algebra([0.0, 0.0, 1.0])
    array([[0.-0.5j, 0.+0.j ],
           [0.+0.j , 0.+0.5j]])
    """

    @property
    @abstractmethod
    def convention(self) -> Convention:
        """Which of the two families of fields."""

    @property
    @abstractmethod
    def size(self) -> int:
        """Number of rows of the matrices."""

    @abstractmethod
    def _make_basis(self) -> Points:
        """Return the matrices ``basis``, linearly independent over the reals."""

    @cached_property
    def basis(self) -> Points:
        """The matrices of the fields, shape ``(dim, size, size)``, read-only.

        Raises
        ------
        MemoryError
            If they need more memory than the machine has.
        ValueError
            If ``_make_basis`` of a subclass returns another number or another size of matrices.
        """
        needed = self.dim * self.size**2 * self.dtype.itemsize
        if needed > total_memory():
            raise MemoryError(
                f"{self!r} is too large: the matrices of its {self.dim} fields need "
                f"{needed / 2**30:.3g} GiB of memory, of {total_memory() / 2**30:.3g} GiB"
            )
        basis = np.asarray(self._make_basis(), dtype=self.dtype)
        if basis.shape != (self.dim, *self.point_shape):
            raise ValueError(
                f"_make_basis of {type(self).__name__} must return matrices of shape "
                f"{(self.dim, *self.point_shape)}, got {basis.shape}"
            )
        basis.flags.writeable = False
        return basis

    @property
    @abstractmethod
    def dim(self) -> int:
        """Dimension of the group."""

    @property
    def point_shape(self) -> tuple[int, ...]:
        """The shape ``(size, size)``."""
        return (self.size, self.size)

    @cached_property
    def structure_constants(self) -> Array:
        r"""The numbers in :math:`[B_i, B_j] = \sum_k c_{ijk} B_k`, shape ``(dim, dim, dim)``."""
        products = self.basis[:, None] @ self.basis[None, :]
        constants = self._algebra_projection(products - products.swapaxes(0, 1))
        constants.flags.writeable = False
        return constants

    def algebra(self, v: ArrayLike) -> Points:
        r"""Return :math:`\Omega(v)`, shape ``(..., size, size)``."""
        return combine(self._vectors(v), self.basis)

    def coefficients(self, matrix: ArrayLike) -> Array:
        """Return ``v`` of elements ``algebra(v)`` of the Lie algebra, shape ``(..., dim)``.

        Parameters
        ----------
        matrix
            Shape ``(..., size, size)``.

        Raises
        ------
        ValueError
            If a matrix isn't in the algebra: if an entry is off by more than 1e-8 of the largest
            one, and by more than 1e-12.
        """
        matrices = self._points(matrix, "matrix")
        v = self._algebra_projection(matrices)
        off = matrices - combine(v, self.basis)
        # One dot product settles what f returns at nearly every stage.
        if not np.vdot(off, off).real <= _ALGEBRA_ROUNDING**2:
            self._check_distance(np.abs(off), np.abs(matrices))
        return v

    def _check_distance(self, off: Array, sizes: Array) -> None:
        """Raise ValueError if matrices are too far from the algebra for their size."""
        distance, size = off.max(axis=(-2, -1)), sizes.max(axis=(-2, -1))
        # NaN passes, for the caller to judge.
        wrong = distance > np.maximum(MEMBERSHIP_TOLERANCE * size, _ALGEBRA_ROUNDING)
        if wrong.any():
            relative = float((distance[wrong] / size[wrong]).max())
            raise ValueError(
                f"matrix must be in the Lie algebra of {self!r}: its distance from it is "
                f"{relative:.3g} of its largest entry, more than {MEMBERSHIP_TOLERANCE:g}"
            )

    def _algebra_projection(self, matrices: Points) -> Array:
        """Return the coefficients of the orthogonal projections of matrices onto the algebra."""
        flat = matrices.reshape(*matrices.shape[:-2], math.prod(matrices.shape[-2:]))
        return np.asarray((flat @ self._dual.conj().T).real)

    @cached_property
    def _dual(self) -> Points:
        flat = self.basis.reshape(self.dim, -1)
        return np.asarray(np.linalg.solve((flat @ flat.conj().T).real, flat))

    @property
    def _side(self) -> float:
        """1 where flows act from the left, -1 from the right."""
        return 1.0 if self.convention == "space" else -1.0

    def _bracket(self, u: Array, v: Array) -> Array:
        first, second = self.algebra(u), self.algebra(v)
        return self._side * self._algebra_projection(first @ second - second @ first)

    def _dexpinv(self, u: Array, v: Array, order: int) -> Array:
        if self.dim <= MAX_CONSTANTS:
            return super()._dexpinv(u, v, order)
        generator, side = self.algebra(u), self._side
        bound = 2.0 * frobenius(generator)

        def adjoint(x: Points) -> Points:
            return np.asarray(side * (generator @ x - x @ generator))

        total = series_dexpinv(adjoint, self.algebra(v), order, bound, axes=2)
        return self._algebra_projection(total)

    def exponential(self, v: ArrayLike) -> Points:
        r"""Return :math:`e^{\Omega(v)}`, shape ``(..., size, size)``."""
        vector = self._vectors(v)
        return expm(self.algebra(vector), vector)

    def logarithm(self, x: ArrayLike) -> Array:
        """Return the smallest ``v`` with ``exponential(v) == x``, NaN where there is none.

        Near the identity it has the relative accuracy of the difference from it.
        """
        return self._log1p(self._points(x, "x") - np.eye(self.size))

    def _log1p(self, away: Points) -> Array:
        """Return the logarithm of the identity plus ``away``, shape ``(..., size, size)``."""
        return self._algebra_projection(real_log1p(away))

    def affine_exponential(self, v: ArrayLike, columns: Array) -> tuple[Points, Points]:
        r"""Return the blocks of the exponential of :math:`\Omega(v)` bordered by columns.

        Parameters
        ----------
        v
            Shape ``(..., dim)``.
        columns
            The border :math:`U`, shape ``(..., size, k)``.

        Returns
        -------
        linear : ndarray
            :math:`e^{\Omega}`, shape ``(..., size, size)``.
        moved : ndarray
            :math:`\int_0^1 e^{s\Omega} ds\, U`, shape ``(..., size, k)``.
        """
        vector = self._vectors(v)
        generator = self.algebra(vector)
        n, k = columns.shape[-2:]
        lead = np.broadcast_shapes(generator.shape[:-2], columns.shape[:-2])
        bordered = np.zeros((*lead, n + k, n + k), dtype=self.dtype)
        bordered[..., :n, :n] = generator
        bordered[..., :n, n:] = columns
        exponential = expm(bordered, vector)
        return exponential[..., :n, :n], exponential[..., :n, n:]

    def inverse(self, x: ArrayLike) -> Points:
        """Return the inverses of group elements, shape ``(..., size, size)``."""
        return np.asarray(np.linalg.inv(self._points(x, "x")))

    def restore(self, y: Points) -> Points:
        """Return ``y`` with rounding errors off the group removed."""
        return y

    def field(self, v: ArrayLike, y: ArrayLike) -> Points:
        """Return ``y @ algebra(v)`` (body) or ``algebra(v) @ y`` (space)."""
        vector, point = self._arguments(v, y)
        return self._multiply(self.algebra(vector), point)

    def flow(self, v: ArrayLike, y: ArrayLike) -> Points:
        """Return ``y @ exponential(v)`` (body) or ``exponential(v) @ y`` (space).

        Raises
        ------
        ValueError
            If the trailing axes have other lengths.
        """
        vector, point = self._arguments(v, y)
        return self.restore(self._multiply(self.exponential(vector), point))

    def _multiply(self, x: Points, y: Points) -> Points:
        return np.asarray(y @ x if self.convention == "body" else x @ y)

    def exp_coordinates(self, y0: ArrayLike, y1: ArrayLike) -> Array:
        """Return the logarithm of the quotient of ``y1`` and ``y0``.

        It is NaN where there is none, or where its flow from ``y0`` misses ``y1`` by more than
        1e-8 of that, since rounding is all there is of the quotient.
        """
        start, end = self._points(y0, "y0"), self._points(y1, "y1")
        # Rounding may have made points singular, whose inverses would end in an error.
        regular = (np.linalg.slogdet(start)[0] != 0.0)[..., None, None]
        inverse = self.inverse(np.where(regular, start, np.eye(self.size)))
        # Of the quotient less the identity this keeps the digits that points nearby have.
        with np.errstate(over="ignore", invalid="ignore"):
            difference = end - start
            body = self.convention == "body"
            away = inverse @ difference if body else difference @ inverse
        finite = (regular & np.isfinite(away)).all(axis=(-2, -1))[..., None]
        coordinates = self._log1p(np.where(finite[..., None], away, 0.0))
        return self._reaching(np.where(finite, coordinates, np.nan), start, end)

    def _reaching(self, v: Array, start: Points, end: Points) -> Array:
        """Return coefficients, NaN where their flow doesn't lead to the end."""
        known = np.asarray(np.linalg.matrix_norm(self.algebra(v)) <= MAX_EXPONENT)
        with np.errstate(over="ignore", invalid="ignore"):
            off = np.linalg.matrix_norm(self.flow(np.where(known[..., None], v, 0.0), start) - end)
            reached = known & (off <= MEMBERSHIP_TOLERANCE * np.linalg.matrix_norm(end))
        return np.where(reached[..., None], v, np.nan)

    def random_point(self, rng: np.random.Generator, size: Size = ()) -> Points:
        """Return exponentials of normal coefficients of deviation 1/2."""
        return self.restore(self.exponential(0.5 * self.random_vector(rng, size)))


class UnitaryMatrixGroup(MatrixGroup):
    """A group of unitary or orthogonal matrices, whose inverses are their adjoints."""

    _special: ClassVar[bool] = False

    def _reaching(self, v: Array, start: Points, end: Points) -> Array:
        return v  # from eigenvalues, which have all their digits

    def inverse(self, x: ArrayLike) -> Points:
        """Return the conjugate transposes, which on the group are the inverses."""
        return np.asarray(self._points(x, "x").mT.conj())

    def restore(self, y: Points) -> Points:
        """Return ``y`` after a Newton-Schulz step towards the group."""
        return newton_schulz(y, self.inverse(y))

    def membership_error(self, y: ArrayLike) -> Array:
        """Return the 2-norm distance to the nearest element of the group, shape ``(...)``."""
        return distance_from_unitary(self._points(y), special=self._special)

    def _project(self, y: Points) -> Points:
        # The polar factor; where the determinant must be 1, as near to it as that allows.
        return nearest_unitary(y, special=self._special)

    def random_point(self, rng: np.random.Generator, size: Size = ()) -> Points:
        """Return points uniform in Haar measure, shape ``(*size, size, size)``."""
        size = check_random(rng, size)
        point = random_unitary(rng, (*size, *self.point_shape), complex_=self.dtype.kind == "c")
        if self._special:
            # Multiplying a column commutes with the action of the group from the left.
            point[..., 0] /= np.linalg.det(point)[..., None]
        return self.restore(point)


@dataclass(frozen=True, repr=False)
class SizedMatrixGroup(MatrixGroup):
    """A matrix group of a family that is numbered by the size of its matrices.

    Parameters
    ----------
    n
        Number of rows.
    convention
        ``"body"`` or ``"space"``.

    Raises
    ------
    ValueError
        If ``n`` is no integer or too small, or ``convention`` is neither of the two.
    """

    n: int
    convention: Convention = "space"

    smallest: ClassVar[int] = 1

    def __post_init__(self) -> None:
        object.__setattr__(self, "n", check_integer("n", self.n, self.smallest))
        check_convention(self.convention)

    @property
    def size(self) -> int:
        """Number of rows, ``n``."""
        return self.n
