"""The first order condition that a method violates."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from typing import TYPE_CHECKING, Any

from cg.construction import conditions
from cg.construction.methods.flat import failing_rooted
from cg.construction.methods.method import Method
from cg.construction.methods.munthe_kaas import MuntheKaas
from cg.construction.plots.text import draw_tree
from cg.construction.trees.ordered import OrderedTree, forest
from cg.construction.trees.rooted import planted, rooted_trees

if TYPE_CHECKING:
    from cg.support.flint import arb


@dataclass(frozen=True)
class FailingCondition:
    """A violated order condition ``Φ(t) = 1/γ(t)``, of an ordered or a planted rooted tree."""

    order: int
    tree: OrderedTree
    residual: float  # Φ(t) - 1/γ(t)
    right_side: Fraction  # 1/γ(t)
    failing: int  # number of violated ones
    of: int  # the number of independent conditions of that order

    @property
    def weight(self) -> float:
        """Φ(t)."""
        return self.residual + float(self.right_side)

    def __str__(self) -> str:
        off = f"{self.residual:.3g}" if self.residual else "less than a double can tell"
        return (
            f"{draw_tree(self.tree)}\n"
            f"{self.tree}  Φ = {self.weight:.10g}, 1/γ = {self.right_side}, "
            f"off by {off}"
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the condition as a dict for JSON."""
        texts = {"tree": str(self.tree), "right_side": str(self.right_side)}
        return vars(self) | texts | {"drawing": draw_tree(self.tree), "weight": self.weight}


def first_failing(method: Method) -> FailingCondition | None:
    """Return the first violated condition of lowest order; None beyond the highest known order."""
    order = method.exact_order + 1
    if order > conditions.MAX_ORDER:
        return None
    return _first_flat(method, order) if isinstance(method, MuntheKaas) else _first(method, order)


def _first(method: Method, order: int) -> FailingCondition:
    lower = conditions.count(order - 1, independent=True) if order > 1 else 0
    trees = conditions.condition_trees(order, independent=True)[lower:]
    sides = conditions.right_sides(order, independent=True)[lower:]
    residuals_in = partial(conditions.residuals, method.tree, order, independent=True)
    residuals = residuals_in(arithmetic="balls")[lower:]
    allowed = method.tolerance(order)[lower:].tolist()
    failing = [
        k for k, (r, t) in enumerate(zip(residuals, allowed, strict=True)) if not _within(r, t)
    ]
    if failing:
        residual = float(residuals[failing[0]].mid())
    else:  # the balls contain zero: decide in exact arithmetic
        exact = residuals_in(arithmetic="exact")[lower:]
        pairs = enumerate(zip(exact, allowed, strict=True))
        failing = [k for k, (r, t) in pairs if abs(r) > Fraction(t)]
        residual = float(exact[failing[0]])
    k = failing[0]
    tree = forest(order + 1).tree(trees[k])
    return FailingCondition(order, tree, residual, sides[k], len(failing), len(trees))


def _within(residual: arb, tolerance: float) -> bool:
    # an infinite tolerance of huge coefficients decides nothing, as in `Method.satisfies`
    if not math.isfinite(tolerance):
        return False
    return bool(residual.contains(0) or abs(residual) <= tolerance)


def _first_flat(method: MuntheKaas, order: int) -> FailingCondition:
    failing = failing_rooted(method.tableau, order)
    tree, weight, side = failing[0]
    trees = len(rooted_trees(order))
    residual = float(weight - side)
    return FailingCondition(order, planted(tree), residual, side, len(failing), trees)
