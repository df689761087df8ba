"""Refinement of zeros of the order conditions beyond binary128, in rational arithmetic.

Newton's method ``x - span J⁺ r(x)`` with exact residuals r, fractions, and the pseudo-inverse J⁺ of
the double Jacobian along the columns of `span`, computed once. `cg.construction.solvers.refine`
computes r in real(16), whose rounding errors exceed a unit in the last digit that is written.
"""

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cg import conditions
from cg.construction.solvers.rational import RationalZero, refine_rational
from cg.construction.solvers.singular import pseudo_inverse
from cg.construction.solvers.system import ConditionSystem, Structure

_ROUNDING = Fraction(1, 10**33)  # largest weight that counts as zero after real(16)
_BELOW = Fraction(1, 10**44)
_GRID = 10**60  # corrections are multiples of 1/_GRID
_RANK_TOLERANCE = 1e-10  # of the largest singular value; smaller ones count as zero
_MAX_ITERATIONS = 20


def polish(
    x: Sequence[Fraction], system: ConditionSystem, *, directions: ArrayLike | None = None
) -> RationalZero:
    """Correct packed weights until the exact residuals of the independent conditions are small.

    Corrections are combinations of the columns of `directions`, (n, k); by default, all movable
    entries may change. The structure of the system isn't used.
    """
    start = tuple(system.complete(list(map(Fraction, x))))
    if len(start) != system.size:
        raise ValueError(f"x must have {system.size} entries, got {len(start)}")
    system = replace(system, structure=Structure.GENERAL)
    jac = system.jacobian(np.array([float(entry) for entry in start]))
    span = _directions(
        np.eye(len(start))[:, system.movable] if directions is None else directions, len(start)
    )
    inverse, _ = pseudo_inverse(jac @ span, _RANK_TOLERANCE)

    def moved(steps: Sequence[Fraction]) -> tuple[Fraction, ...]:
        """Return the point after steps along the directions."""
        moved = [
            entry + sum((Fraction(d) * m for d, m in zip(row, steps, strict=True) if d), Fraction())
            for entry, row in zip(start, span.tolist(), strict=True)
        ]
        return tuple(system.complete(moved))

    end = refine_rational(
        lambda steps: _residuals(moved(steps), system),
        [Fraction()] * span.shape[1],
        lambda residuals: inverse @ residuals,
        below=_BELOW,
        grid=_GRID,
        max_iterations=_MAX_ITERATIONS,
    )
    return replace(end, x=moved(end.x))


def polish_zeros(
    x: Sequence[Fraction], system: ConditionSystem, movable: Sequence[int] | NDArray[np.intp]
) -> RationalZero:
    """Polish the entries `movable`, and set those to zero that are zero up to rounding in real(16).

    If the conditions can't be solved with these zeros, the weights keep their values.
    """
    unit = np.eye(system.size)
    polished = polish(x, system, directions=unit[:, movable])
    tiny = {k for k in movable if 0 < abs(polished.x[k]) <= _ROUNDING}
    rest = [k for k in movable if k not in tiny]
    if not tiny or not rest:
        return polished
    start = [Fraction() if k in tiny else entry for k, entry in enumerate(polished.x)]
    sparse = polish(start, system, directions=unit[:, rest])
    return sparse if sparse.largest_residual <= max(polished.largest_residual, _BELOW) else polished


def _residuals(x: Sequence[Fraction], system: ConditionSystem) -> tuple[Fraction, ...]:
    tree = system.layout.tree(x)
    residuals = conditions.residuals(tree, system.order, independent=True, arithmetic="exact")
    if system.embedded:
        residuals += conditions.residuals(
            tree, system.order - 1, independent=True, embedded=True, arithmetic="exact"
        )
    return residuals


def _directions(directions: ArrayLike, size: int) -> NDArray[np.float64]:
    span = np.array(directions, dtype=np.float64)
    if span.ndim != 2 or span.shape[0] != size or span.shape[1] == 0:
        raise ValueError(
            f"directions must have shape ({size}, k) with k at least 1, got {span.shape}"
        )
    if not np.isfinite(span).all():
        raise ValueError(f"directions must be finite, got {span}")
    return span
