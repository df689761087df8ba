"""Classical order conditions on rooted trees, for methods whose flows commute."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import cache
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.construction.conditions import MAX_ORDER
from cg.construction.methods.coefficients import Coefficient
from cg.construction.methods.tableau import Tableau
from cg.construction.methods.tolerance import TOLERANCE_FACTOR, to_floats
from cg.construction.trees import RootedTree, density, rooted_trees, rooted_trees_through
from cg.support.quads import to_flint, to_fraction

CoefficientRow = Sequence[Coefficient]
CoefficientRows = Sequence[CoefficientRow]
Matrix = Sequence[Sequence[Fraction]]


def flat_order(tableau: Tableau, *, embedded: bool = False) -> int:
    """Return the classical order of a tableau, up to the rounding of its coefficients.

    The tolerance is that of `cg.Method.exact_order`, for the classical weights. With `embedded`, it
    is the order of the second weights of a pair.
    """
    weights = tableau.embedded_weights if embedded else tableau.weights
    if weights is None:
        raise ValueError(f"embedded must be False without second weights, got {tableau!r}")
    return _order(tableau.entries, weights, Fraction(1))


def _order(entries: CoefficientRows, weights: CoefficientRow, end: Fraction) -> int:
    orders = range(1, MAX_ORDER + 1)
    return next((q - 1 for q in orders if failing_rooted(entries, weights, q, end)), MAX_ORDER)


def failing_rooted(
    entries: CoefficientRows, weights: CoefficientRow, order: int, end: Fraction = Fraction(1)
) -> list[tuple[RootedTree, Fraction, Fraction]]:
    """Return the trees with `order` nodes whose conditions fail, with Φ(t) and ``end**|t| / γ(t)``.

    The weights are those of a step to the time `end`, such as a row of ``a`` to its abscissa.
    """
    a, b = [[e.value for e in row] for row in entries], [w.value for w in weights]
    trees = rooted_trees(order)
    weights_of_trees, allowed = _weights(a, b, trees), _tolerances(entries, weights, trees)
    sides = [end**order / density(tree) for tree in trees]
    compared = zip(trees, weights_of_trees, sides, allowed, strict=True)
    return [(tree, phi, side) for tree, phi, side, bound in compared if abs(phi - side) > bound]


def flat_residuals(a: Matrix, b: Sequence[Fraction], order: int) -> tuple[Fraction, ...]:
    """Return the exact ``Φ(t) - 1/γ(t)`` of the trees of `rooted_trees_through`."""
    trees = rooted_trees_through(order)
    weights = _weights(a, b, trees)
    return tuple(phi - Fraction(1, density(t)) for phi, t in zip(weights, trees, strict=True))


def stage_weights(a: NDArray[Any], one: Any = 1.0) -> Callable[[Any], NDArray[Any]]:
    """Return the function from trees to their elementary weights at the stages, shape (s,).

    A tree is the tuple of its children. `one` is the number 1 of the type of the entries of ``a``.
    """
    ones = np.full(len(a), one, dtype=a.dtype)

    @cache
    def at_stages(tree: Any) -> NDArray[Any]:
        return prod((a @ at_stages(child) for child in tree), start=ones)

    return at_stages


def _weights(a: Matrix, b: Sequence[Fraction], trees: Sequence[RootedTree]) -> list[Fraction]:
    matrix = np.array([list(map(to_flint, row)) for row in a], dtype=object)
    row = np.array(list(map(to_flint, b)), dtype=object)
    at_stages = stage_weights(matrix, to_flint(1))
    return [to_fraction(row @ at_stages(tree)) for tree in trees]


def _tolerances(
    entries: CoefficientRows, weights: CoefficientRow, trees: Sequence[RootedTree]
) -> list[Fraction]:
    """Return ``2 Σ_k |∂Φ(t)/∂x_k| u_k`` for each tree, u_k the uncertainty of coefficient k."""
    units = np.array([float(e.unit) for row in (*entries, weights) for e in row])
    if not units.any():
        return [Fraction(0)] * len(trees)
    a, b = np.array([to_floats(row) for row in entries]), to_floats(weights)
    at_stages = stage_weights(a)

    def gradient(tree: RootedTree, outer: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the derivatives by a of ``outer · at_stages(tree)``."""
        factors, total = [a @ at_stages(child) for child in tree], np.zeros_like(a)
        for k, child in enumerate(tree):
            inner = prod(factors[:k] + factors[k + 1 :], start=outer)
            total += np.outer(inner, at_stages(child)) + gradient(child, inner @ a)
        return total

    jacobian = [np.append(gradient(tree, b), at_stages(tree)) for tree in trees]
    bounds = TOLERANCE_FACTOR * (np.abs(jacobian) @ units)
    return list(map(Fraction, bounds.tolist()))


def stage_orders(tableau: Tableau) -> tuple[int, ...]:
    """Return the classical order of each row of ``a`` as weights of a step to its abscissa."""
    rows = zip(tableau.entries, tableau.abscissae, strict=True)
    return tuple(_order(tableau.entries, row, c) if c else 0 for row, c in rows)
