"""Shapes of methods, with unknowns in place of their weights.

The unknowns are those of the flat tableau: b_i, a_ij with 1 < j < i, and the abscissae c_i in
place of the first column, a_i1 = c_i - Σ_{j>1} a_ij. A tree of points whose points are the stages,
but for the last, which is the result, has the same number of weights: they are differences of rows
of its flat tableau.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import permutations, product
from math import prod

from cg.construction.conditions import condition_trees, right_sides
from cg.construction.layouts import MAX_STAGES
from cg.construction.points import START, Point, PointTree
from cg.construction.trees import OrderedTree, forest
from cg.support.checks import check_integer

from .ring import Polynomial, Ring
from .weights import exact_weights, word_weights

_LETTERS = (1, 2)  # the indices of τ and [τ]


@dataclass(frozen=True)
class PathShape:
    """Explicit methods whose result is reached by a given number of flows.

    Conditions are taken of words in the letters τ and [τ] alone, whose values on a flow are Σ_k α_k
    and Σ_k α_k c_k, whatever stages and weights they come from. The unknowns are these values on
    all flows but the last, x{k}_1 and x{k}_2. There they follow from Φ([τ]) = 1 and Φ([[τ]]) = 1/2.
    """

    flows: int

    def __str__(self) -> str:
        return f"path of {self.flows}"

    @cached_property
    def ring(self) -> Ring:
        """The polynomials in the unknowns."""
        return Ring([f"x{k}_{letter}" for letter in _LETTERS for k in range(self.flows - 1)])

    @cached_property
    def _letters(self) -> dict[int, list[Polynomial]]:
        letters = {}
        for letter in _LETTERS:
            values = [self.ring[f"x{k}_{letter}"] for k in range(self.flows - 1)]
            total = self.ring.number(Fraction(1, letter))
            letters[letter] = [*values, total - sum(values, self.ring.number(0))]
        return letters

    def conditions(self, order: int) -> dict[str, Polynomial]:
        """Return χ(w) - 1/γ of the words w of order conditions, by the text of the tree."""
        trees = forest(order + 1)
        weights = {}
        for t in condition_trees(order):
            word = trees.children[t - 1]
            if set(word) <= set(_LETTERS):
                side = self.ring.number(Fraction(1, trees.density[t - 1]))
                weights[str(trees.tree(t))] = self._weight(word) - side
        return weights

    def _weight(self, word: tuple[int, ...]) -> Polynomial:
        chain = tuple(Point(k - 1, {}) for k in range(self.flows))
        tree = PointTree(chain, (START,), self.flows - 1)
        one = self.ring.number(1)
        return word_weights(tree, range(self.flows), word, self._letters, one)[tree.result]


@dataclass(frozen=True)
class Shape:
    """Methods with a number of stages whose weights are unknown.

    Attributes
    ----------
    stages : int
    """

    stages: int

    @cached_property
    def ring(self) -> Ring:
        """The polynomials in the unknowns."""
        stages = range(self.stages, 0, -1)
        inner = [f"a{i}_{j}" for i in stages for j in range(i - 1, 1, -1)]
        return Ring([*(f"b{i}" for i in stages), *inner, *(f"c{i}" for i in stages if i > 1)])

    @cached_property
    def rows(self) -> tuple[tuple[Polynomial, ...], ...]:
        """The flat tableau: the rows of a, then b."""
        ring, s = self.ring, self.stages
        zero = ring.number(0)
        rows = [(zero,) * s]
        for i in range(2, s + 1):
            inner = [ring[f"a{i}_{j}"] for j in range(2, i)]
            rows.append((ring[f"c{i}"] - sum(inner, zero), *inner, *(zero,) * (s - i + 1)))
        return *rows, tuple(ring[f"b{i}"] for i in range(1, s + 1))

    @cached_property
    def tree(self) -> PointTree:
        """The points, with polynomials as weights."""
        raise NotImplementedError

    def conditions(self, order: int) -> dict[str, Polynomial]:
        """Return Φ(t) - 1/γ(t) of all trees of order conditions, by the text of the tree."""
        trees, indices = forest(order + 1), condition_trees(order)
        weights = exact_weights(self.tree, order, indices, self.ring.number)
        return {
            str(trees.tree(t)): phi - self.ring.number(side)
            for t, phi, side in zip(indices, weights, right_sides(order), strict=True)
        }

    def flat_conditions(self, order: int) -> dict[str, Polynomial]:
        """Return what the conditions are where all flows commute, by a text of each tree.

        These are Σ_i b_i Φ_i(t) - 1/γ(t) for rooted trees t without an order of children, with
        Φ_i(t) the product of Σ_j a_ij Φ_j(t_k) over the children t_k, and γ(t) the product of the
        nodes of t with the γ(t_k).
        """
        trees = forest(order)
        zero, one = self.ring.number(0), self.ring.number(1)
        memo: dict[OrderedTree, list[Polynomial]] = {}

        def stages(tree: OrderedTree) -> list[Polynomial]:
            if tree not in memo:
                values = [one] * self.stages
                for child in tree.children:
                    inner = stages(child)
                    for i, row in enumerate(self.rows[:-1]):
                        sums = (row[j] * inner[j] for j in range(i))
                        values[i] = values[i] * sum(sums, zero)
                memo[tree] = values
            return memo[tree]

        conditions = {}
        for tree in trees:
            if tree == sorted_tree(tree):
                total = sum((w * v for w, v in zip(self.rows[-1], stages(tree), strict=True)), zero)
                conditions[str(tree)] = total - one / flat_density(tree)
        return conditions


def sorted_tree(tree: OrderedTree) -> OrderedTree:
    """Return the tree with the children of all nodes sorted by their texts."""
    return OrderedTree(tuple(sorted(map(sorted_tree, tree.children), key=str)))


def flat_density(tree: OrderedTree) -> int:
    """Return the density of a tree whose children have no order."""
    density = tree.nodes
    for child in tree.children:
        density *= flat_density(child)
    return density


def orderings(tree: OrderedTree) -> Counter[OrderedTree]:
    """Return the trees that permutations of the children of all nodes make, and how often.

    A product of letters is the sum of the words that permutations make of them. So the flat
    condition of a tree t is the sum of the conditions of [t'] over these t'.
    """
    counts: Counter[OrderedTree] = Counter()
    inner = [orderings(child).items() for child in tree.children]
    for chosen in product(*inner):
        times = prod(count for _, count in chosen)
        for children in permutations([child for child, _ in chosen]):
            counts[OrderedTree(children)] += times
    return counts


@dataclass(frozen=True)
class TableauShape(Shape):
    """Explicit Crouch–Grossman tableaux: each row is a chain of flows with one weight each."""

    def __str__(self) -> str:
        return "tableau"

    @cached_property
    def tree(self) -> PointTree:
        """The points, with polynomials as weights."""
        points: list[Point] = []
        ends = []
        for i, row in enumerate(self.rows):
            last = START
            for stage in range(min(i, self.stages)):
                points.append(Point(last, {stage: row[stage]}))
                last = len(points) - 1
            ends.append(last)
        return PointTree(tuple(points), tuple(ends[:-1]), ends[-1])


@dataclass(frozen=True)
class PointsShape(Shape):
    """Trees of as many points as stages, all of them stages but the last, which is the result.

    Attributes
    ----------
    parents : tuple of int
    """

    parents: tuple[int, ...]

    def __str__(self) -> str:
        return " ".join(map(str, self.parents))

    @cached_property
    def tree(self) -> PointTree:
        """The points, with polynomials as weights."""
        points = []
        for m, parent in enumerate(self.parents):
            before, row = self.rows[parent + 1], self.rows[m + 1]
            weights = {stage: row[stage] - before[stage] for stage in range(m + 1)}
            points.append(Point(parent, weights))
        return PointTree(tuple(points), tuple(range(START, self.stages - 1)), self.stages - 1)


def point_shapes(stages: int) -> Iterator[PointsShape]:
    """Yield all trees of points, by their parents: stages! of them."""
    for parents in product(*(range(START, m) for m in range(stages))):
        yield PointsShape(stages, parents)


def read_shape(text: str, stages: int) -> Shape | PathShape:
    """Return the shape of a text: ``tableau``, ``path of`` some flows, or the parents of points."""
    if not isinstance(text, str):
        raise TypeError(f"text must be a str, got {text!r}")
    stages = check_integer("stages", stages, 0, MAX_STAGES)
    if text == "tableau":
        return TableauShape(stages)
    flows = text.removeprefix("path of ")
    if flows != text and flows.isdecimal():
        return PathShape(int(flows))
    try:
        parents = tuple(int(part) for part in text.split())
    except ValueError:
        parents = ()
    if len(parents) == stages and all(START <= p < m for m, p in enumerate(parents)):
        return PointsShape(stages, parents)
    raise ValueError(
        f"shape must be 'tableau', 'path of' a number of flows, or the parents of {stages} "
        f"points, got {text!r}"
    )
