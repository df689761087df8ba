"""Systems of equations between weights of a tableau, evaluated in ball arithmetic."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from math import prod
from typing import NamedTuple

from flint import arb, arb_mat

from ..structure.layout import Layout
from ..support.balls import to_ball, to_flint, to_fraction
from .dependent.words import Word, condition_words, reciprocal_density, text
from .weights import Quantity, Weights

_NEGLIGIBLE = 1e-20


class Term(NamedTuple):
    """A rational multiple of a product of weights."""

    factor: Fraction
    weights: tuple[Quantity, ...]


class Equation(NamedTuple):
    """A sum of terms and a constant that should be zero, with a label for messages."""

    label: str
    terms: tuple[Term, ...]
    constant: Fraction | arb = Fraction(0)


def condition(word: Word, row: int) -> Equation:
    """Return ``Φ(t) - 1/γ(t)`` for the tree with these children, along a row of weights."""
    term = Term(Fraction(1), (Quantity(row, word),))
    return Equation(text(word), (term,), -reciprocal_density(word))


@dataclass(frozen=True)
class EquationSystem:
    """Equations in the coefficients of a method."""

    layout: Layout
    equations: tuple[Equation, ...]

    @cached_property
    def _position(self) -> dict[Quantity, int]:
        quantities = (
            quantity
            for equation in self.equations
            for term in equation.terms
            for quantity in term.weights
        )
        return {quantity: k for k, quantity in enumerate(dict.fromkeys(quantities))}

    def residuals(self, z: Sequence[arb]) -> list[arb]:
        """Return the residuals of the equations."""
        return self._evaluate(z)[0]

    def linearise(self, z: Sequence[arb]) -> tuple[list[arb], arb_mat]:
        """Return the residuals and their derivatives by all unknowns."""
        values, weights, phi = self._evaluate(z)
        by_entry = weights.jacobian().tolist()
        rows = []
        for equation in self.equations:
            row = [arb(0)] * self.layout.size
            for term in equation.terms:
                factors = [phi[self._position[quantity]] for quantity in term.weights]
                for k, quantity in enumerate(term.weights):
                    others = prod([*factors[:k], *factors[k + 1 :]], start=to_ball(term.factor))
                    for p, slope in enumerate(by_entry[self._position[quantity]]):
                        row[p] = row[p] + others * slope
            rows.append(row)
        return values, arb_mat(rows)

    def _evaluate(self, z: Sequence[arb]) -> tuple[list[arb], Weights, list[arb]]:
        weights = Weights(self.layout, list(self._position))
        phi = weights.evaluate(z)
        values = []
        for equation in self.equations:
            total = to_ball(equation.constant)
            for term in equation.terms:
                factors = (phi[self._position[quantity]] for quantity in term.weights)
                total = total + prod(factors, start=to_ball(term.factor))
            values.append(total)
        return values, weights, phi


def nearly_satisfied(layout: Layout, equations: Sequence[Equation], x: Sequence[Fraction]) -> bool:
    """Return whether the residuals of equations are as small as rounded coefficients make them."""
    residuals = EquationSystem(layout, tuple(equations)).residuals([to_ball(v) for v in x])
    return all(abs(residual) < _NEGLIGIBLE for residual in residuals)


def order_system(layout: Layout, order: int, embedded_order: int | None) -> EquationSystem:
    """Return the independent order conditions, of both rows of weights for a pair."""
    of_time = layout.of_time
    equations = [condition(word, layout.stages) for word in condition_words(order, True, of_time)]
    if embedded_order:
        embedded = condition_words(embedded_order, True, of_time)
        equations += [
            condition(word, layout.stages + 1)._replace(label=f"{text(word)} embedded")
            for word in embedded
        ]
    return EquationSystem(layout, tuple(equations))


def exact_residuals(
    layout: Layout, x: Sequence[Fraction], words: Sequence[Word], row: int
) -> list[Fraction]:
    """Return ``Φ(t) - 1/γ(t)`` in rational arithmetic, for packed rational entries."""
    weights = Weights(layout, [Quantity(row, word) for word in words])
    weights_of_words = weights.evaluate([to_flint(entry) for entry in x])
    return [
        to_fraction(value) - reciprocal_density(word)
        for value, word in zip(weights_of_words, words, strict=True)
    ]
