"""A system of order conditions: which conditions, on which entries of a tableau."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .. import _core_r64, _core_r128, quad
from ..checks import check_integer
from ..conditions import (
    HIGHEST_ORDER,
    Rows,
    check_rows,
    condition_trees,
    row_lengths,
    unknowns,
)

__all__ = ["System"]


@dataclass(frozen=True)
class System:
    """The conditions of an order for a method, or for an embedded pair.

    A pair of orders q and q - 1 is packed as a tableau with one stage more, whose row
    holds the second weights and which the first weights don't use: the conditions on
    the second weights are then conditions on the weights of that stage.

    Parameters
    ----------
    order : int
        Order q of the method.
    stages : int
        Stages of the method, the additional one of a pair not counted.
    rows : Rows, optional
    embedded : bool, optional
        Whether second weights, of order q - 1 and without the last stage, belong to it.
    """

    order: int
    stages: int
    rows: Rows = Rows.EXPLICIT
    embedded: bool = False

    def __post_init__(self) -> None:
        # the compiled core trusts its callers with both
        order = check_integer("order", self.order, 1)
        if order > HIGHEST_ORDER:
            raise ValueError(f"order must be at most {HIGHEST_ORDER} in this build, got {order}")
        object.__setattr__(self, "order", order)
        object.__setattr__(self, "stages", check_integer("stages", self.stages, 1))
        object.__setattr__(self, "rows", check_rows(self.rows))
        if self.embedded and self.order < 2:
            raise ValueError(f"order must be at least 2 for an embedded pair, got {self.order}")

    @property
    def packed_stages(self) -> int:
        """Stages of the packed tableau."""
        return self.stages + self.embedded

    @cached_property
    def size(self) -> int:
        """Number of packed entries."""
        return unknowns(self.packed_stages, self.rows)

    @cached_property
    def free(self) -> NDArray[np.intp]:
        """Indices of the entries that aren't zero by definition."""
        fixed: list[int] = []
        if self.embedded:
            begin = sum(row_lengths(self.packed_stages, self.rows)[: self.stages])
            # row of the second weights: from its last-stage weight on; and b's last entry
            fixed = [*range(begin + self.stages - 1, self.size - self.packed_stages), self.size - 1]
        return np.setdiff1d(np.arange(self.size), fixed)

    def moving(self, free: Sequence[int] | NDArray[np.intp] | None) -> NDArray[np.intp]:
        """Return the indices of entries that may change, sorted; `free` if None is given.

        Raises
        ------
        ValueError
            If an index isn't an integer or is out of range.
        """
        if free is None:
            return self.free
        given = np.asarray(free)
        if given.size == 0:
            return np.empty(0, dtype=np.intp)
        if given.dtype.kind not in "iu":
            raise ValueError(f"free must hold integers, got {free!r}")
        indices = np.unique(given).astype(np.intp)
        if indices[0] < 0 or indices[-1] >= self.size:
            raise ValueError(f"free must hold indices from 0 to {self.size - 1}, got {free!r}")
        return indices

    def conditions(self, independent: bool) -> tuple[NDArray[np.intc], NDArray[np.intc]]:
        """Return trees, and the stage that a condition is on (0 for ``b``), both (m,)."""
        trees = condition_trees(self.order, independent)
        second = condition_trees(self.order - 1, independent) if self.embedded else ()
        owner = [0] * len(trees) + [self.packed_stages] * len(second)
        return np.array([*trees, *second], dtype=np.intc), np.array(owner, dtype=np.intc)

    def residual(self, x: NDArray[np.float64], independent: bool = True) -> NDArray[np.float64]:
        """Return the residuals at packed entries, shape (m,)."""
        trees, owner = self.conditions(independent)
        found: NDArray[np.float64] = _core_r64.residuals(*self._shape, x, trees, owner=owner)
        return found

    def jacobian(self, x: NDArray[np.float64], independent: bool = True) -> NDArray[np.float64]:
        """Return the derivatives of `residual`, shape (m, size)."""
        trees, owner = self.conditions(independent)
        found: NDArray[np.float64] = _core_r64.jacobian(*self._shape, x, trees, owner=owner)
        return found

    def residual_quad(self, x: quad.Quads, independent: bool = False) -> NDArray[np.float64]:
        """Return the residuals as computed in real(16), rounded to double."""
        trees, owner = self.conditions(independent)
        found = _core_r128.residuals(*self._shape, x.T, trees, owner=owner)
        return quad.to_float(np.ascontiguousarray(found.T))

    @property
    def _shape(self) -> tuple[int, int, int]:
        return self.order, self.packed_stages, int(self.rows)
