"""Crouch–Grossman tableaux whose row b makes a path along which ``A c - c²/2`` is known.

Along the row b, words are iterated integrals over a path that is linear on each stage, and letters
are constant there. Let B and C be the weights of τ and [τ] up to a point of the path on stage k.
Wherever on the stage, ``B c_k - C`` is the same. Many solutions with few stages satisfy

    L_k = μ R_k,    L_k = Σ_j a_kj c_j - c_k²/2,    R_k = B c_k - C - c_k²/2

at all stages k with ``b_k ≠ 0``, for one number μ. Multiplied by the weight of a word w to the
left, by a letter [y], and followed by a word v to the right, this is a relation of residuals, since
the exact solution satisfies it too:

    Σ_{[τ] ⧢ y} w [z] v - Σ_{ττ ⧢ y} w [z] v
        + μ (Σ_{ττ ⧢ y} w [z] v - Σ_{τ ⧢ w} Σ_{τ ⧢ y} w' [z] v + Σ_{[τ] ⧢ w} w' [y] v) = 0.

CG4 satisfies ``R_k = 0``, which is the case of infinite μ.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction
from functools import cached_property

from flint import arb

from ...structure.layout import Layout
from ...support.balls import to_ball
from ..systems import Equation, EquationSystem, Term
from ..weights import Quantity
from .orthogonality import ResidualRelation
from .structure import MethodStructure
from .words import BUSH, DOT, LINE, Word, add_multiple, shuffle, words_with

_NONZERO = 1e-6  # least |R_k| of the stage that determines μ


class PathStructure(MethodStructure):
    """The relation ``L_k = μ R_k`` at the stages of a tableau that have weights.

    With `infinite`, μ is infinite, so that all R_k are zero.
    """

    def __init__(
        self, layout: Layout, orders: Sequence[int], x: Sequence[Fraction], infinite: bool = False
    ) -> None:
        super().__init__(layout, orders, x)
        self._infinite = infinite
        if infinite:  # see `equations`
            self.assumed = (0, DOT), (0, LINE)

    def possible(self) -> bool:
        """Return whether μ is determined."""
        if self._layout.rows is None or self._layout.pair or not self._stages:
            return False
        return self._infinite or bool(abs(self._mu_terms(self._balls)[1]) > _NONZERO)

    @cached_property
    def _balls(self) -> list[arb]:
        return [to_ball(value) for value in self._x]

    @cached_property
    def _stages(self) -> list[int]:
        """The stages with nonzero weights, without those at the initial point."""
        layout = self._layout
        active = {layout.stage_of[k].item() for k in layout.row(layout.stages) if self._x[k]}
        return [k for k in sorted(active) if layout.lengths[k]]

    @cached_property
    def _reference(self) -> int:
        """The stage that determines μ: the one with the largest R_k."""
        values = self._evaluate([self._right(k) for k in self._stages], self._balls)
        return self._stages[max(range(len(values)), key=lambda i: abs(float(values[i])))]

    def _left(self, k: int) -> list[Term]:
        return [
            Term(Fraction(1), (Quantity(k, LINE),)),
            Term(Fraction(-1), (Quantity(k, BUSH),)),
        ]

    def _right(self, k: int) -> list[Term]:
        row = self._layout.stages
        return [
            Term(Fraction(1), (Quantity(row, DOT, k), Quantity(k, DOT))),
            Term(Fraction(-1), (Quantity(row, LINE, k),)),
            Term(Fraction(-1), (Quantity(k, BUSH),)),
        ]

    def _evaluate(self, sums: Sequence[Sequence[Term]], y: Sequence[arb]) -> list[arb]:
        equations = tuple(Equation("", tuple(terms)) for terms in sums)
        return EquationSystem(self._layout, equations).residuals(y)

    def _mu_terms(self, y: Sequence[arb]) -> list[arb]:
        """Return L_k and R_k at the stage that determines μ."""
        return self._evaluate([self._left(self._reference), self._right(self._reference)], y)

    def equations(self) -> list[Equation]:
        """Return ``L_k R_r = L_r R_k`` with the reference stage r, or ``R_k = 0``.

        At the end of the path ``B = 1`` and ``C = 1/2`` by the conditions of orders one and two. So
        at the last stage ``R_k = 0`` is ``(c_k - 1)² = 0``, whose derivative vanishes; the
        equation there is ``c_k = 1``.
        """
        if self._infinite:
            *inner, last = self._stages
            end = Term(Fraction(1), (Quantity(last, DOT),))
            return [
                *(Equation(f"path at stage {k + 1}", tuple(self._right(k))) for k in inner),
                Equation(f"c_{last + 1} = 1", (end,), Fraction(-1)),
            ]
        r = self._reference
        return [
            Equation(
                f"path at stage {k + 1}",
                (
                    *_products(self._left(k), self._right(r), 1),
                    *_products(self._left(r), self._right(k), -1),
                ),
            )
            for k in self._stages
            if k != r
        ]

    def relations(self, y: Sequence[arb]) -> Iterator[ResidualRelation]:
        """Yield combinations of residuals that are zero, for coefficients in the balls y."""
        finite, mu = arb(0), arb(1)
        if not self._infinite:
            left, right = self._mu_terms(y)
            finite, mu = arb(1), left / right
        free = self._orders[0] - 3
        for before in range(free + 1):
            for inside in range(free + 1 - before):
                for after in range(free + 1 - before - inside):
                    for w in words_with(before):
                        for letter in words_with(inside):
                            for v in words_with(after):
                                yield _relation(w, letter, v, finite, mu)


def _relation(w: Word, y: Word, v: Word, finite: arb, mu: arb) -> ResidualRelation:
    total: dict[Word, arb] = {}
    for z, n in shuffle(LINE, y).items():
        add_multiple(total, (*w, z, *v), n * finite)
    for z, n in shuffle(BUSH, y).items():
        add_multiple(total, (*w, z, *v), n * (mu - finite))
    for before, m in shuffle(DOT, w).items():
        for z, n in shuffle(DOT, y).items():
            add_multiple(total, (*before, z, *v), -m * n * mu)
    for before, m in shuffle(LINE, w).items():
        add_multiple(total, (*before, y, *v), m * mu)
    return {(0, word): factor for word, factor in total.items()}


def _products(first: Sequence[Term], second: Sequence[Term], sign: int) -> list[Term]:
    return [Term(sign * a.factor * b.factor, a.weights + b.weights) for a in first for b in second]
