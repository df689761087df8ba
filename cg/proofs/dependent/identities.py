"""Identities of tableaux by which order conditions depend on each other.

At some solutions the derivatives of the order conditions are dependent, so that no
interval test can prove a zero of them directly. Where the solution satisfies further
identities, these are added as equations, and the conditions that follow (`relations`)
are left out.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import product
from math import factorial

from ...structure.layout import Layout
from ..systems import Equation, Term
from ..weights import Quantity
from .relations import Identity, Relation, fill, places, without
from .words import BUSH, DOT, LINE, Word, add_multiple, shuffle, shuffle_all


@dataclass(frozen=True)
class StageOrderTwo(Identity):
    """``Σ_j a_ij c_j = c_i²/2`` at all stages i but one, the exception e, counted from 0.

    So the letter ``[[τ]]`` may be replaced by ``[ττ]``, up to a letter that is zero except on stage
    e: an indicator. Weights are linear in the values of each letter, and both trees have the same
    number of nodes and the same reciprocal_density, so

        residual(t with [[τ]]) = residual(t with [ττ]) + κ Φ(t with the indicator),
        κ = Σ_j a_ej c_j - c_e²/2.
    """

    exception: int

    @property
    def name(self) -> str:
        """Text in certificates."""
        return f"C(2) except at stage {self.exception + 1}"

    def equations(self, layout: Layout, zeros: Sequence[Collection[int]]) -> list[Equation]:
        """Return ``Σ_j a_ij c_j - c_i²/2`` for all i but the exception.

        ValueError if there is no such stage.
        """
        if not self.exception < layout.stages:
            raise ValueError(f"there is no stage {self.exception + 1}")
        return [
            Equation(f"C(2) at stage {i + 1}", _difference(Quantity(i, LINE), Quantity(i, BUSH)))
            for i in range(layout.stages)
            if i != self.exception and layout.lengths[i]
        ]

    def relations(self, word: Word) -> Iterator[Relation]:
        """Yield a relation for each letter of the word that the identity changes.

        Such a letter is ``[z]`` with z in ``[τ] ⧢ y`` or in ``ττ ⧢ y`` for some word y.
        At stage i, the sum over the first has the value ``Σ_j a_ij c_j Φ_i([y])``, that
        over the second ``c_i²/2 Φ_i([y])``. Their difference is a multiple of the indicator,
        which is left out where y isn't empty: then the word with the indicator is one with
        fewer nodes. The factor κ is taken into the indicator, whose weights are zero or not
        with it.

        Letters before an indicator of stage 2 count on stages 1 and 2 only. There, all letters but
        τ are zero or multiples of ``[τ]``, so that words are zero or multiples of one with
        fewer nodes.
        """
        for context, letter in places(word):
            for y in without(letter, LINE) | without(letter, BUSH):
                relation: Relation = {}
                for piece, sign in ((LINE, 1), (BUSH, -1)):
                    for z, multiplicity in shuffle(piece, y).items():
                        add_multiple(relation, fill(context, z), sign * multiplicity)
                if not y:
                    add_multiple(relation, fill(context, self.exception), -1)
                yield relation
        if self.exception == 1:
            rows = (letter for _, letter in places(word))
            if any(map(_before_the_indicator, rows)):
                yield {word: 1}

    def vanishes(self, word: Word, zeros: Collection[int]) -> bool:
        """Return whether a child of the root is the indicator, and the weight there is zero."""
        return self.exception in word and self.exception in zeros


@dataclass(frozen=True)
class MiddleAbscissae(Identity):
    """``c_k = Σ_{j<k} b_j + b_k/2`` at all stages k with a weight that isn't zero.

    Along the weights, words are iterated integrals over a path that is linear on each
    stage, and letters are constant there. Let B be that of τ up to a point of the path, and
    take a letter [y] times ``(B - c_k)^p / p!`` for a *centred letter* (p, y). As c_k is the
    mean of B's values at the ends of stage k, the integrals over that stage change by the
    sign ``(-1)^Σp`` when their centred letters are reversed. Reversal with the sign
    ``(-1)^m`` of words of m letters gives the inverse, so the logarithm on one stage has
    only words with an odd number of letters of even p: at least one. The same holds for
    its exponential and products of such, the constant apart, so that words of centred
    letters with odd p vanish. For one letter this is

        Σ_{k=0}^p (-1)^k Σ_{z in τ^k ⧢ y} τ^{p-k} [z] = 0,

    and each further letter multiplies the integrand from the right. Residuals satisfy the
    same, since ``B = c`` for the exact solution.

    With one letter of even p, all m have to be on one stage. There such a word is a number
    times ``b_k^N Φ_k(y)``, with N = m + Σp and y in the shuffles of all y: a multiple of the
    words of one letter with ``p = N - 1``.
    """

    first_only: bool = False
    """Of a pair, whether only the first weights satisfy it. Both can't with different weights."""

    @property
    def name(self) -> str:
        """Text in certificates."""
        return "middle abscissae of b" if self.first_only else "middle abscissae"

    def equations(self, layout: Layout, zeros: Sequence[Collection[int]]) -> list[Equation]:
        """Return ``c_k - Σ_{j<k} b_j - b_k/2`` where the weight isn't zero."""
        equations = []
        for r, zero in enumerate(zeros[:1] if self.first_only else zeros, layout.stages):
            for k in range(layout.stages):
                if k in zero:
                    continue
                abscissa = [Term(Fraction(1), (Quantity(k, DOT),))] if layout.lengths[k] else []
                terms = (
                    *abscissa,
                    Term(Fraction(-1), (Quantity(r, DOT, k),)),
                    Term(Fraction(-1, 2), (Quantity(r, (k,)),)),
                )
                equations.append(Equation(f"middle of stage {k + 1}", terms))
        return equations

    def relations(self, word: Word) -> Iterator[Relation]:
        """Yield the relations in which the word occurs with all of τ^p within its letters."""
        choices = []
        for letter in word:
            if isinstance(letter, int):
                return
            powers = range(len(letter) + 1)
            choices.append([(p, y) for p in powers for y in without(letter, ((),) * p)])
        for centred in product(*choices):
            relation = _folded(centred)
            if relation:
                yield relation


