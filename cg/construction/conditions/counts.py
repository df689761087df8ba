"""The trees of the order conditions, their numbers and right-hand sides."""

from fractions import Fraction
from functools import cache

from cg import _core_r64
from cg.construction.trees import MAX_NODES, forest
from cg.support.checks import check_flag, check_integer

MAX_ORDER: int = int(_core_r64.highest_order())
"""Highest order of the compiled tables of trees (a build option)."""


def check_order(order: int, highest: int | None = MAX_ORDER) -> int:
    """Return `order` as an int between 1 and `highest`; None for the largest trees of Python."""
    checked = check_integer("order", order, 1, None if highest else MAX_NODES - 1)
    if highest is not None and checked > highest:
        raise ValueError(
            f"order must be at most {highest}, the highest that the tables were built for "
            f"(build option highest_order), got {order}"
        )
    return checked


def condition_trees(order: int, independent: bool = False) -> tuple[int, ...]:
    """Return the indices of the trees whose conditions make an order.

    ``cg.construction.trees.forest(order + 1).tree(index)`` is the tree of an index.

    Parameters
    ----------
    order
        At least 1.
    independent
        Only the trees whose condition doesn't follow from conditions of lower order: those
        whose word of children is a Lyndon word.

    Examples
    --------
    >>> condition_trees(3), condition_trees(3, independent=True)
    ((2, 3, 4, 5, 6, 7, 8, 9), (2, 4, 6, 8, 9))
    """
    return _condition_trees(check_order(order, None), check_flag("independent", independent))


@cache
def _condition_trees(order: int, independent: bool) -> tuple[int, ...]:
    trees = forest(order + 1)
    indices = range(2, len(trees) + 1)
    return tuple(k for k in indices if not independent or trees.is_independent(k))


def table_rows(order: int) -> tuple[int, ...]:
    """Return the integer table of the paper: indices of trees, 0 for dependent conditions.

    >>> table_rows(3)
    (2, 0, 4, 0, 6, 0, 8, 9)
    """
    independent = set(condition_trees(order, independent=True))
    return tuple(t if t in independent else 0 for t in condition_trees(order))


def count(order: int, independent: bool = False) -> int:
    """Return the number of order conditions through `order` (``N_CG`` if independent).

    Examples
    --------
    >>> [count(order) for order in range(1, 7)]
    [1, 3, 8, 22, 64, 196]
    >>> [count(order, independent=True) for order in range(1, 7)]
    [1, 2, 5, 13, 38, 113]
    """
    return len(condition_trees(check_order(order, None), independent))


def right_sides(order: int, independent: bool = False) -> tuple[Fraction, ...]:
    """Return ``1/γ(t)`` for the trees of `condition_trees`.

    >>> [str(side) for side in right_sides(3)]
    ['1', '1/2', '1/2', '1/6', '1/3', '1/6', '1/6', '1/6']
    """
    trees = forest(check_order(order, None) + 1)
    return tuple(Fraction(1, trees.density[t - 1]) for t in condition_trees(order, independent))
