"""What proofs of Magnus methods with brackets state: conditions of Lyndon words in derivatives.

The coefficients of words in a product of exponentials of Lie elements are polynomials in those of
Lyndon words that are not longer (Radford's theorem), so that no other conditions are needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from math import prod
from typing import Any

from cg.construction.conditions.linear_equations import product_of_exponentials
from cg.construction.conditions.words import Condition, Word, condition_words, conditions_of, nodes
from cg.construction.methods.magnus import MagnusMethod
from cg.construction.proofs.packed import Packed, PolynomialEquations


@dataclass(frozen=True)
class PackedBrackets(Packed):
    """A Magnus method with brackets as its coefficients that aren't zero."""

    method: MagnusMethod

    @property
    def names(self) -> list[str]:
        """Nodes c, the sides u and v of brackets, and weights w, all counted from 1."""
        labels = ["c_"]
        labels += [f"{side}_{j}," for j in range(1, len(self.method.brackets) + 1) for side in "uv"]
        labels += [f"w_{i}," for i in range(1, len(self.method.weights) + 1)]
        second = self.method.embedded_weights or ()
        labels += [f"w_embedded_{i}," for i in range(1, len(second) + 1)]
        return [
            f"{label}{k}"
            for label, row in zip(labels, self.method.rows, strict=True)
            for k, x in enumerate(row, 1)
            if x.value
        ]

    @property
    def conditions(self) -> list[Condition]:
        return conditions_of(self.orders, of_time=True)

    def words(self, order: int) -> list[Word]:
        return [word for word in condition_words(order, of_time=True) if nodes(word) == order]

    def equations(self, conditions: Sequence[Condition]) -> PolynomialEquations:
        largest = [0, 0]
        for row, word in conditions:
            largest[row] = max(largest[row], nodes(word))

        def residuals(z: Sequence[Any]) -> list[Any]:
            nodes, brackets, *results = self._filled(z)
            products = [
                product_of_exponentials((nodes, rows, brackets), order)
                for rows, order in zip(results, largest, strict=False)
            ]
            values = []
            for row, word in conditions:
                # the last letter of a word in derivatives is followed first
                degrees = tuple(len(letter) + 1 for letter in reversed(word))
                divisor = prod(accumulate(reversed(degrees)))
                values.append(products[row].get(degrees, 0) - (z[0] * 0 + 1) / divisor)
            return values

        return PolynomialEquations(residuals)

    def _filled(self, z: Sequence[Any]) -> tuple[Any, Any, Any, Any]:
        """Return nodes, brackets and both results, as numbers of the type of z."""
        rows = self.method.filled(z, z[0] * 0)
        pairs = 1 + 2 * len(self.method.brackets)
        first = pairs + len(self.method.weights)
        brackets = list(zip(rows[1:pairs:2], rows[2:pairs:2], strict=True))
        return rows[0], brackets, rows[pairs:first], rows[first:]
