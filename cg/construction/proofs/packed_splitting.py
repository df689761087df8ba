r"""Order conditions of splitting methods that don't follow from each other, for proofs.

The logarithm of a step is a series in the Lie algebra of T and V (see `nystrom`), graded by the
number of letters. Let :math:`T + V + L_q + \dots` be that of a method of order q - 1. Then the
residual of a tree with q nodes is a linear function of :math:`L_q`, a combination of brackets of q
letters, and all of them vanish if those of a basis do. In a symmetric step the even terms of the
logarithm are zero, so that conditions of odd orders suffice, and half of the coefficients are
unknowns.

A composition of n steps :math:`\gamma_i h` of leapfrog has more relations: it is
:math:`\prod_i \exp(\gamma_i Y_1 + \gamma_i^3 Y_3 + \gamma_i^5 Y_5 + \dots)` with unknowns γ. The
coefficient of a word in the letters Y is a polynomial in those of Lyndon words that are not longer
(Radford's theorem), so that these are the conditions [1]_.

References
----------
.. [1] E. Hairer, C. Lubich, G. Wanner, "Geometric Numerical Integration", 2nd ed., Springer, 2006,
   section III.3.3.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise, product
from typing import Any

from cg.construction.conditions.linear_equations import Series, exponential, times
from cg.construction.conditions.nystrom import nystrom_residuals, nystrom_trees, nystrom_values
from cg.construction.conditions.words import Condition, Word, condition_words, nodes
from cg.construction.methods.splitting import Splitting
from cg.construction.proofs.packed import Packed, PolynomialEquations
from cg.construction.trees.rooted import RootedTree, node_count
from cg.support import flint

_DRIFTS: Word = ()
"""Stands for the condition Σ d = 1, which has no tree."""


@dataclass(frozen=True)
class PackedSplitting(Packed):
    """A splitting method as those of its coefficients on which the others depend.

    These are the first half of a symmetric method; of a composition of leapfrog those of its inner
    row, as the outer row has the means of its neighbours.
    """

    size: int  # number of coefficients, of the inner row alone in a composition
    places: tuple[int, ...]  # of the coefficients in the order of a step
    symmetric: bool
    inner: int | None  # the row of γ if this is a composition: 0 for drifts, 1 for kicks

    @classmethod
    def of(cls, method: Splitting, orders: Sequence[int]) -> PackedSplitting:
        """Pack a splitting method."""
        values = [x.value for x in method.coefficients]
        symmetric, inner, places = values == values[::-1], None, range(len(values))
        for row, inside in enumerate((range(2, len(values) - 1, 2), range(1, len(values), 2))):
            if inside and values == _composed([values[k] for k in inside], row):
                inner, places = row, inside
                break
        size = len(places)
        if symmetric:
            places = places[: (len(places) + 1) // 2]
        packed = tuple(method.coefficients[k] for k in places)
        return cls(method.name, packed, tuple(orders), size, tuple(places), symmetric, inner)

    @property
    def names(self) -> list[str]:
        return [f"{'dk'[k % 2]}_{k // 2}" for k in self.places]

    @property
    def conditions(self) -> list[Condition]:
        (order,) = self.orders
        grades = range(1, order + 1, 2 if self.symmetric else 1)
        if self.inner is None:
            found = [_DRIFTS, *((tree,) for q in grades for tree in independent_trees(q))]
        else:
            found = [word for word in _words_of_odd_letters(order) if nodes(word) in grades]
        return [Condition(0, word) for word in found]

    def equations(self, conditions: Sequence[Condition]) -> PolynomialEquations:
        largest = max(nodes(word) for _, word in conditions)
        composed = self.inner is not None and largest <= self.orders[0]  # otherwise trees beyond
        trees = [_DRIFTS, *((tree,) for tree in nystrom_trees(largest))]

        def residuals(z: Sequence[Any]) -> list[Any]:
            if composed:
                known = _composition_residuals(self._mirrored(z), largest)
            else:
                steps = self.spread(z)
                values = nystrom_residuals(steps[::2], steps[1::2], largest)
                known = dict(zip(trees, values, strict=True))
            return [known[word] for _, word in conditions]

        return PolynomialEquations(residuals)

    def words(self, order: int) -> list[Word]:
        return [(tree,) for tree in nystrom_trees(order) if node_count(tree) == order]

    def spread(self, z: Sequence[Any]) -> list[Any]:
        row = self._mirrored(z)
        return row if self.inner is None else _composed(row, self.inner)

    def _mirrored(self, z: Sequence[Any]) -> list[Any]:
        return [*z, *z[: self.size - len(z)][::-1]]


def _composed(row: Sequence[Any], inner: int) -> list[Any]:
    """Return the coefficients in the order of a step, of a composition of leapfrog.

    The inner row is that of drifts (0) or kicks (1).
    """
    zero = [row[0] * 0] if row else []
    outer = [(x + y) / 2 for x, y in pairwise([*zero, *row, *zero])]
    steps = [x for pair in zip(outer, [*row, *zero], strict=True) for x in pair][:-1]
    return steps if inner else [*zero, *steps, *zero]


def _composition_residuals(gammas: Iterable[Any], order: int) -> dict[Word, Any]:
    """Return the coefficients of Lyndon words in Y, less those in exp(Y_1)."""
    total: Series = {(): 1}
    for gamma in gammas:
        letters: Series = {(j,): gamma**j for j in range(1, order + 1, 2)}
        total = times(exponential(letters, order), total, order)
    return {
        word: total[tuple(len(letter) + 1 for letter in word)] - (nodes(word) == 1)
        for word in _words_of_odd_letters(order)
    }


@cache
def _words_of_odd_letters(order: int) -> tuple[Word, ...]:
    """Return the Lyndon words in Y_1, Y_3, … of degrees 1 to `order`; Y_j is a tree of j nodes."""
    every = condition_words(order, independent=True, of_time=True)
    return tuple(word for word in every if all(len(letter) % 2 == 0 for letter in word))


@cache
def independent_trees(q: int) -> tuple[RootedTree, ...]:
    """Return trees with q nodes on whose residuals those of all trees with q nodes depend.

    Values of trees with q nodes are linear functions of the terms of q letters in the logarithm of
    a step whose other terms have more. These are spanned by brackets of T or V with brackets, for
    each of which a commutator of flows is such a step.
    """
    trees = [tree for tree in nystrom_trees(q) if node_count(tree) == q]
    rows = []
    for letters in product((0, 1), repeat=q):
        drifts, kicks = _commutator(letters)
        rows.append(nystrom_values(drifts, kicks, q)[-len(trees) :])
    reduced, rank = flint.fmpq_mat(rows).rref()
    entries = reduced.tolist()
    pivots = [next(k for k, x in enumerate(entries[i]) if x != 0) for i in range(rank)]
    return tuple(trees[k] for k in pivots)


def _commutator(letters: Sequence[int]) -> tuple[list[int], list[int]]:
    """Return drifts and kicks of the nested commutator of the flows of T (0) and V (1)."""
    steps = [(letters[0], 1)]
    for letter in letters[1:]:
        back = [(flow, -sign) for flow, sign in reversed(steps)]
        steps = [*steps, (letter, 1), *back, (letter, -1)]
    drifts = [sign * (flow == 0) for flow, sign in steps]
    return [*drifts, 0], [sign * (flow == 1) for flow, sign in steps]
