"""The semidirect product of a matrix group and the vectors it acts on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.blocks import Blocks, convention_option, dexpinv
from cg.frames.matrix_functions import expm
from cg.frames.matrix_group import Entries, MatrixGroup
from cg.support.arrays import Array, Convention, Points, Size, check_random
from cg.support.checks import check_integer
from cg.support.shared_numbers import BlockKind


@dataclass(frozen=True, repr=False)
class Semidirect(MatrixGroup):
    r"""Affine maps :math:`x \mapsto g x + p`, with :math:`g` in a real matrix group.

    A point is the matrix :math:`\binom{g\;\;p}{0\;\;I}`, where :math:`p` has ``copies`` columns.
    ``Semidirect(SO3())`` is the group of rigid motions, and a point of ``Semidirect(SO3(), 2)``
    holds attitude, velocity and position. The coefficients are those of the group, then the
    columns of the upper right block of :math:`\Omega`.

    Parameters
    ----------
    group
        A real matrix group, whose convention the product adopts.
    copies
        Number of columns of :math:`p`.

    Notes
    -----
    The blocks of the exponential of :math:`\binom{\Omega\;\;U}{0\;\;0}` are :math:`e^{\Omega}` and
    :math:`\int_0^1 e^{s\Omega} ds\,U`: closed forms if the group is SO(3) [1]_,
    ``scipy.linalg.expm`` otherwise.

    References
    ----------
    .. [1] R. M. Murray, Z. Li, S. S. Sastry, *A Mathematical Introduction to Robotic
       Manipulation*, CRC Press, 1994, chapter 2.

    Examples
    --------
    >>> import numpy as np
    >>> import crouch_grossman as cg
    >>> frame = cg.frames.Semidirect(cg.frames.SL(2))
    >>> frame.dim, frame.point_shape
    (5, (3, 3))
    """

    group: MatrixGroup
    copies: int = 1

    def __post_init__(self) -> None:
        if not isinstance(self.group, MatrixGroup):
            raise TypeError(f"group must be a MatrixGroup, got {self.group!r}")
        if self.group.dtype.kind == "c":
            raise ValueError(f"group must be real, got {self.group!r}")
        object.__setattr__(self, "copies", check_integer("copies", self.copies, 1))

    @property
    def convention(self) -> Convention:
        return self.group.convention

    @property
    def size(self) -> int:
        return self.group.size + self.copies

    @property
    def dim(self) -> int:
        return self.group.dim + self.group.size * self.copies

    def turning_coefficients(self) -> Array:
        return np.pad(self.group.turning_coefficients(), (0, self.dim - self.group.dim))

    def _blocks(self) -> Blocks | None:
        match self.group.compiled_blocks():
            case ((BlockKind.SO3, _, option),):
                return ((BlockKind.SE3, self.copies, option),)
        return None

    def _make_basis(self) -> Entries:
        n, size = self.group.size, self.size
        linear = self.group._entries()
        row, column = np.divmod(linear.indices, n)
        moves = np.arange(n * self.copies)
        indices = np.concatenate([row * size + column, moves % n * size + n + moves // n])
        fields = np.concatenate([linear.fields, self.group.dim + moves])
        return Entries(fields, indices, np.concatenate([linear.values, np.ones(len(moves))]))

    def _linear_and_columns(self, point: Array) -> tuple[Array, Array]:
        n = self.group.size
        return point[..., :n, :n], point[..., :n, n:]

    def _assemble(self, linear: Array, columns: Array) -> Array:
        n = self.group.size
        lead = np.broadcast_shapes(linear.shape[:-2], columns.shape[:-2])
        point = np.zeros((*lead, *self.point_shape))
        point[..., :n, :n] = linear
        point[..., :n, n:] = columns
        point[..., n:, n:] = np.eye(self.copies)
        return point

    def _dexpinv(self, u: Array, v: Array, order: int) -> Array:
        if self.group._rotation_sign:
            block = BlockKind.SE3, self.copies, convention_option(self.convention)
            return dexpinv((block,), u, v)
        return super()._dexpinv(u, v, order)

    def _log1p(self, difference: Points) -> Array:
        n = self.group.size
        vector = self.group._log1p(difference[..., :n, :n])
        finite = np.isfinite(vector).all(axis=-1, keepdims=True)
        regular = np.where(finite, vector, 0.0)
        # the upper right block of the exponential is the mean of exp(s Omega) over s
        bordered = np.zeros((*vector.shape[:-1], 2 * n, 2 * n))
        bordered[..., :n, :n], bordered[..., :n, n:] = self.group.algebra(regular), np.eye(n)
        average = expm(bordered, regular)[..., :n, n:]
        columns = np.linalg.solve(average, difference[..., :n, n:])
        flat = columns.mT.reshape(*difference.shape[:-2], n * self.copies)
        return np.concatenate([vector, np.where(finite, flat, np.nan)], axis=-1)

    def inverse(self, x: ArrayLike) -> Points:
        linear, columns = self._linear_and_columns(self._points(x, "x"))
        inverse = self.group.inverse(linear)
        return self._assemble(inverse, -inverse @ columns)

    def _coefficients_at(self, y: Points, tangent: Points) -> Array:
        """Return coefficients of the linear part, and of what else moves the columns."""
        linear, columns = self._linear_and_columns(y)
        linear_rate, rates = self._linear_and_columns(tangent)
        v = self.group._coefficients_at(linear, linear_rate)
        if self.convention == "body":
            rates = self.group._quotient(linear, rates)
        else:
            rates = rates - self.group.algebra(v) @ columns
        flat = rates.mT.reshape(*v.shape[:-1], self.dim - self.group.dim)
        return np.concatenate([v, flat], axis=-1)

    def restore(self, y: Points) -> Points:
        """Return ``y`` with its linear part restored and the constant rows exact."""
        linear, columns = self._linear_and_columns(y)
        return self._assemble(self.group.restore(linear), columns)

    def _project(self, y: Array) -> Array:
        linear, columns = self._linear_and_columns(y)
        return self._assemble(self.group.project(linear), columns)

    def membership_error(self, y: ArrayLike) -> Array:
        """Return the larger of the group's error and the constant rows', shape ``(...)``."""
        linear, off = self._errors(y)
        return np.asarray(np.maximum(self.group.membership_error(linear), off))

    def relative_error(self, y: ArrayLike) -> Array:
        """Return the larger of the group's relative error and the rows', shape ``(...)``."""
        linear, off = self._errors(y)
        return np.asarray(np.maximum(self.group.relative_error(linear), off))

    def _errors(self, y: ArrayLike) -> tuple[Array, Array]:
        """Return the linear parts of points and the errors of their constant rows."""
        point = self._points(y)
        n = self.group.size
        rows = point[..., n:, :] - np.eye(self.size)[n:]
        return point[..., :n, :n], np.abs(rows).max(axis=(-2, -1))

    def distance(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return the root of the sum of the squared distances of group and columns."""
        linear, columns = self._linear_and_columns(self._points(x, "x"))
        other_linear, other_columns = self._linear_and_columns(self._points(y))
        shift = np.linalg.norm(columns - other_columns, axis=(-2, -1))
        return np.asarray(np.hypot(self.group.distance(linear, other_linear), shift))

    def coordinate_sizes(self, y: ArrayLike) -> Array:
        """Return ones for the group, and for each entry of a column the length of the column."""
        point = self._points(y)
        sizes = super().coordinate_sizes(point)
        lengths = np.linalg.norm(self._linear_and_columns(point)[1], axis=-2)
        sizes[..., self.group.dim :] = np.repeat(lengths, self.group.size, axis=-1)
        return sizes

    def random_point(self, rng: np.random.Generator, size: Size = ()) -> Points:
        """Return random points of the group with normal columns."""
        size = check_random(rng, size)
        linear = self.group.random_point(rng, size)
        return self._assemble(linear, rng.standard_normal((*size, self.group.size, self.copies)))
