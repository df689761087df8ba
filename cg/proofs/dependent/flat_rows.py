"""Relations between residuals of a method whose rows add up to those of a flat tableau.

The sums of weights along the ways to stages and results make a tableau. If they are held, at
rational numbers, so are the weights of rooted trees, whose nodes have no order: combinations of
those of ordered trees. Where the conditions of rooted trees are satisfied, and where vectors made
of rooted trees alone depend on each other, that gives relations with rational coefficients.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction
from functools import cache

from flint import fmpq, fmpq_mat

from ...structure.layout import Layout
from ...support.balls import to_fmpq
from ..systems import Equation, Term
from ..weights import Quantity
from .holes import HOLE, basis, outer_nodes
from .orthogonality import Condition
from .relations import fill
from .words import Word, condition_words, reciprocal_density, shuffle

__all__ = ["FlatRows"]

Combination = dict[Word, int]
_Steps = tuple[Word, ...]


class FlatRows:
    """The tableau that the weights along each way to a stage or a result add up to.

    Parameters
    ----------
    layout : Layout
    orders : sequence of int
        Of each row of weights.
    x : sequence of Fraction
        Packed coefficients.
    """

    def __init__(self, layout: Layout, orders: Sequence[int], x: Sequence[Fraction]) -> None:
        self._layout, self._orders = layout, orders
        self._sums = [[Fraction(0)] * layout.stages for _ in layout.ends]
        self._present: list[tuple[int, int]] = []
        for i, end in enumerate(layout.ends):
            for point in layout.path(end):
                for k, stage in enumerate(layout.weights[point], layout.starts[point]):
                    self._sums[i][stage] += x[k]
                    if (i, stage) not in self._present:
                        self._present.append((i, stage))

    def satisfied(self) -> bool:
        """Tell whether the tableau has the orders in flat space, exactly."""
        return all(
            _product(self._sums[row], self._values(tree)) == _exact(_flat(tree))
            for r, order in enumerate(self._orders)
            for row in [self._layout.stages + r]
            for count in range(order)
            for tree in _rooted(count)
        )

    def equations(self) -> list[Equation]:
        """Return that sums of weights are what they are, as far as these are independent."""
        size = self._layout.size
        rows = []
        for i, stage in self._present:
            row = [0] * size
            for point in self._layout.path(self._layout.ends[i]):
                for k, other in enumerate(self._layout.weights[point], self._layout.starts[point]):
                    row[k] += other == stage
            rows.append(row)
        return [
            Equation(
                f"the sum of weights on stage {stage + 1} in row {i + 1}",
                (Term(Fraction(1), (Quantity(i, (stage,)),)),),
                -self._sums[i][stage],
            )
            for i, stage in (self._present[k] for k in _pivots(rows))
        ]

    def relations(self) -> Iterator[dict[Condition, Fraction]]:
        """Yield combinations of residuals that are zero: rows and words, and coefficients."""
        for row, order in enumerate(self._orders):
            for count in range(order):
                for tree in _rooted(count):
                    yield {(row, (word,)): Fraction(m) for word, m in _flat(tree).items()}
        for most in range(self._orders[0]):
            for found in (*self._of_letters(most), *self._of_surroundings(most)):
                # what is zero for the method must be zero for the exact solution
                terms = (value * reciprocal_density(word) for (_, word), value in found.items())
                if sum(terms, Fraction(0)) == 0:
                    yield found

    def _of_letters(self, most: int) -> Iterator[dict[Condition, Fraction]]:
        """Yield products of any surroundings with letters of rooted trees that are dependent."""
        trees = [tree for count in range(most + 1) for tree in _rooted(count)]
        for zero in _dependencies([self._values(tree) for tree in trees]):
            letter = _sum((_flat(trees[k]), share) for k, share in zero.items())
            for row, order in enumerate(self._orders):
                free = order - 1 - most
                for hole in ((HOLE,), *basis(free)) if free >= 0 else ():
                    for factor in _words(free - outer_nodes(hole)):
                        yield _filled(row, {hole: Fraction(1)}, {factor: 1}, letter)

    def _of_surroundings(self, most: int) -> Iterator[dict[Condition, Fraction]]:
        """Yield products of any letter with surroundings of rooted trees that are dependent."""
        rows = [
            (row, steps)
            for row, order in enumerate(self._orders)
            for degree in range(order - most)
            for steps in _chains(degree)
        ]
        for zero in _dependencies([self._along(row, steps) for row, steps in rows]):
            for letter in _words(most):
                found: dict[Condition, Fraction] = {}
                for k, share in zero.items():
                    row, steps = rows[k]
                    holes = _sum([(_around(steps), share)])
                    for one, value in _filled(
                        row, holes, _flat(steps[-1]), {letter: Fraction(1)}
                    ).items():
                        found[one] = found.get(one, Fraction(0)) + value
                yield found

    def _values(self, tree: Word) -> list[Fraction]:
        """Return the weights of a rooted tree at the stages."""
        stages = range(self._layout.stages)
        found = [Fraction(1) for _ in stages]
        for child in tree:
            inner = self._values(child)
            found = [found[i] * _product(self._sums[i], inner) for i in stages]
        return found

    def _along(self, row: int, steps: _Steps) -> list[Fraction]:
        """Return a surrounding of rooted trees as a vector over the stages."""
        stages = range(self._layout.stages)
        found = self._sums[self._layout.stages + row]
        for k, tree in enumerate(steps):
            if k:
                found = [
                    sum((found[i] * self._sums[i][j] for i in stages), Fraction(0)) for j in stages
                ]
            found = [a * b for a, b in zip(found, self._values(tree), strict=True)]
        return found


@cache
def _rooted(count: int) -> tuple[Word, ...]:
    """Return the children of rooted trees with so many nodes besides the root."""
    found = {()} if count == 0 else set()
    for inner in range(count):
        for child in _rooted(inner):
            for rest in _rooted(count - 1 - inner):
                found.add(tuple(sorted((child, *rest))))
    return tuple(sorted(found))


@cache
def _flat(tree: Word) -> Combination:
    """Return a rooted tree as a combination of letters: children of ordered trees."""
    found: Combination = {(): 1}
    for child in tree:
        longer: Combination = {}
        for word, factor in found.items():
            for letter, share in _flat(child).items():
                for z, multiplicity in shuffle(word, (letter,)).items():
                    longer[z] = longer.get(z, 0) + factor * share * multiplicity
        found = longer
    return found


@cache
def _chains(degree: int) -> tuple[_Steps, ...]:
    """Return surroundings of rooted trees: children of the nodes from the root to the hole."""
    found: list[_Steps] = [(tree,) for tree in _rooted(degree)]
    for first in range(degree):
        for tree in _rooted(first):
            found += [(tree, *rest) for rest in _chains(degree - 1 - first)]
    return tuple(found)


@cache
def _around(steps: _Steps) -> Combination:
    """Return a surrounding of rooted trees as words with a hole, but for the last factor."""
    found: Combination = {(HOLE,): 1}
    for tree in steps[:-1]:
        longer: Combination = {}
        for hole, factor in found.items():
            for word, share in _flat(tree).items():
                for inner, multiplicity in shuffle(word, (HOLE,)).items():
                    deeper = fill(hole, inner)
                    longer[deeper] = longer.get(deeper, 0) + factor * share * multiplicity
        found = longer
    return found


def _words(most: int) -> tuple[Word, ...]:
    """Return the letters with at most so many nodes besides their roots."""
    return ((), *condition_words(most, independent=False)) if most > 0 else ((),)


def _exact(letters: Combination) -> Fraction:
    terms = (m * reciprocal_density((letter,)) for letter, m in letters.items())
    return sum(terms, Fraction(0))


def _product(row: Sequence[Fraction], values: Sequence[Fraction]) -> Fraction:
    return sum((a * b for a, b in zip(row, values, strict=True)), Fraction(0))


def _sum(
    terms: Iterator[tuple[Combination, Fraction]] | list[tuple[Combination, Fraction]],
) -> dict[Word, Fraction]:
    found: dict[Word, Fraction] = {}
    for combination, share in terms:
        for word, m in combination.items():
            found[word] = found.get(word, Fraction(0)) + m * share
    return found


def _filled(
    row: int, holes: dict[Word, Fraction], factors: Combination, letters: dict[Word, Fraction]
) -> dict[Condition, Fraction]:
    """Return the words of surroundings times factors, with letters in the hole."""
    found: dict[Condition, Fraction] = {}
    for factor, first in factors.items():
        for letter, second in letters.items():
            for z, multiplicity in shuffle(factor, letter).items():
                for hole, share in holes.items():
                    key = (row, fill(hole, z))
                    value = share * first * second * multiplicity
                    found[key] = found.get(key, Fraction(0)) + value
    return found


def _echelon(rows: Sequence[Sequence[Fraction | int]]) -> tuple[list[list[fmpq]], list[int]]:
    """Return the reduced echelon form of columns, and which of them are independent."""
    columns = fmpq_mat([[to_fmpq(Fraction(x)) for x in row] for row in rows]).transpose()
    reduced, rank = columns.rref()
    entries = reduced.tolist()[:rank]
    return entries, [next(k for k, x in enumerate(row) if x != 0) for row in entries]


def _pivots(rows: Sequence[Sequence[int]]) -> list[int]:
    return _echelon(rows)[1]


def _dependencies(vectors: Sequence[Sequence[Fraction]]) -> list[dict[int, Fraction]]:
    """Return combinations of vectors that are zero, one for each that depends on others."""
    if not vectors:
        return []
    entries, pivots = _echelon(vectors)
    found = []
    for k in range(len(vectors)):
        if k not in pivots:
            zero = {k: Fraction(1)}
            for row, pivot in zip(entries, pivots, strict=True):
                if row[k] != 0:
                    zero[pivot] = -Fraction(int(row[k].p), int(row[k].q))
            found.append(zero)
    return found
