"""Order conditions in exact and in ball arithmetic, and as equations of SymPy.

Elementary weights are those of words of ordered trees. Here a tree is the tuple of its children,
``()`` for ``τ``, and a word is a tuple of letters; the weight of a tree is that of the word of its
children.

With the letters l_m(v) = Σ_k y_mk Φ_k(v) of the flow to point m, its exponential E_m and the
weights χ_m at the point,

    E_m(w) = l_m(w_1) … l_m(w_n) / n!,   χ_m(w) = Σ_{w = u v} χ_parent(u) E_m(v),

as in ``fortran/conditions/weights.f90``: `_letter`, `_flow` and `_chi`. Compiled code has no balls;
the numbers here are those of python-flint, ``arb`` for proofs and ``fmpq`` for exact weights.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache
from itertools import combinations
from math import comb
from typing import Any, NamedTuple

import numpy as np

from cg.construction.conditions.counts import check_order, condition_trees
from cg.construction.layouts import Layout, Rows
from cg.construction.points import START, PointTree, check_not_sums, points_of, tree_of_rows
from cg.construction.trees import MAX_NODES, OrderedTree, forest
from cg.support import flint
from cg.support.checks import check_flag, check_integer
from cg.support.quads import finite_fraction, to_ball, to_flint, to_fraction, working_precision

Word = tuple[Any, ...]
"""A tuple of words, the letters."""

Vector = list[Any]

_BALL_BITS = 512


class Condition(NamedTuple):
    """The order condition of a word's tree, for a row of weights of a pair, from 0."""

    row: int
    word: Word


@cache
def nodes(word: Word) -> int:
    """Return the number of nodes of the letters of a word, one less than of its tree."""
    return sum(1 + nodes(letter) for letter in word)


@cache
def reciprocal_density(word: Word) -> Fraction:
    """Return ``1/γ`` of the tree with these children."""
    product, before = Fraction(1), 0
    for letter in word:
        before += 1 + nodes(letter)
        product *= reciprocal_density(letter) / before
    return product


def is_of_time(word: Word) -> bool:
    """Return whether all letters are ``[τᵏ]``, powers of the time."""
    return not any(any(letter) for letter in word)


@cache
def condition_words(
    order: int, independent: bool = True, of_time: bool = False
) -> tuple[Word, ...]:
    """Return the words of `condition_trees`; if ``of_time``, only those of powers of the time."""
    if of_time:
        return tuple(filter(is_of_time, condition_words(order, independent)))
    trees = forest(order + 1)
    words: list[Word] = []
    for children in trees.children:
        words.append(tuple(words[child - 1] for child in children))
    return tuple(words[t - 1] for t in condition_trees(order, independent))


@cache
def words_with(count: int, of_time: bool = False) -> tuple[Word, ...]:
    """Return all words of trees with `count` nodes; there is one with none, the empty word."""
    if count == 0:
        return ((),)
    return tuple(w for w in condition_words(count, False, of_time) if nodes(w) == count)


def conditions_of(orders: Sequence[int], of_time: bool = False) -> list[Condition]:
    """Return the independent conditions of all rows of weights."""
    return [
        Condition(row, word)
        for row, order in enumerate(orders)
        for word in condition_words(order, True, of_time)
    ]


def add_multiple(total: dict[Any, Any], key: Any, change: Any) -> None:
    """Add to the coefficient of a word, or another key, in a combination."""
    total[key] = total[key] + change if key in total else change


def extend(function: Callable[[Word], dict[Word, int]], words: dict[Word, int]) -> dict[Word, int]:
    """Return the value of a linear function of words at a combination of words."""
    total: dict[Word, int] = {}
    for word, factor in words.items():
        for image, multiplicity in function(word).items():
            add_multiple(total, image, factor * multiplicity)
    return total


@cache
def shuffle(left: Word, right: Word) -> dict[Word, int]:
    """Return the shuffle product of two words, as multiplicities of words."""
    if not left or not right:
        return {left + right: 1}
    product: dict[Word, int] = {}
    heads = (left[0], shuffle(left[1:], right)), (right[0], shuffle(left, right[1:]))
    for letter, tails in heads:
        for word, multiplicity in tails.items():
            product[(letter, *word)] = product.get((letter, *word), 0) + multiplicity
    return product


