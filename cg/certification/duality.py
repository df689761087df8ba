"""Conditions that follow since a method has few stages: orthogonal vectors that span them all.

With n stages besides the first, let u and v be vectors over them: what words with a hole, and
what letters, deviate from the exact solution by. A condition says that a product (u, v) is zero.
If some u_1 … u_a and v_1 … v_b with a + b = n are independent and all (u_i, v_j) = 0, then the
space of the v_j is all that is orthogonal to the u_i. So from (u_i, v) = 0 for all i and
(u, v_j) = 0 for all j it follows that (u, v) = 0.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from math import factorial
from typing import Any, NamedTuple, TypeVar

import numpy as np
from flint import arb, arb_mat, fmpq
from numpy.typing import NDArray

from ..layout import Layout
from .holes import basis, outer_nodes, polynomial, read_hole, write_hole
from .relations import HOLE, fill
from .weights import Quantity, Weights
from .words import Word, condition_words, nodes, parse, reciprocal_density, shuffle, text

__all__ = ["Duality", "Surrounding", "find_dualities", "kept_conditions", "regular"]

_DEPENDENT = 1e-9  # what is left of a unit vector that depends on others


class Surrounding(NamedTuple):
    """A word with a hole, along a row of weights, times a letter's values.

    As a vector over the stages j it is the weight of the word with the letter that is 1 on
    stage j in the hole; less what the exact solution makes of it if there are nodes around
    the hole. Powers of the abscissae are taken as factors as they are, of other letters what they
    deviate from the exact solution by.
    """

    row: int
    hole: Word
    factor: Word = ()

    @property
    def degree(self) -> int:
        """How many nodes a word has besides the letter in the hole."""
        return outer_nodes(self.hole) + nodes(self.factor)

    @property
    def deviates(self) -> bool:
        """Whether the exact solution makes zero of it with any letter."""
        return outer_nodes(self.hole) > 0 or not _leaves(self.factor)

    def __str__(self) -> str:
        factors = ["embedded"] * self.row + [text(self.factor)] * bool(self.factor)
        return "*".join([*factors, write_hole(self.hole)])

    @classmethod
    def read(cls, written: str) -> Surrounding:
        """Read what ``str`` writes; ValueError if it isn't that."""
        match = re.fullmatch(r"(embedded\*)?(?:(\[[\[\]]*\])\*)?(\[.*\])", written)
        if not match:
            raise ValueError(f"no surrounding is written {written!r}")
        return cls(int(bool(match[1])), read_hole(match[3]), parse(match[2] or "[]"))


def _leaves(word: Word) -> bool:
    return word == ((),) * nodes(word)


T = TypeVar("T")
Pair = tuple[Surrounding, Word]
_Rule = tuple[Pair, tuple[Pair, ...]]
_Vector = dict[tuple[int, Word], fmpq]
_NOTHING = fmpq(0)


@dataclass(frozen=True)
class Duality:
    """Letters and surroundings that are orthogonal and together span all stages but the first.

    Powers of the abscissae, letters of leaves alone, serve where all surroundings have nodes around
    the hole: for the exact solution their products are zero too.

    Attributes
    ----------
    letters : tuple of Word
        The children of trees; each stands for what the tree's weight at a stage deviates from
        the exact solution by.
    surroundings : tuple of Surrounding
    """

    letters: tuple[Word, ...]
    surroundings: tuple[Surrounding, ...]

    @property
    def heading(self) -> str:
        """Text from which it is read again."""
        return (
            f"span {' '.join(map(text, self.letters))} with {' '.join(map(str, self.surroundings))}"
        )

    @classmethod
    def read(cls, heading: str) -> Duality:
        """Read a heading; ValueError if it is none."""
        first, _, second = heading.removeprefix("span ").partition(" with ")
        return cls(tuple(map(parse, first.split())), tuple(map(Surrounding.read, second.split())))


