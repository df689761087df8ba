"""Residuals of all words, as combinations of those of independent conditions.

Weights multiply by shuffles, and so do their values for the exact solution. So for words u and v

    Σ_{w in u ⧢ v} residual(w) = 1/γ(u) residual(v) + Φ(v) residual(u),

and a word that is no condition is expressed by shuffling its first condition with the rest.
"""

from collections.abc import Callable, Iterable
from functools import cache
from typing import Any

from cg.construction.conditions.words import (
    Word,
    add_multiple,
    condition_words,
    nodes,
    reciprocal_density,
    shuffle,
)

Combination = dict[Word, Any]


@cache
def _conditions(count: int) -> frozenset[Word]:
    return frozenset(condition_words(count))


@cache
def _first_condition(word: Word) -> int:
    """Return the length of the longest condition that the word begins with."""
    lengths = range(len(word), 0, -1)
    return next(k for k in lengths if word[:k] in _conditions(nodes(word[:k])))


class Reduction:
    """Residuals of words as combinations of those of independent conditions.

    `number` makes a coefficient of a Fraction. `weight` returns Φ of a word: a ball that contains
    it, or the `number` of its value for the exact solution.
    """

    def __init__(self, number: Callable[[Any], Any], weight: Callable[[Word], Any]) -> None:
        self._number, self._weight = number, weight
        self._known: dict[Word, Combination] = {}

    def __call__(self, word: Word) -> Combination:
        """Return the coefficients by condition."""
        if word not in self._known:
            self._known[word] = self._reduced(word)
        return self._known[word]

    def total(self, terms: Iterable[tuple[Word, Any]]) -> Combination:
        """Return a combination of residuals of words, coefficients of the number type."""
        total: Combination = {}
        for word, factor in terms:
            for one, value in self(word).items():
                add_multiple(total, one, factor * value)
        return total

    def _reduced(self, word: Word) -> Combination:
        cut = _first_condition(word)
        if cut == len(word):
            return {word: self._number(1)}
        first, rest = word[:cut], word[cut:]
        shuffled = shuffle(first, rest)
        share = self._number(1) / shuffled[word]
        terms = [
            (rest, share * self._number(reciprocal_density(first))),
            (first, share * self._weight(rest)),
        ]
        terms += [(w, -share * m) for w, m in shuffled.items() if w != word]
        return self.total(terms)
