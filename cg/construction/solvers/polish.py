"""Refinement of zeros beyond binary128, in rational arithmetic.

A step of Newton's method subtracts the product of J⁺ and the residuals r(x), which are fractions.
The pseudo-inverse J⁺ is that of the double Jacobian and stays fixed, so that no linear algebra in
fractions is needed; each correction gains about ten digits. `cg.construction.solvers.refine`
computes r in real(16), whose rounding errors exceed a unit in the last digit that is written.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cg.construction import conditions
from cg.construction.solvers.singular import pseudo_inverse
from cg.construction.solvers.system import ConditionSystem, Structure
from cg.support.arrays import check_finite, real_array

_ROUNDING = Fraction(1, 10**33)  # largest weight that counts as zero after real(16)
_BELOW = Fraction(1, 10**44)
_GRID = 10**60
_RANK_TOLERANCE = 1e-10  # part of the largest singular value; smaller ones count as zero
_MAX_ITERATIONS = 20


@dataclass(frozen=True)
class RationalZero:
    """The best point of a refinement, its residuals, and the number of useful corrections."""

    x: tuple[Fraction, ...]
    residuals: tuple[Fraction, ...]
    iterations: int

    @property
    def largest_residual(self) -> Fraction:
        """Magnitude of the largest residual."""
        return max(map(abs, self.residuals), default=Fraction(0))


def refine_rational(
    residuals: Callable[[Sequence[Fraction]], Sequence[Fraction]],
    x: Sequence[Fraction],
    inverse: NDArray[np.float64],
    *,
    below: Fraction = _BELOW,
    grid: int = _GRID,
) -> RationalZero:
    """Correct a point until its residuals are at most `below` or stop getting smaller.

    `inverse` is J⁺. Corrections are rounded to multiples of ``1/grid``, so that numerators and
    denominators stay short.
    """
    best = RationalZero(tuple(x), tuple(residuals(x)), 0)
    largest = best.largest_residual
    while largest > below and best.iterations < _MAX_ITERATIONS:
        scaled = np.array([float(residual / largest) for residual in best.residuals])
        trial = tuple(
            entry - Fraction(round(Fraction(move) * largest * grid), grid)
            for entry, move in zip(best.x, (inverse @ scaled).tolist(), strict=True)
        )
        corrected = RationalZero(trial, tuple(residuals(trial)), best.iterations + 1)
        if corrected.largest_residual >= largest:
            break
        best, largest = corrected, corrected.largest_residual
    return best


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

    start_steps = [Fraction()] * span.shape[1]
    end = refine_rational(lambda steps: _residuals(moved(steps), system), start_steps, inverse)
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
    span = real_array(directions, "directions")
    if span.ndim != 2 or span.shape[0] != size or span.shape[1] == 0:
        raise ValueError(
            f"directions must have shape ({size}, k) with k at least 1, got {span.shape}"
        )
    check_finite(span, "directions")
    return span
