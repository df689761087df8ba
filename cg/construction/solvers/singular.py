"""Steps close to solutions, made of singular values of the Jacobian.

Order conditions depend on each other, and trees of points often have fewer unknowns than there
are conditions. Singular values that count go down to 1e-9 of the largest; those that do not are
rounding. Normal equations, which square them, stall between sums of squares of 1e-15 and 1e-21;
what is here goes on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from .damped import PROBE, DampedSteps, is_straight
from .system import ConditionSystem

__all__ = ["Decomposition", "decompose", "finish", "pseudo_inverse", "retract"]

Vector = NDArray[np.float64]
Indices = NDArray[np.intp]

_RANK_TOLERANCE = 1e-11  # of the largest singular value; rounding leaves 1e-15
_FAR = 1e-4  # sum of squares above which Newton's steps aren't tried

_FIRST_DAMPING, _MIN_DAMPING, _MAX_DAMPING = 1e-14, 1e-30, 1e-2  # relative
_PATIENCE, _MIN_GAIN = 15, 0.05  # so many steps must gain this fraction


@dataclass(frozen=True)
class Decomposition:
    """A Jacobian of shape (m, n) for what follows.

    Attributes
    ----------
    inverse : ndarray, shape (n, m)
        Its pseudo-inverse, singular values below 1e-11 of the largest left out.
    kernel : ndarray, shape (n, n - rank)
        An orthonormal basis of what the others don't see.
    """

    inverse: Vector
    kernel: Vector

    @property
    def rank(self) -> int:
        """Singular values that count."""
        return int(np.subtract(*self.kernel.shape))


def pseudo_inverse(jac: Vector, rcond: float) -> tuple[Vector, int]:
    """Return the pseudo-inverse of a matrix and its numerical rank.

    Parameters
    ----------
    jac : ndarray, shape (m, n)
    rcond : float
        Singular values below this fraction of the largest count as zero.
    """
    left, values, right = linalg.svd(jac, full_matrices=False)
    rank = int(np.sum(values > rcond * values.max(initial=0.0)))
    return (right[:rank].T / values[:rank]) @ left[:, :rank].T, rank


def decompose(jac: Vector) -> Decomposition:
    """Return the pseudo-inverse and the kernel of a Jacobian, shape (m, n)."""
    if jac.shape[0] > jac.shape[1]:  # less work than with the tall one
        basis, square = linalg.qr(jac, mode="economic", check_finite=False)
        left, values, right = linalg.svd(square, check_finite=False)
        left = basis @ left
    else:
        left, values, right = linalg.svd(jac, check_finite=False)
    rank = int(np.sum(values > _RANK_TOLERANCE * values[0])) if values.size else 0
    inverse = (right[:rank].T / values[:rank]) @ left[:, :rank].T
    return Decomposition(inverse, right[rank:].T)


def retract(
    system: ConditionSystem,
    x: Vector,
    free: Indices,
    near: Decomposition,
    *,
    ftol: float = 1e-27,
    renewals: int = 4,
) -> Vector | None:
    """Return to the solution set by Newton's steps of least norm.

    Parameters
    ----------
    system : ConditionSystem
    x : ndarray, shape (n,)
        Packed weights close to the set.
    free : ndarray of int
        Entries that may change.
    near : Decomposition
        Of the Jacobian's columns `free` at a point close by: it serves as long as steps gain
        much, which saves most of the work.
    ftol : float, optional
        Sum of squares to reach.
    renewals : int, optional
        How often the Jacobian is taken anew.

    Returns
    -------
    ndarray, shape (n,), or None
        None if the sum of squares stays above `ftol`.
    """
    residual = system.residual(x)
    f = float(residual @ residual)
    for renewal in range(renewals + 1):
        slow = False
        while not slow and ftol * 1e-3 < f:
            if not f < _FAR:
                return None
            trial = x.copy()
            trial[free] -= near.inverse @ residual
            trial_residual = system.residual(trial)
            trial_f = float(trial_residual @ trial_residual)
            if not trial_f < f:
                break
            slow = trial_f > 0.03 * f
            x, residual, f = trial, trial_residual, trial_f
        if f < ftol:
            return x
        if renewal < renewals:
            jac = system.jacobian(x)[:, free]
            if not np.isfinite(jac).all():
                return None
            near = decompose(jac)
    return None


def finish(
    system: ConditionSystem,
    x: Vector,
    free: Indices,
    *,
    ftol: float = 1e-27,
    max_iterations: int = 60,
) -> tuple[Vector, float]:
    """Go the last stretch to a zero by Levenberg–Marquardt steps with geodesic acceleration.

    Parameters
    ----------
    system : ConditionSystem
    x : ndarray, shape (n,)
        Packed weights.
    free : ndarray of int
        Entries that may change.
    ftol : float, optional
        Sum of squares at which to stop.
    max_iterations : int, optional

    Returns
    -------
    x : ndarray, shape (n,)
    f : float
        Sum of squares there.
    """
    residual = system.residual(x)
    f = float(residual @ residual)
    damping, history = _FIRST_DAMPING, [f]
    steps: DampedSteps | None = None

    def after(step: Vector) -> Vector:
        moved = x.copy()
        moved[free] += step
        return moved

    for _ in range(max_iterations):
        if not ftol < f < np.inf or damping > _MAX_DAMPING:
            break
        if steps is None:
            steps = DampedSteps(system.jacobian(x)[:, free], by_singular_values=True)
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