def closure(words: Iterable[Word]) -> list[Word]:
    """Return all nonempty factors of words, and of trees among their letters, letters first."""
    factors: set[Word] = set()
    pending = list(words)
    seen: set[Word] = set(pending)
    while pending:
        word = pending.pop()
        factors.update(word[begin:end] for begin, end in combinations(range(len(word) + 1), 2))
        for letter in word:
            if letter and letter not in seen:
                seen.add(letter)
                pending.append(letter)
    return sorted(factors, key=nodes)


def tree_text(word: Word) -> str:
    """Return a word as the tree with these children, in brackets."""
    return f"[{''.join(map(tree_text, word))}]"


def parse(tree: str) -> Word:
    """Read what `tree_text` writes; ValueError if that isn't one tree in balanced brackets."""
    if tree.count("[") > MAX_NODES:
        raise ValueError(f"a tree must have at most {MAX_NODES} nodes, got {tree[:80]!r}")

    def convert(tree: OrderedTree) -> Word:
        return tuple(convert(child) for child in tree.children)

    return convert(OrderedTree.parse(tree))


class Quantity(NamedTuple):
    """The weight of a word at the end of a row: from 0 the stages, then one or two results."""

    row: int
    word: Word


class Weights:
    """Weights of words at points of a method: evaluation of `quantities`, and their derivatives."""

    def __init__(self, layout: Layout, quantities: Sequence[Quantity]) -> None:
        self.layout = layout
        self.quantities = list(quantities)
        self._paths = [layout.path(layout.ends[quantity.row]) for quantity in self.quantities]
        words_at: dict[int, set[Word]] = {}
        for quantity, path in zip(self.quantities, self._paths, strict=True):
            words_at.setdefault(path[-1] if path else START, set()).add(quantity.word)
        letters = {letter for _, word in self.quantities for letter in word}
        for at in layout.stage_points:
            words_at.setdefault(at, set()).update(letters)
        # Weights of words are needed at ends of paths, and so at the points that lead there.
        self._words = {end: closure(words) for end, words in words_at.items()}
        needed: dict[Word, set[int]] = {}
        for end, words in self._words.items():
            for word in words:
                needed.setdefault(word, set()).update(layout.path(end))
        self._needed = {word: sorted(needed[word]) for word in sorted(needed, key=nodes)}
        self._letters = {letter for word in needed for letter in word if letter}

    def evaluate(self, x: Sequence[Any]) -> Vector:
        """Return the weights at packed unknowns, all ``arb`` or all ``fmpq``."""
        layout = self.layout
        points = len(layout.parents)
        self._x = list(x)
        self._rights: dict[int, dict[Word, Vector]] = {}
        self._one = one = x[0] * 0 + 1
        self._zero = zero = one * 0
        self._phi: dict[Word, Vector] = {(): [one] * layout.stages}
        self._letter: dict[Word, Vector] = {}
        # Each word has weights of the flow to each point alone, and at each point, the start last.
        self._flow: dict[Word, Vector] = {(): [one] * points}
        self._chi: dict[Word, Vector] = {(): [one] * (points + 1)}
        for word, where in self._needed.items():
            self._add(word, where)
            if word in self._letters:
                self._phi[word] = [self._chi[word][at] for at in layout.stage_points]
        return [
            self._chi[quantity.word][path[-1]] if path else (zero if quantity.word else one)
            for quantity, path in zip(self.quantities, self._paths, strict=True)
        ]

    def _add(self, word: Word, where: Sequence[int]) -> None:
        """Compute a word whose proper factors are known, at some points with their parents."""
        count, parents = len(word), self.layout.parents
        rest, letter = self._flow[word[1:]], self._letter_at_points(word[0])
        flow: Vector = [None] * len(parents)
        chi: Vector = [None] * len(parents) + [self._zero]
        cuts = [(self._chi[word[:cut]], self._flow[word[cut:]]) for cut in range(1, count)]
        for m in where:
            parent, change = parents[m], rest[m] * letter[m] / count
            flow[m] = change
            for head, tail in cuts:
                change = change + head[parent] * tail[m]
            chi[m] = chi[parent] + change
        self._flow[word], self._chi[word] = flow, chi

    def _letter_at_points(self, letter: Word) -> Vector:
        """Return the combinations of a letter's values that the flows to points have."""
        if letter not in self._letter:
            phi, layout = self._phi[letter], self.layout
            values: Vector = []
            for begin, stages in zip(layout.starts, layout.weights, strict=False):
                terms = [self._x[k] * phi[stage] for k, stage in enumerate(stages, begin)]
                values.append(sum(terms[1:], start=terms[0]) if terms else self._zero)
            self._letter[letter] = values
        return self._letter[letter]

    def slopes(self, row: int, before: Word, after: Word) -> Vector:
        """Return the derivatives of a row's weight by a letter's values on the flows to all points.

        The letter stands between the words `before` and `after`; evaluate the row with them first.
        """
        path = self.layout.path(self.layout.ends[row])
        slopes = [self._zero] * len(self.layout.parents)
        if not path:
            return slopes
        right = self._right_of(path)
        for p in range(len(before) + 1):
            cut = len(before) - p
            chi, flow = self._chi[before[:cut]], self._flow[before[cut:]]
            earlier = [chi[self.layout.parents[i]] * flow[i] for i in path]
            for q in range(len(after) + 1):
                flow, beyond = self._flow[after[:q]], right[after[q:]]
                share = (p + q + 1) * comb(p + q, p)  # (p + q + 1)! / (p! q!)
                for i, head, tail in zip(path, earlier, beyond, strict=True):
                    slopes[i] = slopes[i] + head * flow[i] * tail / share
        return slopes

    def _right_of(self, path: Sequence[int]) -> dict[Word, Vector]:
        """Return the products of the flows after each point of a path, to its end."""
        end = path[-1]
        if end not in self._rights:
            products: dict[Word, Vector] = {(): [self._one] * len(path)}
            for word in self._words[end]:
                cuts = [
                    (self._flow[word[:cut]], products[word[cut:]])
                    for cut in range(1, len(word) + 1)
                ]
                right = [self._zero]
                for i in range(len(path) - 1, 0, -1):
                    total = right[-1]
                    for head, tail in cuts:
                        total = total + head[path[i]] * tail[i]
                    right.append(total)
                products[word] = right[::-1]
            self._rights[end] = products
        return self._rights[end]

    def jacobian(self) -> flint.arb_mat:
        """Return the derivatives of the quantities in balls, shape (quantities, unknowns).

        Weights of letters at the stages come first, from letters with few nodes to many.
        """
        self._at_stages: dict[Word, flint.arb_mat] = {}
        for letter in sorted(self._letters, key=nodes):
            self._at_stages[letter] = self._derivatives(letter, range(self.layout.stages))
        rows = [self._derivatives(word, [row]).tolist()[0] for row, word in self.quantities]
        return flint.arb_mat(rows)

    def _derivatives(self, word: Word, rows: Sequence[int]) -> flint.arb_mat:
        """Return the derivatives of the weights of a word at the ends of rows by all unknowns."""
        layout, size = self.layout, self.layout.size
        total = flint.arb_mat(len(rows), size)
        for m, letter in enumerate(word):
            direct = [[self._zero] * size for _ in rows]
            through = [[self._zero] * layout.stages for _ in rows]  # values at stages
            phi = self._phi[letter]
            for row, by_unknown, by_stage in zip(rows, direct, through, strict=True):
                slopes = self.slopes(row, word[:m], word[m + 1 :])
                for point in layout.path(layout.ends[row]):
                    for k, stage in enumerate(layout.weights[point], layout.starts[point]):
                        by_unknown[k] = slopes[point] * phi[stage]
                        by_stage[stage] = by_stage[stage] + slopes[point] * self._x[k]
            total = total + flint.arb_mat(direct)
            if letter:
                total = total + flint.arb_mat(through) * self._at_stages[letter]
        return total


