"""Steps close to solutions, from the singular value decomposition of the Jacobian.

A step is ``-J⁺ r``, of least norm, with the pseudo-inverse J⁺ of the Jacobian J = U S Vᵀ without
its small singular values; the last columns of V are the `kernel`, along which solutions continue
(Golub and Van Loan, Matrix Computations, section 5.5).

Order conditions depend on each other, and trees of points often have fewer unknowns than there are
conditions. Nonzero singular values go down to 1e-9 of the largest; smaller ones are rounding
errors. Normal equations square the singular values and stall at sums of squares between 1e-15 and
1e-21, so they aren't used here.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from cg.construction.solvers.damped import PROBE, DampedSteps, is_straight
from cg.construction.solvers.system import ConditionSystem

Vector = NDArray[np.float64]
Indices = NDArray[np.intp]

_RANK_TOLERANCE = 1e-11  # part of the largest singular value; rounding leaves 1e-15
_FAR = 1e-4  # sum of squares above which Newton steps aren't tried

_FTOL = 1e-27  # sum of squares to reach
_RENEWALS = 4  # evaluations of the Jacobian in `retract`
_MAX_ITERATIONS = 60
_FIRST_DAMPING, _MIN_DAMPING, _MAX_DAMPING = 1e-14, 1e-30, 1e-2  # relative
_PATIENCE, _MIN_GAIN = 15, 0.05  # stop if that number of steps gains less than this fraction


@dataclass(frozen=True)
class Decomposition:
    """Pseudo-inverse and kernel of a Jacobian of shape (m, n)."""

    inverse: Vector  # shape (n, m), without singular values below 1e-11 of the largest
    kernel: Vector  # shape (n, n - rank), an orthonormal basis


def pseudo_inverse(jac: Vector, rcond: float) -> tuple[Vector, int]:
    """Return the pseudo-inverse and the rank by singular values above `rcond` times the largest."""
    left, values, right = linalg.svd(jac, full_matrices=False)
    rank = int(np.sum(values > rcond * values.max(initial=0.0)))
    return (right[:rank].T / values[:rank]) @ left[:, :rank].T, rank


def decompose(jac: Vector) -> Decomposition:
    """Return the pseudo-inverse and the kernel of a Jacobian, shape (m, n)."""
    if jac.shape[0] > jac.shape[1]:  # faster than the decomposition of the tall matrix
        basis, square = linalg.qr(jac, mode="economic", check_finite=False)
        left, values, right = linalg.svd(square, check_finite=False)
        left = basis @ left
    else:
        left, values, right = linalg.svd(jac, check_finite=False)
    rank = int(np.sum(values > _RANK_TOLERANCE * values[0])) if values.size else 0
    inverse = (right[:rank].T / values[:rank]) @ left[:, :rank].T
    return Decomposition(inverse, right[rank:].T)


def retract(
    system: ConditionSystem, x: Vector, movable: Indices, near: Decomposition
) -> Vector | None:
    """Return to the solution set by Newton steps of least norm; None if f stays above 1e-27.

    Only the entries `movable` of x change. `near` decomposes their columns of the Jacobian at a
    point close by; it is used until steps gain little, which saves most of the work.
    """
    residual = system.residual(x)
    f = float(residual @ residual)
    for renewal in range(_RENEWALS + 1):
        slow = False
        while not slow and f > _FTOL * 1e-3:
            if not f < _FAR:
                return None
            trial = x.copy()
            trial[movable] -= near.inverse @ residual
            trial_residual = system.residual(trial)
            trial_f = float(trial_residual @ trial_residual)
            if not trial_f < f:
                break
            slow = trial_f > 0.03 * f
            x, residual, f = trial, trial_residual, trial_f
        if f < _FTOL:
            return x
        if renewal < _RENEWALS:
            jac = system.jacobian(x)[:, movable]
            if not np.isfinite(jac).all():
                return None
            near = decompose(jac)
    return None


def finish(
    system: ConditionSystem,
    x: Vector,
    movable: Indices,
    *,
    ftol: float = _FTOL,
    damping: float = _FIRST_DAMPING,
    iterations: int = _MAX_ITERATIONS,
) -> tuple[Vector, float]:
    """Return where Levenberg–Marquardt steps of the entries `movable` lead, and f there."""
    residual = system.residual(x)
    f = float(residual @ residual)
    largest, history = max(_MAX_DAMPING, 1e4 * damping), [f]
    steps: DampedSteps | None = None

    def after(step: Vector) -> Vector:
        moved = x.copy()
        moved[movable] += step
        return moved

    for _ in range(iterations):
        if not ftol < f < np.inf or damping > largest:
            break
        if steps is None:
            steps = DampedSteps(system.jacobian(x)[:, movable], by_singular_values=True)
        steps.damp(damping)
        v = steps.step(residual)
        a = steps.acceleration(v, residual, system.residual(after(PROBE * v)))
        best = x
        for trial in (after(v + a / 2), after(v)) if is_straight(v, a) else (after(v),):
            trial_residual = system.residual(trial)
            trial_f = float(trial_residual @ trial_residual)
            if trial_f < f:
                best, residual, f, steps = trial, trial_residual, trial_f, None
        x = best
        if steps is not None:
            damping = 4 * max(damping, 1e-20)
            continue
        damping = max(damping / 5, _MIN_DAMPING)
        history.append(f)
        if len(history) > _PATIENCE and history[-_PATIENCE] < (1 + _MIN_GAIN) * f:
            break
    return x, f
