"""Systems of order conditions in the weights x of a method.

The residuals are ``Φ(t) - 1/γ(t)`` for the ordered trees t of the order, those of a second result
after those of the first, and those of simplifying assumptions on stages k, such as
``Φ_k(t) - c_k^(|t| - 1) / γ(t)`` (Butcher, Numerical Methods for Ordinary Differential Equations,
section 321). Solvers see the system as one vector with one Jacobian, whatever it is made of.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from fractions import Fraction
from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.construction.conditions import condition_trees, core_calls, count
from cg.construction.conditions.counts import check_order
from cg.construction.layouts import Layout, Rows
from cg.construction.points import check_tree
from cg.construction.solvers.held import HeldValues, Hold, RegisterWeights
from cg.construction.trees import OrderedTree, forest
from cg.support import quads
from cg.support.checks import check_instance
from cg.support.shared_numbers import ConditionOwner, StageEquation

_STAGE_ORDER_TWO = forest(3).index(OrderedTree.parse("[[[]]]"))
_REMAINING = {1: (1, 1, 2, 6, 19, 56, 176, 550), 2: (1, 0, 1, 4, 12, 36, 112, 352)}
"""Numbers of conditions on 1, 2, ... nodes that a structure and smaller ones don't imply."""


class Structure(IntEnum):
    """Simplifying assumptions on explicit methods, which are solved as additional equations.

    They make many order conditions redundant: for order six and 13 stages, 76 independent
    equations in 89 unknowns remain of 113.

    - ``GENERAL``: none.
    - ``STAGE_ORDER_TWO``: C(2), Σ_j a_ij c_j = c_i²/2, at all stages except the second, and
      b_2 = 0.
    - ``MIDDLE``: in addition b_1 = 0, and abscissae at the midpoints of the intervals that the
      weights divide the step into, c_k = Σ_{j<k} b_j + b_k/2 for k > 2.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> result = cg.construct(order=4, stages=6, seed=1, structure=cg.Structure.STAGE_ORDER_TWO)
    >>> c = result.method.c
    >>> bool(abs(result.method.a[2:] @ c - c[2:] ** 2 / 2).max() < 1e-15)
    True
    """

    GENERAL = 0
    STAGE_ORDER_TWO = 1
    MIDDLE = 2


