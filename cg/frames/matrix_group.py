"""Matrix groups: a basis of the Lie algebra, the exponential, the logarithm and flows."""

from __future__ import annotations

import math
from abc import abstractmethod
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from cg.frames.algebra import MAX_CONSTANTS, series_dexpinv
from cg.frames.base import Frame
from cg.frames.blocks import CLOSED_COORDINATES, Block, coordinates_between, move
from cg.frames.manifold import MEMBERSHIP_TOLERANCE
from cg.frames.matrix_functions import MAX_EXPONENT, combine, expm, real_log1p
from cg.support.arrays import Array, Convention, Points, Size, read_only

MAX_DENSE = 16
"""Largest number of rows for which products with all matrices of the fields, of n^4 operations,
take less time than those with their few entries."""
# Absolute tolerance for the distance of a matrix from the algebra: at equilibria the matrix that f
# computes is rounding error, which is large relative to the matrix itself.
_ALGEBRA_ROUNDING = 1e-12

Indices = NDArray[np.intp]
Term = tuple[Indices, Indices, NDArray[Any]]  # a row, a column and a value of each matrix


class Entries(NamedTuple):
    """The number of each field, the index in its flat matrix, and the value."""

    fields: Indices
    indices: Indices
    values: NDArray[Any]

    def array(self, fields: int, rows: int) -> Points:
        """Return the matrices, shape ``(fields, rows, rows)``."""
        flat = np.zeros((fields, rows * rows), dtype=self.values.dtype)
        np.add.at(flat, (self.fields, self.indices), self.values)
        return flat.reshape(fields, rows, rows)

    def sparse(self, fields: int, rows: int) -> scipy.sparse.csr_array:
        """Return the matrices as rows of a sparse array, shape ``(fields, rows**2)``."""
        flat = scipy.sparse.csr_array(
            (self.values, (self.fields, self.indices)), shape=(fields, rows * rows)
        )
        flat.eliminate_zeros()
        return flat


def entries_of(rows: int, *terms: Term) -> Entries:
    """Return the entries of matrices that are sums of terms with one entry each."""
    fields = np.tile(np.arange(len(terms[0][0])), len(terms))
    indices = np.concatenate([row * rows + column for row, column, _ in terms])
    return Entries(fields, indices, np.concatenate([values for _, _, values in terms]))


def _real_rank(matrices: ArrayLike) -> int:
    """Return how many matrices are linearly independent over the reals."""
    array = np.asarray(matrices)
    flat = array.reshape(len(array), -1)
    return int(np.linalg.matrix_rank(np.hstack([flat.real, flat.imag])))


def dual_of(flat: scipy.sparse.csr_array) -> scipy.sparse.csr_array:
    """Return the dual matrices of linearly independent ones, few of which are not orthogonal."""
    sparse = scipy.sparse
    products = sparse.csr_array((flat @ flat.conj().T).real)
    products.eliminate_zeros()
    coupled = np.flatnonzero(np.diff(products.indptr) > 1)
    alone = 1.0 / products.diagonal()
    alone[coupled] = 0.0
    block = np.linalg.inv(products[coupled][:, coupled].toarray())
    rows, columns = np.repeat(coupled, len(coupled)), np.tile(coupled, len(coupled))
    inverse = sparse.coo_array((block.ravel(), (rows, columns)), shape=products.shape)
    return sparse.csr_array((sparse.diags_array(alone) + inverse) @ flat)


