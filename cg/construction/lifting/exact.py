"""Splittings beyond double precision: residuals in ball arithmetic, weights with all digits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from ...conditions import condition_trees, exact_weights, right_sides
from ...support.balls import to_ball, working_precision
from ...support.quads import DECIMAL_DIGITS, to_decimal
from .splitting import Splitting

__all__ = ["Exact", "refined"]

_BITS = 400
_GRID = 10**80
_BELOW = 1e-60
_ZERO = Fraction(1, 10**40)
_MAX_ITERATIONS = 12
_GAP = 1e-10
"""Singular values below this fraction of the largest count as zero."""


@dataclass(frozen=True)
class Exact:
    """A splitting with exact sums.

    Attributes
    ----------
    weights : tuple of str and Fraction
        The unknowns with 36 digits; remainders are exact.
    largest_residual : float
        Of the conditions, before the unknowns were rounded.
    rank : int
        Singular values of the derivatives that count.
    """

    weights: tuple[str | Fraction, ...]
    largest_residual: float
    rank: int


def refined(splitting: Splitting, x: NDArray[np.float64]) -> Exact:
    """Correct weights until the conditions hold to far more digits than are written.

    Parameters
    ----------
    splitting : Splitting
    x : ndarray, shape (size,)
        Next to a solution.

    Returns
    -------
    Exact
    """
    jacobian = splitting.jacobian(x)
    left, values, right = linalg.svd(jacobian, full_matrices=False)
    rank = int(np.sum(values > _GAP * values.max(initial=0.0)))
    inverse = (right[:rank].T / values[:rank]) @ left[:, :rank].T
    # from orthonormal directions to the unknowns, which are entries themselves
    inverse = splitting.directions[splitting.free] @ inverse
    free = [Fraction(value) for value in x[splitting.free].tolist()]
    best, size = free, np.inf
    for _ in range(_MAX_ITERATIONS):
        residuals = _residuals(splitting, free)
        largest = max(map(abs, residuals), default=Fraction(0))
        if not largest < size:
            break
        best, size = free, float(largest)
        if size < _BELOW:
            break
        scaled = np.array([float(r / largest) for r in residuals])
        moves = inverse @ (splitting.scale * scaled)
        free = [
            value - Fraction(round(Fraction(move) * largest * _GRID), _GRID)
            for value, move in zip(free, moves.tolist(), strict=True)
        ]
    texts = [
        to_decimal(value if abs(value) > _ZERO else Fraction(0), DECIMAL_DIGITS) for value in best
    ]
    weights: list[str | Fraction] = list(splitting.full([Fraction(text) for text in texts]))
    for k, text in zip(splitting.free.tolist(), texts, strict=True):
        weights[k] = text
    return Exact(tuple(weights), size, rank)


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
        found: list[Fraction] = []
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
                mantissa, exponent = value.mid().man_exp()
                found.append(int(mantissa) * Fraction(2) ** int(exponent))
        return found