def find_dualities(layout: Layout, orders: Sequence[int], y: Sequence[arb]) -> tuple[Duality, ...]:
    """Return the dualities that coefficients seem to have, for letters with few nodes first."""
    found: dict[Duality, None] = {}
    for most in range(1, orders[0]):
        for bushes in (True, False):
            words = [
                w
                for count in range(1, most + 1)
                for w in (_all_letters(count) if bushes else _letters(count))
            ]
            letters = _independent(words, _vectors(layout, words, (), y))
            highest = [order - 1 - most for order in orders]
            for second in range(-1, highest[1] + 1) if len(orders) > 1 else (-1,):
                for first in range(-1, highest[0] + 1):
                    around = [
                        u
                        for degree in range(max(first, second) + 1)
                        for row, most_of_row in enumerate((first, second))
                        if degree <= most_of_row
                        for u in _surroundings(row, degree)
                        if u.deviates or not bushes
                    ]
                    chosen = _independent(around, _vectors(layout, (), around, y))
                    if len(letters) + len(chosen) == layout.stages - 1:
                        found[Duality(tuple(letters), tuple(chosen))] = None
    return tuple(found)


def _independent(keys: Sequence[T], vectors: Sequence[Sequence[arb]]) -> list[T]:
    """Return the keys of vectors that don't depend on those before."""
    rows = [np.array([float(x) for x in vector]) for vector in vectors]
    largest = max((float(np.linalg.norm(row)) for row in rows), default=0.0)
    chosen: list[T] = []
    span: list[NDArray[np.float64]] = []
    for key, row in zip(keys, rows, strict=True):
        size = float(np.linalg.norm(row))
        if size <= _DEPENDENT * max(1.0, largest):
            continue
        rest = row / size
        for _ in range(2):
            for one in span:
                rest = rest - (one @ rest) * one
        left = float(np.linalg.norm(rest))
        if left > _DEPENDENT:
            span.append(rest / left)
            chosen.append(key)
    return chosen


@cache
def _ratio(word: Word) -> Fraction:
    """Return what the exact solution makes of a letter, by what it makes of leaves alone."""
    return reciprocal_density(word) / reciprocal_density(((),) * nodes(word))


def regular(duality: Duality, layout: Layout, box: Sequence[arb]) -> bool:
    """Tell whether its vectors are independent everywhere in a box of coefficients."""
    size = layout.stages - 1
    if len(duality.letters) + len(duality.surroundings) != size:
        return False
    matrix = arb_mat(_vectors(layout, duality.letters, duality.surroundings, box))
    try:
        matrix.solve(arb_mat([[0] for _ in range(size)]))
    except ZeroDivisionError:
        return False
    return True


def _vectors(
    layout: Layout, letters: Sequence[Word], around: Sequence[Surrounding], y: Sequence[arb]
) -> list[list[arb]]:
    """Return the vectors of letters, then of surroundings, over the stages but the first."""
    stages = range(1, layout.stages)
    quantities: dict[Quantity, int] = {}

    def at(row: int, word: Word) -> int:
        return quantities.setdefault(Quantity(row, word), len(quantities))

    plans: list[list[list[tuple[Fraction, list[int]]]]] = []
    for word in letters:
        bush = ((),) * nodes(word)
        less = [(-_ratio(word), bush)] if word != bush else []
        both = [(Fraction(1), word), *less]
        plans.append([[(factor, [at(j, w)]) for factor, w in both] for j in stages])
    for u in around:
        row = layout.stages + u.row
        vector = []
        for j in stages:
            terms = [(Fraction(1), [at(row, fill(u.hole, j))])]
            if outer_nodes(u.hole):
                for power, p in enumerate(polynomial(u.hole)):
                    powers = [at(j, ((),) * power)] if power else []
                    terms.append((-p * factorial(power), [at(row, (j,)), *powers]))
            if _leaves(u.factor):
                c = [at(j, ((),))] * nodes(u.factor)
                terms = [(factor, [*places, *c]) for factor, places in terms]
            else:
                bush = ((),) * nodes(u.factor)
                terms = [
                    (factor * share, [*places, at(j, w)])
                    for factor, places in terms
                    for w, share in ((u.factor, Fraction(1)), (bush, -_ratio(u.factor)))
                ]
            vector.append(terms)
        plans.append(vector)
    values = Weights(layout, list(quantities)).evaluate(y[: layout.size])

    def total(terms: list[tuple[Fraction, list[int]]]) -> arb:
        result = arb(0)
        for factor, places in terms:
            product = arb(fmpq(factor.numerator, factor.denominator))
            for k in places:
                product = product * values[k]
            result = result + product
        return result

    return [[total(terms) for terms in vector] for vector in plans]