@dataclass(frozen=True)
class EquationSystem:
    """Conditions ``Φ(t) - 1/γ(t) = 0`` in the coefficients of a method."""

    layout: Layout
    conditions: tuple[Condition, ...]

    def residuals(self, z: Sequence[Any]) -> list[Any]:
        """Return the residuals, for coefficients that are all ``arb`` or all ``fmpq``."""
        return self._evaluate(z)[0]

    def linearise(self, z: Sequence[flint.arb]) -> tuple[list[flint.arb], flint.arb_mat]:
        """Return the residuals and their derivatives by all coefficients."""
        values, weights = self._evaluate(z)
        return values, weights.jacobian()

    def _evaluate(self, z: Sequence[Any]) -> tuple[list[Any], Weights]:
        rows = [Quantity(self.layout.stages + row, word) for row, word in self.conditions]
        weights = Weights(self.layout, rows)
        targets = (to_flint(reciprocal_density(word)) for _, word in self.conditions)
        values = [phi - target for phi, target in zip(weights.evaluate(z), targets, strict=True)]
        return values, weights


def exact_tree(a: Any, b: Any) -> PointTree:
    """Return the tree of coefficients as `cg.conditions.residuals` takes them, or ValueError."""
    if isinstance(a, Layout):
        return a.tree(_rationals(b, "b"))
    weights_row = _rationals(b, "b")
    check_not_sums(a)
    if not isinstance(a, Iterable) or isinstance(a, str | bytes):
        raise ValueError(f"a must be a sequence of rows, got {a!r}")
    rows = [_rationals(row, f"row {i} of a") for i, row in enumerate(a, 1)]
    stages = len(weights_row)
    if stages == 0 or len(rows) != stages or any(len(row) != stages for row in rows):
        shape = (len(rows), sorted({len(row) for row in rows}))
        raise ValueError(f"a must have shape ({stages}, {stages}) to match b, got {shape}")
    return tree_of_rows(rows, weights_row)


