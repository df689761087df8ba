"""Flat Runge–Kutta methods: rooted trees whose children have no order, and the order they give."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction
from functools import cache
from typing import TYPE_CHECKING

from ..conditions import MAX_ORDER
from ..support.balls import to_fmpq
from .coefficients import Coefficient
from .tableau import Tableau

if TYPE_CHECKING:
    from flint import fmpq

__all__ = ["Rooted", "failing_rooted", "flat_order", "rooted_trees", "stage_orders"]

Rooted = tuple["Rooted", ...]
"""A rooted tree as the sorted tuple of its children; ``()`` is the single node."""


@cache
def rooted_trees(nodes: int) -> tuple[Rooted, ...]:
    """Return all rooted trees with so many nodes: 1, 1, 2, 4, 9, 20, 48, 115, …."""

    def forests(left: int, most: Rooted | None, size: int) -> Iterator[Rooted]:
        if left == 0:
            yield ()
            return
        for first_size in range(min(left, size), 0, -1):
            for first in rooted_trees(first_size):
                if first_size == size and most is not None and first > most:
                    continue
                for rest in forests(left - first_size, first, first_size):
                    yield (first, *rest)

    return tuple(forests(nodes - 1, None, nodes - 1)) if nodes > 1 else ((),)


@cache
def _size(tree: Rooted) -> int:
    return 1 + sum(map(_size, tree))


@cache
def _density(tree: Rooted) -> int:
    product = _size(tree)
    for child in tree:
        product *= _density(child)
    return product


def flat_order(tableau: Tableau, *, embedded: bool = False) -> int:
    """Return the order of a tableau where flows commute, as far as its stored places can tell.

    Residuals are exact. Each is allowed what it can change by if all coefficients change by
    their units (`cg.method.coefficients.Coefficient.unit`), which is nothing for rationals.

    Parameters
    ----------
    tableau : Tableau
    embedded : bool, optional
        Of the second weights of a pair.

    Returns
    -------
    int
        At most ``conditions.MAX_ORDER``.
    """
    weights = tableau.embedded_weights if embedded else tableau.weights
    if weights is None:
        raise ValueError(f"embedded: {tableau!r} has no second weights")
    return _order(tableau.entries, weights, Fraction(1))


def _order(
    entries: Sequence[Sequence[Coefficient]], weights: Sequence[Coefficient], end: Fraction
) -> int:
    for order in range(1, MAX_ORDER + 1):
        if _failing(entries, weights, end, order):
            return order - 1
    return MAX_ORDER


def failing_rooted(tableau: Tableau, order: int) -> list[tuple[Rooted, Fraction, Fraction]]:
    """Return the rooted trees of an order whose condition fails, with Φ(t) and 1/γ(t).

    Parameters
    ----------
    tableau : Tableau
    order : int
        Number of nodes.
    """
    return _failing(tableau.entries, tableau.weights, Fraction(1), order)


def _failing(
    entries: Sequence[Sequence[Coefficient]],
    weights: Sequence[Coefficient],
    end: Fraction,
    order: int,
) -> list[tuple[Rooted, Fraction, Fraction]]:
    a, b = [[e.value for e in row] for row in entries], [w.value for w in weights]
    size_a, size_b = [[abs(e) for e in row] for row in a], [abs(w) for w in b]
    wide_a = [[abs(e.value) + e.unit for e in row] for row in entries]
    wide_b = [abs(w.value) + w.unit for w in weights]
    exact = all(e.unit == 0 for row in (*entries, weights) for e in row)
    trees = rooted_trees(order)
    found = _weights(a, b, trees)
    allowed = [Fraction(0)] * len(trees)
    if not exact:
        near, far = _weights(size_a, size_b, trees), _weights(wide_a, wide_b, trees)
        allowed = [2 * (f - n) for f, n in zip(far, near, strict=True)]
    sides = [end**order / _density(tree) for tree in trees]
    compared = zip(trees, found, sides, allowed, strict=True)
    return [(tree, phi, side) for tree, phi, side, bound in compared if abs(phi - side) > bound]


def _weights(
    a: Sequence[Sequence[Fraction]], b: Sequence[Fraction], trees: Sequence[Rooted]
) -> list[Fraction]:
    from flint import fmpq, fmpq_mat

    matrix = fmpq_mat([[to_fmpq(e) for e in row] for row in a])
    row = [to_fmpq(w) for w in b]
    known: dict[Rooted, list[fmpq]] = {}

    def at_stages(tree: Rooted) -> list[fmpq]:
        if tree not in known:
            product = [fmpq(1)] * len(row)
            for child in tree:
                column = fmpq_mat([[v] for v in at_stages(child)])
                sums = (matrix * column).entries()
                product = [p * s for p, s in zip(product, sums, strict=True)]
            known[tree] = product
        return known[tree]

    totals = [
        sum((w * v for w, v in zip(row, at_stages(tree), strict=True)), fmpq(0)) for tree in trees
    ]
    return [Fraction(int(total.p), int(total.q)) for total in totals]


def stage_orders(tableau: Tableau) -> tuple[int, ...]:
    """Return to which order each stage is the solution at its abscissa, where flows commute."""
    found = []
    for row in tableau.entries:
        c = sum((entry.value for entry in row), Fraction(0))
        if c == 0:
            found.append(0)
            continue
        found.append(_order(tableau.entries, row, c))
    return tuple(found)
