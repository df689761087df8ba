"""Refinement of splittings beyond double precision, with residuals in ball arithmetic."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from ...conditions import condition_trees, exact_weights, right_sides
from ...support.balls import exact_midpoint, to_ball, working_precision
from ...support.quads import DECIMAL_DIGITS, to_decimal
from ..solvers.rational import refine_rational
from ..solvers.singular import pseudo_inverse
from .splitting import Splitting

_BITS = 400
_GRID = 10**80
_BELOW = Fraction(1, 10**60)
_ZERO = Fraction(1, 10**40)
_MAX_ITERATIONS = 11
_GAP = 1e-10
"""Singular values below this fraction of the largest count as zero."""


@dataclass(frozen=True)
class Exact:
    """Weights whose sums are exact, the residual before rounding to 36 digits, and the rank."""

    weights: tuple[str | Fraction, ...]
    largest_residual: float
    rank: int


def refined(splitting: Splitting, x: NDArray[np.float64]) -> Exact:
    """Refine weights x, shape (size,), to more digits than are written."""
    # the pseudo-inverse is in orthonormal directions, the unknowns are entries themselves
    along, rank = pseudo_inverse(splitting.jacobian(x), _GAP)
    inverse = splitting.directions[splitting.free] @ along
    end = refine_rational(
        lambda free: _residuals(splitting, free),
        [Fraction(value) for value in x[splitting.free].tolist()],
        lambda residuals: inverse @ (splitting.scale * residuals),
        below=_BELOW,
        grid=_GRID,
        max_iterations=_MAX_ITERATIONS,
    )
    texts = [
        to_decimal(value if abs(value) > _ZERO else Fraction(0), DECIMAL_DIGITS) for value in end.x
    ]
    weights: list[str | Fraction] = list(splitting.full([Fraction(text) for text in texts]))
    for k, text in zip(splitting.free.tolist(), texts, strict=True):
        weights[k] = text
    return Exact(tuple(weights), float(end.largest_residual), rank)


def _residuals(splitting: Splitting, free: Sequence[Fraction]) -> list[Fraction]:
    """Return the residuals, not scaled, in the order of `Splitting.conditions`."""
    tree = splitting.layout.tree(splitting.full(free))
    claims = [(tree.result, splitting.order, Fraction(1))]
    if tree.embedded_result is not None:
        claims.append((tree.embedded_result, splitting.embedded_order, Fraction(1)))
    for stage, order in splitting.assumptions:
        at = tree.stage_points[stage]
        claims.append((at, order, sum(tree.flat_row(at), Fraction(0))))
    with working_precision(_BITS):
        residuals: list[Fraction] = []
        for end, order, c in claims:
            if order == 0:
                continue
            trees = condition_trees(order, independent=True)
            ended = replace(tree, result=end, embedded_result=None)
            for phi, side, index in zip(
                exact_weights(ended, order, trees, to_ball),
                right_sides(order, independent=True),
                trees,
                strict=True,
            ):
                value = phi - to_ball(side * c ** splitting.nodes(index))
                residuals.append(exact_midpoint(value))
        return residuals