def kept_conditions(
    orders: Sequence[int], dualities: Sequence[Duality]
) -> Iterator[tuple[int, Word]]:
    """Yield conditions, as a row of weights and a word, from which all others follow.

    Words with few nodes come first: what follows is on as many nodes as what it follows from, or
    on more.
    """
    for grade in range(1, orders[0] + 1):
        yield from _Deduction(grade, orders, dualities).kept()


@cache
def _letters(count: int) -> tuple[Word, ...]:
    """Return the letters with so many nodes besides their roots that deviate from the exact."""
    return tuple(w for w in _all_letters(count) if not _leaves(w))


@cache
def _all_letters(count: int) -> tuple[Word, ...]:
    """Return the letters with so many nodes besides their roots, that of leaves alone first."""
    words = [w for w in condition_words(count, independent=False) if nodes(w) == count]
    return tuple(sorted(words, key=lambda w: not _leaves(w)))


def _factors(count: int) -> tuple[Word, ...]:
    return _all_letters(count) if count else ((),)


@cache
def _surroundings(row: int, degree: int) -> tuple[Surrounding, ...]:
    """Return the surroundings of a degree; those without nodes around the hole come first."""
    return tuple(
        Surrounding(row, hole, factor)
        for hole in ((HOLE,), *basis(degree))
        for factor in _factors(degree - outer_nodes(hole))
    )


