"""Relations between residuals of methods of two registers.

Let the points follow each other, each the place of the next stage, and the flow to point m be
that of ``B_m Z_m`` with ``Z_m = A_m Z_{m-1} + F_m``. For a letter v let V be its integral along
the path. Then for two letters, at every point of the path,

    V dw - W dv = d(w V - v W),

where the products on the right are those of values at stages, letters again: on flow m,
``V Z_m(w) - W Z_m(v) - Z_m(w V - v W)`` doesn't change, as V changes by multiples of Z_m(v), and
is A_m times its value on the flow before, since ``Z_m - A_m Z_{m-1}`` is the value at stage m. It
is zero on the first flow. Multiplied by the integral of a word p to the left, and followed by a
word q,

    Σ_{x in p ⧢ v} x w q - Σ_{x in p ⧢ w} x v q = p [w ⧢ v] q - p [v ⧢ w] q,

with the letter v as one more child of the letter w, and of v w, on the right. The exact solution
satisfies this too.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction
from functools import cache

from flint import arb

from ...structure.points import START
from ..systems import Equation, Term
from ..weights import Quantity
from .orthogonality import ResidualRelation
from .structure import MethodStructure
from .words import Word, add_multiple, shuffle, words_with


class TwoRegisters(MethodStructure):
    """The structure of a method of two registers."""

    def possible(self) -> bool:
        """Return whether the points are a chain, each with a stage."""
        layout, points = self._layout, range(len(self._layout.parents))
        return (
            layout.rows is None
            and not (layout.pair or layout.of_time)
            and tuple(layout.parents) == tuple(range(START, len(points) - 1))
            and tuple(layout.stage_points) == tuple(range(START, len(points) - 1))
            and all(tuple(layout.weights[m]) == tuple(range(m + 1)) for m in points)
        )

    def _entries(self) -> Iterator[tuple[int, int]]:
        for m in range(2, len(self._layout.parents)):
            for k in range(m - 1):
                yield m, k

    def equations(self) -> list[Equation]:
        """Return that the weights on two stages have the same ratio in all flows."""
        equations = []
        for m, k in self._entries():
            products = (((m, k), (k + 1, k + 1), 1), ((m, k + 1), (k + 1, k), -1))
            terms = [
                Term(Fraction(sign * a * b), (*one, *other))
                for first, second, sign in products
                for a, one in self._places(*first)
                for b, other in self._places(*second)
            ]
            equations.append(Equation(f"weights {k + 1} and {k + 2} of flow {m + 1}", tuple(terms)))
        return equations

    def _places(self, m: int, k: int) -> list[tuple[int, tuple[Quantity]]]:
        """Return the weight of flow m on stage k as a difference of sums along paths."""
        places = [(1, (Quantity(m + 1, (k,)),))]
        if m > k:
            places.append((-1, (Quantity(m, (k,)),)))
        return places

    def relations(self, y: Sequence[arb] = ()) -> Iterator[ResidualRelation]:
        """Yield combinations of residuals that are zero: rows and words, and coefficients."""
        for row, order in enumerate(self._orders):
            for count in range(1, order + 1):
                for relation in exchanges(count):
                    yield {(row, word): Fraction(m) for word, m in relation.items()}


@cache
def exchanges(count: int) -> tuple[dict[Word, int], ...]:
    """Return combinations of words with `count` nodes that are zero, at the root or deeper."""
    relations = [
        relation
        for first in range(1, count)
        for second in range(1, count - first + 1)
        for left in range(count - first - second + 1)
        for v in words_with(first - 1)
        for w in words_with(second - 1)
        for p in words_with(left)
        for q in words_with(count - first - second - left)
        if (relation := _exchange(p, v, w, q))
    ]
    for inside in range(2, count):
        for left in range(count - inside):
            for p in words_with(left):
                for q in words_with(count - 1 - inside - left):
                    relations += [
                        {(*p, letter, *q): m for letter, m in relation.items()}
                        for relation in exchanges(inside)
                    ]
    return tuple(relations)


def _exchange(p: Word, v: Word, w: Word, q: Word) -> dict[Word, int]:
    relation: dict[Word, int] = {}
    for first, second, sign in ((v, w, 1), (w, v, -1)):
        for word, m in shuffle(p, (first,)).items():
            whole = (*word, second, *q)
            add_multiple(relation, whole, sign * m)
        for letter, m in shuffle(second, (first,)).items():
            whole = (*p, letter, *q)
            add_multiple(relation, whole, -sign * m)
    return {word: m for word, m in relation.items() if m}
