"""Matrices of fields by their few entries that aren't zero."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from cg.support.arrays import Points

Indices = NDArray[np.intp]
Part = tuple[Indices, Indices, NDArray[Any]]


class Entries(NamedTuple):
    """The number of each field, the place in its flat matrix, and the value."""

    fields: Indices
    places: Indices
    values: NDArray[Any]

    def array(self, fields: int, rows: int) -> Points:
        """Return the matrices, shape ``(fields, rows, rows)``."""
        flat = np.zeros((fields, rows * rows), dtype=self.values.dtype)
        np.add.at(flat, (self.fields, self.places), self.values)
        return flat.reshape(fields, rows, rows)

    def sparse(self, fields: int, rows: int) -> scipy.sparse.csr_array:
        """Return the matrices as rows of a sparse array, shape ``(fields, rows**2)``."""
        flat = scipy.sparse.csr_array(
            (self.values, (self.fields, self.places)), shape=(fields, rows * rows)
        )
        flat.eliminate_zeros()
        return flat


def entries_of(rows: int, *parts: Part) -> Entries:
    """Return entries of matrices; each part has a row, a column and a value of each matrix."""
    fields = np.tile(np.arange(len(parts[0][0])), len(parts))
    places = np.concatenate([row * rows + column for row, column, _ in parts])
    return Entries(fields, places, np.concatenate([values for _, _, values in parts]))


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
