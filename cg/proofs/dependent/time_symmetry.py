"""Magnus methods that are the same backwards in time: weights of words in powers of the time.

Let the nodes lie symmetrically in the step, c_(K+1-k) = 1 - c_k, and let flow s + 1 - i have the
weight of flow i on the mirrored stage. Backwards along the path of flows the letter c^j/j! has the
values of

    (1 - c)^j/j! = Σ_m (-1)^m/(j - m)! c^m/m! ,

so that the weight of a word is that of the reversed word of these sums of letters. The exact
solution satisfies this too, so it is a relation between residuals.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction
from functools import cache
from itertools import product
from math import factorial

from flint import arb

from ..systems import Equation, Term
from ..weights import Quantity
from .orthogonality import ResidualRelation
from .structure import MethodStructure
from .words import DOT, Word, add_multiple, condition_words


class TimeSymmetry(MethodStructure):
    """The structure of a Magnus method whose results are symmetric in time."""

    def possible(self) -> bool:
        """Return whether stages are at nodes."""
        return self._layout.of_time

    def equations(self) -> list[Equation]:
        """Return that nodes and weights are those of mirrored stages and flows."""
        stages = self._layout.stages
        equations = []
        for k in range((stages + 1) // 2):
            sides = [Term(Fraction(1), (Quantity(j, DOT),)) for j in (k, stages - 1 - k)]
            equations.append(Equation(f"symmetry of c_{k + 1}", tuple(sides), Fraction(-1)))
        for row in range(len(self._orders)):
            flows = len(self._layout.path(self._layout.ends[stages + row]))
            for i, k in product(range(flows), range(stages)):
                mirror = flows - 1 - i, stages - 1 - k
                if (i, k) < mirror:
                    terms = (*self._weight(row, i, k, 1), *self._weight(row, *mirror, -1))
                    equations.append(Equation(f"symmetry of w_{i + 1},{k + 1}", terms))
        return equations

    def _weight(self, row: int, flow: int, stage: int, sign: int) -> Iterator[Term]:
        """Yield a weight as the difference of sums along the path to the result."""
        for count, factor in ((flow + 1, sign), (flow, -sign)):
            quantity = Quantity(self._layout.stages + row, (stage,), count)
            yield Term(Fraction(factor), (quantity,))

    def relations(self, y: Sequence[arb] = ()) -> Iterator[ResidualRelation]:
        """Yield combinations of residuals that are zero: rows and words, and coefficients."""
        for row, order in enumerate(self._orders):
            for word in condition_words(order, independent=False, of_time=True):
                relation = {(row, other): -factor for other, factor in mirrored(word).items()}
                add_multiple(relation, (row, word), Fraction(1))
                relation = {one: factor for one, factor in relation.items() if factor}
                if relation:
                    yield relation


@cache
def mirrored(word: Word) -> dict[Word, Fraction]:
    """Return the words whose combination has the weight of a word backwards in time."""
    total: dict[Word, Fraction] = {}
    for powers in product(*(range(len(letter) + 1) for letter in reversed(word))):
        factor = Fraction(1)
        for m, letter in zip(powers, reversed(word), strict=True):
            factor *= Fraction((-1) ** m, factorial(len(letter) - m))
        add_multiple(total, tuple(((),) * m for m in powers), factor)
    return total
