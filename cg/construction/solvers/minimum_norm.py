"""Steps towards solutions of order conditions with an exact Jacobian J, in double precision.

The compiled solver takes steps of least norm. A step is ``-Jᵀ y`` with ``(J Jᵀ + λ) y = r``, and
half its acceleration; see ``fortran/conditions/minimum_norm.f90``. With more unknowns than
conditions, this system is smaller than the normal equations of MINPACK's steps.

Order conditions depend on each other, and trees of points often have fewer unknowns than there are
conditions: nonzero singular values of J go down to 1e-9 of the largest; smaller ones are rounding
errors. Normal equations square the singular values and stall at sums of squares between 1e-15 and
1e-21. Close to a solution, steps are computed from the singular value decomposition J = U S Vᵀ: a
damped step v solves ``(Jᵀ J + λ) v = -Jᵀ r``, the acceleration a the same system with the second
derivative of the residual along v in place of r; the accelerated step is ``v + a/2`` [1]_. A step
of least norm is ``-J⁺ r`` with the pseudo-inverse J⁺ without small singular values; the last
columns of V are the kernel, along which solutions continue [2]_.

References
----------
.. [1] M. K. Transtrum, J. P. Sethna, "Improvements to the Levenberg-Marquardt algorithm for
   nonlinear least-squares minimization", arXiv:1201.5885 (2012).
.. [2] G. H. Golub, C. F. Van Loan, "Matrix Computations", section 5.5.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from cg import _core_r64
from cg.construction.conditions.core_calls import Vector, derivatives_bytes, described
from cg.construction.solvers.system import ConditionSystem
from cg.support.capsules import provide_lapack
from cg.support.memory import check_memory
from cg.support.parallel import raise_if_stopped, stoppable
from cg.support.shared_numbers import MinimumNormStatus

provide_lapack()  # compiled solvers call it

_PROBE = 0.1  # part of a step for the finite difference of the second derivative along it
_MAX_BEND = 0.75  # largest ratio |a| / |v| at which the acceleration is trusted

Indices = NDArray[np.intp]

_RANK_TOLERANCE = 1e-11  # part of the largest singular value; rounding leaves 1e-15
_FAR = 1e-4  # sum of squares above which steps with an old inverse aren't tried

_FTOL = 1e-27  # sum of squares to reach
_SLOW, _RENEWALS = 0.03, 4  # in `retract`: ratio of f after a step, evaluations of the Jacobian
_MAX_ITERATIONS = 60
_FIRST_DAMPING, _MIN_DAMPING, _MAX_DAMPING = 1e-14, 1e-30, 1e-2  # relative
_PATIENCE, _MIN_GAIN = 60, 0.3  # stop if that number of steps gains less than this fraction

_BRIEF = 10**8  # multiplications in about 0.1 seconds


@dataclass(frozen=True)
class MinimumNormFit:
    """Packed weights x, the sum f of squared residuals, and the evaluations of residuals."""

    x: NDArray[np.float64]
    f: float
    evaluations: int
    status: MinimumNormStatus


def decompose(jac: Vector, rcond: float = _RANK_TOLERANCE) -> tuple[Vector, Vector]:
    """Return the pseudo-inverse and the kernel of a Jacobian, shapes (n, m) and (n, n - rank).

    Singular values count if they are above `rcond` times the largest one.
    """
    if jac.shape[0] > jac.shape[1]:  # faster than the decomposition of the tall matrix
        basis, square = linalg.qr(jac, mode="economic", check_finite=False)
        left, values, right = linalg.svd(square, check_finite=False)
        left = basis @ left
    else:
        left, values, right = linalg.svd(jac, check_finite=False)
    rank = int(np.sum(values > rcond * values.max(initial=0.0)))
    return (right[:rank].T / values[:rank]) @ left[:, :rank].T, right[rank:].T


def retract(system: ConditionSystem, x: Vector, movable: Indices, inverse: Vector) -> Vector | None:
    """Return to the solution set by steps of least norm; None if f stays above 1e-27.

    Only the entries `movable` of x change. `inverse` is the pseudo-inverse of their columns of the
    Jacobian at a point close by; it is used until steps gain little, which saves most of the work.
    """
    before, renewals = np.inf, 0
    while True:
        residual = system.residual(x)
        f = float(residual @ residual)
        if f < _FTOL:
            return x
        if not f < _FAR:
            return None
        if f > _SLOW * before:
            if renewals == _RENEWALS:
                return None
            inverse, _ = decompose(system.jacobian(x)[:, movable])
            renewals += 1
        before, x = f, x.copy()
        x[movable] -= inverse @ residual


def descend(
    system: ConditionSystem, x: Vector, movable: Indices, *, ftol: float = _FTOL,
    damping: float = _FIRST_DAMPING, iterations: int = _MAX_ITERATIONS,
) -> MinimumNormFit:  # fmt: skip
    """Return where Levenberg–Marquardt steps of the entries `movable` lead."""
    residual = system.residual(x)
    f = float(residual @ residual)
    largest, history = max(_MAX_DAMPING, 1e4 * damping), [f]
    improved, evaluations = True, 1

    for _ in range(iterations):
        raise_if_stopped()
        if not ftol < f < np.inf or damping > largest:
            break
        if improved:
            jac = system.jacobian(x)[:, movable]
            svd = linalg.svd(jac, full_matrices=False, check_finite=False)
        v = _damped_step(svd, damping, residual)
        slope = (system.residual(_moved(x, movable, _PROBE * v)) - residual) / _PROBE
        a = _damped_step(svd, damping, 2 / _PROBE * (slope - jac @ v))
        bent = np.linalg.norm(a) > _MAX_BEND * np.linalg.norm(v)
        trials = [_moved(x, movable, step) for step in ((v,) if bent else (v + a / 2, v))]
        best, improved, evaluations = x, False, evaluations + 1 + len(trials)
        for trial in trials:
            trial_residual = system.residual(trial)
            trial_f = float(trial_residual @ trial_residual)
            if trial_f < f:
                best, residual, f, improved = trial, trial_residual, trial_f, True
        x = best
        if not improved:
            damping = 4 * max(damping, 1e-20)
            continue
        damping = max(damping / 5, _MIN_DAMPING)
        history.append(f)
        if len(history) > _PATIENCE and history[-_PATIENCE] < (1 + _MIN_GAIN) * f:
            break
    status = MinimumNormStatus.SOLVED if f <= ftol else MinimumNormStatus.OUT_OF_ITERATIONS
    if not f <= ftol and (damping > largest or not f < np.inf):
        status = MinimumNormStatus.NO_DESCENT if f < np.inf else MinimumNormStatus.NOT_FINITE
    return MinimumNormFit(x, f, evaluations, status)


def _moved(x: Vector, movable: Indices, step: Vector) -> Vector:
    moved = x.copy()
    moved[movable] += step
    return moved


def _damped_step(svd: tuple[Vector, Vector, Vector], damping: float, right: Vector) -> Vector:
    """Return the solution v of ``(Jᵀ J + λ) v = -Jᵀ right``, with ``λ = damping |J|²``."""
    left, values, axes = svd
    factors = values / (values**2 + damping * values[0] ** 2)
    return np.asarray(-axes.T @ (factors * (left.T @ right)))


def fit_conditions(
    x0: Vector, system: ConditionSystem, *, movable: Sequence[int] | NDArray[np.intp] | None = None,
    ftol: float = _FTOL, damping: float = 1e-2, max_iterations: int = 1000, accurate: bool = False,
) -> MinimumNormFit:  # fmt: skip
    """Minimise the sum of squared residuals of the conditions from packed weights `x0`, shape (n,).

    Only the unknowns `movable` change, and what depends on them. The solver stops when the sum of
    squares is at most `ftol`.
    `damping` is the initial one, relative to the largest squared norm of a row of the Jacobian.
    With `accurate`, steps come from singular values instead of the normal equations, which lose
    those below 1e-8 of the largest; this takes up to three times as long.
    """
    x, indices = np.array(system.complete(x0)), system.moving(movable)
    if accurate or (system.held is not None and system.held.dependent):
        fit = descend(system, x, indices, ftol=ftol, damping=damping, iterations=max_iterations)
        return replace(fit, x=system.complete(fit.x))
    trees, owner = system.conditions(independent=True)
    layout, m, n, k = system.layout, trees.size, system.size, indices.size
    moving = (indices + 1).astype(np.intc)
    problem = (system.order, layout.code, x, trees, owner, moving, ftol, damping, max_iterations)
    numbers = 2 * m * (n + k) + 2 * m * m + (k + 33 * m) + 8 * (m + n + k)
    needed = derivatives_bytes(system.order, layout, m) + 8 * numbers
    check_memory(needed, described("the fit", system.order, layout))
    x_end, f, evaluations, status = stoppable(
        lambda stop_flag: _core_r64.fit_minimum_norm(*problem, stop_flag),
        brief=max_iterations * m**2 * k <= _BRIEF,  # for the Gram matrices
    )
    return MinimumNormFit(x_end, float(f), int(evaluations), MinimumNormStatus(status))
