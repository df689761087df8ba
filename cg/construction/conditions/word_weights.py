"""Weights of words at the points of a method, and their derivatives, in ball arithmetic.

With the letters l_m(v) = Σ_k y_mk Φ_k(v) of the flow to point m, its exponential E_m and the
weights χ_m at the point,

    E_m(w) = l_m(w_1) … l_m(w_n) / n!,   χ_m(w) = Σ_{w = u v} χ_parent(u) E_m(v),

as in ``fortran/conditions/weights.f90``: `_letter`, `_flow` and `_chi`. Compiled code has no balls;
the numbers here are those of python-flint, ``arb`` for proofs and ``fmpq`` for exact weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import comb
from typing import Any, NamedTuple

from cg.construction.conditions.words import Condition, Word, closure, nodes, reciprocal_density
from cg.construction.layouts.layout import Layout
from cg.construction.layouts.points import START
from cg.support import flint
from cg.support.balls import to_flint

Vector = list[Any]


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
        # by the end of a path, and by word the points where it is needed
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
        # by word: of the flow alone, at the parent, and at the point; the start is last
        self._flow: dict[Word, Vector] = {(): [one] * points}
        self._left: dict[Word, Vector] = {(): [one] * points}
        self._chi: dict[Word, Vector] = {(): [one] * (points + 1)}
        for word, where in self._needed.items():
            self._add(word, where)
            if word in self._letters:
                chi = self._chi[word]
                self._phi[word] = [chi[at] for at in layout.stage_points]
        return [
            self._chi[quantity.word][path[-1]] if path else (zero if quantity.word else one)
            for quantity, path in zip(self.quantities, self._paths, strict=True)
        ]

    def _add(self, word: Word, where: Sequence[int]) -> None:
        """Compute a word whose proper factors are known, at some points with their parents."""
        count, points = len(word), len(self.layout.parents)
        rest, letter = self._flow[word[1:]], self._letter_at_points(word[0])
        flow: Vector = [None] * points
        left: Vector = [None] * points
        chi: Vector = [None] * points + [self._zero]
        cuts = [(self._left[word[:cut]], self._flow[word[cut:]]) for cut in range(1, count)]
        parents = self.layout.parents
        for m in where:
            change = flow[m] = rest[m] * letter[m] / count
            for head, tail in cuts:
                change = change + head[m] * tail[m]
            left[m] = chi[parents[m]]
            chi[m] = left[m] + change
        self._flow[word], self._left[word], self._chi[word] = flow, left, chi

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
            left, flow = self._left[before[:cut]], self._flow[before[cut:]]
            earlier = [left[i] * flow[i] for i in path]
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

        Those of letters at the stages come first, from letters with few nodes to those with many.
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
