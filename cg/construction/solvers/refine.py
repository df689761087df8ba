"""Refinement of zeros of the order conditions, to the accuracy of binary128 and beyond.

Newton's method ``x - J⁺ r(x)`` with the pseudo-inverse J⁺ of the double Jacobian, computed once:
each correction gains some ten digits, and no linear algebra beyond double is needed. J⁺ leaves
small singular values out, so that conditions may depend on each other as long as they are
consistent. `refine` computes the residuals r in real(16), whose rounding errors exceed a unit in
the last digit that is written; `polish` computes them as fractions.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cg.construction.conditions.exact import EquationSystem, conditions_of
from cg.construction.solvers.minimum_norm import decompose
from cg.construction.solvers.system import ConditionSystem
from cg.support import quads
from cg.support.parallel import raise_if_stopped
from cg.support.quads import exact_midpoint, to_ball, working_precision

_RANK_TOLERANCE = 1e-10  # part of the largest singular value; smaller ones count as zero
_MAX_ITERATIONS = 40  # in real(16); it takes a few

_MAX_ZERO = Fraction(1, 10**33)  # largest weight that counts as zero after real(16)
_RESIDUAL_GOAL = Fraction(1, 10**44)  # for the largest exact residual
_GRID = 10**60  # corrections are multiples of 1 / _GRID, far below the goal
_BITS = 400  # precision of exact residuals, beyond the digits of both
_MAX_CORRECTIONS = 20  # by exact residuals, some ten digits each


@dataclass(frozen=True)
class Refinement:
    """Packed weights (n, 16), their largest residual, and the number of corrections."""

    x: quads.Quads
    max_residual: float
    iterations: int


def refine(
    x: quads.Quads,
    system: ConditionSystem,
    *,
    movable: Sequence[int] | NDArray[np.intp] | None = None,
) -> Refinement:
    """Correct packed weights in binary128, shape (n, 16), until residuals stop getting smaller.

    Only the entries `movable` change. The simplifying assumptions of the system hold afterwards.
    """
    quads.core("refinement")  # an error if it is missing
    moving = system.moving(movable)
    jac = system.jacobian(quads.to_float(x), independent=False)[:, moving]
    inverse = np.zeros(jac.T.shape)
    if moving.size and np.isfinite(jac).all():  # otherwise no correction is possible
        inverse, _ = decompose(jac, _RANK_TOLERANCE)

    best, best_size, iterations = x, np.inf, 0
    for iterations in range(_MAX_ITERATIONS + 1):  # noqa: B007
        raise_if_stopped()
        if system.held is not None:
            x = quads.encode(system.held.complete(quads.decode(x)))
        residual = system.residual_quad(x)
        largest = float(np.abs(residual).max())
        # rounding errors remain: stop at the first correction that doesn't reduce them
        if not largest < best_size:
            break
        best, best_size = x, largest
        step = np.zeros(system.size)
        step[moving] = inverse @ residual
        steps = map(Fraction, step.tolist())
        x = quads.encode(entry - move for entry, move in zip(quads.decode(x), steps, strict=True))
    return Refinement(best, best_size, iterations)


class RationalZero(NamedTuple):
    """The best point of a refinement, and the magnitude of its largest residual."""

    x: tuple[Fraction, ...]
    max_residual: Fraction


def refine_rational(
    residuals: Callable[[Sequence[Fraction]], Sequence[Fraction]], x: Sequence[Fraction],
    inverse: NDArray[np.float64], *, below: Fraction = _RESIDUAL_GOAL, grid: int = _GRID,
) -> RationalZero:  # fmt: skip
    """Correct a point until its residuals are at most `below` or stop getting smaller.

    `inverse` is J⁺. Corrections are rounded to multiples of ``1/grid``, so that numerators and
    denominators stay short.
    """
    best, values = tuple(x), residuals(x)
    largest = max(map(abs, values), default=Fraction(0))
    for _ in range(_MAX_CORRECTIONS):
        if largest <= below:
            break
        scaled = np.array([float(residual / largest) for residual in values])
        trial = tuple(
            entry - Fraction(round(Fraction(move) * largest * grid), grid)
            for entry, move in zip(best, (inverse @ scaled).tolist(), strict=True)
        )
        trial_values = residuals(trial)
        if max(map(abs, trial_values)) >= largest:
            break
        best, values, largest = trial, trial_values, max(map(abs, trial_values))
    return RationalZero(best, largest)


def polish(
    x: Sequence[Fraction],
    system: ConditionSystem,
    *,
    movable: Sequence[int] | NDArray[np.intp] | None = None,
) -> RationalZero:
    """Correct packed weights until the exact residuals of the independent conditions are small.

    Only the entries `movable` change. The structure of the system isn't used.
    """
    start = list(system.complete(list(map(Fraction, x))))
    moving = system.moving(movable).tolist()
    equations = EquationSystem(system.layout, tuple(conditions_of(system.orders)))
    jac = system.jacobian(np.array(start, dtype=np.float64))[: len(equations.conditions), moving]
    inverse, _ = decompose(jac, _RANK_TOLERANCE)

    def whole(entries: Sequence[Fraction]) -> tuple[Fraction, ...]:
        changed = dict(zip(moving, entries, strict=True))
        return tuple(system.complete([changed.get(k, entry) for k, entry in enumerate(start)]))

    def residuals(entries: Sequence[Fraction]) -> list[Fraction]:
        return list(map(exact_midpoint, equations.residuals(list(map(to_ball, whole(entries))))))

    with working_precision(_BITS):
        end = refine_rational(residuals, [start[k] for k in moving], inverse)
    return RationalZero(whole(end.x), end.max_residual)


def polish_zeros(
    x: Sequence[Fraction], system: ConditionSystem, movable: Sequence[int] | NDArray[np.intp]
) -> RationalZero:
    """Polish the entries `movable`, and set those to zero that are zero up to rounding in real(16).

    If the conditions can't be solved with these zeros, the weights keep their values.
    """
    polished = polish(x, system, movable=movable)
    tiny = {k for k in movable if 0 < abs(polished.x[k]) <= _MAX_ZERO}
    rest = [k for k in movable if k not in tiny]
    if not tiny or not rest:
        return polished
    start = [Fraction() if k in tiny else entry for k, entry in enumerate(polished.x)]
    sparse = polish(start, system, movable=rest)
    return sparse if sparse.max_residual <= max(polished.max_residual, _RESIDUAL_GOAL) else polished