class MatrixGroup(Frame):
    r"""A group of square matrices with the frame of its left- or right-invariant fields.

    With :math:`\Omega(v) = \sum_i v_i B_i` for a basis :math:`B_i` of the Lie algebra,
    ``convention="body"`` has the fields :math:`y' = y\,\Omega(v)` and ``convention="space"`` has
    :math:`y' = \Omega(v)\,y`. A subclass defines ``dim``, ``size``, ``convention``,
    ``_make_basis`` and ``membership_error``; it may override methods with closed forms.

    Examples
    --------
    >>> import numpy as np
    >>> import crouch_grossman as cg
    >>> group = cg.frames.SU(2)
    >>> isinstance(group, cg.frames.MatrixGroup), group.dim, group.size
    (True, 3, 2)
    >>> group.algebra([0.0, 0.0, 1.0])
    array([[0.-0.5j, 0.+0.j ],
           [0.+0.j , 0.+0.5j]])
    """

    @property
    @abstractmethod
    def convention(self) -> Convention:
        """The convention of the fields, "body" or "space"."""

    @property
    @abstractmethod
    def size(self) -> int:
        """Number of rows of the matrices."""

    @abstractmethod
    def _make_basis(self) -> Points | Entries:
        """Return the matrices of `basis`, linearly independent over the reals."""

    @cached_property
    def basis(self) -> Points:
        """The matrices of the fields, shape ``(dim, size, size)``, read-only."""
        basis = self._make_basis()
        if isinstance(basis, Entries):
            basis = basis.array(self.dim, self.size)
        elif (rank := _real_rank(basis)) < self.dim:
            raise ValueError(
                f"basis must have {self.dim} linearly independent matrices, got {rank}"
            )
        return read_only(np.asarray(basis, dtype=self.dtype))

    @cached_property
    def _sparse_basis(self) -> scipy.sparse.csr_array:
        """The matrices of the fields in rows, shape ``(dim, size**2)``."""
        return self._entries().sparse(self.dim, self.size)

    @cached_property
    def _sparse_dual(self) -> scipy.sparse.csr_array:
        """The conjugates of the matrices of `_dual` in rows."""
        return dual_of(self._sparse_basis).conj()

    def _entries(self) -> Entries:
        basis = self._make_basis()
        if isinstance(basis, Entries):
            return basis
        flat = self.basis.reshape(self.dim, -1)
        fields, indices = np.nonzero(flat)
        return Entries(fields, indices, flat[fields, indices])

    @property
    def point_shape(self) -> tuple[int, ...]:
        return (self.size, self.size)

    @cached_property
    def structure_constants(self) -> Array:
        r"""The numbers in :math:`[B_i, B_j] = \sum_k c_{ijk} B_k`, shape ``(dim, dim, dim)``."""
        products = self.basis[:, None] @ self.basis[None, :]
        return read_only(self._algebra_projection(products - products.swapaxes(0, 1)))

    def algebra(self, v: ArrayLike) -> Points:
        r"""Return :math:`\Omega(v)`, shape ``(..., size, size)``."""
        return self._combine(self._vectors(v))

    def _combine(self, v: Array) -> Points:
        if self.size <= MAX_DENSE:
            return combine(v, self.basis)
        flat = v.reshape(math.prod(v.shape[:-1]), self.dim) @ self._sparse_basis
        return np.asarray(flat).reshape(*v.shape[:-1], *self.point_shape)

    def vee(self, matrix: ArrayLike) -> Array:
        """Return the coefficients ``v`` of matrices ``algebra(v)``, shape ``(..., dim)``.

        ValueError if a matrix, shape ``(..., size, size)``, isn't in the algebra: if the error of
        an entry exceeds both 1e-8 of the largest entry and 1e-12.
        """
        matrices = self._points(matrix, "matrix")
        v = self._algebra_projection(matrices)
        error = matrices - self._combine(v)
        # A cheap sufficient test, since f calls this method at each stage
        if np.vdot(error, error).real <= _ALGEBRA_ROUNDING**2:
            return v
        distance, size = (np.abs(x).max(axis=(-2, -1)) for x in (error, matrices))
        # The comparison accepts NaN, which the caller handles.
        wrong = distance > np.maximum(MEMBERSHIP_TOLERANCE * size, _ALGEBRA_ROUNDING)
        if wrong.any():
            relative = float((distance[wrong] / size[wrong]).max())
            raise ValueError(
                f"matrix must be in the Lie algebra of {self!r}: its distance from it is "
                f"{relative:.3g} of its largest entry, more than {MEMBERSHIP_TOLERANCE:g}"
            )
        return v

    def _algebra_projection(self, matrices: Points) -> Array:
        """Return the coefficients of the orthogonal projections of matrices onto the algebra."""
        lead, entries = matrices.shape[:-2], math.prod(matrices.shape[-2:])
        if self.size <= MAX_DENSE:
            return np.asarray((matrices.reshape(*lead, entries) @ self._dual.conj().T).real)
        flat = matrices.reshape(math.prod(lead), entries)
        moments = np.asarray((self._sparse_dual @ flat.T).real)
        return np.ascontiguousarray(moments.T).reshape(*lead, self.dim)

    @cached_property
    def _dual(self) -> Points:
        flat = self.basis.reshape(self.dim, -1)
        return np.asarray(np.linalg.solve((flat @ flat.conj().T).real, flat))

    @property
    def _side(self) -> float:
        """1 if flows act from the left, -1 if from the right."""
        return 1.0 if self.convention == "space" else -1.0

    def _bracket(self, u: Array, v: Array) -> Array:
        if self._rotation_sign:
            return super()._bracket(u, v)
        first, second = self.algebra(u), self.algebra(v)
        return self._side * self._algebra_projection(first @ second - second @ first)

    def _dexpinv(self, u: Array, v: Array, order: int) -> Array:
        if self.dim <= MAX_CONSTANTS:
            return super()._dexpinv(u, v, order)
        generator, side = self.algebra(u), self._side
        bound = np.asarray(2.0 * np.linalg.matrix_norm(generator))

        def adjoint(x: Points) -> Points:
            return np.asarray(side * (generator @ x - x @ generator))

        total = series_dexpinv(adjoint, self.algebra(v), order, bound, axes=2)
        return self._algebra_projection(total)

    def exponential(self, v: ArrayLike) -> Points:
        r"""Return :math:`e^{\Omega(v)}`, shape ``(..., size, size)``."""
        vector = self._vectors(v)
        if not (blocks := self.compiled_blocks()):
            return expm(self.algebra(vector), vector)
        shape = *vector.shape[:-1], *self.point_shape
        identity = np.broadcast_to(np.eye(self.size, dtype=self.dtype), shape)
        return move(blocks[0], vector, identity)

    def _closed_form(self) -> Block | None:
        """Return the block whose coordinates compiled code knows for all points."""
        blocks = self.compiled_blocks()
        return blocks[0] if blocks and blocks[0][0] in CLOSED_COORDINATES else None

    def logarithm(self, x: ArrayLike) -> Array:
        """Return the ``v`` of least norm with ``exponential(v) == x``, NaN where there is none.

        Near the identity its relative accuracy is that of ``x - I``.
        """
        point, identity = self._points(x, "x"), np.eye(self.size, dtype=self.dtype)
        if block := self._closed_form():
            return coordinates_between(block, self.dim, 2, identity, point)
        return self._log1p(point - identity)

    def _log1p(self, difference: Points) -> Array:
        """Return the logarithm of the identity plus ``difference``, shape ``(..., dim)``."""
        return self._algebra_projection(real_log1p(difference))

    def inverse(self, x: ArrayLike) -> Points:
        """Return the inverses of group elements, shape ``(..., size, size)``."""
        return np.asarray(np.linalg.inv(self._points(x, "x")))

    def restore(self, y: Points) -> Points:
        """Return ``y`` without the rounding errors normal to the group."""
        return y

    def field(self, v: ArrayLike, y: ArrayLike) -> Points:
        """Return ``y @ algebra(v)`` (body) or ``algebra(v) @ y`` (space)."""
        vector, point = self._arguments(v, y)
        return self._multiply(self.algebra(vector), point)

    @np.errstate(over="ignore", invalid="ignore")
    def flow(self, v: ArrayLike, y: ArrayLike) -> Points:
        """Return ``y @ exponential(v)`` (body) or ``exponential(v) @ y`` (space)."""
        vector, point = self._arguments(v, y)
        return self.restore(self._multiply(self.exponential(vector), point))

    def _multiply(self, x: Points, y: Points) -> Points:
        return np.asarray(y @ x if self.convention == "body" else x @ y)

    def exp_coordinates(self, y0: ArrayLike, y1: ArrayLike) -> Array:
        """Return the logarithm of the quotient of ``y1`` and ``y0``.

        It is NaN where the logarithm does not exist, or where its flow misses ``y1`` by more than
        1e-8 of its norm because the quotient has lost its digits.
        """
        start, end = self._points(y0, "y0"), self._points(y1, "y1")
        if block := self._closed_form():
            return coordinates_between(block, self.dim, 2, start, end)
        # Quotient minus identity from the difference, without cancellation for points nearby
        difference = self._quotient(start, end - start)
        finite = np.asarray(np.isfinite(difference).all(axis=(-2, -1)))[..., None]
        coordinates = self._log1p(np.where(finite[..., None], difference, 0.0))
        return self._checked_coordinates(np.where(finite, coordinates, np.nan), start, end)

    def _quotient(self, y: Points, change: Points) -> Points:
        """Return y⁻¹ times a change (body) or the change times y⁻¹, NaN for singular points."""
        # Points may be singular by rounding; np.linalg.inv would raise.
        regular = (np.linalg.slogdet(y)[0] != 0.0)[..., None, None]
        inverse = self.inverse(np.where(regular, y, np.eye(self.size)))
        with np.errstate(over="ignore", invalid="ignore"):
            quotient = self._multiply(change, inverse)
        return np.where(regular, quotient, np.nan)

    def _coefficients_at(self, y: Points, tangent: Points) -> Array:
        return self._algebra_projection(self._quotient(y, tangent))

    def _checked_coordinates(self, v: Array, start: Points, end: Points) -> Array:
        """Return coefficients, NaN where their flow from ``start`` does not end at ``end``."""
        computable = np.asarray(np.linalg.matrix_norm(self.algebra(v)) <= MAX_EXPONENT)
        with np.errstate(over="ignore", invalid="ignore"):
            moved = self.flow(np.where(computable[..., None], v, 0.0), start)
            error = np.linalg.matrix_norm(moved - end)
            reached = computable & (error <= MEMBERSHIP_TOLERANCE * np.linalg.matrix_norm(end))
        return np.where(reached[..., None], v, np.nan)

    def random_point(self, rng: np.random.Generator, size: Size = ()) -> Points:
        """Return exponentials of normal coefficients with standard deviation 1/2."""
        return self.restore(self.exponential(0.5 * self.random_vector(rng, size)))
