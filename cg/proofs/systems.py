"""Systems of equations between weights of a tableau, evaluated in ball arithmetic."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any, NamedTuple

from flint import arb, arb_mat, fmpq

from ..structure.layout import Layout
from .dependent.words import Word, condition_words, reciprocal_density, text
from .weights import Quantity, Weights

__all__ = ["Equation", "EquationSystem", "Term", "condition", "exact_residuals", "order_system"]


class Term(NamedTuple):
    """A rational multiple of a product of weights, and maybe of a parameter."""

    factor: Fraction
    weights: tuple[Quantity, ...]
    parameter: int | None = None


class Equation(NamedTuple):
    """A sum of terms that should be zero.

    Attributes
    ----------
    label : str
        What it says, for messages.
    terms : tuple of Term
    constant : Fraction or arb
        Added to the terms.
    """

    label: str
    terms: tuple[Term, ...]
    constant: Fraction | arb = Fraction(0)


def condition(word: Word, row: int) -> Equation:
    """Return ``Φ(t) - 1/γ(t)`` for the tree with these children, along a row of weights."""
    term = Term(Fraction(1), (Quantity(row, word),))
    return Equation(text(word), (term,), -reciprocal_density(word))


@dataclass(frozen=True)
class EquationSystem:
    """Equations in the entries of a tableau, and in parameters of their own.

    Attributes
    ----------
    layout : Layout
    equations : tuple of Equation
    parameters : int
        Number of further unknowns, after the entries of the tableau.
    """

    layout: Layout
    equations: tuple[Equation, ...]
    parameters: int = 0

    @property
    def unknowns(self) -> int:
        """Number of unknowns."""
        return self.layout.size + self.parameters

    @cached_property
    def _position(self) -> dict[Quantity, int]:
        found: dict[Quantity, int] = {}
        for equation in self.equations:
            for term in equation.terms:
                for quantity in term.weights:
                    found.setdefault(quantity, len(found))
        return found

    def residuals(self, z: Sequence[arb]) -> list[arb]:
        """Return what the equations should make zero."""
        return self._evaluate(z)[0]

    def linearise(self, z: Sequence[arb]) -> tuple[list[arb], arb_mat]:
        """Return the residuals and their derivatives by all unknowns."""
        values, weights, found = self._evaluate(z)
        by_entry = weights.jacobian().tolist()
        size, rest = self.layout.size, list(z[self.layout.size :])
        rows = []
        for equation in self.equations:
            row = [arb(0)] * self.unknowns
            for term in equation.terms:
                factor = _ball(term.factor)
                outer = factor if term.parameter is None else factor * rest[term.parameter]
                known = [found[self._position[quantity]] for quantity in term.weights]
                for k, quantity in enumerate(term.weights):
                    others = _product([outer, *known[:k], *known[k + 1 :]])
                    derivative = by_entry[self._position[quantity]]
                    for p, y in enumerate(derivative):
                        row[p] = row[p] + others * y
                if term.parameter is not None:
                    p = size + term.parameter
                    row[p] = row[p] + _product([factor, *known])
            rows.append(row)
        return values, arb_mat(rows)

    def _evaluate(self, z: Sequence[arb]) -> tuple[list[arb], Weights, list[arb]]:
        weights = Weights(self.layout, list(self._position))
        found = weights.evaluate(z[: self.layout.size])
        rest = list(z[self.layout.size :])
        values = []
        for equation in self.equations:
            total = _ball(equation.constant)
            for term in equation.terms:
                factors = [found[self._position[quantity]] for quantity in term.weights]
                if term.parameter is not None:
                    factors.append(rest[term.parameter])
                total = total + _product([_ball(term.factor), *factors])
            values.append(total)
        return values, weights, found


def order_system(layout: Layout, order: int, embedded_order: int | None) -> EquationSystem:
    """Return the independent order conditions, of both rows of weights for a pair."""
    equations = [condition(word, layout.stages) for word in condition_words(order)]
    if embedded_order:
        embedded = condition_words(embedded_order)
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
    found = weights.evaluate([fmpq(entry.numerator, entry.denominator) for entry in x])
    return [
        Fraction(int(value.p), int(value.q)) - reciprocal_density(word)
        for value, word in zip(found, words, strict=True)
    ]


def _ball(value: Fraction | arb) -> arb:
    return value if isinstance(value, arb) else arb(fmpq(value.numerator, value.denominator))


def _product(factors: Sequence[Any]) -> Any:
    total = factors[0]
    for factor in factors[1:]:
        total = total * factor
    return total