def tree_residuals(
    tree: PointTree, order: Any, independent: bool, in_balls: bool
) -> tuple[Any, ...]:
    """Return ``Φ(t) - 1/γ(t)`` of the result of a tree, as fractions or as balls."""
    words = condition_words(check_order(order, None), check_flag("independent", independent))
    layout = Layout.of_tree(tree)
    layout.check_places()
    system = EquationSystem(layout, tuple(Condition(0, word) for word in words))
    x = [weight for point in tree.points for weight in point.weights.values()]
    x.append(Fraction(0))  # from which numbers are words if there are no weights
    if not in_balls:
        return tuple(map(to_fraction, system.residuals(list(map(to_flint, x)))))
    with working_precision(_BALL_BITS):
        return tuple(system.residuals(list(map(to_ball, x))))


def result_tree(method: Any, embedded: bool) -> PointTree:
    """Return the tree of a method with only one of its results."""
    tree = points_of(method)
    if not check_flag("embedded", embedded):
        return replace(tree, embedded_result=None)
    if tree.embedded_result is None:
        raise ValueError(f"embedded must be False without second weights, got {method!r}")
    return replace(tree, result=tree.embedded_result, embedded_result=None)


def _rationals(entries: Any, name: str) -> list[Fraction]:
    sequence = isinstance(entries, Iterable) and not isinstance(entries, str | bytes)
    if not sequence or (isinstance(entries, np.ndarray) and entries.ndim == 0):
        raise ValueError(f"{name} must be a sequence of numbers, got {entries!r}")
    return [finite_fraction(entry, f"{name} must hold") for entry in entries]


def equations(method: Any, order: int, independent: bool = True) -> list[Any]:
    """Return order conditions as equations of SymPy, in unknown coefficients.

    Parameters
    ----------
    method
        The number of stages of an explicit tableau, at most 100, or a method, of which only the
        pattern of coefficients is used.
    order
        Conditions through this order.
    independent
        Whether conditions that others imply are left out.

    Returns
    -------
    list of sympy.Eq
        ``Φ(t) = 1/γ(t)``, in the sequence of `cg.conditions.residuals`. The symbols are those of
        `cg.diagnose`, counted from 1: ``a_2,1`` and ``b_2`` of a tableau, ``w_3,1`` of point 3
        and stage 1 of other methods. ``sympy.latex`` writes them for a paper, ``sympy.expand``
        multiplies their products of sums out.

    Raises
    ------
    ModuleNotFoundError
        Without SymPy.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> cg.conditions.equations(2, order=2)
    [Eq(b_1 + b_2, 1), Eq(a_2,1*b_2, 1/2)]
    """
    import sympy

    if isinstance(method, int) and not isinstance(method, bool):
        layout: Any = Layout.tableau(check_integer("method", method, 1, 100), Rows.EXPLICIT)
    else:
        layout = getattr(method, "layout", None)
    if not isinstance(layout, Layout) or not getattr(method, "of_trees", True):
        kinds = "a Crouch-Grossman or a commutator-free method"
        raise TypeError(f"method must be a number of stages, {kinds}, got {method!r}")
    words = condition_words(check_order(order, None), check_flag("independent", independent))
    weights = Weights(layout, [Quantity(layout.stages, word) for word in words])
    values = weights.evaluate([sympy.Symbol(name) for name in layout.names])
    sides = [sympy.Rational(str(reciprocal_density(word))) for word in words]
    pairs = zip(values, sides, strict=True)
    return [sympy.Eq(value, side, evaluate=False) for value, side in pairs]
