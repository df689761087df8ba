"""Refinement of split rows beyond double precision, with residuals in ball arithmetic.

Newton's method in fractions (`refine_rational`) with the midpoints of balls as residuals: trees of
order eight have too many words for exact fractions, whose lengths grow with the order.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from cg.construction.conditions.word_weights import Quantity, Weights
from cg.construction.conditions.words import condition_words, nodes, reciprocal_density
from cg.construction.lifting.split_rows import SplitRows
from cg.construction.solvers.polish import refine_rational
from cg.construction.solvers.singular import pseudo_inverse
from cg.support.balls import exact_midpoint, to_ball, working_precision
from cg.support.quads import DECIMAL_DIGITS, to_decimal

_BITS = 400
_GRID = 10**80
_BELOW = Fraction(1, 10**60)
_CLOSE, _MAX_DENOMINATOR = Fraction(1, 10**40), 10**5  # limits for rational numbers
_GAP = 1e-10
"""Singular values below this fraction of the largest count as zero."""


@dataclass(frozen=True)
class Exact:
    """Weights whose sums are exact, the residual before rounding to 36 digits, and the rank."""

    weights: tuple[str | Fraction, ...]
    largest_residual: float
    rank: int


def refined(split: SplitRows, x: NDArray[np.float64]) -> Exact:
    """Refine weights x, shape (size,), to more digits than are written."""
    # the pseudo-inverse is in orthonormal directions, the unknowns are entries themselves
    along, rank = pseudo_inverse(split.jacobian(x), _GAP)
    inverse = split.directions[split.movable] @ along * split.scale
    end = refine_rational(
        lambda movable: _residuals(split, movable),
        [Fraction(value) for value in x[split.movable].tolist()],
        inverse,
        below=_BELOW,
        grid=_GRID,
    )
    texts = list(map(_text, end.x))
    weights: list[str | Fraction] = list(split.full([Fraction(text) for text in texts]))
    for k, text in zip(split.movable.tolist(), texts, strict=True):
        weights[k] = text
    return Exact(tuple(weights), float(end.largest_residual), rank)


def _text(value: Fraction) -> str:
    """Return a value as a decimal, or as the rational number that it is to all digits."""
    simple = value.limit_denominator(_MAX_DENOMINATOR)
    return str(simple) if abs(value - simple) <= _CLOSE else to_decimal(value, DECIMAL_DIGITS)


def _residuals(split: SplitRows, movable: Sequence[Fraction]) -> list[Fraction]:
    """Return the residuals, not scaled, in the order of `SplitRows.conditions`."""
    layout, x = split.layout, split.full(movable)
    claims = [(layout.stages, split.order, Fraction(1))]
    if split.embedded_order:
        claims.append((layout.stages + 1, split.embedded_order, Fraction(1)))
    for stage, order in split.assumptions:
        claims.append((stage, order, sum((x[k] for k in layout.row(stage)), Fraction(0))))
    quantities, sides = [], []
    for row, order, c in claims:
        for word in condition_words(order):
            quantities.append(Quantity(row, word))
            sides.append(reciprocal_density(word) * c ** nodes(word))
    with working_precision(_BITS):
        weights = Weights(layout, quantities).evaluate(list(map(to_ball, x)))
        return [
            exact_midpoint(phi - to_ball(side)) for phi, side in zip(weights, sides, strict=True)
        ]
