r"""Order conditions of splitting methods for H = T + V, with T quadratic in the momentum.

A step is a composition of flows of T (drifts) and V (kicks). A bracket of Hamiltonians that are
polynomials of degrees m and n in the momentum has degree m + n - 1, so that [V, [V, [V, T]]] = 0,
and so are all brackets with more kicks than drifts allow, on any manifold. What remains is the Lie
algebra of :math:`\ddot q = f(q)`, of which a splitting method is a Runge–Kutta–Nyström method with
nodes c and weights :math:`a_{ij} = b_j (c_i - c_j)`, j < i: c are sums of drifts, b kicks. Its
conditions belong to the special Nyström trees [1]_: rooted trees in which each node at an odd
distance from the root has one child at most. A method has order q if its drifts sum to 1 and
:math:`\sum_i b_i \Phi_i(t) = 1/\gamma(t)` for all of them with up to q nodes; being symplectic, it
satisfies the conditions for positions as well. Independent are 2, 1, 2, 2, 4, 5, 10 and 14
conditions of orders 1 to 8, those of even orders follow if the method is symmetric.

References
----------
.. [1] E. Hairer, S. P. Nørsett, G. Wanner, "Solving Ordinary Differential Equations I", 2nd
   ed., Springer, 1993, section II.14.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import accumulate, chain, product
from math import factorial, prod
from typing import Any

from cg.construction.conditions.linear_equations import Series, exponential, times
from cg.construction.trees.rooted import RootedTree, density, rooted_trees_through


@cache
def nystrom_trees(order: int) -> tuple[RootedTree, ...]:
    """Return the special Nyström trees with 1 to `order` nodes, smaller ones first.

    Examples
    --------
    >>> [len(nystrom_trees(order)) for order in range(1, 9)]
    [1, 2, 4, 7, 13, 23, 43, 79]
    """
    return tuple(tree for tree in rooted_trees_through(order) if _is_special(tree))


def _is_special(tree: RootedTree) -> bool:
    return all(len(child) <= 1 and all(map(_is_special, child)) for child in tree)


def nystrom_residuals(drifts: Sequence[Any], kicks: Sequence[Any], order: int) -> list[Any]:
    """Return Σ drifts - 1, then the residuals Φ(t) - 1/γ(t) of `nystrom_trees`.

    Parameters
    ----------
    drifts, kicks
        Sequences of s + 1 and s numbers. Of any type that can be added, multiplied and divided by
        integers.
    order
        The largest number of nodes.
    """
    values = nystrom_values(drifts, kicks, order)
    one = values[0] * 0 + 1
    sides = (one / density(tree) for tree in nystrom_trees(order))
    return [value - side for value, side in zip(values, (one, *sides), strict=True)]


def nystrom_values(drifts: Sequence[Any], kicks: Sequence[Any], order: int) -> list[Any]:
    """Return Σ drifts, then Φ(t) of `nystrom_trees`: polynomials without negative coefficients."""
    nodes = list(accumulate(drifts))
    at_kicks: dict[RootedTree, list[Any]] = {}

    def flowed(tree: RootedTree) -> list[Any]:
        """Return Σ_j b_j (c_i - c_j) Φ_j(tree) at each kick i."""
        moved, speed, position = [], 0, 0
        for drift, kick, value in zip(drifts, kicks, phi(tree), strict=False):
            position = position + drift * speed
            moved.append(position)
            speed = speed + kick * value
        return moved

    def phi(tree: RootedTree) -> list[Any]:
        if tree not in at_kicks:
            rows = [flowed(child[0]) if child else nodes for child in tree]
            at_kicks[tree] = [prod(row[i] for row in rows) for i in range(len(kicks))]
        return at_kicks[tree]

    sums = (sum(map(prod, zip(kicks, phi(tree), strict=True))) for tree in nystrom_trees(order))
    return [nodes[-1], *sums]


@cache
def splitting_words(order: int) -> tuple[tuple[int, ...], ...]:
    """Return the words of the letters 0 (T) and 1 (V) of lengths 1 to `order`, shorter ones first.

    Examples
    --------
    >>> splitting_words(2)
    ((0,), (1,), (0, 0), (0, 1), (1, 0), (1, 1))
    """
    return tuple(word for n in range(1, order + 1) for word in product((0, 1), repeat=n))


def splitting_values(drifts: Sequence[Any], kicks: Sequence[Any], order: int) -> list[Any]:
    """Return the coefficients of `splitting_words` in the product of exponentials of T and V."""
    zero = drifts[0] * 0
    values: Series = {(): zero + 1}
    for k, weight in enumerate(chain.from_iterable(zip(drifts, (*kicks, zero), strict=True))):
        values = times(exponential({(k % 2,): weight}, order, len), values, order, len)
    return [values.get(word, zero) for word in splitting_words(order)]


def splitting_residuals(drifts: Sequence[Any], kicks: Sequence[Any], order: int) -> list[Any]:
    """Return `splitting_values` less 1/n!, as in exp(T + V): the conditions for any T and V."""
    values, words = splitting_values(drifts, kicks, order), splitting_words(order)
    one = drifts[0] * 0 + 1
    return [x - one / factorial(len(word)) for x, word in zip(values, words, strict=True)]
