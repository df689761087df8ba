"""Compiled solver of order conditions: exact Jacobian J, steps of least norm, in double precision.

A step is ``-Jᵀ y`` with ``(J Jᵀ + λ) y = r``, and half its acceleration; see
``fortran/conditions/minimum_norm.f90``. With more unknowns than conditions, this system is smaller
than the normal equations of MINPACK's steps.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg import _core_r64
from cg.construction.conditions.core_calls import Trees, Vector, derivatives_bytes, described
from cg.construction.layouts.layout import Layout
from cg.construction.solvers.singular import finish
from cg.construction.solvers.system import ConditionSystem
from cg.support.capsules import provide_lapack
from cg.support.memory import reserved
from cg.support.parallel import stoppable
from cg.support.shared_numbers import MinimumNormStatus

_BRIEF = 10**8  # multiplications in about 0.1 seconds

provide_lapack()


@dataclass(frozen=True)
class MinimumNormFit:
    """Packed weights x, the sum f of squared residuals, and the steps and evaluations taken."""

    x: NDArray[np.float64]
    f: float
    iterations: int
    evaluations: int
    status: MinimumNormStatus


def fit_conditions(
    x0: Vector,
    system: ConditionSystem,
    *,
    movable: Sequence[int] | NDArray[np.intp] | None = None,
    ftol: float = 1e-27,
    damping: float = 1e-2,
    max_iterations: int = 1000,
    accurate: bool = False,
) -> MinimumNormFit:
    """Minimise the sum of squared residuals of the conditions from packed weights `x0`, shape (n,).

    Only the unknowns `movable` change, and what depends on them. The solver stops when the sum of
    squares is at most `ftol`.
    `damping` is the initial one, relative to the largest squared norm of a row of the Jacobian.
    With `accurate`, steps come from a QR factorisation instead of the normal equations, which lose
    singular values below 1e-8 of the largest; this takes up to three times as long.
    """
    x, indices = np.array(system.complete(x0)), system.moving(movable)
    if system.held is not None and system.held.dependent:
        end, f = finish(system, x, indices, ftol=ftol, damping=damping, iterations=max_iterations)
        done = MinimumNormStatus.SOLVED if f <= ftol else MinimumNormStatus.OUT_OF_ITERATIONS
        return MinimumNormFit(system.complete(end), f, max_iterations, max_iterations, done)
    trees, owner = system.conditions(independent=True)
    moving = (indices + 1).astype(np.intc)
    problem = (system.order, system.layout, x, trees, owner)
    most = max_iterations * trees.size**2 * moving.size  # for the Gram matrices
    x_end, f, iterations, evaluations, status = stoppable(
        lambda stop_flag: fit_minimum_norm(
            *problem, moving, ftol, damping, max_iterations, accurate, stop_flag
        ),
        brief=most <= _BRIEF,
    )
    return MinimumNormFit(
        x_end, float(f), int(iterations), int(evaluations), MinimumNormStatus(status)
    )


def fit_minimum_norm(
    order: int,
    layout: Layout,
    x: Vector,
    trees: Trees,
    owner: Trees,
    movable: Trees,
    *arguments: Any,
) -> tuple[Any, ...]:
    """Call the compiled solver; `movable`, intc (k,), are the unknowns that may move, from 1."""
    m, n, k = trees.size, layout.size, movable.size
    solver = 2 * m * (n + k) + 2 * m * m + (k + 33 * m) + 8 * (m + n + k)
    accurate = m * (2 * k + m)  # numbers of the QR factorisation, with a transposed copy
    needed = derivatives_bytes(order, layout, m) + 8 * (solver + accurate)
    with reserved(needed, described("the fit", order, layout)):
        results: tuple[Any, ...] = _core_r64.fit_minimum_norm(
            order, layout.code, x, trees, owner, movable, *arguments
        )
    return results
