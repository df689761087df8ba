"""Relations between residuals of a method whose rows add up to those of a flat tableau.

The sums of weights along the paths to stages and results are a flat tableau. If they are held at
rational numbers, or at numbers ``a + b √d``, the weights of rooted trees are fixed, which are
combinations of those of ordered trees. The conditions of rooted trees, and combinations of
products of vectors of rooted trees that vanish, are relations with exact coefficients.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from fractions import Fraction
from functools import cache, reduce
from itertools import product

from flint import arb

from ...structure.layout import Layout
from ...trees.rooted import rooted_trees
from ..systems import Equation, Term
from ..weights import Quantity
from .contexts import basis, outer_nodes
from .orthogonality import Condition, ResidualRelation
from .quadratic import Quadratic, dependencies
from .relations import SLOT, fill
from .structure import MethodStructure
from .words import Word, add_multiple, extend, nodes, reciprocal_density, shuffle, words_with

Combination = dict[Word, int]
_Steps = tuple[Word, ...]
_Zero = dict[Condition, Quadratic]
_ONE = Quadratic(1)


class FlatTableau(MethodStructure):
    """The flat tableau of a method: sums of weights along the paths to stages and results.

    `root` is the d of numbers ``a + b √d`` that the sums are rounded from; 0 if they are exact.
    """

    def __init__(
        self, layout: Layout, orders: Sequence[int], x: Sequence[Fraction], root: int = 0
    ) -> None:
        super().__init__(layout, orders, x)
        sums = [[Fraction(0)] * layout.stages for _ in layout.ends]
        self._present: list[tuple[int, int]] = []
        for i, end in enumerate(layout.ends):
            for point in layout.path(end):
                for k, stage in enumerate(layout.weights[point], layout.starts[point]):
                    sums[i][stage] += x[k]
                    if (i, stage) not in self._present:
                        self._present.append((i, stage))
        self._sums = [[Quadratic.near(entry, root) for entry in row] for row in sums]
        self._known_values: dict[Word, list[Quadratic]] = {}
        self._known_along: dict[tuple[int, _Steps], list[Quadratic]] = {}

    def satisfied(self) -> bool:
        """Return whether the tableau has the orders in flat space, exactly."""
        return not self._layout.of_time and all(
            not _product(self._sums[row], self._values(tree)) - _exact(_flat(tree))
            for r, order in enumerate(self._orders)
            for row in [self._layout.stages + r]
            for count in range(order)
            for tree in rooted_trees(count + 1)
        )

    def equations(self) -> list[Equation]:
        """Return the sums of weights as equations; one of those over the same weights."""
        size = self._layout.size
        rows = []
        for i, stage in self._present:
            row = [0] * size
            for point in self._layout.path(self._layout.ends[i]):
                for k, other in enumerate(self._layout.weights[point], self._layout.starts[point]):
                    row[k] += other == stage
            rows.append([Quadratic(entry) for entry in row])
        return [
            Equation(
                f"the sum of weights on stage {stage + 1} in row {i + 1}",
                (Term(Fraction(1), (Quantity(i, (stage,)),)),),
                -self._sums[i][stage].number,
            )
            for i, stage in (self._present[k] for k in _independent(rows))
        ]

    def relations(self, y: Sequence[arb] = ()) -> Iterator[ResidualRelation]:
        """Yield combinations of residuals that are zero: rows and words, and coefficients."""
        for row, order in enumerate(self._orders):
            for count in range(order):
                for tree in rooted_trees(count + 1):
                    yield {(row, (word,)): Fraction(m) for word, m in _flat(tree).items()}
        for most in range(self._orders[0]):
            for relation in (
                *self._of_letters(most),
                *self._of_contexts(most),
                *self._of_products(most),
            ):
                # a relation between residuals if the exact solution satisfies it too
                terms = (value.times(reciprocal_density(w)) for (_, w), value in relation.items())
                if not sum(terms, Quadratic(0)):
                    yield {key: value.number for key, value in relation.items() if value}

    def _of_letters(self, most: int) -> Iterator[_Zero]:
        """Yield products of all contexts with dependent letters of rooted trees."""
        trees = [tree for count in range(most + 1) for tree in rooted_trees(count + 1)]
        for zero in dependencies([self._values(tree) for tree in trees]):
            if nodes(trees[max(zero)]) < most:
                continue  # with more contexts before
            letter = _sum((_flat(trees[k]), share) for k, share in zero.items())
            for row, order in enumerate(self._orders):
                free = order - 1 - most
                for context in ((SLOT,), *basis(free)) if free >= 0 else ():
                    for factor in _letters(free - outer_nodes(context)):
                        yield _filled(row, {context: _ONE}, {factor: 1}, letter)

    def _of_contexts(self, most: int) -> Iterator[_Zero]:
        """Yield products of all letters with dependent contexts of rooted trees."""
        rows = self._contexts(most + 1)
        for zero in dependencies([self._along(row, steps) for row, steps in rows]):
            for letter in words_with(most):
                relation: _Zero = {}
                for k, share in zero.items():
                    _add(relation, self._around(*rows[k], share, letter))
                yield relation

    def _of_products(self, most: int) -> Iterator[_Zero]:
        """Yield combinations of products of contexts and letters of rooted trees.

        Those that are zero for all rows i and stages k such that flows on the way to the end of
        row i have weights on stage k: then they are zero with any words on these ways, `most`
        nodes in each besides the letter.
        """
        if not most:
            return
        trees = [
            tree for count in range(self._orders[0] - most) for tree in rooted_trees(count + 1)
        ]
        trees = [trees[k] for k in _independent([self._values(tree) for tree in trees])]
        rows = self._contexts(most + 1)
        rows = [rows[k] for k in _independent([self._along(*one) for one in rows])]
        rows += [(row, ()) for row in range(len(self._orders))]
        both = [
            (row, steps, tree)
            for row, steps in rows
            for tree in trees
            if len(steps) - 1 + sum(map(nodes, steps)) + nodes(tree) <= self._orders[row] - 2 - most
        ]
        products = []
        for row, steps, tree in both:
            left, right = self._at_ends(row, steps), self._values(tree)
            products.append([left[i] * right[k] for i, k in self._present])
        for zero in dependencies(products):
            for context in _root_contexts(most):
                relation: _Zero = {}
                for k, share in zero.items():
                    row, steps, tree = both[k]
                    for (_, word), value in self._around(row, steps, share, context).items():
                        filled = {(row, fill(word, z)): m for z, m in _flat(tree).items()}
                        _add(relation, {one: value.times(m) for one, m in filled.items()})
                yield relation

    def _contexts(self, nodes_left: int) -> list[tuple[int, _Steps]]:
        """Return contexts of rooted trees that leave `nodes_left` nodes to the slot."""
        return [
            (row, steps)
            for row, order in enumerate(self._orders)
            for degree in range(order + 1 - nodes_left)
            for steps in _chains(degree)
        ]

    def _around(self, row: int, steps: _Steps, share: Quadratic, word: Word) -> _Zero:
        """Return a multiple of a context of rooted trees, with a word in the slot."""
        if not steps:
            return {(row, word): share}
        contexts = _sum([(_around(steps), share)])
        return _filled(row, contexts, _flat(steps[-1]), {word: _ONE})

    def _at_ends(self, row: int, steps: _Steps) -> list[Quadratic]:
        """Return a context as a vector over stages and results; a row itself for no steps."""
        stages = self._layout.stages
        if steps:
            return self._along(row, steps) + [Quadratic(0)] * len(self._orders)
        return [Quadratic(int(i == stages + row)) for i in range(len(self._layout.ends))]

    def _values(self, tree: Word) -> list[Quadratic]:
        """Return the weights of a rooted tree at the stages."""
        if tree not in self._known_values:
            values = [_ONE] * self._layout.stages
            for child in tree:
                inner = self._values(child)
                rows = self._sums[: self._layout.stages]
                values = [x * _product(row, inner) for x, row in zip(values, rows, strict=True)]
            self._known_values[tree] = values
        return self._known_values[tree]

    def _along(self, row: int, steps: _Steps) -> list[Quadratic]:
        """Return a context of rooted trees as a vector over the stages."""
        if (row, steps) not in self._known_along:
            vector = self._sums[self._layout.stages + row]
            if len(steps) > 1:
                before = self._along(row, steps[:-1])
                columns = zip(*self._sums[: self._layout.stages], strict=True)
                vector = [_product(before, column) for column in columns]
            values = self._values(steps[-1])
            self._known_along[row, steps] = [a * b for a, b in zip(vector, values, strict=True)]
        return self._known_along[row, steps]


@cache
def _flat(tree: Word) -> Combination:
    """Return a rooted tree as a combination of letters: children of ordered trees."""

    def with_child(words: Combination, child: Word) -> Combination:
        return extend(
            lambda word: extend(lambda letter: shuffle(word, (letter,)), _flat(child)), words
        )

    return reduce(with_child, tree, {(): 1})


@cache
def _chains(degree: int) -> tuple[_Steps, ...]:
    """Return contexts of rooted trees: children of the nodes from the root to the slot."""
    chains: list[_Steps] = [(tree,) for tree in rooted_trees(degree + 1)]
    for first in range(degree):
        for tree in rooted_trees(first + 1):
            chains += [(tree, *rest) for rest in _chains(degree - 1 - first)]
    return tuple(chains)


@cache
def _around(steps: _Steps) -> Combination:
    """Return a context of rooted trees as words with a slot, but for the last factor."""

    def filled(contexts: Combination, tree: Word) -> Combination:
        inner = extend(lambda word: shuffle(word, (SLOT,)), _flat(tree))
        return extend(lambda context: {fill(context, z): m for z, m in inner.items()}, contexts)

    return reduce(filled, steps[:-1], {(SLOT,): 1})


def _letters(most: int) -> Iterator[Word]:
    """Yield the letters with at most `most` nodes besides their roots."""
    for count in range(most + 1):
        yield from words_with(count)


@cache
def _root_contexts(count: int) -> tuple[Word, ...]:
    """Return the words with a slot at the root, and `count` nodes around it."""
    return tuple(
        (*left, SLOT, *right)
        for before in range(count + 1)
        for left, right in product(words_with(before), words_with(count - before))
    )


def _exact(letters: Combination) -> Quadratic:
    total = sum((m * reciprocal_density((letter,)) for letter, m in letters.items()), Fraction(0))
    return _ONE.times(total)


def _product(row: Sequence[Quadratic], values: Sequence[Quadratic]) -> Quadratic:
    terms = (a * b for a, b in zip(row, values, strict=True) if a and b)
    return sum(terms, Quadratic(0))


def _add(total: _Zero, more: _Zero) -> None:
    for one, value in more.items():
        add_multiple(total, one, value)


def _sum(terms: Iterable[tuple[Combination, Quadratic]]) -> dict[Word, Quadratic]:
    total: dict[Word, Quadratic] = {}
    for combination, share in terms:
        for word, m in combination.items():
            add_multiple(total, word, share.times(m))
    return total


def _filled(
    row: int,
    contexts: dict[Word, Quadratic],
    factors: Combination,
    letters: dict[Word, Quadratic],
) -> _Zero:
    """Return the words of contexts times factors, with letters in the slot."""
    relation: _Zero = {}
    for factor, first in factors.items():
        for letter, second in letters.items():
            for z, multiplicity in shuffle(factor, letter).items():
                for context, share in contexts.items():
                    value = (share * second).times(first * multiplicity)
                    add_multiple(relation, (row, fill(context, z)), value)
    return relation


def _independent(vectors: Sequence[Sequence[Quadratic]]) -> list[int]:
    """Return the vectors that don't depend on those before."""
    dependent = {max(zero) for zero in dependencies(vectors)}
    return [k for k in range(len(vectors)) if k not in dependent]
