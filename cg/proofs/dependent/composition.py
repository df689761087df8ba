"""Methods that are symmetric sequences of implicit midpoint steps.

One step applies a functional on words after another. Functionals multiply by the
convolution of the coproduct below: what the first has done before a letter of the second
is spread over the trees that the letter grows on. The weights of a midpoint step of
length b are ``exp(b m_1 + b³ m_3 + b⁵ m_5 + …)`` with functionals m_k that see words with
k nodes only, and those of the exact flow are ``exp(m_1)``. A symmetric sequence of steps
has ``exp(Σ b m_1 + …)`` too, with Lie polynomials of m_1, m_3, … of odd degree. So once
the conditions on fewer nodes hold, the residuals of words with k nodes are none for even
k, and for odd k a combination of the Lie polynomials of degree k.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache

from flint import fmpq_mat

from ...structure.layout import Layout, Rows
from ...support.balls import to_flint, to_fraction
from ..systems import Equation, Term, exact_residuals
from ..weights import Quantity
from .relations import Identity, Relation
from .words import (
    Word,
    add_multiple,
    condition_words,
    nodes,
    reciprocal_density,
    shuffle,
    words_with,
)

Functional = dict[Word, Fraction]


@cache
def coproduct(word: Word) -> dict[tuple[Word, Word], int]:
    """Return the parts of a word that a first and a second step take, with multiplicities."""
    parts_of_word: dict[tuple[Word, Word], int] = {}
    for cut in range(len(word) + 1):
        parts: dict[tuple[Word, Word], int] = {(word[:cut], ()): 1}
        for letter in word[cut:]:
            grown: dict[tuple[Word, Word], int] = {}
            for (first, second), m in parts.items():
                for (early, late), n in coproduct(letter).items():
                    for mixed, multiplicity in shuffle(first, early).items():
                        add_multiple(grown, (mixed, (*second, late)), m * n * multiplicity)
            parts = grown
        for key, m in parts.items():
            add_multiple(parts_of_word, key, m)
    return parts_of_word


def convolve(first: Functional, second: Functional, words: Sequence[Word]) -> Functional:
    """Return the functional of a first step, then a second, on some words."""
    product: Functional = {}
    for word in words:
        total = Fraction(0)
        for (early, late), m in coproduct(word).items():
            if early in first and late in second:
                total += m * first[early] * second[late]
        if total:
            product[word] = total
    return product


def logarithm(functional: Functional, words: Sequence[Word]) -> Functional:
    """Return the logarithm of a functional that is 1 on the empty word."""
    rest = {word: value for word, value in functional.items() if word}
    total: Functional = {}
    power, k = rest, 1
    while power:
        for word, value in power.items():
            total[word] = total.get(word, Fraction(0)) + Fraction((-1) ** (k + 1), k) * value
        power, k = convolve(power, rest, words), k + 1
    return {word: value for word, value in total.items() if value}


@cache
def _generators(grade: int) -> list[Functional]:
    """Return m_1, …, m_grade, where those with even index should be empty."""
    words = condition_words(grade, independent=False)
    layout = Layout.tableau(1, Rows.DIAGONAL)
    residuals = exact_residuals(layout, [Fraction(1, 2), Fraction(1)], words, 1)
    step = {w: value + reciprocal_density(w) for w, value in zip(words, residuals, strict=True)}
    whole = logarithm({(): Fraction(1), **step}, words)
    return [{w: v for w, v in whole.items() if nodes(w) == k} for k in range(1, grade + 1)]


@cache
def _lie_polynomials(grade: int) -> list[Functional]:
    """Return functionals that span the Lie polynomials of a degree: brackets from the right."""
    words = list(words_with(grade))
    generators = _generators(grade)
    assert not any(generators[1::2])
    polynomials = [generators[grade - 1]] if grade % 2 else []
    for k in range(1, grade, 2):
        for inner in _lie_polynomials(grade - k):
            one = convolve(generators[k - 1], inner, words)
            other = convolve(inner, generators[k - 1], words)
            bracket = {w: one.get(w, Fraction(0)) - other.get(w, Fraction(0)) for w in words}
            polynomials.append({w: value for w, value in bracket.items() if value})
    return [functional for functional in polynomials if functional]


@cache
def _expansions(grade: int) -> dict[Word, dict[Word, Fraction]]:
    """Return for each word how its residual combines those of a few."""
    words = list(words_with(grade))
    lyndon = set(condition_words(grade))
    words.sort(key=lambda w: (w not in lyndon, len(w)))
    spanning = _lie_polynomials(grade) if grade % 2 else []
    if not spanning:
        return {word: {} for word in words}
    entries = [f.get(w, Fraction(0)) for f in spanning for w in words]
    matrix = fmpq_mat(len(spanning), len(words), [to_flint(v) for v in entries])
    reduced, rank = matrix.rref()
    rows = [list(map(to_fraction, row)) for row in reduced.tolist()[:rank]]
    pivots = [words[next(k for k, value in enumerate(row) if value)] for row in rows]
    return {
        word: {p: row[k] for p, row in zip(pivots, rows, strict=True) if row[k]}
        for k, word in enumerate(words)
    }


@dataclass(frozen=True)
class MidpointSteps(Identity):
    """``a_ij = b_j`` for j < i, ``a_ii = b_i/2``, ``b_i = b_{s+1-i}``."""

    @property
    def name(self) -> str:
        """Text in certificates."""
        return "symmetric midpoint steps"

    def equations(self, layout: Layout, zeros: Sequence[Collection[int]]) -> list[Equation]:
        """Return what makes a tableau a symmetric sequence of midpoint steps.

        ValueError if the layout isn't diagonally implicit, or a pair.
        """
        if layout.rows is not Rows.DIAGONAL or layout.pair:
            raise ValueError("midpoint steps need a diagonally implicit tableau, no pair")
        s = layout.stages
        equations = []
        for i in range(s):
            for j in range(i + 1):
                share = Fraction(-1, 2) if j == i else Fraction(-1)
                terms = Term(Fraction(1), (Quantity(i, (j,)),)), Term(share, (Quantity(s, (j,)),))
                equations.append(Equation(f"midpoint steps, a_{i + 1},{j + 1}", terms))
        for j in range(s // 2):
            terms = (
                Term(Fraction(1), (Quantity(s, (j,)),)),
                Term(Fraction(-1), (Quantity(s, (s - 1 - j,)),)),
            )
            equations.append(Equation(f"symmetry of b_{j + 1}", terms))
        return equations

    def relations(self, word: Word) -> Iterator[Relation]:
        """Yield the relation of the word to those that span its residuals."""
        if any(isinstance(letter, int) for letter in word):
            return
        relation: Relation = {other: -v for other, v in _expansions(nodes(word))[word].items()}
        if relation != {word: -1}:
            relation[word] = 1
            yield relation