class _Deduction:
    """Which conditions on words of one size follow from which, in rational arithmetic.

    The residuals of a row and a word are unknowns, of which linear relations are known. What
    is left of a combination after these has no unknown that is expressed by others.

    Parameters
    ----------
    grade : int
        Nodes of the words.
    orders : sequence of int
        Of each row of weights.
    dualities : sequence of Duality
    """

    def __init__(self, grade: int, orders: Sequence[int], dualities: Sequence[Duality]) -> None:
        self.grade, self.orders, self.dualities = grade, orders, dualities
        rows = [row for row, order in enumerate(orders) if grade <= order]
        self.lyndon = [
            (row, w) for row in rows for w in condition_words(grade) if nodes(w) == grade
        ]
        self.singles = set(self.lyndon)
        self.pairs = [
            (u, v)
            for row in rows
            for degree in range(grade - 1)
            for u in _surroundings(row, degree)
            for v in _all_letters(grade - 1 - degree)
            if _valid(u, v)
        ]
        self.left: dict[Any, _Vector] = {pair: _combination(pair) for pair in self.pairs}
        self.left |= {one: {one: fmpq(1)} for one in self.lyndon}
        words = [w for w in condition_words(grade, independent=False) if nodes(w) == grade]
        products = {
            (row, word, cut): {
                (row, w): fmpq(m) for w, m in shuffle(word[:cut], word[cut:]).items()
            }
            for row in rows
            for word in words
            for cut in range(1, len(word))
        }
        self.left |= products
        for key in products:
            self._learn(key)
            del self.left[key]

    def kept(self) -> Iterator[tuple[int, Word]]:
        """Yield conditions to keep, so that all others follow."""
        rules = [(pair, way) for pair in self.pairs for way in self._ways(pair)]
        uses: dict[Pair, int] = {}
        for _, way in rules:
            for premise in way:
                uses[premise] = uses.get(premise, 0) + 1
        while True:
            rules = self._conclude(rules)
            waiting = [p for p in uses if self.left[p]]
            if waiting:
                premise = min(waiting, key=lambda p: (len(self.left[p]), -uses[p]))
                best = min(self.left[premise], key=lambda one: (nodes(one[1][0]), str(one)))
            else:
                remaining = [one for one in self.lyndon if self.left[one]]
                if not remaining:
                    return
                best = min(one for vector in map(self.left.get, remaining) for one in vector or ())
            self._learn(best)
            yield best

    def _conclude(self, rules: list[_Rule]) -> list[_Rule]:
        """Learn what follows, and return the rules that may still serve."""
        while True:
            rules = [rule for rule in rules if self.left[rule[0]]]
            ready = [pair for pair, way in rules if not any(self.left[p] for p in way)]
            if not ready:
                return rules
            for pair in ready:
                self._learn(pair)

    def _ways(self, pair: Pair) -> Iterator[tuple[Pair, ...]]:
        """Yield what a pair would follow from, of what isn't known from shorter words."""
        u, v = pair
        for duality in self.dualities:
            sides = [(one, v) for one in duality.surroundings]
            sides += [(u, letter) for letter in duality.letters]
            if pair in sides:
                continue
            sides += [(one, letter) for one in duality.surroundings for letter in duality.letters]
            if all(self._comes_before(one) for one in sides):
                yield tuple(one for one in sides if _grade(one) == self.grade)

    def _comes_before(self, pair: Pair) -> bool:
        grade = _grade(pair)
        return _valid(*pair) and grade <= min(self.grade, self.orders[pair[0].row])

    def _learn(self, key: Any) -> None:
        """Take a combination, or one unknown that occurs in those that are left, for zero."""
        known = self.left.get(key, {key: fmpq(1)})
        if not known:
            return
        pivot = min(known, key=lambda one: (one in self.singles, str(one)))
        scale = known[pivot]
        rest = [(one, value / scale) for one, value in known.items() if one != pivot]
        for vector in self.left.values():
            factor = vector.pop(pivot, None)
            if factor is None:
                continue
            for one, value in rest:
                total = vector.get(one, _NOTHING) - factor * value
                if total == 0:
                    del vector[one]
                else:
                    vector[one] = total


def _valid(u: Surrounding, v: Word) -> bool:
    """Tell whether the product is zero for the exact solution."""
    return u.deviates or not _leaves(v)


def _grade(pair: Pair) -> int:
    return pair[0].degree + 1 + nodes(pair[1])


def _times(letter: Word, scale: Fraction, factor: Word) -> Iterator[tuple[Word, Fraction]]:
    """Yield the words of which a letter times a factor of a surrounding consists."""
    bush = ((),) * nodes(factor)
    parts = [(factor, Fraction(1))]
    if factor == bush:
        parts = [(factor, Fraction(factorial(len(bush))))]
    else:
        parts.append((bush, -_ratio(factor)))
    for part, share in parts:
        for y, m in shuffle(part, letter).items():
            yield y, scale * share * m


def _combination(pair: Pair) -> _Vector:
    """Return a product as a combination of residuals, those of shorter words being zero."""
    u, v = pair
    count = nodes(v)
    letters = {v: Fraction(1)}
    if not _leaves(v):
        letters[((),) * count] = -_ratio(v)
    found: dict[Word, Fraction] = {}
    around = outer_nodes(u.hole)
    for letter, factor in letters.items():
        for y, inner in _times(letter, factor, u.factor):
            filled = fill(u.hole, y)
            found[filled] = found.get(filled, Fraction(0)) + inner
            if around:
                leading = polynomial(u.hole)[around] * factorial(around)
                for z, n in shuffle(((),) * around, y).items():
                    found[(z,)] = found.get((z,), Fraction(0)) - inner * leading * n
    return {
        (u.row, word): fmpq(value.numerator, value.denominator)
        for word, value in found.items()
        if value
    }
