"""Systems of order conditions, evaluated in ball or rational arithmetic."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from cg.construction.conditions.word_weights import Quantity, Weights
from cg.construction.conditions.words import Condition, reciprocal_density
from cg.construction.layouts.layout import Layout
from cg.support import flint
from cg.support.balls import to_flint


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