def _before_the_indicator(word: Word) -> bool:
    """Return whether a letter before an indicator of stage 2 is neither τ nor [τ]."""
    last = max((k for k, letter in enumerate(word) if isinstance(letter, int)), default=0)
    return any(letter not in ((), DOT) for letter in word[:last])


def _folded(letters: Sequence[tuple[int, Word]]) -> Relation:
    """Return a word of centred letters less a multiple of words of one letter.

    Empty if there is no such relation.
    """
    even = sum(p % 2 == 0 for p, _ in letters)
    if even > 1 or even == len(letters):
        return {}
    relation = _centred(letters)
    if even:
        whole = sum(p + 1 for p, _ in letters) - 1
        share = _on_a_stage(letters) / _on_a_stage([(whole, ())])
        for y, multiplicity in shuffle_all([y for _, y in letters]).items():
            for word, m in _centred([(whole, y)]).items():
                add_multiple(relation, word, -share * multiplicity * m)
    return {word: c for word, c in relation.items() if c}


def _centred(letters: Sequence[tuple[int, Word]]) -> Relation:
    """Return a word of centred letters as a sum of words."""
    words: Relation = {(): 1}
    for p, y in letters:
        words = _append(words, p, y)
    return words


def _on_a_stage(letters: Sequence[tuple[int, Word]]) -> Fraction:
    """Return the iterated integral of the letters' ``u^p / p!``, over -1/2 < u < 1/2."""
    half = Fraction(1, 2)
    integral = [Fraction(1)]  # coefficients of a polynomial in u
    for p, _ in letters:
        scaled = [Fraction(0)] * p + [c / factorial(p) for c in integral]
        integral = [Fraction(0)] + [c / (k + 1) for k, c in enumerate(scaled)]
        integral[0] = -sum((c * (-half) ** k for k, c in enumerate(integral)), Fraction(0))
    return sum((c * half**k for k, c in enumerate(integral)), Fraction(0))


def _append(words: Relation, p: int, y: Word) -> Relation:
    """Return the words followed by a centred letter."""
    longer: Relation = {}
    for inner in range(p + 1):
        for word, multiplicity in words.items():
            for before, m in shuffle(((),) * (p - inner), word).items():
                for z, n in shuffle(((),) * inner, y).items():
                    add_multiple(longer, (*before, z), (-1) ** inner * multiplicity * m * n)
    return longer


def _difference(first: Quantity, second: Quantity) -> tuple[Term, ...]:
    return Term(Fraction(1), (first,)), Term(Fraction(-1), (second,))
