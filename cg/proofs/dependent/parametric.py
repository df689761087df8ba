"""Identities with unknown parameters: linear relations between stages.

Solutions with few stages often have to satisfy them. Weights of stages, seen as vectors,
are orthogonal to weights of what is around a stage; where the two together span all
stages, one of them may become dependent, and then conditions do.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from flint import arb

from ...structure.layout import Layout
from ...support.balls import to_ball
from ..systems import Equation, Term
from ..weights import Quantity
from .relations import Relation, fill, places, without
from .words import Word, nodes, parse, reciprocal_density, shuffle, text

__all__ = ["RELATION_RADIUS", "Columns", "Letters", "Path"]

_DOT: Word = ((),)  # τ as a word
_LINE: Word = (((),),)  # [τ] as a word, [[τ]] as a letter
_BUSH: Word = ((), ())  # ττ as a word, [ττ] as a letter

RELATION_RADIUS = 1e-15
"""Radius of the balls around the parameters in the proof of the rank of the relations."""


def _add(relation: Relation, word: Word, coefficient: Any) -> None:
    relation[word] = relation.get(word, 0) + coefficient


def _ball(value: Fraction) -> arb:
    return to_ball(value) + arb(0, RELATION_RADIUS)


@dataclass(frozen=True)
class Path:
    """``Σ_j a_kj c_j - c_k²/2 = μ (Σ_{j<k} b_j (c_k - c_j) - c_k²/2)`` where ``b_k ≠ 0``.

    Along the weights, words are iterated integrals over a path that is linear on each
    stage, and letters are constant there. With B and C for those of τ and [τ] up to a
    point of the path on stage k, the sum on the right is ``B c_k - C``, wherever on the
    stage. Multiplied by the weights of a word w to the left, by a letter [y], and followed
    by a word v to the right, it says of residuals, as the exact solution satisfies it,

        Σ_{[τ] ⧢ y} w [y] v - (1 - μ) Σ_{ττ ⧢ y} w [y] v
            - μ Σ_{τ ⧢ w} Σ_{τ ⧢ y} w [y] v + μ Σ_{[τ] ⧢ w} w [y] v = 0.

    Attributes
    ----------
    parameters : tuple of one Fraction
        Close to μ.
    """

    parameters: tuple[Fraction, ...]

    @property
    def heading(self) -> str:
        """Text that identifies it, without the parameters."""
        return "path"

    def equations(
        self, layout: Layout, zeros: Sequence[Collection[int]], first: int
    ) -> list[Equation]:
        """Return the identity at all stages with weights; `first` is the index of μ."""
        found = []
        for r, held in enumerate(zeros, layout.stages):
            for k in range(layout.stages):
                if k in held or not layout.lengths[k]:
                    continue
                bush = (Quantity(k, _BUSH),)
                terms = (
                    Term(Fraction(1), (Quantity(k, _LINE),)),
                    Term(Fraction(-1), bush),
                    Term(Fraction(-1), (Quantity(r, _DOT, k), Quantity(k, _DOT)), first),
                    Term(Fraction(1), (Quantity(r, _LINE, k),), first),
                    Term(Fraction(1), bush, first),
                )
                found.append(Equation(f"path at stage {k + 1}", terms))
        return found

    def relations(self, word: Word) -> Iterator[Relation]:
        """Yield the relations with the word among the terms that change one letter."""
        mu = _ball(self.parameters[0])
        for k, letter in enumerate(word):
            if isinstance(letter, int):
                continue
            left, right = word[:k], word[k + 1 :]
            for y in without(letter, _LINE) | without(letter, _BUSH):
                relation: Relation = {}
                for z, n in shuffle(_LINE, y).items():
                    _add(relation, (*left, z, *right), n)
                for z, n in shuffle(_BUSH, y).items():
                    _add(relation, (*left, z, *right), n * (mu - 1))
                for w, m in shuffle(_DOT, left).items():
                    for z, n in shuffle(_DOT, y).items():
                        _add(relation, (*w, z, *right), -m * n * mu)
                for w, m in shuffle(_LINE, left).items():
                    _add(relation, (*w, y, *right), m * mu)
                yield relation

    def vanishes(self, word: Word, zeros: Collection[int]) -> bool:
        """Return False."""
        return False


@dataclass(frozen=True)
class Letters:
    """``R_i(p) = Σ_t β_t R_i(t)`` at all stages i, for some trees t with up to four nodes.

    Here ``R_i(t) = Φ_i(t) - c_i^n / γ(t)`` for a tree with n + 1 nodes, which is
    zero for the exact solution. In any word, a letter with the children of p, shuffled
    with some word y, may so be replaced. Trees with fewer nodes than p contribute weights
    with fewer nodes, whose residuals are zero.

    Attributes
    ----------
    pivot : Word
        The children of p.
    others : tuple of Word
        The children of the trees t.
    parameters : tuple of Fraction
        Close to the β.
    """

    pivot: Word
    others: tuple[Word, ...]
    parameters: tuple[Fraction, ...]

    @property
    def heading(self) -> str:
        """Text that identifies it, without the parameters."""
        return f"letters {text(self.pivot)} by {' '.join(map(text, self.others))}"

    @classmethod
    def read(cls, heading: str, parameters: tuple[Fraction, ...]) -> Letters:
        """Read a heading."""
        first, by, *trees = heading.split()[1:]
        if by != "by" or len(trees) != len(parameters):
            raise ValueError(f"no identity is known as {heading!r}")
        return cls(parse(first), tuple(map(parse, trees)), parameters)

    @staticmethod
    def _parts(word: Word) -> tuple[tuple[Fraction, Word], tuple[Fraction, Word]]:
        bush = ((),) * nodes(word)
        return (Fraction(1), word), (-reciprocal_density(word) / reciprocal_density(bush), bush)

    def equations(
        self, layout: Layout, zeros: Sequence[Collection[int]], first: int
    ) -> list[Equation]:
        """Return the identity at all stages; `first` is the index of the first β."""
        found = []
        for i in range(layout.stages):
            if not layout.lengths[i]:
                continue
            terms = [Term(f, (Quantity(i, w),)) for f, w in self._parts(self.pivot)]
            for k, word in enumerate(self.others, first):
                terms += [Term(-f, (Quantity(i, w),), k) for f, w in self._parts(word)]
            found.append(Equation(f"letters at stage {i + 1}", tuple(terms)))
        return found

    def relations(self, word: Word) -> Iterator[Relation]:
        """Yield a relation for each letter that is one of the trees, shuffled with a word."""
        combination: dict[Word, arb] = {}
        for factor, other in ((arb(1), self.pivot), *zip(self._factors, self.others, strict=True)):
            if nodes(other) == nodes(self.pivot):
                for f, w in self._parts(other):
                    combination[w] = combination.get(w, arb(0)) + factor * to_ball(f)
        for context, letter in places(word):
            for y in set[Word]().union(*(without(letter, piece) for piece in combination)):
                relation: Relation = {}
                for piece, factor in combination.items():
                    for z, multiplicity in shuffle(piece, y).items():
                        _add(relation, fill(context, z), factor * multiplicity)
                yield relation

    @property
    def _factors(self) -> list[arb]:
        return [-_ball(beta) for beta in self.parameters]

    def vanishes(self, word: Word, zeros: Collection[int]) -> bool:
        """Return False."""
        return False


@dataclass(frozen=True)
class Columns:
    """``Σ_i b_i a_ij = b_j (1 - α c_j - (1 - α) (Σ_{i<j} b_i + b_j/2))`` at all stages j.

    So for any tree t with children y, of residuals, as the exact solution satisfies it,

        [[t]] + α Σ_{z in τ ⧢ y} [[z]] + (1 - α) [τ t] = 0.

    Attributes
    ----------
    parameters : tuple of one Fraction
        Close to α.
    """

    parameters: tuple[Fraction, ...]

    @property
    def heading(self) -> str:
        """Text that identifies it, without the parameters."""
        return "columns"

    def equations(
        self, layout: Layout, zeros: Sequence[Collection[int]], first: int
    ) -> list[Equation]:
        """Return the identity at all stages; `first` is the index of α."""
        found = []
        for r, _ in enumerate(zeros, layout.stages):
            for j in range(layout.stages):
                weight, behind = Quantity(r, (j,)), Quantity(r, ((), j))
                terms = (
                    Term(Fraction(1), (Quantity(r, ((j,),)),)),
                    Term(Fraction(-1), (weight,)),
                    Term(Fraction(1), (behind,)),
                    Term(Fraction(1), (weight, Quantity(j, _DOT)), first),
                    Term(Fraction(-1), (behind,), first),
                )
                found.append(Equation(f"column {j + 1}", terms))
        return found

    def relations(self, word: Word) -> Iterator[Relation]:
        """Yield the relations with the word ``[[t]]`` or ``[[z]]`` of one letter."""
        if len(word) != 1 or isinstance(word[0], int):
            return
        letter = word[0]
        alpha = _ball(self.parameters[0])
        inner = {letter[0]} if len(letter) == 1 and not isinstance(letter[0], int) else set()
        for y in inner | without(letter, _DOT):
            relation: Relation = {}
            _add(relation, ((y,),), 1)
            for z, multiplicity in shuffle(_DOT, y).items():
                _add(relation, (z,), multiplicity * alpha)
            _add(relation, ((), y), 1 - alpha)
            yield relation

    def vanishes(self, word: Word, zeros: Collection[int]) -> bool:
        """Return False."""
        return False
