"""User-defined frames of linear vector fields, which are given as matrices."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.manifold import MEMBERSHIP_TOLERANCE
from cg.frames.matrix_functions import combine, expm
from cg.frames.user import Function, UserFrame
from cg.support.arrays import Array, Points, check_finite, is_qobj, number_array, read_only
from cg.support.checks import check_integer


class MatrixFrame(UserFrame):
    r"""The vector fields :math:`E_i(y) = A_i y` for given matrices.

    Parameters
    ----------
    matrices
        The :math:`A_i`, real or complex, shape ``(m, n, n)``.
    columns
        Number of columns of a point; None for points that are vectors of length ``n``.
    membership_error, restore, project, random_point
        As for `FieldFrame`.

    Notes
    -----
    The flow is ``scipy.linalg.expm`` of :math:`\sum_i v_i A_i`.

    Examples
    --------
    Flows along an ellipse:

    >>> import numpy as np
    >>> frame = MatrixFrame([[[0.0, -0.5], [2.0, 0.0]]])
    >>> frame.flow([np.pi / 2], [1.0, 0.0]).round(15) + 0.0
    array([0., 2.])
    """

    _matrices: Points
    _columns: int | None

    def __init__(
        self, matrices: ArrayLike, columns: int | None = None, *,
        membership_error: Function | None = None, restore: Function | None = None,
        project: Function | None = None, random_point: Function | None = None,
    ) -> None:  # fmt: skip
        if isinstance(matrices, list | tuple):
            matrices = [each.full() if is_qobj(each) else each for each in matrices]
        array = number_array(matrices, "matrices")
        if array.ndim != 3 or array.shape[1] != array.shape[2] or 0 in array.shape:
            raise ValueError(f"matrices must have shape (m, n, n), got {array.shape}")
        check_finite("matrices", array)
        if columns is not None:
            columns = check_integer("columns", columns, 1)
        vars(self).update(_matrices=read_only(array), _columns=columns)
        self._store_functions(
            membership_error=membership_error,
            restore=restore,
            project=project,
            random_point=random_point,
        )

    def __repr__(self) -> str:
        columns = "" if self._columns is None else f", {self._columns}"
        functions = "".join(f", {name}={value!r}" for name, value in self._functions.items())
        return f"MatrixFrame({self._matrices.tolist()}{columns}{functions})"

    def _key(self) -> tuple[Any, ...]:
        return (*super()._key(), self._matrices.tobytes())

    @property
    def matrices(self) -> Points:
        """The matrices of the fields, shape ``(m, n, n)``, read-only."""
        return self._matrices

    @property
    def dim(self) -> int:
        return len(self._matrices)

    @property
    def point_shape(self) -> tuple[int, ...]:
        n = self._matrices.shape[1]
        return (n,) if self._columns is None else (n, self._columns)

    @property
    def dtype(self) -> np.dtype[Any]:
        """Complex if the matrices are."""
        return self._matrices.dtype

    def _apply(self, matrix: Points, y: Points) -> Points:
        if self._columns is None:
            return np.asarray((matrix @ y[..., None])[..., 0])
        return np.asarray(matrix @ y)

    @cached_property
    def _structure_constants(self) -> Array | None:
        """Numbers c with ``A_i A_j - A_j A_i = sum_k c_ijk A_k``; None if they don't exist."""
        products = self._matrices[:, None] @ self._matrices[None, :]
        commutators = (products - products.swapaxes(0, 1)).reshape(self.dim**2, -1)
        span = self._matrices.reshape(self.dim, -1)
        if self.dtype.kind == "c":
            span, commutators = span.view(np.float64), commutators.view(np.float64)
        constants, *_ = np.linalg.lstsq(span.T, commutators.T)
        error = np.abs(span.T @ constants - commutators.T).max()
        if not error <= MEMBERSHIP_TOLERANCE * np.abs(products).max():
            return None
        return np.asarray(constants.T.reshape(self.dim, self.dim, self.dim))

    def _bracket(self, u: Array, v: Array) -> Array:
        if (constants := self._structure_constants) is None:
            raise NotImplementedError(
                f"{self!r} has no bracket: its matrices do not span a Lie algebra"
            )
        return np.asarray((v[..., None, :] @ combine(u, constants))[..., 0, :])

    def field(self, v: ArrayLike, y: ArrayLike) -> Points:
        vector, point = self._arguments(v, y)
        return self._apply(combine(vector, self._matrices), point)

    def flow(self, v: ArrayLike, y: ArrayLike) -> Points:
        vector, point = self._arguments(v, y)
        return self.restore(self._apply(expm(combine(vector, self._matrices), vector), point))
