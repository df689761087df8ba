"""Refinement of a zero of the order conditions to the accuracy of binary128.

Newton's method ``x - J⁺ r(x)`` with residuals r in real(16) and the pseudo-inverse J⁺ of the double
Jacobian, computed once: each correction gains some ten digits, and no linear algebra in real(16) is
needed. J⁺ leaves small singular values out, so that conditions may depend on each other as long as
they are consistent.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cg.construction.solvers.singular import pseudo_inverse
from cg.construction.solvers.system import ConditionSystem
from cg.support import quads
from cg.support.parallel import raise_if_stopped

_RANK_TOLERANCE = 1e-10  # part of the largest singular value; smaller ones count as zero
_MAX_ITERATIONS = 40


@dataclass(frozen=True)
class Refined:
    """Packed weights (n, 16), their largest residual, the rank of the Jacobian, and corrections."""

    x: quads.Quads
    largest_residual: float
    rank: int
    iterations: int


def refine(
    x: quads.Quads,
    system: ConditionSystem,
    *,
    movable: Sequence[int] | NDArray[np.intp] | None = None,
) -> Refined:
    """Correct packed weights in binary128, shape (n, 16), until residuals stop getting smaller.

    Only the entries `movable` change. The simplifying assumptions of the system hold afterwards.
    """
    core = quads.core("refinement")
    moving = system.moving(movable)
    jac = system.jacobian(quads.to_float(x), independent=False)[:, moving]
    rank, inverse = 0, np.zeros(jac.T.shape)
    if moving.size and np.isfinite(jac).all():  # otherwise no correction is possible
        inverse, rank = pseudo_inverse(jac, _RANK_TOLERANCE)

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
        x = np.ascontiguousarray(core.subtract_double(x.T, step).T)
    return Refined(best, best_size, rank, iterations)
