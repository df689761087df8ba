"""Which order conditions follow from others, given identities: linear algebra of residuals.

Take the residuals ``Φ(t) - 1/γ(t)`` of all words with equally many nodes as unknowns,
those of words with fewer nodes being zero. Then the relations

- of the shuffle product, ``Σ_{w in u ⧢ v} residual(w) = 0``, and
- of the identities

are a homogeneous linear system with rational coefficients. Its solution vanishes if the residuals
of the *kept* words do; these are chosen such that the other columns are independent.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Sequence
from fractions import Fraction
from typing import Any

from flint import nmod, nmod_mat

from ...structure.layout import Layout
from ..systems import Equation
from .words import Word, condition_words, shuffle, words_with

Relation = dict[Word, Any]
"""Coefficients, integers or Fractions, of a sum of residuals that is zero."""

_PRIME = 2**61 - 1

SLOT = -1  # where a letter was cut out of a word


class Identity(ABC):
    """A property of solutions besides their order conditions."""

    first_only: bool = False
    """Whether only the first weights of a pair satisfy it."""

    @property
    @abstractmethod
    def name(self) -> str:
        """Text in certificates."""

    @abstractmethod
    def equations(self, layout: Layout, zeros: Sequence[Collection[int]]) -> list[Equation]:
        """Return the equations of the identity.

        `zeros` has the stages, from 0, where each row of weights is held at zero.
        """

    @abstractmethod
    def relations(self, word: Word) -> Iterable[Relation]:
        """Return relations that contain this word, and possibly new words with indicators."""

    def vanishes(self, word: Word, zeros: Collection[int]) -> bool:
        """Return whether a weight is zero since the weights at the stages `zeros` are."""
        return False


def kept_words(grade: int, identities: Sequence[Identity], zeros: Collection[int]) -> list[Word]:
    """Return words with `grade` nodes whose residuals force those of all others to zero.

    `zeros` are the stages, from 0, where the weights are held at zero.
    """
    plain = words_with(grade)
    lyndon = set(condition_words(grade))
    words, relations = _close(plain, identities)
    relations += _shuffles(words)
    columns = [w for w in words if not any(i.vanishes(w, zeros) for i in identities)]
    # leftmost are eliminated first
    columns.sort(key=lambda w: (w in lyndon, not _has_line(w), -_depth(w), len(w)))
    position = {word: k for k, word in enumerate(columns)}
    table = nmod_mat(len(relations), len(columns), _PRIME)
    for i, relation in enumerate(relations):
        for word, factor in relation.items():
            if word in position:
                numerator, denominator = factor.as_integer_ratio()
                table[i, position[word]] = nmod(numerator, _PRIME) / nmod(denominator, _PRIME)
    reduced, rank = table.rref()
    # columns that are independent modulo a prime are independent
    eliminated = {
        next(k for k, entry in enumerate(row) if int(entry)) for row in reduced.tolist()[:rank]
    }
    return [word for k, word in enumerate(columns) if k not in eliminated]


def _close(
    plain: Sequence[Word], identities: Sequence[Identity]
) -> tuple[list[Word], list[Relation]]:
    words = dict.fromkeys(plain)
    relations: dict[frozenset[tuple[Word, Fraction | int]], Relation] = {}
    pending = list(plain)
    while pending:
        word = pending.pop()
        for identity in identities:
            for relation in identity.relations(word):
                relations[frozenset(relation.items())] = relation
                pending += [new for new in relation if new not in words]
                words.update(dict.fromkeys(relation))
    return list(words), list(relations.values())


def _shuffles(words: Sequence[Word]) -> list[Relation]:
    """Return ``Σ residual(u ⧢ v) = 0`` for all ways to cut these words in two."""
    known = set(words)
    relations: list[Relation] = []
    for word in words:
        for cut in range(1, len(word)):
            relation = shuffle(word[:cut], word[cut:])
            if known.issuperset(relation):
                relations.append(relation)
    return relations


def _depth(word: Word) -> int:
    return 1 + max((0 if isinstance(t, int) else _depth(t) for t in word), default=-1)


def _has_line(word: Word) -> bool:
    return any(not isinstance(t, int) and (t == (((),),) or _has_line(t)) for t in word)


def places(word: Word) -> list[tuple[Word, Word]]:
    """Return all letters of a word at any depth, each with the word around it, which has a slot."""
    letters: list[tuple[Word, Word]] = []
    for k, letter in enumerate(word):
        if isinstance(letter, int):
            continue
        letters.append(((*word[:k], SLOT, *word[k + 1 :]), letter))
        letters += [((*word[:k], rest, *word[k + 1 :]), t) for rest, t in places(letter)]
    return letters


def fill(context: Word, letter: Any) -> Word:
    """Put a letter into the slot of what `places` returned."""
    return tuple(
        letter if t == SLOT else t if isinstance(t, int) else fill(t, letter) for t in context
    )


def without(word: Word, part: Word) -> set[Word]:
    """Return the words y such that `word` occurs in ``part ⧢ y``."""
    if not part:
        return {word}
    words: set[Word] = set()
    for k, letter in enumerate(word):
        if letter == part[0]:
            words |= {word[:k] + rest for rest in without(word[k + 1 :], part[1:])}
    return words