@dataclass(frozen=True)
class ConditionSystem:
    """The conditions of order q on a layout; a second result of a pair has order q - 1.

    A `structure` is for explicit tableaux of order 4 or more. In all vectors, values that `hold`
    gives, or that two `registers` imply, replace those of their unknowns; derivatives are those
    along vectors that keep them.
    """

    order: int
    layout: Layout
    structure: Structure = Structure.GENERAL
    hold: Hold = ()
    registers: bool = False

    def __post_init__(self) -> None:
        order = check_order(self.order)  # the compiled core checks neither order nor layout
        object.__setattr__(self, "order", order)
        check_instance("layout", self.layout, Layout)
        if self.rows is None:
            check_tree(self.layout.tree([Fraction(1)] * self.size))
        if self.layout.pair and self.order < 2:
            raise ValueError(f"order must be at least 2 for an embedded pair, got {self.order}")
        try:
            structure = Structure(self.structure)
        except (TypeError, ValueError):
            names = ", ".join(map(str, Structure.__members__))
            raise ValueError(f"structure must be one of {names}, got {self.structure!r}") from None
        object.__setattr__(self, "structure", structure)
        explicit, highest = self.rows is Rows.EXPLICIT, len(_REMAINING[1])
        if structure and not (explicit and self.stages > 2 and 4 <= order <= highest):
            raise ValueError(
                f"structure = {structure.name} is for explicit tableaux of orders 4 to {highest} "
                f"with 3 stages or more, got order {order}, {self.stages} stages, {self.rows!r}"
            )

    @classmethod
    def tableau(
        cls, order: int, stages: int, rows: Rows | str | int = Rows.EXPLICIT,
        embedded: bool = False, structure: Structure = Structure.GENERAL,
    ) -> ConditionSystem:  # fmt: skip
        """Return the conditions on a Crouch–Grossman tableau."""
        return cls(order, Layout.tableau(stages, rows, embedded), structure)

    @property
    def stages(self) -> int:
        """Number of stages."""
        return self.layout.stages

    @property
    def rows(self) -> Rows | None:
        """The pattern of a tableau; None for other methods."""
        return self.layout.rows

    @property
    def size(self) -> int:
        """Number of packed entries."""
        return self.layout.size

    @property
    def orders(self) -> tuple[int, ...]:
        """The orders of the results."""
        return (self.order, self.order - 1)[: 1 + self.layout.pair]

    @property
    def assumptions(self) -> list[tuple[int, int]]:
        """The trees of the simplifying assumptions with their stages, from 1."""
        trees = (_STAGE_ORDER_TWO, StageEquation.MIDDLE)[: self.structure]
        return [(tree, stage) for tree in trees for stage in range(3, self.stages + 1)]

    @cached_property
    def zeros(self) -> list[int]:
        """Indices of the entries that are fixed at zero."""
        fixed = list(self.layout.fixed)
        weights = [self.layout.row(self.stages + r) for r in range(len(self.layout.results))]
        if self.structure >= Structure.STAGE_ORDER_TWO:
            fixed += [row[1] for row in weights]
        if self.structure >= Structure.MIDDLE:
            fixed.append(weights[0][0])
        return fixed

    @cached_property
    def held(self) -> HeldValues | RegisterWeights | None:
        """The equations held beside zeros; None without `hold` and `registers`."""
        if self.registers:
            return RegisterWeights(self.layout)
        return HeldValues.of(self.hold, self.layout, self.zeros) if self.hold else None

    @cached_property
    def movable(self) -> NDArray[np.intp]:
        """Indices of the entries that aren't fixed at zero or by what is held."""
        fixed = self.zeros if self.held is None else self.held.pivots
        return np.setdiff1d(np.arange(self.size), fixed)

    def complete(self, x: Any) -> Any:
        """Return packed entries, doubles or Fractions, with the values that are held."""
        return x if self.held is None else self.held.complete(x)

    def texts(self, x: Sequence[Fraction]) -> list[str]:
        """Return entries as decimals, those that are held themselves as rationals."""
        if isinstance(self.held, HeldValues):
            return self.held.texts(x)
        return list(map(quads.to_decimal, x))

    @property
    def equations(self) -> int:
        """Number of equations that are independent at general points."""
        trees, _ = self.conditions(independent=True)
        if not self.structure:
            return len(trees)
        remaining = _REMAINING[self.structure]
        assumptions = int(self.structure) * (self.stages - 2)
        second = sum(_REMAINING[1][: self.order - 1]) if self.layout.pair else 0
        return sum(remaining[: self.order]) + second + assumptions

    def moving(self, movable: Sequence[int] | NDArray[np.intp] | None) -> NDArray[np.intp]:
        """Return the indices of entries that may change, sorted; all movable entries for None."""
        if movable is None:
            return self.movable
        # compiled code doesn't check indices
        return np.unique(np.arange(self.size)[np.asarray(movable, dtype=np.intp)])

    def movable_without(self, frozen: Sequence[int] | NDArray[np.intp]) -> NDArray[np.intp]:
        """Return the indices of the movable entries that aren't in `frozen`."""
        return np.setdiff1d(self.movable, self.moving(frozen))

    def conditions(self, independent: bool) -> tuple[NDArray[np.intc], NDArray[np.intc]]:
        """Return trees and owners: a `ConditionOwner` or, of assumptions, a stage from 1."""
        trees: list[int] = []
        owner: list[int] = []
        for result, order in zip(ConditionOwner, self.orders, strict=False):
            added = condition_trees(order, independent)
            trees += added
            owner += [result] * len(added)
        for tree, stage in self.assumptions:
            trees.append(tree)
            owner.append(stage)
        return np.array(trees, dtype=np.intc), np.array(owner, dtype=np.intc)

    def residual(self, x: NDArray[np.float64], independent: bool = True) -> NDArray[np.float64]:
        """Return the residuals at packed entries, shape (m,)."""
        trees, owner = self.conditions(independent)
        return core_calls.residuals(self.order, self.layout, self.complete(x), trees, owner)

    def jacobian(self, x: NDArray[np.float64], independent: bool = True) -> NDArray[np.float64]:
        """Return the derivatives of `residual`, shape (m, size)."""
        trees, owner = self.conditions(independent)
        jac = core_calls.jacobian(self.order, self.layout, self.complete(x), trees, owner)
        return jac if self.held is None else self.held.derivatives(jac, x)

    def residual_quad(self, x: quads.Quads, independent: bool = False) -> NDArray[np.float64]:
        """Return the residuals, computed in real(16) and rounded to double."""
        trees, owner = self.conditions(independent)
        return quads.to_float(core_calls.residuals(self.order, self.layout, x, trees, owner))


@cache
def next_trees(order: int) -> NDArray[np.intc]:
    """Return the trees of order q + 1, whose residuals make the principal error of order q."""
    return np.array(condition_trees(order + 1)[count(order) :], dtype=np.intc)
