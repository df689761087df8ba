"""Which order conditions follow from others, given identities: linear algebra of residuals.

Take the residuals ``Φ(t) - 1/γ(t)`` of all words with equally many nodes as unknowns,
those of words with fewer nodes being zero. Then the relations

- of the shuffle product, ``Σ_{w in u ⧢ v} residual(w) = 0``, and
- of the identities

are a homogeneous linear system. Its solution vanishes if the residuals of the *kept*
words do; these are chosen such that the other columns are independent.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from fractions import Fraction
from typing import Any, Protocol

import numpy as np
from flint import arb, arb_mat
from numpy.typing import NDArray

from ...structure.layout import Layout
from ..systems import Equation
from .words import Word, condition_words, nodes, shuffle

__all__ = ["HOLE", "Identity", "Relation", "fill", "kept_words", "places", "regular", "without"]

Relation = dict[Word, Any]
"""Coefficients, integers, Fractions or balls, of a sum of residuals that is zero."""

HOLE = -1  # where a letter was cut out of a word


class Identity(Protocol):
    """Something that a solution satisfies besides its order conditions."""

    @property
    def heading(self) -> str:
        """Text that tells it from others, without its parameters."""

    @property
    def parameters(self) -> tuple[Fraction, ...]:
        """Approximations of unknown coefficients of its own."""

    def equations(
        self, layout: Layout, zeros: Sequence[Collection[int]], first: int
    ) -> list[Equation]:
        """Return what is to be proved of the coefficients.

        `zeros` has the stages, from 0, where each row of weights is held at zero, `first`
        is the index of the first parameter.
        """

    def relations(self, word: Word) -> Iterable[Relation]:
        """Return relations that contain this word, and maybe new ones, with marks."""

    def vanishes(self, word: Word, zeros: Collection[int]) -> bool:
        """Tell whether a weight is zero since the weights at the stages `zeros` are."""


def kept_words(grade: int, identities: Sequence[Identity], zeros: Collection[int]) -> list[Word]:
    """Return words with `grade` nodes whose residuals force those of all others to zero.

    Parameters
    ----------
    grade : int
    identities : sequence of Identity
    zeros : collection of int
        Stages, from 0, where the weights are held at zero.

    Raises
    ------
    ArithmeticError
        If the relations don't have the rank that was expected of them.
    """
    plain = [w for w in condition_words(grade, independent=False) if nodes(w) == grade]
    lyndon = set(condition_words(grade))
    words, relations = _close(plain, identities)
    relations += _shuffles(words)
    columns = [w for w in words if not any(i.vanishes(w, zeros) for i in identities)]
    # leftmost are eliminated first
    columns.sort(key=lambda w: (w in lyndon, not _has_line(w), -_depth(w), len(w)))
    position = {word: k for k, word in enumerate(columns)}
    rows = [
        {position[w]: c for w, c in relation.items() if w in position} for relation in relations
    ]
    matrix = np.zeros((len(rows), len(columns)))
    for entries, row in zip(rows, matrix, strict=True):
        for k, coefficient in entries.items():
            row[k] = float(coefficient)
    used, eliminated = _pivots(matrix)
    square = arb_mat([[_ball(rows[i].get(k, 0)) for k in eliminated] for i in used])
    if eliminated and not regular(square):
        raise ArithmeticError(f"the relations between words with {grade} nodes are degenerate")
    gone = set(eliminated)
    return [word for k, word in enumerate(columns) if k not in gone]


def _close(
    plain: Sequence[Word], identities: Sequence[Identity]
) -> tuple[list[Word], list[Relation]]:
    words, found = dict.fromkeys(plain), dict[frozenset[tuple[Word, float]], Relation]()
    pending = list(plain)
    while pending:
        word = pending.pop()
        for identity in identities:
            for relation in identity.relations(word):
                found[frozenset((w, float(c)) for w, c in relation.items())] = relation
                pending += [new for new in relation if new not in words]
                words.update(dict.fromkeys(relation))
    return list(words), list(found.values())


def _shuffles(words: Sequence[Word]) -> list[Relation]:
    """Return ``Σ residual(u ⧢ v) = 0`` for all ways to cut these words in two."""
    known = set(words)
    found: list[Relation] = []
    for word in words:
        for cut in range(1, len(word)):
            relation = shuffle(word[:cut], word[cut:])
            if known.issuperset(relation):
                found.append(relation)
    return found


def _ball(value: Any) -> arb:
    if isinstance(value, Fraction):
        return arb(value.numerator) / value.denominator
    return arb(value)


def regular(matrix: arb_mat) -> bool:
    """Tell whether all matrices in a square ball matrix are regular."""
    try:
        matrix.solve(arb_mat([[0] for _ in range(matrix.nrows())]))
    except ZeroDivisionError:
        return False
    return True


def _pivots(matrix: NDArray[np.float64]) -> tuple[list[int], list[int]]:
    """Return rows and columns of a regular square part of full rank, leftmost columns."""
    work = matrix.copy()
    left = list(range(len(work)))
    rows: list[int] = []
    columns: list[int] = []
    for k in range(work.shape[1]):
        if not left:
            break
        best = max(left, key=lambda i: abs(float(work[i, k])))
        if abs(work[best, k]) < 1e-9:
            continue
        left.remove(best)
        rows.append(best)
        columns.append(k)
        others = np.array(left, dtype=np.intp)
        work[others] -= np.outer(work[others, k] / work[best, k], work[best])
    return rows, columns


def _depth(word: Word) -> int:
    return 1 + max((0 if isinstance(t, int) else _depth(t) for t in word), default=-1)


def _has_line(word: Word) -> bool:
    return any(not isinstance(t, int) and (t == (((),),) or _has_line(t)) for t in word)


def places(word: Word) -> list[tuple[Word, Word]]:
    """Return all letters of a word at any depth, each after what it leaves, with a hole."""
    found: list[tuple[Word, Word]] = []
    for k, letter in enumerate(word):
        if isinstance(letter, int):
            continue
        found.append(((*word[:k], HOLE, *word[k + 1 :]), letter))
        found += [((*word[:k], rest, *word[k + 1 :]), t) for rest, t in places(letter)]
    return found


def fill(context: Word, letter: Any) -> Word:
    """Put a letter into the hole of what `places` returned."""
    return tuple(
        letter if t == HOLE else t if isinstance(t, int) else fill(t, letter) for t in context
    )


def without(word: Word, part: Word) -> set[Word]:
    """Return the words y such that `word` occurs in ``part ⧢ y``."""
    if not part:
        return {word}
    found: set[Word] = set()
    for k, letter in enumerate(word):
        if letter == part[0]:
            found |= {word[:k] + rest for rest in without(word[k + 1 :], part[1:])}
    return found
