"""Zeros of the order conditions beyond binary128: residuals in rational arithmetic.

The residuals that `cg.construction.solvers.refine` sees carry the rounding of real(16), so its last
digits are off by more than the places in which they are written. Here the residual is
exact and each correction by the pseudo-inverse of the double Jacobian gains some ten
digits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...conditions import exact_residuals_of
from .rational import refine_rational
from .singular import pseudo_inverse
from .system import ConditionSystem, Structure

__all__ = ["Polished", "polish", "polish_zeros"]

_NOTHING = Fraction(1, 10**33)  # real(16) leaves this much at most of a weight that is zero
_BELOW = Fraction(1, 10**44)
_GRID = 10**60  # iterates are moved by multiples of 1/_GRID, so that they don't grow


@dataclass(frozen=True)
class Polished:
    """A polished point.

    Attributes
    ----------
    x : tuple of Fraction, length n
        Packed weights.
    largest_residual : Fraction
        Over the independent conditions, exact.
    rank : int
        Singular values of the Jacobian above the threshold.
    iterations : int
        Corrections that were applied.
    """

    x: tuple[Fraction, ...]
    largest_residual: Fraction
    rank: int
    iterations: int


def polish(
    x: Sequence[Fraction],
    system: ConditionSystem,
    *,
    directions: ArrayLike | None = None,
    rcond: float = 1e-10,
    below: Fraction = _BELOW,
    max_iterations: int = 20,
) -> Polished:
    """Correct packed weights until its exact residuals are small.

    Parameters
    ----------
    x : sequence of n rationals
        Close to a zero.
    system : ConditionSystem
        Its structure is left aside: the order conditions alone decide.
    directions : array_like, shape (n, k), optional
        Corrections are combinations of its columns: columns of the identity leave the other
        entries alone, and any linear relation between entries can be kept up. By default
        all entries may change.
    rcond : float, optional
        Singular values below this fraction of the largest count as zero.
    below : Fraction, optional
        Stop when no residual exceeds this.
    max_iterations : int, optional

    Returns
    -------
    Polished
        The best point seen.

    Raises
    ------
    ValueError
        If x or `directions` don't fit the number of unknowns.
    """
    start = tuple(map(Fraction, x))
    if len(start) != system.size:
        raise ValueError(f"x must have {system.size} entries, got {len(start)}")
    system = replace(system, structure=Structure.GENERAL)
    jac = system.jacobian(np.array([float(entry) for entry in start]))
    span = _directions(
        np.eye(len(start))[:, system.free] if directions is None else directions, len(start)
    )
    inverse, rank = pseudo_inverse(jac @ span, rcond)

    def moved(steps: Sequence[Fraction]) -> tuple[Fraction, ...]:
        """Return the point after steps along the directions."""
        return tuple(
            entry + sum((Fraction(d) * m for d, m in zip(row, steps, strict=True) if d), Fraction())
            for entry, row in zip(start, span.tolist(), strict=True)
        )

    end = refine_rational(
        lambda steps: _residuals(moved(steps), system),
        [Fraction()] * span.shape[1],
        lambda residuals: inverse @ residuals,
        below=below,
        grid=_GRID,
        max_iterations=max_iterations,
    )
    return Polished(moved(end.x), end.largest_residual, rank, end.iterations)


def polish_zeros(
    x: Sequence[Fraction], system: ConditionSystem, free: Sequence[int] | NDArray[np.intp]
) -> Polished:
    """Polish, with weights at zero that are zero but for the rounding of real(16).

    They stay as they are where the conditions can't be solved without them.

    Parameters
    ----------
    x, system
        As `polish` takes them.
    free : sequence of int
        The entries that may change.

    Returns
    -------
    Polished
    """
    unit = np.eye(system.size)
    found = polish(x, system, directions=unit[:, free])
    nothing = {k for k in free if 0 < abs(found.x[k]) <= _NOTHING}
    rest = [k for k in free if k not in nothing]
    if not nothing or not rest:
        return found
    without = [Fraction() if k in nothing else entry for k, entry in enumerate(found.x)]
    again = polish(without, system, directions=unit[:, rest])
    return again if again.largest_residual <= max(found.largest_residual, _BELOW) else found


def _residuals(x: Sequence[Fraction], system: ConditionSystem) -> tuple[Fraction, ...]:
    tree = system.layout.tree(x)
    residuals = exact_residuals_of(tree, system.order, independent=True)
    if system.embedded:
        residuals += exact_residuals_of(tree, system.order - 1, independent=True, embedded=True)
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
