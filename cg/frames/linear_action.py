"""Sparse linear vector fields on large vectors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import IntEnum
from functools import cached_property
from hashlib import blake2b
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cg.frames.base import CompiledFlow
from cg.frames.blocks import Blocks
from cg.frames.user import UserFrame
from cg.support.arrays import Array, Points, conversion_hint, is_qobj, read_only
from cg.support.checks import check_flag, check_integer, short
from cg.support.shared_numbers import BlockKind

if TYPE_CHECKING:
    from scipy import sparse

_HERMITIAN_PART = 1e-13  # largest part of skew-Hermitian generators, relative to their entries


class _EntryKind(IntEnum):
    """The parts of the entries of matrices that compiled code stores."""

    REAL = 0
    IMAGINARY = 1
    COMPLEX = 2


class LinearAction(CompiledFlow, UserFrame):
    r"""The vector fields :math:`E_i(y) = G_i y` for given sparse matrices.

    For large state vectors, such as those of spin chains. The flow
    :math:`\exp(\sum_i v_i G_i)\, y` is computed from products of the matrix with vectors, by
    Chebyshev polynomials if all generators are skew-Hermitian [1]_, else by Taylor polynomials
    after scaling the matrix to a norm of at most two [2]_; no matrix exponential is formed. Real
    and purely imaginary generators take half the time of complex ones.

    `cg.solve_linear` takes one flow per step, along the polynomial in time that interpolates the
    coefficients at the nodes of the method, nine by default. With :math:`y' = \sum_m t^m D_m y`,
    :math:`D_m = \sum_i d_{mi} G_i`, the coefficients of its Taylor polynomial are

    .. math:: y_{k+1} = \frac{1}{k + 1} \sum_i G_i \sum_m d_{mi}\, y_{k-m} .

    Each takes one product of each generator, where a product of exponentials takes one for each
    term of each exponential. The step is divided where norms are above six; terms are left out
    whose sum over the whole integration is below the tolerance. The norm of the vector is then
    restored if all generators are skew-Hermitian. Linear invariants, such as the trace of a density
    matrix, are kept to rounding.

    Parameters
    ----------
    generators
        Shape ``(n, n)``. The :math:`G_i`, sparse, dense or of QuTiP. A Hamiltonian H has the
        generator ``-1j * H``.
    unitary
        Whether all generators have to be skew-Hermitian, so that flows keep the norm of the vector.
        Without it, H in place of ``-1j * H`` gives solutions that grow.
    columns
        Number of columns of a point, a matrix whose columns move alike: a propagator, or many
        initial vectors. By default points are vectors. The norm that is restored is that of the
        whole matrix.

    References
    ----------
    .. [1] H. Tal-Ezer, R. Kosloff, "An accurate and efficient scheme for propagating the time
       dependent Schrödinger equation", J. Chem. Phys. 81 (1984), 3967-3971.
    .. [2] A. H. Al-Mohy, N. J. Higham, "Computing the action of the matrix exponential, with an
       application to exponential integrators", SIAM J. Sci. Comput. 33 (2011), 488-511.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> x, z = [[0, -1j], [-1j, 0]], [[-1j, 0], [0, 1j]]
    >>> frame = LinearAction([sparse.csr_array(x), sparse.csr_array(z)])
    >>> frame.flow([np.pi / 2, 0.0], [1.0, 0.0]).round(12) + 0.0
    array([0.+0.j, 0.-1.j])
    """

    _pattern: Pattern
    _values: Points
    _columns: int | None

    def __init__(
        self, generators: Sequence[Any], *, unitary: bool = False, columns: int | None = None
    ) -> None:
        matrices = _read(generators)
        if check_flag("unitary", unitary):
            matrices = [_skew_hermitian(matrix, i) for i, matrix in enumerate(matrices)]
        if columns is not None:
            columns = check_integer("columns", columns, 1)
        self._store(*on_one_pattern(matrices), columns)

    def _store(self, pattern: Pattern, values: Points, columns: int | None) -> None:
        vars(self).update(_pattern=pattern, _values=read_only(values), _columns=columns)
        self._store_functions()

    @classmethod
    def from_pattern(cls, pattern: Pattern, values: Points, columns: int | None) -> LinearAction:
        """Return the frame of generators that are known to be right, by their values."""
        frame = cls.__new__(cls)
        frame._store(pattern, values, columns)
        return frame

    def __repr__(self) -> str:
        m, n = len(self._values), self._pattern.size
        columns = "" if self._columns is None else f", columns={self._columns}"
        return f"LinearAction({m} generators of shape ({n}, {n}){columns})"

    def _key(self) -> tuple[Any, ...]:
        return (*super()._key(), self.dim, self._digest)

    @cached_property
    def _digest(self) -> bytes:
        """A checksum of the generators, by which large frames are compared quickly."""
        digest = blake2b()
        for array in (self._values, self._pattern.columns, self._pattern.rows):
            digest.update(array.tobytes())
        return digest.digest()

    @property
    def dim(self) -> int:
        return len(self._values)

    @property
    def point_shape(self) -> tuple[int, ...]:
        n = self._pattern.size
        return (n,) if self._columns is None else (n, self._columns)

    @property
    def dtype(self) -> np.dtype[Any]:
        """Complex if a generator is."""
        return self._values.dtype

    def _blocks(self) -> Blocks | None:
        return ((BlockKind.LINEAR_ACTION, math.prod(self.point_shape), 0, self._numbers),)

    @cached_property
    def _numbers(self) -> Array:
        """The generators as ``fortran/frames/linear_action.f90`` reads them."""
        if self._columns is not None and self._columns > 1:
            from scipy import sparse

            # entries of a point are its rows, one after the other
            identity = sparse.eye_array(self._columns)
            matrices = [sparse.kron(self._matrix(e), identity) for e in np.eye(self.dim)]
            return LinearAction(matrices)._numbers
        values, pattern = self._values, self._pattern
        kind = _EntryKind.COMPLEX
        if values.dtype.kind != "c":
            kind = _EntryKind.REAL
        elif not values.real.any():
            kind = _EntryKind.IMAGINARY
        generator, entry = np.nonzero(values)
        terms, indices = values[generator, entry], entry + 1
        if kind == _EntryKind.IMAGINARY:
            terms = terms.imag.copy()
        if kind == _EntryKind.COMPLEX:
            indices = np.stack([2 * entry + 1, 2 * entry + 2], axis=-1).reshape(-1)
        n, rows, columns = pattern
        starts = np.searchsorted(generator * n + rows[entry], np.arange(self.dim * n + 1))
        sizes = n, self.dim, len(rows), len(generator), kind, self.is_skew
        tables = pattern.starts + 1, columns + 1, starts + 1, columns[entry] + 1, indices
        return np.concatenate([sizes, *tables, terms.view(np.float64)], dtype=np.float64)

    @cached_property
    def is_skew(self) -> bool:
        """Whether all generators are skew-Hermitian."""
        place = self._pattern.transposed()
        return place is not None and not (self._values + self._values[:, place].conj()).any()

    def _matrix(self, v: Array) -> sparse.csr_array:
        from scipy import sparse

        n, _, columns = self._pattern
        return sparse.csr_array((v @ self._values, columns, self._pattern.starts), shape=(n, n))

    def dense(self) -> Points:
        """Return the generators as one array, shape ``(m, n, n)``."""
        return np.array([self._matrix(unit).toarray() for unit in np.eye(self.dim)])

    def field(self, v: ArrayLike, y: ArrayLike) -> Points:
        vectors, points = self._rows(v, y)
        flat = points.reshape(-1, *self.point_shape)
        pairs = zip(vectors.reshape(-1, self.dim), flat, strict=True)
        rows = [self._matrix(u) @ x for u, x in pairs]
        return np.array(rows, dtype=self.dtype).reshape(points.shape)


def _read(generators: Sequence[Any]) -> list[sparse.csr_array]:
    """Return generators as sparse matrices of one type, after checking them."""
    from scipy import sparse

    if not np.iterable(generators) or isinstance(generators, str | bytes):
        raise TypeError(f"generators must be a sequence of matrices, got {generators!r}")
    matrices: list[sparse.csr_array] = []
    for i, generator in enumerate(generators):
        try:
            numbers = generator.to("CSR").data.as_scipy() if is_qobj(generator) else generator
            matrix = sparse.csr_array(numbers)
            matrix = matrix.astype(np.complex128 if matrix.dtype.kind == "c" else np.float64)
        except (TypeError, ValueError) as error:
            raise ValueError(
                f"generators[{i}] must be a matrix of numbers, got {short(generator)}"
                f"{conversion_hint(generator, error)}"
            ) from error
        if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or matrix.shape[0] == 0:
            raise ValueError(f"generators[{i}] must be a square matrix, got shape {matrix.shape}")
        if matrix.shape != (matrices or [matrix])[0].shape:
            raise ValueError(
                f"generators must have one shape, got {matrices[0].shape} and {matrix.shape}"
            )
        if len(wrong := matrix.data[~np.isfinite(matrix.data)]):
            raise ValueError(f"generators[{i}] must be finite, got {wrong[0]}")
        matrices.append(matrix)
    if not matrices:
        raise ValueError("generators must have at least one matrix, got none")
    return matrices


def _skew_hermitian(matrix: sparse.csr_array, i: int) -> sparse.csr_array:
    """Return a generator without the rounding of its Hermitian part; ValueError if it is larger."""
    from scipy import sparse

    adjoint = matrix.conj().T
    size = abs(matrix).max()
    if abs(matrix + adjoint).max() <= _HERMITIAN_PART * size:
        return sparse.csr_array(0.5 * (matrix - adjoint))
    raise ValueError(
        f"generators[{i}] must be skew-Hermitian if unitary is True, as -1j * H of a Hamiltonian H"
    )


class Pattern(NamedTuple):
    """A sparsity pattern: the rows and columns of the entries of square matrices, row by row."""

    size: int
    rows: NDArray[np.intp]
    columns: NDArray[np.intp]

    @property
    def starts(self) -> NDArray[np.intp]:
        """Number of entries before each row, and of all."""
        return np.searchsorted(self.rows, np.arange(self.size + 1))

    def transposed(self) -> NDArray[np.intp] | None:
        """Return the permutation of entries that transposes matrices, None without symmetry."""
        order = np.lexsort((self.rows, self.columns))
        same = np.array_equal(self.rows[order], self.columns)
        return order if same and np.array_equal(self.columns[order], self.rows) else None


def on_one_pattern(
    matrices: list[sparse.csr_array], symmetric: bool = False
) -> tuple[Pattern, Points]:
    """Return the union of the sparsity patterns, and the values of each matrix on it."""
    n = matrices[0].shape[0]
    nonzero = [np.flatnonzero(m.data) for m in matrices]
    keys = [
        np.repeat(n * np.arange(n), np.diff(m.indptr))[k] + m.indices[k]
        for m, k in zip(matrices, nonzero, strict=True)
    ]
    union = np.concatenate(keys)
    if symmetric:
        union = np.concatenate([union, union % n * n + union // n])
    union.sort()
    union = union[np.diff(union, prepend=-1) > 0]  # numpy.unique takes ten times as long
    values = np.zeros((len(matrices), len(union)), np.result_type(*(m.dtype for m in matrices)))
    for row, matrix, k, key in zip(values, matrices, nonzero, keys, strict=True):
        np.add.at(row, np.searchsorted(union, key), matrix.data[k])
    return Pattern(n, union // n, union % n), values
