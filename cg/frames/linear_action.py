"""Sparse linear vector fields on large vectors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.arrays import Points
from cg.frames.base import FlowOverflowError
from cg.frames.user import Function, UserFrame

if TYPE_CHECKING:
    from scipy import sparse

# Terms of a Taylor polynomial for a matrix of this norm lose less than a digit to cancellation.
_MAX_NORM = 2.0
_MAX_TERMS = 60
_MAX_PARTS = 10**7


class LinearAction(UserFrame):
    r"""The vector fields :math:`E_i(y) = G_i y` for given sparse matrices.

    For large state vectors, such as those of spin chains. The flow
    :math:`\exp(\sum_i v_i G_i)\, y` is computed by Taylor polynomials after scaling the matrix to
    a norm of at most two [1]_; no matrix exponential is formed.

    Parameters
    ----------
    generators : sequence of m matrices of shape (n, n)
        The :math:`G_i`, sparse or dense, real or complex.
    membership_error, project, random_point : callable, optional
        As for `cg.frames.MatrixFrame`.

    Raises
    ------
    TypeError
        If one of the functions isn't callable.
    ValueError
        If ``generators`` aren't square matrices of finite numbers, all of one shape.

    References
    ----------
    .. [1] A. H. Al-Mohy, N. J. Higham, "Computing the action of the matrix exponential, with an
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

    _pattern: sparse.csr_array
    _values: Points

    def __init__(
        self,
        generators: Sequence[Any],
        *,
        membership_error: Function | None = None,
        project: Function | None = None,
        random_point: Function | None = None,
    ) -> None:
        pattern, values = _on_one_pattern(_read(generators))
        values.flags.writeable = False
        object.__setattr__(self, "_pattern", pattern)
        object.__setattr__(self, "_values", values)
        self._store_functions(
            membership_error=membership_error, project=project, random_point=random_point
        )

    def __repr__(self) -> str:
        m, n = len(self._values), self._pattern.shape[0]
        return f"LinearAction({m} generators of shape ({n}, {n}))"

    def _key(self) -> tuple[Any, ...]:
        pattern = self._pattern
        parts = (self._values, pattern.indices, pattern.indptr)
        return (*super()._key(), *(part.tobytes() for part in parts))

    @property
    def dim(self) -> int:
        """Number of generators."""
        return len(self._values)

    @property
    def point_shape(self) -> tuple[int, ...]:
        """The shape ``(n,)``."""
        return (int(self._pattern.shape[0]),)

    @property
    def dtype(self) -> np.dtype[Any]:
        """Complex if a generator is."""
        return self._values.dtype

    def _matrix(self, v: Points) -> sparse.csr_array:
        from scipy import sparse

        pattern = self._pattern
        entries = v @ self._values
        return sparse.csr_array((entries, pattern.indices, pattern.indptr), shape=pattern.shape)

    def field(self, v: ArrayLike, y: ArrayLike) -> Points:
        r"""Return :math:`\sum_i v_i G_i y`, shape ``(..., n)``."""
        return self._on_rows(v, y, lambda matrix, point: matrix @ point)

    def flow(self, v: ArrayLike, y: ArrayLike) -> Points:
        r"""Return :math:`\exp(\sum_i v_i G_i)\, y`, shape ``(..., n)``.

        Raises
        ------
        ValueError
            If the trailing axes have other lengths.
        FlowOverflowError
            If the norm of the matrix is so large that no digits of the flow are known.
        """
        return self._on_rows(v, y, _exponential_action)

    def _on_rows(self, v: ArrayLike, y: ArrayLike, act: Any) -> Points:
        vectors, points = self._arguments(v, y)
        lead = np.broadcast_shapes(vectors.shape[:-1], points.shape[:-1])
        vectors = np.broadcast_to(vectors, (*lead, self.dim)).reshape(-1, self.dim)
        points = np.broadcast_to(points, (*lead, *self.point_shape)).reshape(-1, *self.point_shape)
        result = np.empty(points.shape, dtype=self.dtype)
        for k, (vector, point) in enumerate(zip(vectors, points, strict=True)):
            result[k] = act(self._matrix(vector), point)
        return result.reshape(*lead, *self.point_shape)


def _exponential_action(matrix: sparse.csr_array, y: Points) -> Points:
    """Return exp(matrix) y."""
    columns = np.bincount(matrix.indices, np.abs(matrix.data), minlength=matrix.shape[0])
    norm = float(columns.max(initial=0.0))
    if not norm <= _MAX_NORM * _MAX_PARTS:
        raise FlowOverflowError(
            f"the flow of a matrix of norm {norm:.3g} can't be computed in double precision"
        )
    parts = max(1, math.ceil(norm / _MAX_NORM))
    unit = np.finfo(np.float64).eps
    for _ in range(parts):
        term, total, last = y, y.copy(), math.inf
        for k in range(1, _MAX_TERMS):
            term = (matrix @ term) * (1.0 / (parts * k))
            total += term
            size = float(np.abs(term).max())
            if size + last <= 0.5 * unit * float(np.abs(total).max()) or not math.isfinite(size):
                break
            last = size
        y = total
    return y


def _read(generators: Sequence[Any]) -> list[sparse.csr_array]:
    """Return generators as sparse matrices of one type, after checking them."""
    from scipy import sparse

    try:
        listed = list(generators)
    except TypeError:
        listed = None
    if listed is None or isinstance(generators, str | bytes):
        raise ValueError(f"generators must be a sequence of matrices, got {generators!r}")
    matrices: list[sparse.csr_array] = []
    for i, generator in enumerate(listed):
        try:
            matrix = sparse.csr_array(generator)
            matrix = matrix.astype(np.complex128 if matrix.dtype.kind == "c" else np.float64)
        except (TypeError, ValueError) as error:
            raise ValueError(f"generators[{i}] must be a matrix of numbers: {error}") from None
        if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or matrix.shape[0] == 0:
            raise ValueError(f"generators[{i}] must be square, got shape {matrix.shape}")
        if matrix.shape != (matrices or [matrix])[0].shape:
            raise ValueError(
                f"generators must have one shape, got {matrices[0].shape} and {matrix.shape}"
            )
        if not np.isfinite(matrix.data).all():
            raise ValueError(f"generators[{i}] must be finite")
        matrices.append(matrix)
    if not matrices:
        raise ValueError("generators must have at least one matrix, got none")
    return matrices


def _on_one_pattern(matrices: list[sparse.csr_array]) -> tuple[sparse.csr_array, Points]:
    """Return the union of the sparsity patterns, and the values of each matrix on it."""
    from scipy import sparse

    ones = [
        sparse.csr_array((np.ones(m.nnz), m.indices, m.indptr), shape=m.shape) for m in matrices
    ]
    pattern = sparse.csr_array(sum(ones[1:], ones[0]))
    pattern.sort_indices()
    n = pattern.shape[0]
    keys = np.repeat(np.arange(n), np.diff(pattern.indptr)) * n + pattern.indices
    dtype = np.result_type(*(m.dtype for m in matrices))
    values = np.zeros((len(matrices), pattern.nnz), dtype=dtype)
    for row, matrix in zip(values, matrices, strict=True):
        matrix.sum_duplicates()
        positions = np.repeat(np.arange(n), np.diff(matrix.indptr)) * n + matrix.indices
        row[np.searchsorted(keys, positions)] = matrix.data
    return pattern, values
